"""What an error of G means for S."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arguments import checked
from ..errors import DataError
from ..transfer import ErrorEstimate, TransferMatrix, error_of_pairs, relative_error_at
from ..typing import ComplexArray, FloatArray

_WAVES = 64  # random cosines that make up one perturbation


@dataclass(frozen=True, eq=False)
class StrengthInterval:
    """S of the unperturbed G, and the ``low``, ``median`` and ``high`` quantiles over perturbed ones, each
    [-].

    All have the shape of what the strength function returns; ``samples`` (n_draws, ...) are the draws.
    """

    value: FloatArray
    low: FloatArray
    median: FloatArray
    high: FloatArray
    samples: FloatArray
    coverage: float


@checked
def signal_strength_uncertainty(
    transfer: TransferMatrix,
    strength: Callable[[TransferMatrix], FloatArray],
    errors: Sequence[ErrorEstimate] | None = None,
    *,
    draws: int = 100,
    seed: int = 0,
    correlation: float = 50.0,
    coverage: float = 0.95,
) -> StrengthInterval:
    """Interval of S when G errs by ``errors`` (None: those of ``transfer``), by Monte Carlo.

    ``strength`` maps a G to S of any shape, e.g. ``lambda g: strengths(g, targets, methods, wavelet)``: it aims anew on
    each perturbed G (the error of the S printed), or replays fixed drives (what a device calibrated on a wrong G does).
    Each source adds an independent complex Gaussian perturbation, as large at each pair of ports as it states there
    (:func:`perturbed`), or where it does not tell pairs apart over all entries, with max_ij |dG_ij| = e(f) max_ij
    |G_ij| at every frequency, smooth in frequency over about ``correlation`` [Hz]: discretisation and truncation err
    smoothly, and errors white in frequency would average out of S. The true error has structure that this does not
    know. Holes of G are left as they are; what they cost is not in the interval. Raises DataError without errors, with
    one that is unknown, or with fewer than 2 draws.
    """
    sources = tuple(transfer.errors if errors is None else errors)
    if not sources or draws < 2 or not 0 < coverage < 1 or correlation <= 0:
        raise DataError("an interval of S needs error estimates of G, at least 2 draws, a coverage in (0, 1)")
    if lost := [e.source for e in sources if not e.known]:
        raise DataError(f"the error by {', '.join(lost)} is unknown, and so is the interval of S")
    rng = np.random.default_rng(seed)
    samples = np.stack([strength(perturbed(transfer, sources, rng, correlation)) for _ in range(draws)])
    tail = (1 - coverage) / 2
    low, median, high = np.quantile(samples, [tail, 0.5, 1 - tail], axis=0)
    value = np.asarray(strength(transfer), dtype=float)
    return StrengthInterval(value, np.asarray(low), np.asarray(median), np.asarray(high), samples, coverage)


def perturbed(
    transfer: TransferMatrix, sources: Sequence[ErrorEstimate], rng: np.random.Generator, correlation: float
) -> TransferMatrix:
    """G plus one draw of its errors: complex noise per source, independent over entries, smooth over ``correlation``
    [Hz]. Its root mean square is each pair's own error where a source tells pairs apart; its largest entry is e(f) of
    the largest of G at each frequency where not."""
    usable = np.isfinite(transfer.values) if transfer.valid is None else transfer.valid & np.isfinite(transfer.values)
    scale = np.max(np.abs(transfer.values), axis=(1, 2), where=usable, initial=0)
    change = np.zeros(transfer.values.shape, dtype=complex)
    for source in sources:
        noise = smooth_noise(transfer.frequency, transfer.values.shape[1:], rng, correlation)
        size = error_of_pairs(source, transfer.frequency)
        if size is None:
            noise /= np.abs(noise).max(axis=(1, 2), keepdims=True)
            size = relative_error_at(source, transfer.frequency)[:, None, None]
        change += scale[:, None, None] * size * noise
    return replace(transfer, values=transfer.values + change)


@checked
def smooth_noise(
    frequency: FloatArray, shape: tuple[int, ...], rng: np.random.Generator, correlation: float
) -> ComplexArray:
    """Complex noise (n, *shape) [-] of unit variance with correlation exp(-(df / correlation)^2 / 2), df in
    [Hz].

    Sum of 64 exponentials exp(i tau f) with random amplitudes and tau normal of width 1 / correlation.
    """
    whole = isinstance(shape, list | tuple) and all(isinstance(n, int | np.integer) and n >= 0 for n in shape)
    if frequency.ndim != 1 or not whole or not 0 < correlation < np.inf:
        raise DataError(
            "noise needs frequencies (n,), a shape of whole numbers and a positive correlation in Hz, got "
            f"{frequency.shape}, {shape!r} and {correlation:g}"
        )
    tau = rng.normal(0, 1 / correlation, _WAVES)
    amplitude = rng.normal(size=(_WAVES, *shape)) + 1j * rng.normal(size=(_WAVES, *shape))
    return np.asarray(np.tensordot(np.exp(1j * np.outer(frequency, tau)), amplitude / np.sqrt(2 * _WAVES), axes=1))
