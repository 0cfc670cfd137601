"""How near two transfer matrices are, and when what brings them nearer is a mistake and not another arm.

Nearness is s = ||A - B|| / sqrt(||A|| ||B||), as large for B a thousand times too small as for a thousand times too
large.
"""

from __future__ import annotations

import math

import numpy as np

from ...typing import ComplexArray

_BETTER, _NEAR = 3.0, 1.0  # a reading must lower s at least so many times, to no more than this,
_SHAPE, _GAINED = 0.6, 0.5  # or raise the correlation by the second to above the first, sizes being within LARGE,
_FAR, _NEARISH = 10.0, 2.0  # or bring what lies beyond the first, correlating so, to within the second
PRICE = 1.5  # every further element of a reading must lower s this many times
FLOOR = 1e-3  # s below this counts as exact: rounding must not choose
AGREES = 0.5  # e_band up to which two are called so
LARGE = 30.0  # a ratio of norms beyond this is said even where no reading helps


def explains(base: float, shape_before: float, after: float, shape: float) -> bool:
    """Whether distances and correlations before and after a reading are those of a mistake, not of another arm."""
    nearer = after <= min(base / _BETTER, _NEAR)
    alike = shape >= _SHAPE and shape - shape_before >= _GAINED and after <= math.sqrt(LARGE + 1 / LARGE - 2 * shape)
    return nearer or alike or (base >= _FAR and after <= _NEARISH and shape >= _SHAPE)


def distance(a: ComplexArray, b: ComplexArray) -> float:
    """s [-] of two matrices of one shape."""
    return float(np.linalg.norm(a - b) / np.sqrt(np.linalg.norm(a) * np.linalg.norm(b)))


def correlation(a: ComplexArray, b: ComplexArray) -> float:
    """Re <a, b> / (||a|| ||b||) [-]."""
    return float((a.conj() * b).real.sum() / (np.linalg.norm(a) * np.linalg.norm(b)))
