"""From a transfer matrix on its own frequencies to the bins of a periodic record, and back to time.

A record of n samples at f_s has bins k f_s / n. Spectra are one-sided and in unit/Hz: X_k = dt sum_j x_j
exp(-i omega_k t_j), phase referred to t = 0 at sample ``centre``; signals are real, so the mirror bins are
the conjugates (the thesis' [9, 4, 20000] form) and are never stored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Self

import numpy as np
from scipy.fft import irfft, rfft

from ..errors import DataError, ScenarioError
from ..ports import Port
from ..transfer import TransferMatrix, relative_error_at
from ..typing import BoolArray, ComplexArray, FloatArray, IntArray
from .bridging import Interpolation, filled_in
from .inversion import Control


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
    interpolation: Interpolation | None = None,
) -> BinValues:
    """Set ``values`` (n_frequency, ...) known at ``frequency`` [Hz] on the bins of a record.

    Samples on a bin (to 1e-3 of the bin spacing) are copied. Between samples, bins are filled by a cubic spline of real
    and imaginary part where ``interpolation`` allows; never across a gap, an invalid sample, or outside the band. Bins
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
        out, on = filled_in(place, np.where(known, flat, 0), known, index, record.df, interpolation or Interpolation())
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


def on_record_bins(
    transfer: TransferMatrix, record: Record, interpolation: Interpolation | None = None
) -> BinnedTransfer:
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
        interpolation=interpolation,
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
