r"""Discs that are held sideways: what they take from the motion of the limb, and from its uncertainty.

Bonded discs move along the normal only. On discs let go, with forces :math:`f_t` along the skin,
:math:`u_t=C_{tz}f_z+C_{tt}f_t=0` holds them, so that

.. math:: C=C_{zz}+B\,C_{tz}=C_{zz}-C_{zt}C_{tt}^{-1}C_{tz},\quad B=-C_{zt}C_{tt}^{-1}.

A small change of the free compliance changes it by :math:`[I\;B]\,\delta C\,[I\;B]^T`.
"""

from __future__ import annotations

import numpy as np

from ...typing import ComplexArray, FloatArray


def held(free: ComplexArray, n: int) -> tuple[ComplexArray, ComplexArray]:
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
