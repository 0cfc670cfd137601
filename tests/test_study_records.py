"""What a study leaves behind: tables that BIDS tools read, what played, and answers of strength and outlines."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import time
from dataclasses import replace

import numpy as np
import pytest
from test_rendering import waves
from test_study_session import GRID, opened, silent, small, study

pd = pytest.importorskip("pandas")
pytest.importorskip("statsmodels")

from forearm_fem.errors import DataError, HardwareError, ScenarioError  # noqa: E402
from forearm_fem.measurement.loopback import Loopback  # noqa: E402
from forearm_fem.measurement.sound import SoundCard  # noqa: E402
from forearm_fem.measurement.virtual import VirtualDaq, VirtualOptions  # noqa: E402
from forearm_fem.rendering import InverseFilter, drives, render_all, ricker  # noqa: E402
from forearm_fem.scenario import parse_scenario  # noqa: E402
from forearm_fem.scenario.measurement import DaqOptions  # noqa: E402
from forearm_fem.study.adaptive import Track  # noqa: E402
from forearm_fem.study.analysis import outline, with_errors  # noqa: E402
from forearm_fem.study.devices import back_end  # noqa: E402
from forearm_fem.study.order import Trial, trials  # noqa: E402
from forearm_fem.study.percept import Felt, Percept, SimulatedParticipant  # noqa: E402
from forearm_fem.study.plan import Adaptive, Order, Stimuli, Study, Task  # noqa: E402
from forearm_fem.study.report import write_analysis  # noqa: E402
from forearm_fem.study.run import answer_of, answers_of  # noqa: E402
from forearm_fem.study.session import Given, Presented, Session  # noqa: E402
from forearm_fem.study.stimuli import DevicePlayer, Stimulus, stimuli_for  # noqa: E402
from forearm_fem.study.store import StudyStore  # noqa: E402
from forearm_fem.transfer import TransferMatrix  # noqa: E402

SQUARE = np.array([[-5, -5], [5, -5], [5, 5], [-5, 5]]) * 1e-3


@pytest.fixture
def answered(tmp_path):
    """Two participants, a task of points and one of outlines, each in two sittings; the first device is known."""
    plan = study(
        stimuli=Stimuli(methods=("funneling", "combination"), targets=("1", "5", "9")),
        tasks=(
            Task(name="places", repetitions=2, blocks=2, training=0, break_seconds=0.0),
            Task(name="drawn", answer="drawing", repetitions=2, blocks=1, training=0),
        ),
    )
    store = StudyStore.open(tmp_path / "data", plan)
    for who in ("01", "02"):
        store.enrol(who, consent="2026-11-24", added="2026-11-24")
        for task in plan.tasks:
            for _ in range(2):
                _half(Session(store, who, task, GRID, silent, back_end=known()))
    return store


def known():
    return back_end(SoundCard(256, module=_Card()), DaqOptions(outputs=("1",)), 48e3, cable())


class _Card:
    def query_devices(self, device):
        return {"name": "card"}


def cable():
    return Loopback(96.0, 0.97, 0.01, "sound card card", 48e3, "2026-11-24T10:00:00+00:00")


def _half(session):
    for _ in range(6):
        session.start()
        session.present()
        at = np.array(next(p.position[:2] for p in GRID if p.name == session.current.target))
        drawn = session.task.answer == "drawing"
        session.answer(Given(strokes=at + SQUARE) if drawn else Given(points=(session.current.target,)))


def test_tables_are_as_bids_wants_them(answered):
    """Names, places, first columns, order of onsets, n/a for what is missing, and each column in a dictionary."""
    root = answered.folder
    people = pd.read_csv(root / "participants.tsv", sep="\t", dtype=str)
    assert next(iter(people)) == "participant_id"
    assert sorted(people["participant_id"]) == sorted(p.name for p in root.glob("sub-*"))
    files = sorted(root.glob("sub-*/beh/*.tsv"))
    assert [f.name for f in files] == [
        f"sub-{w}_task-{t}_events.tsv" for w in ("01", "02") for t in ("drawn", "places")
    ]
    for file in [*files, root / "participants.tsv", root / "devices.tsv"]:
        table = pd.read_csv(file, sep="\t", dtype=str, keep_default_na=False)
        told = json.loads(file.with_suffix(".json").read_text(encoding="utf-8"))
        assert set(table) <= set(told)
        assert all(told[c]["Description"] for c in table)
        assert not (table == "").any().any()
        if file.name.endswith("events.tsv"):
            assert list(table)[:2] == ["onset", "duration"]
            assert np.all(np.diff(table["onset"].astype(float)) > 0)  # over both sittings
            assert told["duration"]["Units"] == "s"
            assert "Units" not in told["method"]
    about = json.loads((root / "dataset_description.json").read_text())
    assert {"Name", "BIDSVersion", "DatasetType"} <= set(about)
    ignored = (root / ".bidsignore").read_text().split()
    assert {"study.json", "devices.tsv"} <= set(ignored)


@pytest.mark.skipif(
    shutil.which("bids-validator-deno") is None, reason="no validator; `pip install bids-validator-deno` brings it"
)
def test_the_official_validator_finds_no_error(answered):
    done = subprocess.run(
        ["bids-validator-deno", "--json", str(answered.folder)], capture_output=True, text=True, check=False
    )
    issues = json.loads(done.stdout)["issues"]["issues"]
    assert [i for i in issues if i["severity"] == "error"] == []


def test_a_full_disk_refuses_the_answer_and_it_can_be_given_again(tmp_path, monkeypatch):
    """The line is written and then cannot be flushed: it is taken back, so that the second one stands alone."""
    session = opened(tmp_path, small())
    session.start()
    session.present()
    session.answer(Given(points=("1",)))
    session.present()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", _full)
        with pytest.raises(DataError, match=r"cannot be written \(No space left on device\); make room"):
            session.answer(Given(points=("5",)))
    assert session.view()["waiting"] == "answer"
    session.answer(Given(points=("5",)))
    assert [r["response"] for r in opened(tmp_path, small())._store.answers("01", "places")] == ["1", "5"]


def _full(_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_what_played_is_kept_before_the_first_answer(answered):
    rows = answered.devices()
    assert [(r["participant_id"], r["task"], r["session"]) for r in rows[:3]] == [
        ("sub-01", "places", "1"), ("sub-01", "places", "2"), ("sub-01", "drawn", "1"),
    ]  # fmt: skip
    assert {r["latency"] for r in rows} == {"0.002"}  # 96 samples at 48 kHz
    assert {r["latency_basis"] for r in rows} == {"measured"}
    assert {r["gain"] for r in rows} == {"0.97"}


def test_what_was_not_measured_is_unknown_and_analysis_says_so(tmp_path):
    card = SoundCard(256, module=_Card())
    blank = back_end(card, DaqOptions(outputs=("1",)), 48e3, None)
    assert np.isnan(blank.latency)
    assert blank.latency_basis == "unknown"
    assert back_end(card, DaqOptions(outputs=("1",), latency=0.01), 48e3, None).latency_basis == "declared"
    g = TransferMatrix(np.array([50.0, 100.0]), np.ones((2, 9, 1), dtype=complex), GRID, (GRID[0],))
    virtual = back_end(VirtualDaq(g, 1000.0, 0.1, VirtualOptions(latency=7)), DaqOptions(), 1000.0, None)
    assert (virtual.latency, virtual.latency_basis) == (7e-3, "known")
    store = StudyStore.open(tmp_path, small())
    store.enrol("01", consent="2026-11-24", added="2026-11-24")
    _half(Session(store, "01", store.study.tasks[0], GRID, silent, back_end=blank))
    page = write_analysis(
        store.study, {"places": answers_of(store, "places")}, GRID, tmp_path, devices=store.devices()
    ).read_text()
    row = page[page.index("What played") :]
    assert "sound card card" in row
    assert row.count("<td>unknown</td>") >= 3  # latency, how, gain
    (tmp_path / "devices.tsv").unlink()
    page = write_analysis(store.study, {"places": answers_of(store, "places")}, GRID, tmp_path, devices=[]).read_text()
    assert page[page.index("What played") :].count("<td>unknown</td>") >= 4


def test_withdrawal_takes_the_devices_too(answered):
    answered.withdraw("01")
    assert {r["participant_id"] for r in answered.devices()} == {"sub-02"}
    assert not (answered.folder / "sub-01").exists()


def test_withdrawal_takes_what_an_analysis_made_of_the_answers(answered):
    """Its tables hold every trial of every participant."""
    write_analysis(answered.study, {"places": answers_of(answered, "places")}, GRID, answered.folder)
    assert list((answered.folder / "analysis").glob("*-trials.csv"))
    (answered.folder / "analysis" / "notes.txt").write_text("of the experimenter's own")
    answered.withdraw("01")
    assert [f.name for f in (answered.folder / "analysis").iterdir()] == ["notes.txt"]


def test_answers_of_0_14_0_are_read_and_go_on(tmp_path):
    """Its tables lay in the participant's folder and had two columns less."""
    session = opened(tmp_path, small())
    session.start()
    session.present()
    session.answer(Given(points=("5",)))
    new = session._store.events_file("01", "places")
    table = pd.read_csv(new, sep="\t", dtype=str, keep_default_na=False)
    old = new.parents[1] / new.name
    table.drop(columns=["comparison", "response_outline"]).to_csv(old, sep="\t", index=False)
    shutil.rmtree(new.parent)
    again = opened(tmp_path, small())
    assert again.view()["answered"] == 1
    again.start()
    again.present()
    again.answer(Given(points=("1",)))
    rows = again._store.answers("01", "places")
    assert [r["response"] for r in rows] == ["5", "1"]
    assert {r["comparison"] for r in rows} == {"n/a"}
    assert not new.exists()


def test_outlines_are_kept_and_judged(answered):
    """Squares of 1 cm2 about each target hold it; moved by 8 mm they do not."""
    table = answers_of(answered, "drawn")
    main = with_errors(table, GRID)
    assert main["inside"].all()
    assert main["error"].to_numpy() == pytest.approx(np.zeros(len(main)), abs=1e-8)
    first = outline(table["response_outline"][0])
    target = 1e3 * np.array(next(p.position[:2] for p in GRID if p.name == table["target"][0]))
    assert first - target == pytest.approx(1e3 * SQUARE)
    away = " ".join(f"{x + 8:.2f},{y:.2f}" for x, y in first)
    table.loc[0, "response_outline"] = away
    assert with_errors(table, GRID)["inside"].tolist() == [False] + [True] * (len(table) - 1)
    with pytest.raises(DataError, match="expected pairs 'x,y'"):
        outline("1,2 3")
    page = write_analysis(answered.study, {"drawn": table}, GRID, answered.folder, devices=answered.devices())
    made = {p.name for p in page.parent.glob("*.png")}
    assert {"drawn-areas.png", "drawn-outlines.png", "drawn-ellipses.png"} <= made
    assert "selected for larger answers" in page.read_text()


def strength(pause=0.0, **changes):
    options = {"reference": "funneling", "low": -12.0, "high": 12.0, "step": 1.0, "trials": 40, **changes}
    task = Task(
        name="strength", answer="first or second", repetitions=1, blocks=1, training=0, adaptive=Adaptive(**options)
    )
    return study(
        stimuli=Stimuli(methods=("funneling", "combination"), targets=("5",), pause=pause),
        order=Order(no_target_twice=False),
        tasks=(task,),
    )


def test_a_stimulus_is_over_with_its_last_wavelet(tmp_path):
    """From then on the response's clock runs: silence stands between wavelets and between two stimuli that are
    compared, and none after the last."""
    session = opened(tmp_path, strength(pause=0.1), lambda method, target, level: Presented(0.2, 1.0))
    session.start()
    before = time.monotonic()
    session.present()
    assert time.monotonic() - before >= 0.1
    session.answer(Given(interval="first"))
    (row,) = session._store.answers("01", "strength")
    assert float(row["duration"]) == pytest.approx(0.2 + 0.1 + 0.2)


def pair(ratio_db):
    """A participant to whom a combination feels ``ratio_db`` stronger than funneling at level 0."""
    louder = 10 ** (ratio_db / 10)
    energy = {("funneling", "5"): np.ones((2, 9)), ("combination", "5"): louder * np.ones((2, 9))}
    felt = Felt(np.array([p.position[:2] for p in GRID]), np.ones(9), energy)
    return SimulatedParticipant(Percept(lapse=0.0), felt, GRID, np.random.default_rng(2))


@pytest.mark.parametrize("rule", ["QUEST+", "staircase"])
def test_equal_strength_is_found_where_it_is(tmp_path, rule):
    """A combination that is 5 dB stronger matches funneling at -5 dB, funneling itself at 0: three deviations. The
    staircase goes down after one answer, for 50 %."""
    if rule == "QUEST+":
        pytest.importorskip("questplus")
    plan = strength(rule=rule, down=1)
    played = []

    def player(method, target, level):
        played.append((method, level))
        return Presented(0.2, 1.0)

    session, person = opened(tmp_path, plan, player), pair(5.0)
    while session.view()["waiting"] != "done":
        session.start()
        session.present()
        trial = session.current
        first, second = played[-2:]
        reference = second if trial.comparison == "first" else first
        assert reference == ("funneling", 0.0)
        session.answer(answer_of(person, session.task, trial, session.level))
    rows = session._store.answers("01", "strength")
    assert {r["comparison"] for r in rows} == {"first", "second"}
    assert {r["duration"] for r in rows} == {"0.4"}
    for found in session._track.thresholds():
        wanted = -5.0 if found.method == "combination" else 0.0
        assert found.trials == 40
        assert abs(found.level - wanted) < 3 * found.deviation + 0.5  # half a step
    again = opened(tmp_path, plan, player)
    assert again._track.thresholds() == session._track.thresholds()


def test_a_staircase_by_hand():
    """Two yes down, one no up, from the top; too few reversals tell nothing, and levels stay within their ends."""
    task = Task(name="d", answer="yes or no", repetitions=1, blocks=1, training=0,
                adaptive=Adaptive(rule="staircase", low=-6.0, high=0.0, step=2.0, down=2))  # fmt: skip
    track, trial = Track.of(task, []), Trial(1, "main", 1, "m", "5", 1)
    levels = []
    for yes in [True, True, True, True, False, True, True, False, False, False, False]:
        levels.append(track.next(trial))
        track.update(trial, levels[-1], yes)
    assert levels == [0, 0, -2, -2, -4, -2, -2, -4, -2, 0, 0]
    (found,) = track.thresholds()
    assert np.isnan(found.level)


def track_of(options, level, trials, rng, lapse=0.02, guess=0.05):
    """A track after answers of somebody whose Weibull threshold, of slope 3.5, is at ``level`` [dB]."""
    task = Task(name="d", answer="yes or no", repetitions=1, blocks=1, training=0, adaptive=options)
    track, trial = Track.of(task, []), Trial(1, "main", 1, "m", "5", 1)
    for _ in range(trials):
        at = track.next(trial)
        chance = guess + (1 - guess - lapse) * (1 - np.exp(-(10 ** (3.5 * (at - level) / 20))))
        track.update(trial, at, bool(rng.random() < chance))
    return track.thresholds()[0]


def test_a_staircase_states_what_it_scatters_by():
    """Fine steps make neighbouring reversals alike: their own scatter over sqrt(n) said 0.44 dB of 0.79. 150 tracks
    know a standard deviation to 6 %, the simulated ones to 5 %; their level is known to an eighth of a step."""
    rng, options = np.random.default_rng(5), Adaptive(rule="staircase", low=-30.0, high=0.0, step=1.0, down=1)
    found = [track_of(options, -15.3, 40, rng) for _ in range(150)]
    stated = np.sqrt(np.mean([f.deviation**2 for f in found]))
    assert stated == pytest.approx(np.std([f.level for f in found], ddof=1), rel=0.25)


def test_a_staircase_that_has_not_arrived_says_nothing():
    """Two yes to a step of 1 dB from 0: forty trials barely come to -14.8 dB, and reversals by lapses on the way were
    told as up to 9 deviations of it. Those told that have just arrived lean upwards by up to four, still."""
    rng, options = np.random.default_rng(6), Adaptive(rule="staircase", low=-30.0, high=0.0, step=1.0, down=2)
    found = [f for f in (track_of(options, -15.3, 40, rng) for _ in range(100)) if np.isfinite(f.level)]
    assert len(found) < 40
    assert max(abs(f.level + 14.8) / f.deviation for f in found) < 5


@pytest.mark.parametrize("rule", ["QUEST+", "staircase"])
@pytest.mark.parametrize(("level", "side"), [(9.0, "above"), (-50.0, "below")])
def test_a_threshold_beyond_the_levels_is_no_number(rule, level, side):
    """QUEST+ told it as 0.0 dB, give or take 0.0: it knows no other levels."""
    if rule == "QUEST+":
        pytest.importorskip("questplus")
    rng, options = np.random.default_rng(7), Adaptive(rule=rule, low=-30.0, high=0.0, step=2.0)
    found = track_of(options, level, 60, rng)
    assert np.isnan([found.level, found.deviation]).all()
    assert found.beyond == side  # also where a staircase has not reversed at all


def test_strength_needs_a_reference_and_detection_none():
    with pytest.raises(ScenarioError, match=r"adaptive.reference go together"):
        Task(name="s", answer="first or second", adaptive=Adaptive())
    with pytest.raises(ScenarioError, match=r"adaptive.reference go together"):
        Task(name="s", answer="yes or no", adaptive=Adaptive(reference="funneling"))
    with pytest.raises(ScenarioError, match=r"is not among stimuli\.methods"):
        Study(name="a", scenario="b", stimuli=Stimuli(methods=("combination",)), tasks=strength().tasks)


def test_stimuli_on_a_g_with_holes_are_those_of_a_run():
    """Bins that were not measured are bridged before anything is aimed, as `render` does: undriven, a hole of three of
    123 rings through the record and moves the drives by per cents."""
    g, shape = waves(np.arange(12.0, 500.1, 4.0)), ricker(duration=0.25)
    valid = np.ones(g.values.shape, dtype=bool)
    valid[[20, 45, 70]] = False
    holed = replace(g, valid=valid, values=np.where(valid, g.values, np.nan))
    scenario = parse_scenario({"sweep": {"duration": 0.25}})
    wanted = Stimuli(methods=("inverse filter",), targets=("5",), lead=0.1, tail=0.1)
    expected = render_all(holed, ("5",), (InverseFilter(),), shape)["inverse filter", "5"]
    kept = np.abs(shape.record.time) <= 0.1
    found = stimuli_for(holed, scenario, wanted, shape)["inverse filter", "5"]
    for ours, theirs in ((found.signals, expected.drives.signals), (found.moved, expected.displacements.values)):
        np.testing.assert_allclose(ours, theirs[:, kept], atol=1e-9 * np.abs(theirs).max())
    undriven = drives(InverseFilter(), holed, "5", shape).signals[:, kept]
    assert np.abs(undriven - found.signals).max() > 0.01 * np.abs(found.signals).max()


def test_a_g_of_arbitrary_gain_makes_no_stimulus_of_micrometres():
    """Its drives would be volts by a scale that nobody knows; a peak of the drives needs none."""
    g, shape = replace(waves(np.arange(12.0, 500.1, 4.0)), provenance={"gain": "arbitrary"}), ricker(duration=0.25)
    scenario = parse_scenario({"sweep": {"duration": 0.25}})
    wanted = {"methods": ["inverse filter"], "targets": ["5"]}
    for level in ({"rule": "target peak", "value": 2.0}, {}):
        with pytest.raises(ScenarioError, match=r"set stimuli\.level\.rule = 'drive peak'"):
            stimuli_for(g, scenario, Stimuli.model_validate({**wanted, "level": level}), shape)
    asked = Stimuli.model_validate({**wanted, "level": {"rule": "drive peak", "value": 0.5}})
    made = stimuli_for(g, scenario, asked, shape)["inverse filter", "5"]
    assert np.abs(made.signals).max() == pytest.approx(0.5)


def test_levels_that_a_task_may_ask_for_are_refused_before_the_session():
    """A drive of 1 V raised by 12 dB is 4 V; the limit is 2.5 V."""
    g = TransferMatrix(np.array([50.0, 100.0]), np.ones((2, 1, 1), dtype=complex), GRID[:1], (GRID[0],))
    daq, options = VirtualDaq(g, 1000.0, 0.1, VirtualOptions()), DaqOptions(outputs=("a",))
    stimuli = {("funneling", "5"): Stimulus(np.ones((1, 100)), np.ones((1, 100)))}
    DevicePlayer(daq, stimuli, 1000.0, options, Stimuli())
    with pytest.raises(HardwareError, match=r"needs 3\.98 V, the limit is 2\.5 V"):
        DevicePlayer(daq, stimuli, 1000.0, options, Stimuli(), loudest=12.0)


@pytest.mark.parametrize(("repeats", "lasts"), [(1, 0.1), (3, 0.9)])
def test_what_is_played_ends_with_its_last_wavelet(repeats, lasts):
    """Wavelets of 0.1 s, 0.3 s of silence between them and none after."""
    g = TransferMatrix(np.array([50.0, 100.0]), np.ones((2, 1, 1), dtype=complex), GRID[:1], (GRID[0],))
    daq, options = VirtualDaq(g, 1000.0, 0.1, VirtualOptions()), DaqOptions(outputs=("a",))
    stimuli = {("funneling", "5"): Stimulus(np.ones((1, 100)), np.ones((1, 100)))}
    player = DevicePlayer(daq, stimuli, 1000.0, options, Stimuli(repeats=repeats, pause=0.3))
    assert player("funneling", "5", 0.0).seconds == pytest.approx(lasts)


def test_intervals_are_balanced_by_chance_and_the_same_again():
    plan = strength()
    order = trials(plan, plan.tasks[0], "01")
    share = np.mean([t.comparison == "first" for t in order])
    assert 0.3 < share < 0.7  # 80 tosses: 3.6 standard deviations
    again = trials(plan, plan.tasks[0], "01")
    assert [t.comparison for t in order] == [t.comparison for t in again]
    assert all(t.comparison is None for t in trials(small(), small().tasks[0], "01"))
