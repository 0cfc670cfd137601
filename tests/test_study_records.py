"""What a study leaves behind: tables that BIDS tools read, what played, who takes part."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime

import numpy as np
import pytest
from test_study_session import GRID, opened, silent, small, study

pd = pytest.importorskip("pandas")

from forearm_fem.errors import DataError  # noqa: E402
from forearm_fem.measurement.playback import Loopback  # noqa: E402
from forearm_fem.measurement.sound import SoundCard  # noqa: E402
from forearm_fem.measurement.virtual import VirtualDaq, VirtualOptions  # noqa: E402
from forearm_fem.scenario.measurement import DaqOptions  # noqa: E402
from forearm_fem.study.handover import answers  # noqa: E402
from forearm_fem.study.plan import Order, Stimuli, Task  # noqa: E402
from forearm_fem.study.report import write_analysis  # noqa: E402
from forearm_fem.study.run import _due, known_of  # noqa: E402
from forearm_fem.study.session import Session  # noqa: E402
from forearm_fem.study.store import StudyStore  # noqa: E402
from forearm_fem.transfer import TransferMatrix  # noqa: E402


@pytest.fixture
def answered(tmp_path):
    """Two participants, two tasks, each in two sittings; the device is known."""
    plan = study(
        stimuli=Stimuli(methods=("funneling", "combination"), targets=("1", "5", "9")),
        tasks=(
            Task(name="places", repetitions=2, blocks=2, training=0, break_seconds=0.0),
            Task(name="several", answer="several points", repetitions=2, blocks=1, training=0),
        ),
    )
    store = StudyStore.open(tmp_path / "data", plan)
    for who in ("01", "02"):
        store.enrol(who, consent="2026-11-24")
        for task in plan.tasks:
            for _ in range(2):
                _half(Session(store, who, task, GRID, silent, columns=known()))
    return store


def known(cable=True):
    loop = Loopback(96.0, 0.97, 0.01, "sound card card", 48e3, "2026-11-24T10:00:00+00:00") if cable else None
    return known_of(SoundCard(256, module=_Card()), DaqOptions(outputs=("1",)), 48e3, loop)


class _Card:
    def query_devices(self, device):
        return {"name": "card"}


def _half(session):
    for _ in range(6):
        session.start()
        session.present()
        session.answer((session.current.target,))


def test_tables_are_as_bids_wants_them(answered):
    """Names, places, first columns, order of onsets, n/a for what is missing, and each column in a dictionary."""
    root = answered.folder
    people = pd.read_csv(root / "participants.tsv", sep="\t", dtype=str)
    assert next(iter(people)) == "participant_id"
    assert sorted(people["participant_id"]) == sorted(p.name for p in root.glob("sub-*"))
    files = sorted(root.glob("sub-*/beh/*.tsv"))
    assert [f.name for f in files] == [
        f"sub-{w}_task-{t}_events.tsv" for w in ("01", "02") for t in ("places", "several")
    ]
    for file in [*files, root / "participants.tsv"]:
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
    assert {"study.json", "stimuli/"} <= set(ignored)


@pytest.mark.skipif(
    shutil.which("bids-validator-deno") is None, reason="no validator; `pip install bids-validator-deno` brings it"
)
def test_the_official_validator_finds_no_error(answered):
    """With an analysis and exported stimuli in the folder, and a column of the laboratory's own."""
    write_analysis(answered.study, answers(answered), GRID, answered.folder)
    (answered.folder / "stimuli" / "sub-01").mkdir(parents=True)
    (answered.folder / "stimuli" / "sub-01" / "trials.csv").write_text("a,b\n1,2\n")
    answered.enrol("03", invited=True)
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
    session.answer(("1",))
    session.present()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", _full)
        with pytest.raises(DataError, match=r"cannot be written \(No space left on device\); make room"):
            session.answer(("5",))
    assert session.view()["waiting"] == "answer"
    session.answer(("5",))
    assert [r["response"] for r in opened(tmp_path, small())._store.answers("01", "places")] == ["1", "5"]


def _full(_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_what_plays_stands_in_each_trial_and_what_was_not_measured_is_unknown(answered, tmp_path):
    rows = answered.answers("01", "places")
    assert {(r["device"], r["latency"], r["cable_gain"]) for r in rows} == {("sound card card", "0.002", "0.97")}
    blank = known(cable=False)
    assert (blank["latency"], blank["cable_gain"]) == (None, None)
    card = SoundCard(256, module=_Card())
    assert known_of(card, DaqOptions(outputs=("1",), latency=0.01), 48e3, None)["latency"] == 0.01
    g = TransferMatrix(np.array([50.0, 100.0]), np.ones((2, 9, 1), dtype=complex), GRID, (GRID[0],))
    virtual = VirtualDaq(g, 1000.0, 0.1, VirtualOptions(latency=7))
    assert known_of(virtual, DaqOptions(), 1000.0, None)["latency"] == 7e-3
    store = StudyStore.open(tmp_path / "other", small())
    store.enrol("01", consent="2026-11-24")
    _half(Session(store, "01", store.study.tasks[0], GRID, silent, columns=blank))
    page = write_analysis(store.study, answers(store), GRID, tmp_path / "other").read_text()
    row = page[page.index("What played") :]
    assert "sound card card" in row
    assert row.count("<td>unknown</td>") == 2  # latency, gain


def test_withdrawal_takes_what_an_analysis_made_of_the_answers(answered):
    """Its tables hold every trial of every participant."""
    write_analysis(answered.study, answers(answered), GRID, answered.folder)
    assert list((answered.folder / "analysis").glob("*-trials.csv"))
    (answered.folder / "analysis" / "notes.txt").write_text("of the experimenter's own")
    answered.withdraw("01")
    assert [f.name for f in (answered.folder / "analysis").iterdir()] == ["notes.txt"]


def test_people_who_enrol_at_the_same_moment_get_places_of_their_own(tmp_path):
    """Two at once, tasks balanced: each sits down to the task of the own place. Without the lock the pause gave both
    the first one. The lock is the operating system's, on a file, so that threads stand for processes."""

    def sit(who):
        store = StudyStore.open(tmp_path, plan)
        with store.locked():
            task = _due(store, who, None)
            time.sleep(0.1)
            store.enrol(who, consent="2026-11-24")
        return store.place(who), task.name

    StudyStore.open(tmp_path, plan := study(order=Order(tasks="balanced")))
    with ThreadPoolExecutor(2) as pool:
        assert sorted(pool.map(sit, ("anna", "berta"))) == [(1, "identification"), (2, "confidence")]


def test_a_second_process_is_told_who_holds_the_participant(tmp_path):
    """A process of its own sits with participant 01; here 01 is refused by its number, 02 is not."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[2]); import test_study_session as t\n"
        "from forearm_fem.study.store import StudyStore\n"
        "with StudyStore.open(sys.argv[1], t.small()).sitting('01'):\n"
        "    print('held', flush=True); sys.stdin.read()\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path), os.path.dirname(__file__)]
    other = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert other.stdout.readline() == "held\n"
    store = StudyStore.open(tmp_path, small())
    try:
        with pytest.raises(DataError, match=f"process {other.pid} on .* holds this participant"), store.sitting("01"):
            pass
        with store.sitting("02"):
            pass
    finally:
        other.kill()
        other.communicate()
    with store.sitting("01"):  # a lock ends with its process, also by kill -9
        pass


def test_age_sex_and_columns_of_the_laboratory_are_kept(tmp_path):
    """BIDS' own columns broke the table, and so would any that a laboratory adds."""
    store = StudyStore.open(tmp_path, small())
    store.enrol("01", consent="2026-11-24", age=27, sex="F")
    file = tmp_path / "participants.tsv"
    head, row = file.read_text().splitlines()
    file.write_text(f"{head}\thandedness\n{row}\tR\n")
    store.enrol("02", consent="2026-11-25")
    store.enrol("02", age=31, sex="M")  # what was not known yet
    people = {p["participant_id"]: p for p in store.people()}
    assert [(p["age"], p["sex"], p["handedness"]) for p in people.values()] == [("27", "F", "R"), ("31", "M", "n/a")]
    store.withdraw("01")
    gone = store.people()[0]
    assert (gone["age"], gone["sex"], gone["handedness"], gone["status"]) == ("n/a", "n/a", "n/a", "withdrawn")
    assert store.place("02") == 2  # a place is kept when others withdraw


def test_consent_on_the_page_is_kept_with_the_text_agreed_to(tmp_path):
    store = StudyStore.open(tmp_path, plan := small())
    store.enrol("01", invited=True)
    session = Session(store, "01", plan.tasks[0], GRID, silent, consent="You may stop at any time.")
    session.start()
    assert session.view()["waiting"] == "consent"
    session.consent()
    assert session.view()["waiting"] == "start"
    (row,) = store.people()
    expected = hashlib.sha256(b"You may stop at any time.").hexdigest()[:12]
    assert (row["status"], row["consent_text"]) == ("active", expected)
    assert row["consent"] == datetime.now(UTC).date().isoformat()
    again = Session(store, "01", plan.tasks[0], GRID, silent, consent="You may stop at any time.")
    assert again.view()["waiting"] == "start"
