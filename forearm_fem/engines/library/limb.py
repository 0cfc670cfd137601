"""Compliance of combinations of loads by poles and residues, with ports held still."""

from __future__ import annotations

import numpy as np

from ...fem.reduction.affine import Modes
from ...layered.response import chebyshev_between, chebyshev_nodes
from ...typing import BoolArray, ComplexArray, FloatArray, IntArray

# Discs that are held sideways: what they take from the motion of the limb, and from its uncertainty.
# Bonded discs move along the normal only. On discs let go, with forces :math:`f_t` along the skin,
# :math:`u_t=C_{tz}f_z+C_{tt}f_t=0` holds them, so that
# .. math:: C=C_{zz}+B\,C_{tz}=C_{zz}-C_{zt}C_{tt}^{-1}C_{tz},\quad B=-C_{zt}C_{tt}^{-1}.
# A small change of the free compliance changes it by :math:`[I\;B]\,\delta C\,[I\;B]^T`.


def constrained_compliance(free: ComplexArray, n: int) -> tuple[ComplexArray, ComplexArray]:
    """Compliance (n_frequency, n, n) [m/N] where all but the first ``n`` directions of ``free`` (n_frequency, m, m) are
    held, symmetric; and B (n_frequency, n, m - n)."""
    motion = free[:, n:, :n]
    forces = np.linalg.solve(free[:, n:, n:], motion)
    taken = motion.swapaxes(1, 2) @ forces
    return free[:, :n, :n] - 0.5 * (taken + taken.swapaxes(1, 2)), np.asarray(-forces.swapaxes(1, 2))


def deviation_held(deviation: FloatArray, hold: ComplexArray) -> FloatArray:
    """Standard deviation (n_frequency, n, n) [m/N] where those of ``free``, (n_frequency, m, m), are independent."""
    n = hold.shape[1]
    share, squared = np.abs(hold) ** 2, deviation**2
    both = share @ squared[:, n:, :n]
    total = squared[:, :n, :n] + both + both.swapaxes(1, 2) + share @ squared[:, n:, n:] @ share.swapaxes(1, 2)
    return np.asarray(np.sqrt(total))


# The limb as bells on its skin see it: poles and residues.

_DEGREE = 12  # of the Chebyshev rule that carries what far poles add up to
_FAR = 3.5  # half axes of a pole's Bernstein ellipse from which it is far: 3.5^-12 is 3e-7
_NUMBERS = 2**18  # of the residues of some poles that are held side by side: four megabytes stay in the cache


def modal_compliance(
    limb: Modes, frequency: FloatArray, weights: FloatArray, wanted: BoolArray | None = None
) -> ComplexArray:
    """Compliance (n_frequency, p, p) of p combinations ``weights`` (n, p) of the limb's bells; of those ``wanted`` (p,
    p), or all, others are zero.

    Poles far from the band asked for are summed at the nodes of a Chebyshev rule, near ones at every frequency.
    """
    p = weights.shape[1]
    i, j = np.nonzero(np.triu(np.ones((p, p), dtype=bool) if wanted is None else wanted | wanted.T))
    poles, modes = limb.half
    seen, omega, paired = real_product(weights.T, modes), 2 * np.pi * frequency, poles.imag > 0
    near, ends = _near(poles, omega), (float(omega.min()), float(omega.max()))
    some = len(omega) > 2 * _DEGREE
    at = 1j * (chebyshev_nodes(*ends, _DEGREE) if some else omega)
    own = np.where((near & some)[:, None], 0.0, 1 / (at - poles[:, None]))
    values = _summed(seen, i, j, own, paired[:, None] / (at - poles[:, None].conj()))
    if some:
        values = chebyshev_between(*ends, omega, values)[0]
        values += _summed(seen[:, near], i, j, 1 / (1j * omega - poles[near, None]))
    whole = np.zeros((len(omega), p, p), dtype=complex)
    whole[:, i, j] = whole[:, j, i] = values
    return whole


def _near(poles: ComplexArray, omega: FloatArray) -> BoolArray:
    """True where ``poles`` (m,) [1/s] keep a Chebyshev rule in the root of ``omega`` [rad/s] from converging."""
    low, high = np.sqrt(omega.min()), np.sqrt(omega.max())
    if not high > low:
        return np.zeros(len(poles), dtype=bool)
    root = np.sqrt(poles / 1j)
    x = (2 * np.stack([root, -root]) - low - high) / (high - low)
    beside = np.sqrt(x * x - 1)
    return np.asarray((np.maximum(np.abs(x + beside), np.abs(x - beside)) < _FAR).any(axis=0))


def _summed(
    seen: ComplexArray, i: IntArray, j: IntArray, own: ComplexArray, mirrored: ComplexArray | float = 0.0
) -> ComplexArray:
    """Sums (n, pairs) over poles k of r ``own`` (m, n) + conj(r) ``mirrored`` (m, n), r = ``seen``_ik ``seen``_jk.

    As a product of real numbers: Re r (own + mirrored) + Im r i (own - mirrored).
    """
    n = own.shape[1]
    factors = np.stack([own + mirrored, 1j * (own - mirrored)], axis=1)
    total, step = np.zeros((len(i), 2 * n)), max(8, _NUMBERS // max(1, len(i)))
    for start in range(0, seen.shape[1], step):
        some = seen[:, start : start + step]
        factor = factors[start : start + step].reshape(-1, n)
        total += (some[i] * some[j]).view(float) @ factor.view(float)
    return np.asarray(total.view(complex).T)


def real_product(some: FloatArray, others: ComplexArray) -> ComplexArray:
    """``some`` (p, n) times ``others`` (..., n, m) without making the first complex."""
    return np.asarray((some @ others.view(float)).view(complex))
