"""Signals of a periodic record: wavelet, one-sided spectra, and G on the record's bins."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from scipy.fft import irfft, rfft
from scipy.io import wavfile

from ..errors import DataError, ScenarioError
from ..metrics.strength import seconds_of
from ..ports import Port
from ..transfer import TransferMatrix, relative_error_at
from ..typing import BoolArray, ComplexArray, FloatArray, IntArray
from .bridging import filled_in

# From a transfer matrix on its own frequencies to the bins of a periodic record, and back to time.
# A record of n samples at f_s has bins k f_s / n. Spectra are one-sided and in unit/Hz: X_k = dt sum_j x_j
# exp(-i omega_k t_j), phase referred to t = 0 at sample ``centre``; signals are real, so the mirror bins are
# the conjugates (the thesis' [9, 4, 20000] form) and are never stored.

@dataclass(frozen=True)
class Record:
    """One period of n samples at ``sample_rate`` [Hz]; t = 0 at sample ``centre`` = n // 2."""

    sample_rate: float
    n: int

    @classmethod
    def of(cls, sample_rate: float, duration: float) -> Self:
        """The record of ``duration`` [s]; raises ScenarioError unless it holds a whole number of samples."""
        n = round(sample_rate * duration) if sample_rate > 0 and duration > 0 else 0
        if n < 4 or abs(n - sample_rate * duration) > 1e-6 * n:
            raise ScenarioError(
                f"{duration:g} s at {sample_rate:g} Hz is no whole number of samples >= 4; change either"
            )
        return cls(float(sample_rate), n)

    @property
    def centre(self) -> int:
        """Index of the sample at t = 0."""
        return self.n // 2

    @property
    def df(self) -> float:
        """Spacing of the bins [Hz]: 1 / duration."""
        return self.sample_rate / self.n

    @property
    def time(self) -> FloatArray:
        """Time of the samples (n,) [s]."""
        return np.asarray((np.arange(self.n) - self.centre) / self.sample_rate, dtype=np.float64)

    @property
    def frequency(self) -> FloatArray:
        """All one-sided bins (n // 2 + 1,) [Hz]."""
        return np.asarray(np.arange(self.n // 2 + 1) * self.df, dtype=np.float64)

    @property
    def weights(self) -> FloatArray:
        """Times a one-sided bin occurs in the two-sided spectrum (n // 2 + 1,): 2, but 1 at 0 Hz and Nyquist."""
        weights = np.full(self.n // 2 + 1, 2.0)
        weights[0] = 1
        if self.n % 2 == 0:
            weights[-1] = 1
        return weights

if TYPE_CHECKING:
    from .inverse_filter import Control


def to_spectrum(signals: FloatArray, record: Record) -> ComplexArray:
    """One-sided spectra (..., n // 2 + 1) [unit/Hz] of ``signals`` (..., n) [unit]: forward DFT times dt."""
    if signals.shape[-1:] != (record.n,):
        raise DataError(f"signals of a record have its {record.n} samples along the last axis, got {signals.shape}")
    rolled = np.roll(signals, -record.centre, axis=-1)
    return np.asarray(rfft(rolled, axis=-1) / record.sample_rate, dtype=np.complex128)


def to_time(spectrum: ComplexArray, index: IntArray, record: Record) -> FloatArray:
    """Real signals (m, n) [unit] of the spectra (n_bins, m) [unit/Hz] on the bins ``index``; zero elsewhere."""
    if spectrum.ndim != 2 or index.shape != spectrum.shape[:1] or np.any((index < 0) | (index > record.n // 2)):
        raise DataError(
            f"spectra (n_bins, m) need as many bins 0 to {record.n // 2} of the record, got {spectrum.shape} on "
            f"{index.shape}"
        )
    full = np.zeros((spectrum.shape[1], record.n // 2 + 1), dtype=complex)
    full[:, index] = spectrum.T * record.sample_rate
    signals = irfft(full, record.n, axis=-1, overwrite_x=True)
    return np.asarray(np.roll(signals, record.centre, axis=-1), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class BinValues:
    """Values on bins of a record: ``index`` (n_bins,), ``values`` and ``valid`` (n_bins, ...).

    Bins on which nothing is known are absent; ``values`` is zero where ``valid`` is False.
    """

    record: Record
    index: IntArray
    values: ComplexArray
    valid: BoolArray

    @cached_property
    def frequency(self) -> FloatArray:
        """Frequencies of the bins (n_bins,) [Hz]."""
        return np.asarray(self.record.df * self.index, dtype=np.float64)


def place_on_bins(
    frequency: FloatArray,
    values: ComplexArray,
    sample_rate: float,
    duration: float,
    *,
    valid: BoolArray | None = None,
) -> BinValues:
    """Set ``values`` (n_frequency, ...) known at ``frequency`` [Hz] on the bins of a record.

    Samples on a bin (to 1e-3 of the bin spacing) are copied. Between samples, bins are filled by a cubic spline of real
    and imaginary part where that is safe; never across a gap, an invalid sample, or outside the band. Bins
    at 0 Hz and from Nyquist up are left out. Raises DataError for frequencies that do not increase, for NaN in a valid
    entry, for samples too far apart to interpolate, and if no bin is left.
    """
    record = Record.of(sample_rate, duration)
    if values.ndim < 1:
        raise DataError(f"values at frequencies have these as their first axis, got {values.shape}")
    valid = _checked(np.asarray(frequency, dtype=float), values, valid)
    place = np.asarray(frequency, dtype=float) / record.df
    flat, known = values.reshape(len(values), -1), valid.reshape(len(values), -1)
    index = np.arange(max(1, int(np.ceil(place[0] - 1e-3))), min((record.n - 1) // 2, int(place[-1] + 1e-3)) + 1)
    out, on = np.zeros((0, flat.shape[1]), dtype=complex), np.zeros((0, flat.shape[1]), dtype=bool)
    if len(index):
        out, on = filled_in(place, np.where(known, flat, 0), known, index, record.df)
    kept = on.any(axis=1)
    if not known.any():
        raise DataError(
            "G holds no valid entry at any frequency, so that there is nothing to render; measure or solve it"
        )
    if not kept.any():
        raise DataError(
            f"no bin of the record (every {record.df:g} Hz) lies on or between samples of G "
            f"({frequency[0]:g}-{frequency[-1]:g} Hz, {len(frequency)} of them); compute G on the bins"
        )
    shape = (int(kept.sum()), *values.shape[1:])
    return BinValues(record, index[kept], out[kept].reshape(shape), on[kept].reshape(shape))


def _checked(frequency: FloatArray, values: ComplexArray, valid: BoolArray | None) -> BoolArray:
    if frequency.ndim != 1 or len(frequency) != len(values) or len(frequency) == 0:
        raise DataError(f"G has {len(values)} matrices for frequencies of shape {frequency.shape}")
    if not np.all(np.isfinite(frequency)) or np.any(np.diff(frequency) <= 0) or frequency[0] <= 0:
        raise DataError("the frequencies of G must be positive and increase")
    usable = np.ones(values.shape, dtype=bool) if valid is None else np.asarray(valid, dtype=bool)
    if usable.shape != values.shape:
        raise DataError(f"the mask of G has shape {usable.shape}, expected {values.shape}")
    if bad := int(np.count_nonzero(~np.isfinite(values) & usable)):
        first = frequency[np.nonzero((~np.isfinite(values) & usable).reshape(len(values), -1).any(axis=1))[0][0]]
        raise DataError(f"G has {bad} entries that are not finite, the first at {first:g} Hz; mark them in `valid`")
    return usable


@dataclass(frozen=True, eq=False)
class BinnedTransfer:
    """A transfer matrix on the bins of a record: ``bins.values`` (n_bins, n_out, n_in) in ``unit``.

    ``error`` (n_bins,) [-] is e(f) that its measurement states, NaN where that is unknown or G was not measured: what
    a simulation states of itself is in the interval of S and moves no drive (decision 0027).
    ``controls`` are control points, by their rows, that are decomposed already (:func:`.with_controls`): what has none
    is decomposed when it is asked for, to the same last bit.
    """

    bins: BinValues
    outputs: tuple[Port, ...]
    inputs: tuple[Port, ...]
    unit: str
    error: FloatArray
    controls: Mapping[tuple[int, ...], Control] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def record(self) -> Record:
        """The record the bins belong to."""
        return self.bins.record

    def row(self, name: str) -> int:
        """Index of the output called ``name``; raises ScenarioError if there is none."""
        names = [p.name for p in self.outputs]
        if name not in names:
            raise ScenarioError(f"'{name}' is no output of G; its outputs are {', '.join(names)}")
        return names.index(name)


def on_record_bins(transfer: TransferMatrix, record: Record) -> BinnedTransfer:
    """``transfer`` on the bins of ``record``; raises as :func:`place_on_bins` and DataError for a wrong shape."""
    expected = (len(transfer.frequency), len(transfer.outputs), len(transfer.inputs))
    if transfer.values.shape != expected:
        raise DataError(f"G has shape {transfer.values.shape}, expected {expected} (frequency, output, input)")
    duration = record.n / record.sample_rate
    bins = place_on_bins(
        transfer.frequency,
        transfer.values,
        record.sample_rate,
        duration,
        valid=transfer.valid,
    )
    parts = [relative_error_at(e, bins.frequency) for e in transfer.errors if e.source == "measurement"]
    error = np.linalg.norm(parts, axis=0) if parts else np.full(len(bins.index), np.nan)
    return BinnedTransfer(bins, transfer.outputs, transfer.inputs, transfer.unit, np.asarray(error))


def respond(placed: BinnedTransfer, spectrum: ComplexArray) -> FloatArray:
    """Displacements (n_out, n_t) [m] for drive spectra (n_bins, n_in) [unit/Hz]; eq. 3 of de Vlam 2022.

    Entries of G that are not valid count as zero.
    """
    if spectrum.shape != (expected := (len(placed.bins.index), len(placed.inputs))):
        raise DataError(f"spectra of drives have the shape {expected} (bin, input), got {spectrum.shape}")
    return to_time((placed.bins.values @ spectrum[:, :, None])[:, :, 0], placed.bins.index, placed.record)


# The stimulus: samples at a rate, with a time zero.

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
