"""Signals of a periodic record: wavelet, one-sided spectra, G on the record's bins, and bins missing from it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from scipy.fft import irfft, rfft
from scipy.interpolate import CubicSpline

from ..errors import DataError, ScenarioError
from ..metrics.strength import seconds_of
from ..ports import Port
from ..transfer import ErrorEstimate, TransferMatrix, relative_error_at
from ..typing import BoolArray, ComplexArray, FloatArray, IntArray

if TYPE_CHECKING:
    from .renderers import Control

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
    at 0 Hz and from Nyquist up are left out. DataError for frequencies that do not increase, NaN in a valid entry,
    samples too far apart to interpolate, and if no bin is left.
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

# Filling bins between samples of G, and refusing to where the samples are too far apart.

_ON_BIN = 1e-3  # of the bin spacing: further off, a sample is not on its bin
_PRINTED, _FARTHEST = 6, 0.05  # digits that programs print of a frequency; of the bin spacing, what these may be off
_EVEN = 0.01  # of the spacing: how far it may differ from bin to bin
_NOISE, _ALIKE = 0.1, 2.5  # of the values' size, noise; how much larger misses at twice the spacing are, at most
_GAP, _TOLERANCE = 3.0, 0.01  # times both neighbours, an interval that is a gap; e(f) of a spline, at most
_SHORTEST = 8  # samples: fewer leave no way to judge a spline


def filled_in(
    place: FloatArray,
    values: ComplexArray,
    valid: BoolArray,
    index: IntArray,
    df: float,
) -> tuple[ComplexArray, BoolArray]:
    """Values and mask (n_index, m) on bins ``index`` from samples (n, m) at ``place`` [bins], ``df`` [Hz] apart.

    Samples on a bin are copied; the others serve a cubic spline per unbroken run of valid samples. An interval 3 times
    wider than both its neighbours is a gap: nothing is filled there. Raises DataError where the spline's estimated
    error, max |dG| / max |G| at one frequency, exceeds 1 %.
    """
    shape = (len(index), values.shape[1])
    out, on = np.zeros(shape, dtype=complex), np.zeros(shape, dtype=bool)
    nearest = np.rint(place).astype(int)
    slack = np.clip(_slack(place * df) / df, _ON_BIN, _FARTHEST)
    rows = np.nonzero((np.abs(place - nearest) < slack) & np.isin(nearest, index))[0]
    copied = nearest[rows] - index[0]
    open_bins = np.delete(index, copied)
    if len(open_bins):
        for columns, run in _runs(place, valid):
            inside = open_bins[(open_bins > place[run[0]]) & (open_bins < place[run[-1]])]
            if len(inside):
                known, target = values[np.ix_(run, columns)], np.ix_(inside - index[0], columns)
                _judge(place[run], known, inside, df)
                out[target], on[target] = CubicSpline(place[run], known)(inside), True
    out[copied], on[copied] = values[rows], valid[rows]
    return out, on


def _slack(frequency: FloatArray) -> FloatArray:
    """Tolerance [Hz] of samples at ``frequency`` (n,) [Hz] beside their bins: what six printed digits leave off."""
    digit = 10.0 ** (np.floor(np.log10(np.maximum(frequency, 1e-300))) - (_PRINTED - 1))
    return np.asarray(0.51 * digit)


def _runs(place: FloatArray, valid: BoolArray) -> list[tuple[IntArray, IntArray]]:
    """Entries (columns) with the same mask, with each of their runs of valid samples that is long enough."""
    step = np.diff(place)
    padded = np.concatenate([[0.0], step, [0.0]])
    wide = step > _GAP * np.maximum(padded[:-2], padded[2:])
    patterns, group = np.unique(valid, axis=1, return_inverse=True)
    runs: list[tuple[IntArray, IntArray]] = []
    for g, pattern in enumerate(patterns.T):
        broken = wide | ~pattern[1:] | ~pattern[:-1]
        columns = np.nonzero(np.ravel(group) == g)[0]
        pieces = np.split(np.arange(len(place)), np.nonzero(broken)[0] + 1)
        runs.extend((columns, run) for run in pieces if len(run) >= _SHORTEST)
    return runs


def _judge(place: FloatArray, values: ComplexArray, bins: IntArray, df: float) -> None:
    """Raise if a spline through every other sample misses the rest by more than 8 times the tolerance.

    Halving the spacing of a cubic spline divides its error by up to 16; we count on 8. Only samples next
    to an interval to be filled are asked.
    """
    odd = np.arange(1, len(place) - 1, 2)
    used = np.isin(np.arange(len(place) - 1), np.searchsorted(place, bins) - 1)
    odd = odd[used[odd] | used[odd - 1]]
    if len(odd) == 0:
        return
    miss = CubicSpline(place[::2], values[::2])(place[odd]) - values[odd]
    size = np.maximum(np.abs(values[odd]).max(axis=1), np.finfo(float).tiny)
    error = np.abs(miss).max(axis=1) / size / 8
    worst = int(np.argmax(error))
    if error[worst] > _TOLERANCE and not _noisy(place, values, odd, miss):
        at = odd[worst]
        step = float(np.median(np.diff(place))) * df
        even = bool(np.abs(np.diff(place) * df / step - 1).max() < _EVEN)
        record = f"a record whose bins lie on them, sweep.duration = {1 / step:.6g}," if even else "even frequencies"
        raise DataError(
            f"samples of G near {place[at] * df:.4g} Hz are {(place[at + 1] - place[at]) * df:.3g} Hz apart: "
            f"interpolating them would err by about {error[worst]:.1%}, allowed {_TOLERANCE:.1%}; give {record} or G "
            "on more frequencies (time.length of a recipe)"
        )


def _noisy(place: FloatArray, values: ComplexArray, odd: IntArray, miss: ComplexArray) -> bool:
    """True if ``miss`` (n, m) of every other sample is noise: no course between samples, but what they scatter by.

    Noise is as large whatever samples are left out. A spline of twice the spacing errs by up to 16 times as much in
    what it follows. It is small beside the values; a response that is sampled too seldom is missed by all of them.
    """
    used = odd[(odd >= 2) & (odd < len(place) - 2)]
    if len(used) < _SHORTEST or len(place) < 4 * _SHORTEST:
        return False
    coarse = CubicSpline(place[::4], values[::4])(place[used]) - values[used]
    fine = float(np.median(np.abs(miss)))
    size = float(np.median(np.abs(values)))
    return fine < _NOISE * size and float(np.median(np.abs(coarse))) < _ALIKE * fine


# Missing bins of G: bridged where known bins left out show that this is safe, else their cost is kept in sight.
# A hole rings through the whole record: 3 of 981 bins move S by 30 %.

Fit = Callable[[FloatArray, ComplexArray, FloatArray], ComplexArray]
_SAFE = 0.1  # of the largest entry at a frequency: what a fit may miss at known bins that it did not see
_MARGIN = 2.0  # a bin missing may lie worse than the known ones beside it
_MOST_HOLES = 0.5  # of a band: fewer known bins than missing ones leave nothing to learn from
_LEVELS = (1e-6, 1e-3)  # where a rational fit stops: G as smooth as computed, and as measured
_MOST_TERMS = 25  # of a rational fit: a limb's G over 10-500 Hz needs 20; more would fit noise
_LISTED = 6  # of what is missing, by name
_NEIGHBOURS, _ORDER = 12, 3  # of the local polynomial, which noise does not mislead


@dataclass(frozen=True, eq=False)
class Bridged:
    """G with its safe holes filled (``transfer``), and with all of them (``guess``, None if none is left).

    ``error`` is e(f) of what was filled (None without any); ``filled`` and ``left`` count (bin, entry) pairs; ``bins``
    are those with any hole. ``ends`` counts the pairs before the first or after the last known bin of their entry.
    ``absent`` names the actuators, points and entries of which nothing is known.
    """

    transfer: TransferMatrix
    guess: TransferMatrix | None = None
    error: ErrorEstimate | None = None
    filled: int = 0
    left: int = 0
    bins: int = 0
    ends: int = 0
    absent: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Sentence on the bins that were missing and how they were filled; empty without any."""
        ends = f"G misses {self.ends} values at the ends of its band, which are not bridged and not driven"
        parts = [*([self._holes] if self.bins else []), *([ends] if self.ends else [])]
        return "; ".join([*parts, *([self.said_of_absent] if self.absent else [])])

    @property
    def said_of_absent(self) -> str:
        """Sentence on actuators, points and entries of which nothing is known; empty without any."""
        if not self.absent:
            return ""
        more = f" and {len(self.absent) - _LISTED} more" if len(self.absent) > _LISTED else ""
        names = ", ".join(self.absent[:_LISTED]) + more
        return f"nothing is known of G's {names}: such actuators stay silent, and S is of what is known"

    @property
    def _holes(self) -> str:
        """Of the holes within the band."""
        said = f"G misses {self.filled + self.left} values on {self.bins} bins within its band"
        if self.filled and self.error is not None:
            said += f"; {self.filled} are bridged, with e(f) up to {self.error.worst:.1g} there"
        if self.left:
            said += f"; {self.left} could not be bridged within {_SAFE:.0%} and are not driven: see S' column of holes"
        return said


def bridged(transfer: TransferMatrix) -> Bridged:
    """Fill the holes of each entry of G between its first and its last known bin.

    Each entry is fitted by rational functions (AAA, Nakatsukasa et al. 2018) and by a local polynomial. Known bins
    beside the holes, in runs as long as these, are left out first: the fit that misses them least is taken, and twice
    what it missed is its error. A miss above 10 % of the largest entry at the frequency is not safe. Entries that are
    half unknown, and bins beyond the known band, stay as they are; the latter are counted.
    """
    whole = _with_missing_rows(transfer)
    known = known_of(whole)
    holes, ends = _inner_holes(known), int(np.count_nonzero(beyond(known)))
    absent = _absent(transfer, np.asarray(known.any(axis=0)))
    if not holes.any() or not whole.values[known].any():
        return Bridged(transfer, ends=ends, absent=absent)
    size = np.abs(np.where(known, whole.values, 0)).max(axis=(1, 2))
    size = np.interp(whole.frequency, whole.frequency[size > 0], size[size > 0])
    values, missed = np.where(known, whole.values, 0), np.zeros(known.shape)
    for o, i in np.argwhere(holes.any(axis=0)):
        at, on = np.nonzero(holes[:, o, i])[0], np.nonzero(known[:, o, i])[0]
        values[at, o, i], miss = _best_fit(whole.frequency, values[:, o, i], on, at, size)
        missed[at, o, i] = _MARGIN * miss
    safe = holes & (missed <= _MARGIN * _SAFE)
    filled = np.where(known | safe, values, 0)
    estimate = _estimate(whole.frequency, filled, np.where(safe, missed, 0) * size[:, None, None])
    left = int(np.count_nonzero(holes & ~safe))
    return Bridged(
        replace(whole, values=filled, valid=known | safe),
        replace(whole, values=values, valid=known | holes) if left else None,
        estimate if safe.any() else None,
        int(np.count_nonzero(safe)),
        left,
        int(np.count_nonzero(holes.any(axis=(1, 2)))),
        ends,
        absent,
    )


def known_of(transfer: TransferMatrix) -> BoolArray:
    """True where values (n, n_out, n_in) of G are known."""
    return np.asarray(np.isfinite(transfer.values) & (True if transfer.valid is None else transfer.valid))


def _absent(transfer: TransferMatrix, known: BoolArray) -> tuple[str, ...]:
    """Names of actuators, points and, of the others, entries that are not ``known`` (n_out, n_in) at any frequency."""
    if not known.any():
        return ()
    columns, rows = np.asarray(~known.any(axis=0)), np.asarray(~known.any(axis=1))
    single = ~known & ~columns & ~rows[:, None]
    outputs, inputs = transfer.outputs, transfer.inputs
    return (
        *(f"actuator {inputs[i].name}" for i in np.flatnonzero(columns)),
        *(f"point {outputs[o].name}" for o in np.flatnonzero(rows)),
        *(f"entry {outputs[o].name} <- {inputs[i].name}" for o, i in np.argwhere(single)),
    )


def _estimate(frequency: FloatArray, values: ComplexArray, off: FloatArray) -> ErrorEstimate:
    """Of ``values`` that may be ``off`` (n, n_out, n_in), both in G's unit; what was not filled errs by nothing."""
    largest = np.abs(values).max(axis=(1, 2), keepdims=True)
    shares = np.divide(off, largest, out=np.zeros_like(off), where=largest > 0)
    return ErrorEstimate(
        "bridging", float(np.linalg.norm(off) / np.linalg.norm(values)),
        f"{_MARGIN:g} times what the fit misses at known bins that it did not see",
        tuple(frequency.tolist()), tuple(shares.max(axis=(1, 2)).tolist()), shares,
    )  # fmt: skip


def _with_missing_rows(transfer: TransferMatrix) -> TransferMatrix:
    """G with NaN on the bins that an evenly spaced list of frequencies leaves out."""
    f = transfer.frequency
    if len(f) < _NEIGHBOURS:
        return transfer
    step = float(np.median(np.diff(f)))
    place = np.rint((f - f[0]) / step).astype(int)
    uneven = not np.allclose(f, f[0] + step * place, atol=1e-3 * step) or len(set(place.tolist())) < len(place)
    if uneven or place[-1] + 1 == len(f):
        return transfer
    frequency = f[0] + step * np.arange(place[-1] + 1)
    frequency[place] = f
    values = np.full((len(frequency), *transfer.values.shape[1:]), np.nan + 0j)
    values[place] = transfer.values
    valid = np.zeros(values.shape, dtype=bool)
    valid[place] = np.isfinite(transfer.values) if transfer.valid is None else transfer.valid
    deviation = None if transfer.deviation is None else np.full(values.shape, np.nan)
    if deviation is not None:
        deviation[place] = transfer.deviation
    return replace(transfer, frequency=frequency, values=values, valid=valid, contacts=None, deviation=deviation)


def _inner_holes(known: BoolArray) -> BoolArray:
    """Unknown values with known ones on both sides, in entries known on most of their band."""
    before, after = np.maximum.accumulate(known, axis=0), np.maximum.accumulate(known[::-1], axis=0)[::-1]
    inner = ~known & before & after
    enough = inner.sum(axis=0) <= _MOST_HOLES * (inner | known).sum(axis=0)
    return np.asarray(inner & enough & (known.sum(axis=0) >= _NEIGHBOURS))


def beyond(known: BoolArray) -> BoolArray:
    """Values before the first or after the last known one of their entry; none of an entry that is all unknown."""
    before, after = np.maximum.accumulate(known, axis=0), np.maximum.accumulate(known[::-1], axis=0)[::-1]
    return np.asarray(~(before & after) & known.any(axis=0))


def _best_fit(
    f: FloatArray, values: ComplexArray, on: IntArray, at: IntArray, size: FloatArray
) -> tuple[ComplexArray, float]:
    """Values at the bins ``at`` from those at ``on``, and what the fit misses at known bins, relative to ``size``."""
    asked = _like_holes(on, at)
    rest = np.setdiff1d(on, asked)
    best = (np.zeros(len(at), dtype=complex), np.inf)
    fits: list[Fit] = [*(partial(_rational, level=level) for level in _LEVELS), _local]
    for fit in fits:
        try:
            miss = float(np.max(np.abs(fit(f[rest], values[rest], f[asked]) - values[asked]) / size[asked]))
            if miss < best[1]:
                best = (fit(f[on], values[on], f[at]), miss)
        except (np.linalg.LinAlgError, ImportError):  # SciPy has AAA since 1.15
            continue
        if best[1] < 1e-2 * _SAFE:
            break
    return best


def _like_holes(on: IntArray, at: IntArray) -> IntArray:
    """Known bins to leave out: for each run of holes the known run beside it of the same length, a tenth at most."""
    runs = np.split(at, np.nonzero(np.diff(at) > 1)[0] + 1)
    most, asked = max(len(on) // 10, 1), []
    for run in runs[:: max(1, len(at) // most)]:
        first = int(np.searchsorted(on, run[-1]))
        # one known bin stays between the hole and what is left out
        asked.append(on[first + 1 : first + 1 + len(run)] if first + 2 + len(run) < len(on) else on[-len(run) - 2 : -2])
    return np.unique(np.concatenate(asked))


def _rational(x: FloatArray, y: ComplexArray, at: FloatArray, level: float) -> ComplexArray:
    from scipy.interpolate import AAA

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # that it stopped at its most terms shows in what it misses
        return np.asarray(AAA(x, y, rtol=level, max_terms=_MOST_TERMS)(at))


def _local(x: FloatArray, y: ComplexArray, at: FloatArray) -> ComplexArray:
    """Least-squares cubic through the nearest known bins."""
    first = np.clip(np.searchsorted(x, at) - _NEIGHBOURS // 2, 0, len(x) - _NEIGHBOURS)
    near = first[:, None] + np.arange(_NEIGHBOURS)
    scale = np.abs(x[near] - at[:, None]).max(axis=1, keepdims=True)
    powers = ((x[near] - at[:, None]) / scale)[:, :, None] ** np.arange(_ORDER + 1)
    return np.asarray((np.linalg.pinv(powers) @ y[near][:, :, None])[:, 0, 0])
