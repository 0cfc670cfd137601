"""Numbers that say how alike two transfer matrices are, per entry, per frequency and overall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...typing import ComplexArray, FloatArray
from .common import CommonGround


@dataclass(frozen=True, eq=False)
class Agreement:
    """B against A, A being the reference; NaN where nothing could be compared.

    Per entry (n_out, n_in): ``magnitude_db`` the rms of 20 log10 |B/A|; ``bias_db`` its mean; ``phase``
    [rad] the rms of the phase of B/A, weighted with |A|^2; ``delay`` [s] the slope of that phase (positive:
    B is later); ``error`` ||B - A|| / ||A||; ``frac`` the frequency response assurance criterion |<A, B>|^2
    / (<A, A><B, B>) over frequency. Per frequency (n,): ``per_frequency`` e(f) and ``fdac`` the same
    criterion over entries. Overall: ``band`` e_band, ``overall_frac``, and ``misfit`` the rms of |B - A|
    over the standard deviations of both, 1 where they differ by noise alone, NaN without deviations.
    """

    magnitude_db: FloatArray
    bias_db: FloatArray
    phase: FloatArray
    delay: FloatArray
    error: FloatArray
    frac: FloatArray
    per_frequency: FloatArray
    fdac: FloatArray
    band: float
    overall_frac: float
    misfit: float
    misfit_entries: FloatArray


def agreement(g: CommonGround) -> Agreement:
    """All of :class:`Agreement` from the valid entries of ``g``."""
    a, b = np.where(g.valid, g.a, 0), np.where(g.valid, g.b, 0)
    both = (a != 0) & (b != 0)
    ratio = np.divide(b, a, out=np.full(a.shape, np.nan + 0j), where=both)
    ratio_db, phase = 20 * np.log10(np.abs(ratio)), np.where(both, np.angle(ratio), np.nan)
    off, largest = np.abs(b - a).max(axis=(1, 2)), np.abs(a).max(axis=(1, 2))
    entry = (0,)
    variance = np.zeros(g.valid.shape)
    for deviation in (g.deviation_a, g.deviation_b):
        variance = variance + (0 if deviation is None else np.nan_to_num(deviation, nan=0.0) ** 2)
    known = g.valid & (variance > 0)  # where something is known about either
    misfit = np.asarray(np.divide(_power(g.b - g.a), variance, out=np.full(g.valid.shape, np.nan), where=known))
    return Agreement(
        magnitude_db=np.sqrt(_mean(ratio_db**2, entry)),
        bias_db=_mean(ratio_db, entry),
        phase=np.sqrt(_share(_power(a) * phase**2, _power(a), entry)),
        delay=_delay(g.omega, a, b),
        error=np.sqrt(_share(_power(b - a), _power(a), entry)),
        frac=assurance(a, b, entry),
        per_frequency=np.divide(off, largest, out=np.full(len(a), np.nan), where=largest > 0),
        fdac=assurance(a, b, (1, 2)),
        band=float(np.sqrt(_share(_power(b - a), _power(a), (0, 1, 2)))),
        overall_frac=float(assurance(a, b, (0, 1, 2))),
        misfit=float(np.sqrt(_mean(misfit, (0, 1, 2)))),
        misfit_entries=np.sqrt(_mean(misfit, entry)),
    )


def assurance(a: ComplexArray, b: ComplexArray, axes: tuple[int, ...]) -> FloatArray:
    """|sum a* b|^2 / (sum |a|^2 sum |b|^2) over ``axes``: 1 if b is a complex number times a; NaN if either is zero.

    Over frequency it is the FRAC (Heylen & Lammens 1996), over entries the diagonal of the FDAC (Pascual et
    al. 1997) in its squared form.
    """
    below = _power(a).sum(axis=axes) * _power(b).sum(axis=axes)
    above = np.abs((a.conj() * b).sum(axis=axes)) ** 2
    return np.asarray(np.divide(above, below, out=np.full(np.shape(below), np.nan), where=below > 0))


def fdac_matrix(g: CommonGround) -> FloatArray:
    """FDAC (n, n) [-] between every frequency of A (rows) and of B (columns): a ridge off the diagonal is a shift."""
    a, b = (np.where(g.valid, m, 0).reshape(len(g.frequency), -1) for m in (g.a, g.b))
    below = _power(a).sum(axis=1)[:, None] * _power(b).sum(axis=1)
    above = np.abs(a.conj() @ b.T) ** 2
    return np.asarray(np.divide(above, below, out=np.full(below.shape, np.nan), where=below > 0))


def _power(x: ComplexArray) -> FloatArray:
    return np.asarray(x.real**2 + x.imag**2)


def _mean(x: FloatArray, axes: tuple[int, ...]) -> FloatArray:
    """Mean of the finite values, NaN if there are none."""
    known = np.isfinite(x)
    count = known.sum(axis=axes)
    total = np.where(known, x, 0).sum(axis=axes)
    return np.asarray(np.divide(total, count, out=np.full(np.shape(count), np.nan), where=count > 0))


def _share(x: FloatArray, weight: FloatArray, axes: tuple[int, ...]) -> FloatArray:
    """sum x / sum weight, NaN for no weight."""
    below = weight.sum(axis=axes)
    above = np.where(np.isfinite(x), x, 0).sum(axis=axes)
    return np.asarray(np.divide(above, below, out=np.full(np.shape(below), np.nan), where=below > 0))


def _delay(omega: FloatArray, a: ComplexArray, b: ComplexArray) -> FloatArray:
    """Delay (n_out, n_in) [s] of b behind a from the phase steps of the cross spectrum between neighbouring
    frequencies, weighted with its size: no unwrapping. NaN with fewer than two frequencies."""
    cross = a.conj() * b
    steps = cross[1:] * cross[:-1].conj()
    width = np.diff(omega)[:, None, None]
    even = np.isclose(width, np.median(width)) if len(omega) > 1 else np.zeros(width.shape, dtype=bool)
    total = np.where(even, steps, 0).sum(axis=0)
    if len(omega) < 2:
        return np.full(a.shape[1:], np.nan)
    return np.where(total != 0, -np.angle(total) / np.median(width), np.nan)
