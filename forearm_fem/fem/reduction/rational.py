"""Rational functions of frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...typing import ComplexArray, FloatArray, IntArray

# Few frequencies for many: a rational function through some values, checked against the others.
# The barycentric form of Nakatsukasa, Sete and Trefethen (AAA, SIAM J. Sci. Comput. 40, 2018), all entries with the
# same weights: supports are taken where the function errs most, weights make it the best at all other values.


@dataclass(frozen=True)
class Rational:
    """Entries (k,) as functions of frequency: ``supports`` (m,) [Hz], ``values`` (m, k) and ``weights`` (m,).

    ``misfits`` (m,) are the largest errors of the watched entries at the frequencies it did not pass through, relative
    to the largest entry there.
    """

    supports: FloatArray
    values: ComplexArray
    weights: ComplexArray
    misfits: FloatArray

    @property
    def misfit(self) -> float:
        """The largest of all."""
        return float(self.misfits.max())

    def at(self, frequency: FloatArray) -> ComplexArray:
        """Entries (n, k) at ``frequency`` (n,) [Hz]."""
        apart = 2j * np.pi * (np.asarray(frequency, dtype=float)[:, None] - self.supports)
        here = np.abs(apart) < 1e-9
        shares = self.weights / np.where(here, 1.0, apart)
        shares = np.where(here.any(axis=1)[:, None], here, shares)
        return np.asarray((shares @ self.values) / shares.sum(axis=1)[:, None])


def rational(frequency: FloatArray, values: ComplexArray, tolerance: float, watched: int | None = None) -> Rational:
    """A rational function of the smallest degree within ``tolerance`` of ``values`` (n, k), or of two thirds of n.

    Only the first ``watched`` entries, all where left out, shape it and are compared.
    """
    seen = values[:, :watched]
    sizes, lengths = np.abs(seen).max(axis=1), np.linalg.norm(seen, axis=0)
    lengths[lengths == 0] = 1.0
    scaled = seen / lengths  # weak entries shape the function as much as strong ones
    supports, fit = [_farthest(scaled, np.broadcast_to(scaled.mean(axis=0), scaled.shape), [])], None
    while fit is None or (fit.misfit > tolerance and len(supports) < 2 * len(frequency) // 3):
        weights = _weights(frequency, scaled, np.array(supports))
        made = Rational(frequency[supports], values[supports], weights, np.zeros(seen.shape[1]))
        found = made.at(frequency)[:, :watched]
        fit = Rational(made.supports, made.values, made.weights, (np.abs(found - seen) / sizes[:, None]).max(axis=0))
        if fit.misfit > tolerance:
            supports.append(_farthest(scaled, found / lengths, supports))
    return fit


def _farthest(values: ComplexArray, found: ComplexArray, taken: list[int]) -> int:
    error = np.abs(values - found).max(axis=1)
    error[taken] = -1.0
    return int(np.argmax(error))


def _weights(frequency: FloatArray, values: ComplexArray, supports: IntArray) -> ComplexArray:
    """The last right singular vector of the Loewner matrix of all entries."""
    others = np.setdiff1d(np.arange(len(frequency)), supports)
    cauchy = 1 / (2j * np.pi * (frequency[others, None] - frequency[supports]))
    loewner = (values[others, None, :] - values[None, supports, :]) * cauchy[:, :, None]
    rows = loewner.transpose(0, 2, 1).reshape(-1, len(supports))
    return np.asarray(np.linalg.svd(np.linalg.qr(rows, mode="r"))[2][-1].conj())


def chebyshev_frequencies(band: FloatArray, count: int) -> FloatArray:
    """``count`` Chebyshev points in the square root of the frequency, the ends of the ``band`` (n,) [Hz] included."""
    low, high = np.sqrt(band[0]), np.sqrt(band[-1])
    return np.asarray((low + (high - low) * (1 - np.cos(np.pi * np.arange(count) / (count - 1))) / 2) ** 2)
