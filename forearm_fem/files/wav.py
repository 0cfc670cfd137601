"""Drive signals as WAV files, one channel per actuator, for players and amplifiers without a DAQ."""

from __future__ import annotations

import io
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import wavfile

from ..errors import DataError
from ..typing import FloatArray
from .declaration import reading

_OPEN = 0xFFFFFFFF  # the length of what was written to a pipe


def read_wav_drives(path: str | Path, *, full_scale: float | None = None) -> tuple[FloatArray, float]:
    """Signals (n_in, n) [V] and the sample rate [Hz]. Integer samples need ``full_scale`` [V]: it is never guessed.

    Floating-point ones are volts. DataError for a ``full_scale`` of these, or that is no voltage.
    """
    file = Path(path)
    rate, samples = wav_samples(file)
    columns = samples.reshape(len(samples), -1).T
    whole = not np.issubdtype(columns.dtype, np.floating)
    if full_scale is not None and not (whole and 0 < full_scale < np.inf):
        what = "has floating-point samples, which are volts: full scale has no effect; leave it out"
        raise DataError(f"{file}: {what if not whole else f'full scale is some volts, got {full_scale:g}'}")
    if whole:
        if full_scale is None:
            raise DataError(
                f"{file}: has integer samples, which are no volts; say how many volts full scale is (--full-scale)"
            )
        if columns.dtype == np.uint8:
            columns = (columns.astype(float) - 128) / 128 * full_scale
        else:
            columns = columns.astype(float) / -float(np.iinfo(columns.dtype.name).min) * full_scale
    if not np.all(np.isfinite(columns)):
        raise DataError(f"{file}: holds samples that are not finite; it must not be played")
    return np.ascontiguousarray(columns, dtype=float), float(rate)


def wav_samples(file: Path) -> tuple[int, Any]:
    """Sample rate [Hz] and samples (n,) or (n, channels) as they are stored; DataError for what is no whole WAV file.

    Programs that write into a pipe cannot go back to say how long the file is: theirs says nothing or the most there
    can be, and all that follows is samples.
    """
    with reading(file, "damaged, cut short or not a WAV file; export it again"), warnings.catch_warnings():
        warnings.simplefilter("error")  # scipy only warns of files that are cut short
        warnings.filterwarnings("ignore", message="Chunk .*not understood")  # peaks, cues, dates: nothing of the signal
        rate, samples = wavfile.read(io.BytesIO(_of_true_length(file.read_bytes())))
    return int(rate), samples


def _of_true_length(content: bytes) -> bytes:
    """``content`` with the lengths that a pipe left open put right."""
    if content[:4] != b"RIFF" or content[8:12] != b"WAVE":
        return content
    at = 12
    while at + 8 <= len(content):
        name, (size,) = content[at : at + 4], struct.unpack("<I", content[at + 4 : at + 8])
        rest = len(content) - at - 8
        if name == b"data":
            if size not in (0, _OPEN, _OPEN - 1) and size < 0x7FFFF000:
                return content
            said, whole = struct.pack("<I", rest), struct.pack("<I", len(content) - 8)
            return content[:4] + whole + content[8 : at + 4] + said + content[at + 8 :]
        at += 8 + size + size % 2
    return content
