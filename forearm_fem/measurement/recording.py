"""Recordings of a calibration and the folder that keeps them."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from ..errors import DataError
from ..store.folder import set_kind, write_text
from ..store.record import dims, load, save
from ..typing import FloatArray

# Record of one measurement, in volts as taken: nothing is converted before it is saved.


@dataclass(frozen=True, eq=False)
class Recording:
    """One actuator driven, one point watched.

    ``sent`` (n,) [V at the actuator] is one period of the drive. ``response`` (n_repeat, n) [V at the input] and, where
    a loopback was wired, ``loopback`` (n_repeat, n) [V at the input] are the periods kept. ``full_scale`` [V] and
    ``resolution`` [V per step, 0 = unknown] are the input's. ``notes`` are what the hardware said.
    """

    output: str
    input: str
    sample_rate: float
    sent: FloatArray = field(metadata=dims("sample", units="V"))
    response: FloatArray = field(metadata=dims("repeat sample", units="V"))
    loopback: FloatArray | None = field(default=None, metadata=dims("repeat sample", units="V"))
    full_scale: float = float("inf")
    resolution: float = 0.0
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, array in (("response", self.response), ("loopback", self.loopback)):
            if array is not None and (array.ndim != 2 or array.shape[1] != self.sent.size):
                raise DataError(
                    f"{self.output} <- {self.input}: {name} has shape {array.shape}, expected (repeats, "
                    f"{self.sent.size}); record whole periods of the sweep"
                )
        if self.response.shape[0] < 1:
            raise DataError(f"{self.output} <- {self.input}: no period was recorded; record at least one")

    @property
    def n(self) -> int:
        """Samples in a period."""
        return int(self.sent.size)

    @property
    def label(self) -> str:
        """Names for messages: output <- input."""
        return f"{self.output} <- {self.input}"


# Recordings on disk: one file each, whole or absent, with a checksum; the folder is the state of a calibration.

_VERSION = 1


@dataclass(frozen=True, eq=False)
class RecordingFile:
    """A recording, and the digest ``setup`` of what it was taken for."""

    kind: ClassVar[str] = "recording"
    version: ClassVar[int] = 1

    recording: Recording = field(metadata=dims(name=""))
    setup: str


def write_recording(path: Path, recording: Recording, setup: str) -> None:
    """``recording`` as netCDF with the digest ``setup`` of what it was taken for; atomic and flushed to disk."""
    save(path, RecordingFile(recording, setup))


def read_recording(path: Path, setup: str | None = None) -> Recording:
    """The recording as written; DataError if the file is damaged, or was taken for another ``setup``."""
    try:
        found = load(path, RecordingFile)
    except DataError as problem:
        again = "; this entry is to be measured again" if path.is_file() else ""
        raise DataError(f"{problem}{again}") from None
    if setup is not None and found.setup != setup:
        raise DataError(f"{path}: was taken with another sweep or wiring; use a new folder for a new calibration")
    return found.recording


@dataclass(frozen=True)
class Folder:
    """The files of one calibration: ``session.json`` and one recording per entry."""

    path: Path
    setup: str

    def begin(self, description: Mapping[str, Any]) -> None:
        """Create the folder, or check that it belongs to the same ``setup``."""
        session = self.path / "session.json"
        if not session.exists():
            set_kind(self.path, "calibration")
            write_text(session, json.dumps({"version": _VERSION, "setup": self.setup, **description}, indent=1))
            return
        try:
            found = json.loads(session.read_text(encoding="utf-8"))["setup"]
        except (ValueError, KeyError, TypeError, OSError, UnicodeDecodeError):
            raise DataError(
                f"{session}: damaged; delete this one file to go on, the recordings beside it stay valid"
            ) from None
        if found != self.setup:
            raise DataError(
                f"{session}: belongs to a calibration with another sweep, grid or wiring, or through another virtual "
                "device (its G, --snr, --bits, --latency or --seed); choose an empty folder"
            )

    def file(self, output: str, source: str) -> Path:
        """File of the recording ``output`` <- ``source``."""
        safe = [re.sub(r"[^A-Za-z0-9_-]", "_", name) for name in (output, source)]
        tag = hashlib.sha256(f"{output}\0{source}".encode()).hexdigest()[:6]
        return self.path / f"G_{safe[0]}_{safe[1]}_{tag}.nc"

    def get(self, output: str, source: str) -> Recording | None:
        """The recording, or None if it was not taken; DataError if it is damaged or holds another entry."""
        file = self.file(output, source)
        if not file.exists():
            return None
        recording = read_recording(file, self.setup)
        if (recording.output, recording.input) != (output, source):
            raise DataError(f"{file}: holds {recording.label}, expected {output} <- {source}; it was renamed by hand")
        return recording

    def put(self, recording: Recording) -> None:
        """Save; whatever stood there before is replaced in one step."""
        write_recording(self.file(recording.output, recording.input), recording, self.setup)
