"""The stimulus: samples at a rate, with a time zero."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.io import wavfile

from ..errors import DataError, ScenarioError
from ..metrics.strength import seconds_of
from ..typing import ComplexArray, FloatArray
from .spectrum import Record, to_spectrum, to_time

Window = Literal["wavelet", "record"] | tuple[float, float]
_HEARD = 1e-3  # of a wavelet's largest sample: where it begins and ends
_ROOM = 0.05  # s before and after it: later, the band's edges ring (decision 0027)
_OUTER = 0.1  # of f_max: where a taper falls


@dataclass(frozen=True, eq=False)
class Wavelet:
    """A stimulus of unit size that a renderer scales to volts or metres.

    ``samples`` (n_t,) [-] at ``record.sample_rate``; sample ``record.centre`` is t = 0. The record is one
    period of a periodic signal: what an inverse filter sends before t = 0 needs the half of the record before
    it, and what does not fit wraps around. A non-periodic record is not covered. DataError for samples that are not the
    record's n finite ones.
    """

    samples: FloatArray
    record: Record
    name: str = "wavelet"

    def __post_init__(self) -> None:
        samples = np.asarray(self.samples)
        real = samples.dtype.kind in "fiu"
        if not real or samples.shape != (self.record.n,) or not np.isfinite(samples).all():
            raise DataError(
                f"{self.name}: expected {self.record.n} finite samples, one for each of the record's, got "
                f"{samples.shape} of {samples.dtype}"
            )
        object.__setattr__(self, "samples", np.asarray(samples, dtype=float))

    @property
    def time(self) -> FloatArray:
        """Time of the samples (n_t,) [s]."""
        return self.record.time

    @cached_property
    def spectrum(self) -> ComplexArray:
        """One-sided spectrum (n_t // 2 + 1,) [1/Hz] on ``record.frequency``, phase referred to t = 0."""
        return to_spectrum(self.samples, self.record)

    @cached_property
    def energy(self) -> FloatArray:
        """Energy spectrum (n_t // 2 + 1,) [1/Hz^2], both sides of the spectrum in one."""
        return np.asarray(self.record.weights * np.abs(self.spectrum) ** 2)

    @cached_property
    def window(self) -> tuple[float, float]:
        """Start and end [s] of what S is taken over: the samples above 1e-3 of the largest, and 50 ms on either side.

        Milliseconds rounded outwards, cut to the record. Longer records of the same wavelet have the same window.
        """
        heard = self.time[np.abs(self.samples) > _HEARD * np.abs(self.samples).max()]
        if not len(heard):
            raise DataError(f"{self.name}: all samples are zero, so that there is nothing to take S over")
        start, end = np.floor(1e3 * (heard[0] - _ROOM)) / 1e3, np.ceil(1e3 * (heard[-1] + _ROOM)) / 1e3
        return max(float(start), float(self.time[0])), min(float(end), float(self.time[-1]))

    def tapered(self, first: float, last: float) -> Wavelet:
        """The wavelet without sharp edges of the band ``first`` to ``last`` [Hz]: half cosines over the lowest octave
        and the uppermost tenth, zero outside."""
        f = self.record.frequency
        up = np.clip((f - first) / first, 0, 1)
        down = np.clip((last - f) / (_OUTER * last), 0, 1)
        shape = np.sin(np.pi / 2 * up) ** 2 * np.sin(np.pi / 2 * down) ** 2
        samples = to_time((self.spectrum * shape)[:, None], np.arange(len(f)), self.record)[0]
        return replace(self, samples=samples, name=f"{self.name}, tapered")


def window_of(window: Window, wavelet: Wavelet) -> tuple[float, float] | None:
    """Seconds (start, end) of a window by name or as given; None for the whole record."""
    if isinstance(window, str) and window == "record":
        return None
    return wavelet.window if isinstance(window, str) and window == "wavelet" else seconds_of(window)


def ricker(
    peak_hz: float = 250.0, amplitude: float = 1.0, sample_rate: float = 10000.0, duration: float = 2.0
) -> Wavelet:
    """Ricker wavelet A (1 - s^2) exp(-s^2 / 2), s = t / sigma, sigma = 1 / (sqrt(2) pi peak_hz).

    De Vlam 2022, eq. 7 and 8; with this sigma [s] the spectrum has its maximum at ``peak_hz`` [Hz].
    ``samples`` (n_t,) [-] with t = 0 in the middle of the record of ``duration`` [s] at ``sample_rate`` [Hz].
    Raises ScenarioError if the wavelet does not fit below the Nyquist frequency or into the record.
    """
    if not 0 < peak_hz < np.inf or not np.isfinite(amplitude):
        raise ScenarioError(
            f"a Ricker wavelet needs a positive peak frequency and a finite size, got {peak_hz:g} Hz and {amplitude:g}"
        )
    record = Record.of(sample_rate, duration)
    if 3 * peak_hz > sample_rate / 2:
        raise ScenarioError(
            f"a Ricker wavelet with its peak at {peak_hz:g} Hz needs a sample rate of {6 * peak_hz:g} Hz, "
            f"got {sample_rate:g} Hz"
        )
    if 6 / peak_hz > duration:
        raise ScenarioError(
            f"a Ricker wavelet at {peak_hz:g} Hz needs a record of {6 / peak_hz:g} s, got {duration:g} s"
        )
    s = record.time * np.sqrt(2) * np.pi * peak_hz
    return Wavelet(amplitude * (1 - s**2) * np.exp(-(s**2) / 2), record, f"Ricker {peak_hz:g} Hz")


def from_samples_file(
    path: str | Path, sample_rate: float = 10000.0, duration: float = 2.0, *, normalise: bool = True
) -> Wavelet:
    """A wavelet from the samples in a CSV (one column, or time and value), WAV (one channel) or NPY (1-D) file.

    The samples are set into a record of ``duration`` [s] at ``sample_rate`` [Hz] (returned ``samples`` (n_t,)
    [-]) with their largest |value| at t = 0, and divided by it unless ``normalise`` is False. Raises
    DataError if the file cannot be read, is not finite, is all zero, is longer than the record or has another
    rate: nothing is resampled.
    """
    path = Path(path)
    samples, rate = _read(path)
    record = Record.of(sample_rate, duration)
    if rate is not None and abs(rate / sample_rate - 1) > 1e-3:
        raise DataError(f"{path.name} is sampled at {rate:g} Hz, expected {sample_rate:g} Hz; resample it first")
    if samples.ndim != 1 or samples.size < 2:
        raise DataError(f"{path.name}: expected one row of at least 2 samples, got an array of shape {samples.shape}")
    if not np.all(np.isfinite(samples)):
        raise DataError(f"{path.name}: {np.count_nonzero(~np.isfinite(samples))} samples are not finite")
    if not np.any(samples):
        raise DataError(f"{path.name}: all {samples.size} samples are zero")
    if samples.size > record.n:
        raise DataError(f"{path.name}: {samples.size} samples do not fit into the record of {record.n}")
    peak = int(np.argmax(np.abs(samples)))
    placed = np.zeros(record.n)
    placed[: samples.size] = samples
    placed = np.roll(placed, record.centre - peak)
    return Wavelet(placed / abs(samples[peak]) if normalise else placed, record, path.name)


def _read(path: Path) -> tuple[FloatArray, float | None]:
    readers: dict[str, Callable[[Path], tuple[FloatArray, float | None]]] = {
        ".csv": _read_csv,
        ".txt": _read_csv,
        ".wav": _read_wav,
        ".npy": _read_npy,
    }
    if path.suffix.lower() not in readers:
        raise DataError(f"{path}: expected a wavelet's file that ends in {', '.join(readers)}")
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    try:
        return readers[path.suffix.lower()](path)
    except (ValueError, OSError, EOFError) as error:
        raise DataError(f"{path.name} cannot be read as {path.suffix[1:].upper()}: {error}") from error


def _read_csv(path: Path) -> tuple[FloatArray, float | None]:
    lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip() and line[0] != "#"]
    try:
        float(lines[0].split(",")[0])
    except (ValueError, IndexError):  # names of the columns, or nothing
        lines = lines[1:]
    if not lines:
        raise ValueError("it holds no numbers")
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    if table.shape[1] == 1:
        return table[:, 0], None
    if table.shape[1] != 2:
        raise ValueError(f"expected 1 or 2 columns, got {table.shape[1]}")
    steps = np.diff(table[:, 0])
    if steps.size == 0 or steps.min() <= 0 or np.ptp(steps) > 1e-3 * steps.mean():
        raise ValueError("its first column is not an evenly increasing time")
    return table[:, 1], float(1 / steps.mean())


def _read_wav(path: Path) -> tuple[FloatArray, float | None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error", wavfile.WavFileWarning)  # scipy only warns of files that are cut short
        warnings.filterwarnings("ignore", message="Chunk .*not understood")
        try:
            rate, samples = wavfile.read(path)
        except wavfile.WavFileWarning as problem:
            raise ValueError(str(problem)) from None
    silence = 128.0 if samples.dtype == np.uint8 else 0.0  # 8 bits have no sign
    return np.asarray(samples, dtype=float) - silence, float(rate)


def _read_npy(path: Path) -> tuple[FloatArray, float | None]:
    array = np.load(path, allow_pickle=False)
    if not np.issubdtype(array.dtype, np.floating) and not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"expected real numbers, got {array.dtype}")
    return np.asarray(array, dtype=float), None
