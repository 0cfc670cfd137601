"""Drive signals as WAV files, one channel per actuator, for players and amplifiers without a DAQ."""

from __future__ import annotations

import io
import struct
import warnings
from pathlib import Path

import numpy as np
from scipy.io import wavfile

from ..errors import DataError
from ..store.folder import atomic_path
from ..typing import FloatArray
from .reading import reading
from .seal import BLANK, sealed


def write_wav_drives(path: str | Path, signals: FloatArray, sample_rate: float) -> None:
    """``signals`` (n_in, n) [V] as 64-bit floating point samples, whose value is the voltage: exact, nothing is scaled.

    Players take 1.0 for their full scale, so set the amplifier accordingly. Raises DataError for samples
    that are not finite and for a rate that is no whole number [Hz], which WAV cannot hold.
    """
    if signals.ndim != 2 or signals.size == 0:
        raise DataError(f"{path}: expected signals of shape (actuators, samples), got {signals.shape}")
    if not np.all(np.isfinite(signals)):
        raise DataError(
            f"{path}: {np.count_nonzero(~np.isfinite(signals))} samples are not finite; nothing was written"
        )
    if sample_rate != int(sample_rate):
        raise DataError(
            f"{path}: a WAV file holds whole sample rates only, got {sample_rate:g} Hz; resample the drives"
        )
    memory = io.BytesIO()
    wavfile.write(memory, int(sample_rate), np.ascontiguousarray(signals.T, dtype="<f8"))
    with atomic_path(path) as beside:
        beside.write_bytes(sealed(_commented(memory.getvalue())))
        if not np.array_equal(read_wav_drives(beside)[0], signals):
            raise DataError(f"{path}: reading back gave something else than was written; nothing was saved")


def _commented(content: bytes) -> bytes:
    """A WAV file with a blank seal as a comment (chunk LIST INFO ICMT, which players show or skip) before and after
    its samples."""
    comment = b"INFOICMT" + struct.pack("<I", len(BLANK) + 1) + BLANK + b"\0"
    chunk = b"LIST" + struct.pack("<I", len(comment)) + comment
    at = content.index(b"data")
    whole = content[:at] + chunk + content[at:] + b"\0" * (len(content) % 2) + chunk
    return whole[:4] + struct.pack("<I", len(whole) - 8) + whole[8:]


def read_wav_drives(path: str | Path, *, full_scale: float | None = None) -> tuple[FloatArray, float]:
    """Signals (n_in, n) [V] and the sample rate [Hz]. Integer samples need ``full_scale`` [V]: it is never guessed.

    Floating-point ones are volts. DataError for a ``full_scale`` of these, or that is no voltage.
    """
    file = Path(path)
    with reading(file, "damaged, cut short or not a WAV file; export it again"), warnings.catch_warnings():
        warnings.simplefilter("error")  # scipy only warns of files that are cut short
        warnings.filterwarnings("ignore", message="Chunk .*not understood")  # peaks, cues, dates: nothing of the signal
        rate, samples = wavfile.read(file)
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
