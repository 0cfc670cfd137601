"""Recordings on disk: one file each, whole or absent, with a checksum; the folder is the state of a calibration."""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from ..io.recording import Recording
from ..store.folder import atomic_path, set_kind, write_text

_VERSION = 1


def write_recording(path: Path, recording: Recording, setup: str) -> None:
    """``recording`` as an NPZ file, with the digest ``setup`` of what it was taken for; atomic and flushed to disk."""
    head = {
        "version": _VERSION,
        "output": recording.output,
        "input": recording.input,
        "setup": setup,
        "sample_rate": recording.sample_rate,
        "full_scale": recording.full_scale,
        "resolution": recording.resolution,
        "notes": list(recording.notes),
        "provenance": dict(recording.provenance),
    }
    arrays: dict[str, Any] = {"sent": recording.sent, "response": recording.response}
    if recording.loopback is not None:
        arrays["loopback"] = recording.loopback
    text = json.dumps(head)
    with atomic_path(path) as beside, beside.open("wb") as stream:
        np.savez(stream, head=np.array(text), digest=np.array(_digest(text, arrays)), **arrays)


def read_recording(path: Path, setup: str | None = None) -> Recording:
    """The recording as written; DataError if the file is damaged, altered, or was taken for another ``setup``."""
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as content:
            arrays = {name: content[name] for name in content.files if name not in ("head", "digest")}
            text, digest = str(content["head"]), str(content["digest"])
    except FileNotFoundError:
        raise DataError(f"{path}: no such recording") from None
    except Exception as problem:  # zip, npy and zlib each fail in their own way
        raise DataError(
            f"{path}: damaged or cut short ({type(problem).__name__}); this entry is to be measured again"
        ) from None
    if _digest(text, arrays) != digest:
        raise DataError(f"{path}: its checksum does not fit its content; this entry is to be measured again")
    head = json.loads(text)
    if setup is not None and head["setup"] != setup:
        raise DataError(f"{path}: was taken with another sweep or wiring; use a new folder for a new calibration")
    return Recording(
        head["output"],
        head["input"],
        head["sample_rate"],
        arrays["sent"],
        arrays["response"],
        arrays.get("loopback"),
        head["full_scale"],
        head["resolution"],
        tuple(head["notes"]),
        head["provenance"],
    )


def _digest(text: str, arrays: Mapping[str, Any]) -> str:
    total = hashlib.sha256(text.encode())
    for name in sorted(arrays):
        total.update(f"{name}{arrays[name].dtype}{arrays[name].shape}".encode())
        total.update(np.ascontiguousarray(arrays[name]).tobytes())
    return total.hexdigest()


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
        """Where the recording ``output`` <- ``source`` is kept."""
        safe = [re.sub(r"[^A-Za-z0-9_-]", "_", name) for name in (output, source)]
        tag = hashlib.sha256(f"{output}\0{source}".encode()).hexdigest()[:6]
        return self.path / f"G_{safe[0]}_{safe[1]}_{tag}.npz"

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
