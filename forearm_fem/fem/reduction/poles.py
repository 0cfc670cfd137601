"""Poles of a reduced model, and rational functions of frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from ...typing import ComplexArray, FloatArray, IntArray
from ..assembly.coefficients import is_polynomial, polynomial_weights
from .reduced_model import ReducedModel

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


# Second stage: from the certified reduced space to the few directions the band uses, and to poles and residues.

_BAND = np.linspace(10.0, 500.0, 50)  # [Hz]
_PROBES = 5  # bins at which poles and residues are compared with the model they stand for
_AT_ONCE = 100  # frequencies: their weights, as many times all poles, stay in the cache (2000: a third longer)


def compressed(reduced: ReducedModel, frequency: FloatArray, *, samples: int = 48, drop: float = 1e-6) -> ReducedModel:
    """The reduced model on the span of its own states at ``samples`` frequencies spread over the band.

    Singular directions below ``drop`` of the largest (states of unit length) are left out; projection keeps the
    structure. Costs ``samples`` small solves, and makes each later frequency several times cheaper.
    """
    states = reduced.states(chebyshev_frequencies(frequency, samples))
    columns = np.concatenate([states.real, states.imag], axis=2).transpose(1, 0, 2).reshape(reduced.size, -1)
    norms = np.linalg.norm(columns, axis=0)
    keep = norms > 1e-12 * norms.max()
    left, values, _ = np.linalg.svd(columns[:, keep] / norms[keep], full_matrices=False)
    return reduced.projected(left[:, values > drop * values[0]])


@dataclass(frozen=True)
class PoleResidue:
    """C(omega) = sum_k left_ik right_kj share_j / (i omega - pole_k): any number of frequencies at once.

    ``left`` (n_port, n_pole) are the modes seen through the ports, ``right`` (n_pole, n_port) their amplitudes.
    """

    poles: ComplexArray
    left: ComplexArray
    right: ComplexArray
    shares: FloatArray

    def compliance(self, frequency: FloatArray) -> ComplexArray:
        """Compliance (n_frequency, n_port, n_port) [m/N]."""
        s = 2j * np.pi * np.asarray(frequency, dtype=float)
        if len(s) < len(self.left):  # pairs of hundreds of ports, times all poles, come to gigabytes
            products = np.array([(self.left / (one - self.poles)) @ self.right for one in s])
            return np.asarray((products + products.transpose(0, 2, 1)) / 2 * self.shares)
        i, j = np.triu_indices(len(self.left))
        pairs = (self.left[i] * self.right.T[j] + self.left[j] * self.right.T[i]) / 2  # reciprocal to the last digit
        values = np.empty((len(s), len(self.left), len(self.left)), dtype=complex)
        for piece in (slice(k, k + _AT_ONCE) for k in range(0, len(s), _AT_ONCE)):
            values[piece, i, j] = (1 / (s[piece, None] - self.poles)) @ pairs.T
        values[:, j, i] = values[:, i, j]
        return np.asarray(values * self.shares)


@dataclass(frozen=True)
class Modes(PoleResidue):
    """Poles and residues with the ``shapes`` (r, n_pole) of the modes in the reduced space."""

    shapes: ComplexArray

    def states(self, frequency: FloatArray, ports: Sequence[int]) -> ComplexArray:
        """Reduced solutions (n_frequency, r, n_chosen) for the force shares of the chosen ``ports``."""
        s = 2j * np.pi * np.asarray(frequency, dtype=float)
        amplitudes = (self.right * self.shares)[:, None, ports] / (s[None, :] - self.poles[:, None])[:, :, None]
        return np.moveaxis(np.tensordot(self.shapes, amplitudes, 1), 1, 0)


def pole_residue(reduced: ReducedModel, frequency: FloatArray = _BAND) -> Modes | None:
    """Diagonalised reduced pencil, or None where a modulus is not Kelvin-Voigt or the diagonalisation is inaccurate.

    Every coefficient must be a polynomial of second degree in omega (Kelvin-Voigt, springs, dashpots, masses). With
    s = i omega: (K + s C + s^2 M) q = f, first companion form s [q, s q]; the result is checked against direct reduced
    solves at bins of ``frequency`` (n,) [Hz], where it will be used, and refused above 1e-8.
    """
    if not all(is_polynomial(c) for c in reduced.coefficients):
        return None
    taylor = np.array([c.taylor(0.0, 2) for c in reduced.coefficients])
    stiffness, damping, mass = (np.tensordot(w, reduced.matrices, 1) for w in polynomial_weights(taylor))
    r, functionals = reduced.size, reduced.functionals
    rate = np.sqrt(np.linalg.norm(stiffness) / np.linalg.norm(mass))  # a typical one, the unit of s
    inverse_k = np.linalg.solve(mass, stiffness) / rate**2
    inverse_c = np.linalg.solve(mass, damping) / rate
    companion = np.block([[np.zeros((r, r)), np.eye(r)], [-inverse_k, -inverse_c]])
    values, vectors = scipy.linalg.eig(companion)
    source = np.vstack([np.zeros_like(functionals), np.linalg.solve(mass, functionals) / rate**2])
    shapes, right = vectors[:r], np.linalg.solve(vectors, source) * rate
    result = Modes(values * rate, functionals.T @ shapes, right, reduced.shares, shapes)
    probes = frequency[np.unique(np.linspace(0, len(frequency) - 1, _PROBES).astype(int))]
    exact, fast = reduced.compliance(probes), result.compliance(probes)
    off, scale = np.nanmax(np.abs(exact - fast), axis=(1, 2)), np.nanmax(np.abs(exact), axis=(1, 2))
    return result if np.all(off < 1e-8 * scale) else None
