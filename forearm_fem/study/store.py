"""Study on disk: tables as BIDS lays them out, one line per answer, safe before the next stimulus plays.

``participants.tsv`` (pseudonyms, age, sex, consent, status), and per participant ``beh/sub-ID_task-NAME_events.tsv``
with a data dictionary beside it. Lines are appended and flushed to the disk; a line cut short by a power failure is
taken off when the file is opened again, so its trial is presented anew and nothing stands there twice.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import re
import shutil
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from .. import __version__
from ..errors import DataError
from ..store.folder import check_kind, set_kind, write_text
from .plan import Study

EVENTS: Mapping[str, str] = {
    "onset": "start of the stimulus since the first sitting began, the time between sittings left out [s]",
    "duration": "length of the stimulus [s]",
    "trial": "number within the task, from 1",
    "phase": "training or main",
    "block": "from 1; 0 in training",
    "method": "renderer",
    "target": "grid point aimed at",
    "repetition": "of this method at this target, from 1",
    "response": "grid points answered, separated by spaces",
    "response_x": "mean of the points answered, along the limb [m]",
    "response_y": "mean of the points answered, across the limb [m]",
    "response_time": "from the end of the stimulus to the answer [s]",
    "presentations": "times the stimulus was played before the answer counted (1 unless repeated or resumed)",
    "peak_voltage": "largest drive at an actuator [V]",
    "device": "what played",
    "latency": "of the device, output and input together [s]; n/a: not measured, and within response_time",
    "cable_gain": "what a cable from an output returned [V/V]; n/a: not measured, full scale is the scenario's",
    "session": "number of the sitting in which it was answered, from 1",
    "date": "of the answer (UTC)",
    "gain": "of the stimulus re as its renderer made it [dB]",
    "peak_um": "largest displacement of the target by G [um]",
    "rms_um": "rms displacement of the target over the stimulus by G [um]",
    "weighted_db": "rms displacement of the target weighted by two receptor channels, re 1 um [dB]",
    "transfer": "12 digits of the SHA-256 of G",
    "scenario": "12 digits of the SHA-256 of the scenario",
    "levels": "12 digits of the SHA-256 of the levels asked for",
    "drives": "12 digits of the SHA-256 of the stimulus' drives, to 0.1 mV",
}
SOURCES = ("transfer", "scenario", "levels")
_PEOPLE: Mapping[str, str] = {
    "participant_id": "pseudonym; the number of the line is the place in the study, which balances the order",
    "age": "at enrolment [year]",
    "sex": "F, M, O (other) or n/a",
    "consent": "date on which consent was given; n/a: invited, stimuli were made",
    "consent_text": "12 digits of the SHA-256 of the text agreed to on the page; n/a: on paper",
    "status": "invited, active or withdrawn",
    "added": "date of enrolment",
}
ANALYSIS, STIMULI = "analysis", "stimuli"  # folders of what is made of the answers, and for other programs
_PEOPLE_LOCK = ".participants.lock"
_NUMBERS = ("onset", "duration", "response_time")  # BIDS itself says that they are numbers
_IGNORED = ("study.json", "folder.json", "SHA256SUMS", f"{STIMULI}/", ".*.lock", ANALYSIS)
_README = """Study "{name}", run with forearm_fem {version}.

participants.tsv holds pseudonyms, sub-*/beh the answers of each task with their dictionaries, study.json the study as
it was when data were first taken.
"""


@dataclass(frozen=True)
class StudyStore:
    """The folder of a study."""

    folder: Path
    study: Study

    @classmethod
    def open(cls, folder: str | Path, study: Study, *, begin: bool = True) -> StudyStore:
        """The folder; DataError where another study lies there that somebody takes part in.

        With ``begin`` it is made if need be with the study it belongs to; else nothing is written.
        """
        store, text = cls(Path(folder), study), study.model_dump_json(indent=2)
        kept = store.folder / "study.json"
        try:
            same = kept.exists() and Study.model_validate_json(kept.read_text(encoding="utf-8")) == study
        except (OSError, ValueError):  # pydantic's and the decoder's are among the second
            raise DataError(
                f"{kept}: damaged; delete this one file, the same study writes it again and the answers stay"
            ) from None
        if not same and store.people():
            raise DataError(
                f"{store.folder}: the study file was changed after data were taken; put it back, or give the new one "
                "a folder of its own"
            )
        if begin and not same:
            check_kind(store.folder, "study")
            set_kind(store.folder, "study")
            about = {"Name": study.name, "BIDSVersion": "1.10.0", "DatasetType": "raw",
                     "GeneratedBy": [{"Name": "forearm_fem", "Version": __version__}]}  # fmt: skip
            write_text(store.folder / "dataset_description.json", json.dumps(about, indent=2))
            write_text(store.folder / "README", _README.format(name=study.name, version=__version__))
            write_text(store.folder / ".bidsignore", "\n".join(_IGNORED) + "\n")
            write_text(store.folder / "participants.json", _dictionary(_PEOPLE))
            write_text(kept, text)
        return store

    def people(self) -> list[dict[str, str]]:
        """Rows of ``participants.tsv``, with the columns that a laboratory added."""
        return read_table(self.folder / "participants.tsv", tuple(_PEOPLE), more=True)

    def place(self, participant: str) -> int:
        """Place of a participant in the study, from 1: its line's number, of who is not enrolled the next one."""
        names = [p["participant_id"] for p in self.people()]
        name = f"sub-{participant}"
        return 1 + (names.index(name) if name in names else len(names))

    def locked(self) -> FileLock:
        """A lock of the list of participants over processes; the one that holds it may take it again."""
        return FileLock(self.folder / _PEOPLE_LOCK, is_singleton=True)

    def enrol(self, participant: str, *, consent: str = "", age: float | None = None, sex: str = "",
              invited: bool = False) -> None:  # fmt: skip
        """Add a participant once, or what was not known of one; DataError for one who was withdrawn.

        Without the date of ``consent`` (of signing) that is an error too, unless ``invited``: somebody is, whose
        stimuli are made, or who will agree on the page.
        """
        name = f"sub-{participant}"
        with self.locked():
            row = next((p for p in self.people() if p["participant_id"] == name), None)
            if row is not None and row["status"] == "withdrawn":
                raise DataError(f"{name} was withdrawn; take another pseudonym")
            if not consent and not invited and (row is None or row["consent"] == "n/a"):
                raise DataError(f"{name}: no consent is recorded; give its date, e.g. --consent 2026-11-24")
            if consent:
                _checked_date(name, consent)
            known = {"age": age, "sex": sex, "consent": consent, "status": "active" if consent else ""}
            told = {k: _cell(v) for k, v in known.items() if v not in ("", None)}
            if row is None:
                told = {"participant_id": name, "status": "invited", "added": date.today().isoformat(), **told}
                _append(self.folder / "participants.tsv", self._columns(), told)
            elif changed := {k: v for k, v in told.items() if row[k] in ("n/a", "invited")}:
                self._change(name, changed)

    def consented(self, participant: str) -> bool:
        """True if a participant's consent is recorded."""
        return any(p["participant_id"] == f"sub-{participant}" and p["consent"] != "n/a" for p in self.people())

    def consent(self, participant: str, day: str, text: str) -> None:
        """Keep that a participant agreed to ``text``."""
        digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        self._change(f"sub-{participant}", {"consent": day, "status": "active", "consent_text": digest})

    def _columns(self) -> tuple[str, ...]:
        return tuple(self.people()[0]) if self.people() else tuple(_PEOPLE)

    def _change(self, name: str, changed: Mapping[str, str]) -> None:
        with self.locked():  # another participant's process may add a line meanwhile
            rows = [{**r, **changed} if r["participant_id"] == name else r for r in self.people()]
            write_text(self.folder / "participants.tsv", _table(self._columns(), rows))

    @contextmanager
    def sitting(self, participant: str) -> Iterator[None]:
        """One process at a time for a participant; DataError saying who holds it."""
        lock = FileLock(self.folder / f".sub-{participant}.lock")
        holder = self.folder / f".sub-{participant}.holder.lock"
        try:
            lock.acquire(timeout=0)
        except Timeout:
            who = holder.read_text(encoding="utf-8") if holder.exists() else "another process"
            raise DataError(f"sub-{participant}: {who} holds this participant's session; end it, or wait") from None
        try:
            since = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
            holder.write_text(f"process {os.getpid()} on {socket.gethostname()}, since {since},", encoding="utf-8")
            yield
        finally:
            holder.unlink(missing_ok=True)
            lock.release()

    def withdraw(self, participant: str) -> None:
        """Delete a participant's answers and mark the pseudonym; nothing of what was answered is kept, nor what an
        analysis made of it."""
        rows, name = self.people(), f"sub-{participant}"
        if name not in {r["participant_id"] for r in rows}:
            raise DataError(f"{name} is no participant of {self.folder}")
        if (self.folder / name).exists():
            shutil.rmtree(self.folder / name)
        for made in (self.folder / ANALYSIS).glob("*"):
            if made.suffix in (".csv", ".png", ".html", ".R"):
                made.unlink()
        shutil.rmtree(self.folder / STIMULI / name, ignore_errors=True)
        stays = {"participant_id", "status", "added", "consent"}
        self._change(name, {**{k: "n/a" for k in self._columns() if k not in stays}, "status": "withdrawn"})

    def events_file(self, participant: str, task: str) -> Path:
        """File of the answers of a participant to a task."""
        return self.folder / f"sub-{participant}" / "beh" / f"sub-{participant}_task-{task}_events.tsv"

    def answers(self, participant: str, task: str) -> list[dict[str, str]]:
        """Answered trials in the order in which they came."""
        return read_table(self.events_file(participant, task), tuple(EVENTS))

    def add(self, participant: str, task: str, row: Mapping[str, Any]) -> None:
        """Append one answer; on the disk when this returns. DataError where it cannot be written."""
        file = self.events_file(participant, task)
        if not file.exists():
            write_text(file.with_suffix(".json"), _dictionary(EVENTS, {"TaskName": task}))
        _append(file, tuple(EVENTS), row)


def _dictionary(columns: Mapping[str, str], facts: Mapping[str, str] | None = None) -> str:
    """A data dictionary in the manner of BIDS: ``facts``, and description and unit of each column."""
    told: dict[str, Any] = dict(facts or {})
    for name, text in columns.items():
        unit = re.search(r"\[(.*?)\](?:;|$)", text)
        told[name] = {"Description": text} | ({"Units": unit[1]} if unit else {})
        told[name] |= {"Format": "number"} if name in _NUMBERS else {}
    return json.dumps(told, indent=2, ensure_ascii=False)


def read_table(file: Path, columns: Sequence[str], *, more: bool = False) -> list[dict[str, str]]:
    """Rows of a table of our own, a last line that was cut short taken off the file; none where there is no file.

    With ``more``, columns beside our own are kept, and of ours only the first must be there.
    """
    if not file.exists():
        return []
    _take_off_torn_line(file)
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise DataError(f"{file}: is not in UTF-8, as another program saves it; save it as UTF-8, with tabs") from None
    reader = csv.DictReader(io.StringIO(text), delimiter="\t", quoting=csv.QUOTE_NONE)
    rows = [(reader.line_num, row) for row in reader]  # blank lines are skipped, and counted
    for number, row in rows:
        fits = columns[0] in row if more else set(row) == set(columns)
        if not fits or None in row or any(v is None for v in row.values()):
            raise DataError(f"{file}, line {number}: its columns are not those of the header; mend it")
    return [{**{c: row.get(c, "n/a") for c in columns}, **row} for _, row in rows]


def _checked_date(name: str, day: str) -> None:
    try:
        date.fromisoformat(day)
    except ValueError:
        raise DataError(f"{name}: --consent expects the date of signing, e.g. 2026-11-24, got '{day}'") from None


def _take_off_torn_line(file: Path) -> None:
    """Removal of a line cut short by a power failure, which counts as never answered."""
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
        before = file.stat().st_size if file.exists() else 0
        try:
            with file.open("ab") as stream:
                stream.write(_table(columns, [row], header=not before).encode("utf-8"))
                stream.flush()
                os.fsync(stream.fileno())
        except OSError:
            with suppress(OSError):
                os.truncate(file, before)  # a refused answer is given again: it must not stand there twice
            raise
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
