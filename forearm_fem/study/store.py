"""What a study leaves on disk: tables in the manner of BIDS, one line per answer, safe before the next stimulus plays.

``participants.tsv`` (pseudonyms, consent, status), and per participant ``sub-ID_task-NAME_events.tsv`` with a data
dictionary beside it. Lines are appended and flushed to the disk; a line cut short by a power failure is taken off when
the file is opened again, so its trial is presented anew and nothing stands there twice.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import DataError
from ..io.atomic import write_text
from .plan import Study

EVENTS: Mapping[str, str] = {
    "onset": "start of the stimulus since the session began [s]",
    "duration": "length of the stimulus [s]",
    "trial": "number within the task, from 1",
    "phase": "training or main",
    "block": "from 1; 0 in training",
    "method": "renderer",
    "target": "grid point aimed at",
    "repetition": "of this method at this target, from 1",
    "level": "level of the stimulus re its own [dB]",
    "response": "grid points answered, separated by spaces; yes or no; n/a for a drawing",
    "response_x": "centre of the answer along the limb [m]; mean of the points, centroid of a drawing",
    "response_y": "centre of the answer across the limb [m]",
    "response_area": "area drawn [m2]; n/a for points",
    "response_time": "from the end of the stimulus to the answer [s]",
    "late": "1 where the answer came after answer_seconds",
    "presentations": "times the stimulus was played before the answer counted (1 unless repeated or resumed)",
    "peak_voltage": "largest drive at an actuator [V]",
    "session": "number of the sitting in which it was answered, from 1",
}
_PEOPLE = ("participant_id", "consent", "status", "added", "note")


@dataclass(frozen=True)
class Store:
    """The folder of a study."""

    folder: Path
    study: Study

    @classmethod
    def open(cls, folder: str | Path, study: Study) -> Store:
        """The folder, made if need be with the study it belongs to; DataError where another study lies there."""
        store, text = cls(Path(folder), study), study.model_dump_json(indent=2)
        kept = store.folder / "study.json"
        if not kept.exists():
            about = {"Name": study.name, "BIDSVersion": "1.10.0", "DatasetType": "raw",
                     "GeneratedBy": [{"Name": "forearm_fem"}]}  # fmt: skip
            write_text(store.folder / "dataset_description.json", json.dumps(about, indent=2))
            write_text(kept, text)
        elif json.loads(kept.read_text(encoding="utf-8")) != json.loads(text):
            raise DataError(
                f"{store.folder}: the study file was changed after data were taken; put it back, or give the new one "
                "a folder of its own"
            )
        return store

    def people(self) -> list[dict[str, str]]:
        """Rows of ``participants.tsv``."""
        return read_table(self.folder / "participants.tsv", _PEOPLE)

    def enrol(self, participant: str, *, consent: str, added: str, note: str = "") -> None:
        """Add a participant once; DataError without recorded consent, or where the pseudonym was withdrawn."""
        known = {p["participant_id"]: p for p in self.people()}
        name = f"sub-{participant}"
        if name in known:
            if known[name]["status"] == "withdrawn":
                raise DataError(f"{name} was withdrawn; take another pseudonym")
            return
        if not consent:
            raise DataError(f"{name}: no consent is recorded; give its date, e.g. --consent 2026-11-24")
        row = {"participant_id": name, "consent": consent, "status": "active", "added": added, "note": note}
        _append(self.folder / "participants.tsv", _PEOPLE, row)

    def withdraw(self, participant: str) -> None:
        """Delete a participant's answers and mark the pseudonym; nothing of what was answered is kept."""
        rows, name = self.people(), f"sub-{participant}"
        if name not in {r["participant_id"] for r in rows}:
            raise DataError(f"{name} is no participant of {self.folder}")
        for file in sorted((self.folder / name).glob("*"), reverse=True):
            file.unlink()
        if (self.folder / name).is_dir():
            (self.folder / name).rmdir()
        changed = [{**r, "status": "withdrawn", "note": ""} if r["participant_id"] == name else r for r in rows]
        write_text(self.folder / "participants.tsv", _table(_PEOPLE, changed))

    def events_file(self, participant: str, task: str) -> Path:
        """Where the answers of a participant to a task lie."""
        return self.folder / f"sub-{participant}" / f"sub-{participant}_task-{task}_events.tsv"

    def answers(self, participant: str, task: str) -> list[dict[str, str]]:
        """Answered trials in the order in which they came."""
        return read_table(self.events_file(participant, task), tuple(EVENTS))

    def add(self, participant: str, task: str, row: Mapping[str, Any]) -> None:
        """Append one answer; on the disk when this returns. DataError where it cannot be written."""
        file = self.events_file(participant, task)
        if not file.exists():
            dictionary = {name: {"Description": text} for name, text in EVENTS.items()}
            write_text(file.with_suffix(".json"), json.dumps(dictionary, indent=2))
        _append(file, tuple(EVENTS), row)


def read_table(file: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Rows of a table of our own, a last line that was cut short taken off the file; none where there is no file."""
    if not file.exists():
        return []
    _take_off_torn_line(file)
    text = file.read_text(encoding="utf-8")
    rows = list(csv.DictReader(io.StringIO(text), delimiter="\t", quoting=csv.QUOTE_NONE))
    for number, row in enumerate(rows, start=2):
        if set(row) != set(columns) or any(v is None for v in row.values()):
            raise DataError(f"{file}, line {number}: its columns are not those of the header; mend it")
    return rows


def _take_off_torn_line(file: Path) -> None:
    """What follows the last line end was cut short by a power failure and counts as never answered."""
    with file.open("rb+") as stream:
        size = stream.seek(0, os.SEEK_END)
        if size and stream.seek(-1, os.SEEK_END) is not None and stream.read(1) != b"\n":
            stream.seek(0)
            stream.truncate(stream.read().rfind(b"\n") + 1)


def _append(file: Path, columns: Sequence[str], row: Mapping[str, Any]) -> None:
    if unknown := set(row) - set(columns):
        raise DataError(f"{file}: no column is called {sorted(unknown)[0]}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.exists():
            _take_off_torn_line(file)
        new = not file.exists() or not file.stat().st_size
        with file.open("ab") as stream:
            stream.write(_table(columns, [row], header=new).encode("utf-8"))
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as problem:
        raise DataError(f"{file}: the answer cannot be written ({problem.strerror or problem}); make room") from None


def _table(columns: Sequence[str], rows: Sequence[Mapping[str, Any]], *, header: bool = True) -> str:
    lines = ["\t".join(columns)] if header else []
    lines += ["\t".join(_cell(row.get(c)) for c in columns) for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: Any) -> str:
    if value is None or value == "" or value != value:
        return "n/a"
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return " ".join(text.split())
