"""A study's order, what a session keeps, and that no answer is lost, doubled or misplaced."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forearm_fem.errors import DataError, HardwareError, ScenarioError
from forearm_fem.ports import Port
from forearm_fem.study.plan import Order, Stimuli, Study, Task, balanced, load_study, tasks_of, trials
from forearm_fem.study.session import Presented, Session
from forearm_fem.study.store import StudyStore

GRID = tuple(
    Port(str(3 * r + c + 1), "point", (0.01 * (r - 1), 0.01 * (c - 1), 0.0)) for r in range(3) for c in range(3)
)


def study(**changes):
    return Study(name="pilot", scenario="thesis.toml", **changes)


def small(targets=("1", "5", "9"), **task):
    options = {"name": "places", "repetitions": 2, "blocks": 2, "training": 0, "break_seconds": 0.0, **task}
    return study(stimuli=Stimuli(methods=("funneling",), targets=targets), tasks=(Task(**options),))


def silent(method, target):
    return Presented(0.2, 1.0)


def opened(folder, plan, player=silent, participant="01"):
    store = StudyStore.open(folder, plan)
    store.enrol(participant, consent="2026-11-24")
    return Session(store, participant, plan.tasks[0], GRID, player)


def answer_one(session, name="5"):
    session.start()
    session.present()
    session.answer((name,))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(["mixed", "one after the other"]), st.integers(1, 3))
def test_every_block_holds_everything_equally_and_no_target_twice_in_a_row(seed, methods, per_block):
    """The thesis' 81 trials, and others: what any seed must keep."""
    task = Task(name="identification", repetitions=3 * per_block, blocks=3, training=0)
    plan = study(order=Order(seed=seed, methods=methods), tasks=(task,))
    order = trials(plan, task, 7)
    assert len(order) == 81 * per_block
    for block in (1, 2, 3):
        counts = Counter((t.method, t.target) for t in order if t.block == block)
        assert len(counts) == 27
        assert set(counts.values()) == {per_block}
    assert all(a.target != b.target for a, b in itertools.pairwise(order))
    assert order == trials(plan, task, 7)
    assert order != trials(plan, task, 8)


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_a_williams_square_balances_positions_and_followers(count):
    """Over n rows (2 n for odd n) each item stands as often at each position, and after each other one."""
    items, rows = tuple("abcde"[:count]), count if count % 2 == 0 else 2 * count
    square = [balanced(items, k) for k in range(rows)]
    assert set(Counter((k, m) for row in square for k, m in enumerate(row)).values()) == {rows // count}
    follows = Counter(pair for row in square for pair in itertools.pairwise(row))
    assert len(follows) == count * (count - 1)
    assert set(follows.values()) == {rows // count}


def test_orders_of_400_participants_are_balanced_in_every_block_and_task():
    """Of 400 participants each of six orders of three methods comes 66 or 67 times in each block of each task; blocks
    and tasks of one participant differ; the two orders of tasks come 200 times each; mixed first methods are even by
    chance (133 with a standard deviation of 9.4)."""
    plan = study(order=Order(methods="one after the other", tasks="balanced"))
    seen, firsts = {}, Counter()
    for place in range(1, 401):
        own = []
        for task in plan.tasks:
            order = trials(plan, task, place)
            assert {t.block for t in order} == {0, 1, 2, 3}
            assert all(a.target != b.target for a, b in itertools.pairwise(order))
            for block in (1, 2, 3):
                methods = tuple(dict.fromkeys(t.method for t in order if t.block == block))
                seen.setdefault((task.name, block), Counter())[methods] += 1
                own.append(methods)
        assert len(set(own)) == 6
        firsts[trials(study(), study().tasks[0], place)[0].method] += 1
    assert all(set(c.values()) <= {66, 67} and len(c) == 6 for c in seen.values())
    assert Counter(tasks_of(plan, k)[0].name for k in range(1, 401)) == {"identification": 200, "confidence": 200}
    assert max(firsts.values()) - min(firsts.values()) < 80


def test_balance_follows_the_place_in_the_study_and_not_the_pseudonym(tmp_path):
    """Ids without digits, or with the same ones, got one order."""
    store = StudyStore.open(tmp_path, plan := study(order=Order(methods="one after the other")))
    for name in ("A1", "B1", "C1", "anna", "berta", "carla"):
        store.enrol(name, consent="2026-11-24")
    places = [store.place(n) for n in ("A1", "B1", "C1", "anna", "berta", "carla")]
    assert places == [1, 2, 3, 4, 5, 6]
    first = Counter(trials(plan, plan.tasks[0], p)[0].method for p in places)
    assert set(first.values()) == {2}


def test_an_order_that_cannot_be_is_named():
    with pytest.raises(ScenarioError, match="cannot be met in task identification with one target"):
        study(stimuli=Stimuli(targets=("5",)))  # before anybody is enrolled, whichever task comes first


def test_a_session_goes_on_at_the_same_trial(tmp_path):
    plan = small()
    first = opened(tmp_path, plan)
    for _ in range(2):
        answer_one(first)
    second = opened(tmp_path, plan)
    assert second.current == first.current
    assert second.view()["answered"] == 2
    while second.view()["waiting"] != "done":
        answer_one(second)
    rows = StudyStore.open(tmp_path, plan).answers("01", "places")
    assert [int(r["trial"]) for r in rows] == list(range(1, 7))
    assert {r["session"] for r in rows} == {"1", "2"}


@pytest.mark.parametrize("cut", [1, 5, 40])
def test_a_line_cut_short_is_presented_anew(tmp_path, cut):
    """A power cut in the middle of a line: that trial counts as never answered, the others stay."""
    plan = small()
    session = opened(tmp_path, plan)
    answer_one(session)
    answer_one(session)
    file = session._store.events_file("01", "places")
    file.write_bytes(file.read_bytes()[:-cut])
    again = opened(tmp_path, plan)
    assert again.view()["answered"] == 1
    answer_one(again)
    assert [r["trial"] for r in again._store.answers("01", "places")] == ["1", "2"]


_KILLED = """
import os, sys, signal, threading, random
sys.path.insert(0, sys.argv[3])
import test_study_session as t
plan = t.small(repetitions=8, blocks=1)
session = t.opened(sys.argv[1], plan)
moment = random.Random(int(sys.argv[2])).uniform(0.0, 0.06)
threading.Timer(moment, lambda: os.kill(os.getpid(), signal.SIGKILL)).start()
while session.view()["waiting"] != "done":
    t.answer_one(session, "5")
    print(session.view()["answered"], flush=True)
"""


@pytest.mark.parametrize("count", [2, pytest.param(20, marks=pytest.mark.slow)])
def test_killed_at_random_moments_no_answer_is_lost_or_doubled(tmp_path, count):
    """What the session said was answered is on disk after SIGKILL, in the order planned, each trial once."""
    plan = small(repetitions=8, blocks=1)
    expected = trials(plan, plan.tasks[0], 1)
    said = 0
    for seed in range(count):
        done = subprocess.run(
            [sys.executable, "-c", _KILLED, str(tmp_path), str(seed), os.path.dirname(__file__)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        said = max([said, *map(int, done.stdout.split())])
        session = opened(tmp_path, plan)
        rows = session._store.answers("01", "places")
        assert len(rows) >= said
        assert [(r["trial"], r["target"]) for r in rows] == [(str(t.number), t.target) for t in expected[: len(rows)]]


def test_a_changed_study_file_is_refused(tmp_path):
    answer_one(opened(tmp_path, small()))
    with pytest.raises(DataError, match="the study file was changed after data were taken"):
        StudyStore.open(tmp_path, small(repetitions=4))


def test_until_somebody_takes_part_the_study_may_change_and_looking_writes_nothing(tmp_path):
    """``study status`` begins no data, and a session that was refused binds nobody."""
    StudyStore.open(tmp_path / "data", small(), begin=False)
    assert not (tmp_path / "data").exists()
    StudyStore.open(tmp_path, small())
    answer_one(opened(tmp_path, small(repetitions=4)))
    assert len(StudyStore.open(tmp_path, small(repetitions=4), begin=False).people()) == 1


@pytest.mark.parametrize("consent", ["yesterday", "2026-02-30", "24-11-2026"])
def test_consent_is_a_day(tmp_path, consent):
    with pytest.raises(DataError, match="expects the date of signing"):
        StudyStore.open(tmp_path, small()).enrol("01", consent=consent)
    assert not (tmp_path / "participants.tsv").exists()


@pytest.mark.parametrize(("name", "content"), [("study.json", b'{"name": "pi'), ("participants.tsv", b"p\xfc\n")])
def test_a_damaged_table_or_study_is_a_sentence(tmp_path, name, content):
    """Cut short by a full disk, or saved anew in another encoding by a spreadsheet."""
    opened(tmp_path, small())
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=f"{name}: (damaged|is not in UTF-8)"):
        StudyStore.open(tmp_path, small()).people()


def test_answers_that_were_not_asked_are_refused_and_nothing_is_written(tmp_path):
    session = opened(tmp_path, small())
    with pytest.raises(DataError, match="no stimulus is due"):
        session.present()
    session.start()
    with pytest.raises(DataError, match="no answer is due"):
        session.answer(("5",))
    session.present()
    for bad, words in ((("5", "6"), "choose one point"), ((), "choose one point"), (("10",), "no grid point")):
        with pytest.raises(DataError, match=words):
            session.answer(bad)
    assert session._store.answers("01", "places") == []
    session.answer(("5",))
    with pytest.raises(DataError, match="no answer is due"):
        session.answer(("5",))
    assert len(session._store.answers("01", "places")) == 1


def test_a_dead_device_pauses_and_the_stimulus_comes_again(tmp_path):
    fails = iter([True, False])

    def player(method, target):
        if next(fails, False):
            raise HardwareError("the device stopped answering; check its cable")
        return Presented(0.2, 1.0)

    session = opened(tmp_path, small(), player)
    trial = session.current
    session.start()
    with pytest.raises(HardwareError):
        session.present()
    assert session.view()["waiting"] == "pause"
    assert "check its cable" in session.view()["problem"]
    answer_one(session)
    row = session._store.answers("01", "places")[0]
    assert row["target"] == trial.target
    assert row["presentations"] == "1"  # only what was played counts


def test_an_answer_that_cannot_be_written_waits_and_the_experimenter_is_told(tmp_path):
    session = opened(tmp_path, small())
    session.start()
    session.present()
    table = tmp_path / "sub-01" / "beh"
    table.parent.mkdir(parents=True, exist_ok=True)
    table.write_text("a file where the folder of answers would be")
    with pytest.raises(DataError, match="cannot be"):
        session.answer(("5",))
    assert session.view()["waiting"] == "answer"
    assert "sub-01" in session.view()["problem"]
    table.unlink()
    session.answer(("5",))
    assert session.view()["problem"] == ""
    assert len(session._store.answers("01", "places")) == 1


def test_pause_repeat_and_break(tmp_path):
    now = [0.0]
    plan = small(break_seconds=30.0)
    store = StudyStore.open(tmp_path, plan)
    store.enrol("01", consent="2026-11-24")
    session = Session(store, "01", plan.tasks[0], GRID, silent, clock=lambda: now[0])
    session.start()
    session.present()
    session.repeat()
    session.present()
    session.pause()
    assert session.view()["waiting"] == "pause"
    session.start()
    session.present()
    session.answer(("1",))
    assert store.answers("01", "places")[0]["presentations"] == "3"
    answer_one(session)
    answer_one(session)
    assert session.view()["waiting"] == "break"
    with pytest.raises(DataError, match="30 s longer"):
        session.start()
    now[0] = 31.0
    session.start()
    assert session.view()["waiting"] == "stimulus"


def test_what_pages_see_tells_neither_method_nor_target(tmp_path):
    session = opened(tmp_path, small())
    session.start()
    session.present()
    text = json.dumps(session.view())
    assert "funneling" not in text
    assert "target" not in text


def test_consent_and_withdrawal(tmp_path):
    store = StudyStore.open(tmp_path, small())
    with pytest.raises(DataError, match="no consent is recorded"):
        store.enrol("01")
    answer_one(opened(tmp_path, small()))
    store.withdraw("01")
    assert not store.events_file("01", "places").exists()
    assert store.people()[0]["status"] == "withdrawn"
    with pytest.raises(DataError, match="was withdrawn"):
        store.enrol("01", consent="2026-11-24")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name = 'a b'\nscenario = 'x'", "name"),
        ("name = 'a'\nscenario = 'x'\nwhat = 1", "what: unknown key"),
        ("name = 'a'\nscenario = 'x'\n[[tasks]]\nname = 't'\nrepetitions = 3\nblocks = 2", "does not divide"),
        ("name = 'a'\nscenario = 'x'\n[[tasks]]\nname = 't'\nanswer = 'yes or no'", "answer"),
        ("name = 'a'\nscenario = 'x'\n[stimuli]\ntargets = []", "targets"),
        ("name = 'a'\nscenario = 'x'\n[stimuli]\ntargets = ['1', '1']", "names one twice"),
        ("name = 'a'\nscenario = 'x'\n[stimuli]\nlevels = 'as rendered'\npeak = 1.0", "neither peak nor drive"),
        ("name = 'a'\nscenario = 'x'\n[stimuli.levels.funneling]\n1 = 2.0", "no dB for inverse filter"),
        ("name = ", "not valid TOML"),
    ],
)
def test_bad_study_files_get_one_sentence(tmp_path, text, words):
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(ScenarioError, match=words) as problem:
        load_study(file)
    assert len(str(problem.value)) - len(str(tmp_path)) < 300
    assert "\n" not in str(problem.value)
