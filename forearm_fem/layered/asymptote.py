r"""Static interaction of two discs on a half-space: :math:`\frac1{2\pi}\int_0^\infty j(ka)j(kb)J_0(kd)\,dk`.

With :math:`j(x)=2J_1(x)/x` this times (1 - nu)/mu is the displacement, averaged over a disc of radius b at
distance d, due to a unit force spread uniformly over a disc of radius a. [1/m]
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy import special

from ..typing import FloatArray

# Tanh-sinh rule on (-1, 1): exact to rounding with square-root and logarithmic ends.
_STEP = np.arange(-3.6, 3.6001, 0.06)
_ABSCISSAE = np.tanh(0.5 * np.pi * np.sinh(_STEP))
_WEIGHTS = 0.06 * 0.5 * np.pi * np.cosh(_STEP) / np.cosh(0.5 * np.pi * np.sinh(_STEP)) ** 2


def disc_potential(r: FloatArray, radius: float) -> FloatArray:
    """One uniform disc, seen at points: Weber-Schafheitlin integrals.

    (1/(pi a)) F(1/2, -1/2; 1; r^2/a^2) inside, (1/(2 pi r)) F(1/2, 1/2; 2; a^2/r^2) outside; inf at a point
    source itself.
    """
    r = np.asarray(r, dtype=float)
    inside = r < radius
    near, far = np.where(inside, r, 0.0), np.where(inside, 1.0, r)
    with np.errstate(divide="ignore", invalid="ignore"):
        out = special.hyp2f1(0.5, 0.5, 2.0, np.where(inside, 0.0, (radius / far) ** 2)) / (2 * np.pi * far)
        if radius > 0:
            within = special.hyp2f1(0.5, -0.5, 1.0, (near / radius) ** 2) / (np.pi * radius)
            out = np.where(inside, within, out)
    return np.where((r == 0) & (radius == 0), np.inf, out)


def disc_interaction(distance: float, a: float, b: float) -> float:
    """Two uniform discs, coincident, overlapping or apart; symmetric in a and b [1/m].

    The larger disc is the source; the mean over the smaller, b, is an integral over rings around the source,
    2 r theta(r) dr, theta = arccos((r^2 + d^2 - b^2)/(2 r d)) the half angle of the ring inside b.
    """
    a, b = max(a, b), min(a, b)
    if b == 0:
        return float(disc_potential(np.array(distance), a))
    if distance == 0:
        return float(special.hyp2f1(0.5, -0.5, 2.0, (b / a) ** 2) / (math.pi * a))
    cuts = {abs(distance - b), distance + b}
    cuts |= {a} if min(cuts) < a < max(cuts) else set()
    cuts |= {0.0} if distance < b else set()
    edges = sorted(cuts)
    total = sum(_ring_integral(lo, hi, distance, a, b) for lo, hi in itertools.pairwise(edges))
    return total / (math.pi * b * b)


def _ring_integral(lo: float, hi: float, distance: float, a: float, b: float) -> float:
    """Integral of 2 r theta(r) times the potential of disc a over lo < r < hi."""
    r = np.maximum(0.5 * (lo + hi) + 0.5 * (hi - lo) * _ABSCISSAE, 1e-12 * hi)
    weight = 0.5 * (hi - lo) * _WEIGHTS
    cosine = (r * r + distance * distance - b * b) / (2 * r * distance)
    theta = np.arccos(np.clip(cosine, -1.0, 1.0))
    return float(np.sum(weight * 2 * r * theta * disc_potential(r, a)))
