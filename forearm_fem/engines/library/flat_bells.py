r"""Bells on the limb's flat twin, along its normal and along it.

Two bells at a distance d meet in four integrals :math:`K_q=\frac1{2\pi}\int_0^\infty k\,U\,e^{-k^2w^2}J_q(kd)\,dk` over
the surface compliance: U is zz, zx, and half the sum and half the difference of the compliances along and across a wave
(:mod:`forearm_fem.layered.discs`). With the unit vector e from the one that pushes to the one that reads,

.. math:: T_{zz}=K_0^{zz},\quad T_{zt}=K_1^{zx}e,\quad T_{tt}=K_0^+I-K_2^-(2ee^T-I).
"""

from __future__ import annotations

import numpy as np

from ...layered.hankel import HankelTable, Radial
from ...layered.integrals import Integrals, Medium
from ...typing import ComplexArray, FloatArray, IntArray

_TOLERANCE = 1e-6
_AT_ONCE = 64  # distances of one quadrature
_ORDERS = (0, 1, 0, 2)  # q of the four integrals


def between_flat_bells(
    medium: Medium, frequency: FloatArray, width: float, distances: FloatArray, *, sideways: bool = False
) -> ComplexArray:
    """Integrals (n_frequency, 1, n_distance) [m/N] of two bells of ``width`` [m] at increasing ``distances``; all four
    of them with ``sideways``."""
    omega, kinds, parts = 2 * np.pi * frequency, len(_ORDERS) if sideways else 1, []
    for piece in np.array_split(distances, max(1, len(distances) // _AT_ONCE)):
        kernel, place = (a.ravel() for a in np.indices((kinds, len(piece))))
        order = np.array(_ORDERS)[kernel]
        sure = (order > 0) & (piece[place] == 0)  # J_q(0) = 0
        kernel, place, order = kernel[~sure], place[~sure], order[~sure]
        zero = np.zeros(len(kernel), dtype=int)
        table = HankelTable((Radial("bell", width),), kernel, zero, zero, order, piece[place])
        integrals, out = Integrals(medium, table, _TOLERANCE), np.zeros((len(omega), kinds, len(piece)), dtype=complex)
        for chunk in integrals.chunks(omega):
            out[chunk[:, None], kernel, place] = integrals.solve(omega[chunk]).values
        parts.append(out)
    return np.concatenate(parts, axis=2)


def flat_compliance(
    integrals: ComplexArray, distances: FloatArray, centres: FloatArray, sideways: FloatArray
) -> ComplexArray:
    """Compliance (..., n + 2 s, n + 2 s) between bells along the normal at ``centres`` (n, 2), then along u and along v
    at ``sideways`` (s, 2), from ``integrals`` (..., 1 or 4, n_distance) at the ``distances`` of them all."""
    n, s = len(centres), len(sideways)
    out = np.empty((*integrals.shape[:-2], n + 2 * s, n + 2 * s), dtype=complex)
    out[..., :n, :n] = integrals[..., 0, :][..., _number(distances, centres, centres)]
    if s:
        number, e = _number(distances, centres, sideways), _directions(centres, sideways)
        coupling = np.concatenate([integrals[..., 1, :][..., number] * along for along in e], axis=-1)
        out[..., :n, n:], out[..., n:, :n] = coupling, coupling.swapaxes(-1, -2)
        number, e = _number(distances, sideways, sideways), _directions(sideways, sideways)
        even, odd = integrals[..., 2, :][..., number], integrals[..., 3, :][..., number]
        for i in range(2):
            for j in range(2):
                block = even * (i == j) - odd * (2 * e[i] * e[j] - (i == j))
                out[..., n + i * s : n + (i + 1) * s, n + j * s : n + (j + 1) * s] = block
    return out


def pair_distances(centres: FloatArray) -> FloatArray:
    """The distinct distances (m,) [m] between any two of ``centres`` (n, 2), rising."""
    return np.unique(_distances(centres, centres))


def _distances(some: FloatArray, others: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(some[:, None] - others[None], axis=2).round(9))


def _number(distances: FloatArray, some: FloatArray, others: FloatArray) -> IntArray:
    """Which of ``distances`` each pair (n, m) has."""
    return np.searchsorted(distances, _distances(some, others))


def _directions(some: FloatArray, others: FloatArray) -> FloatArray:
    """Unit vectors (2, n, m) from ``others`` (m, 2) to ``some`` (n, 2); zero between a place and itself."""
    way = np.moveaxis(some[:, None] - others[None], 2, 0)
    length = np.linalg.norm(way, axis=0)
    return np.asarray(way / np.where(length > 0, length, 1.0))
