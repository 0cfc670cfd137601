"""How large the moving spot is."""

from __future__ import annotations

import numpy as np

from ..arguments import checked
from ..errors import DataError
from ..typing import FloatArray


@checked
def contrast(areas: FloatArray, target: int) -> float:
    """Area of |u| at ``target`` over the largest one elsewhere [-]; ``areas`` (n_out,) from :func:`area`.

    Above 1 the target moves most; stricter than S, which compares with the mean. NaN areas are ignored elsewhere; NaN
    where the target or all others are unknown, or nothing moves; inf where the target moves alone. DataError for a
    target that is none of the outputs.
    """
    _check_target(areas, target)
    others = np.delete(areas, target)
    known = others[np.isfinite(others)]
    if not np.isfinite(areas[target]) or not len(known):
        return float("nan")
    if known.max() > 0:
        return float(areas[target] / known.max())
    return float("inf") if areas[target] > 0 else float("nan")


@checked
def spot_radius(areas: FloatArray, positions: FloatArray, target: int) -> float:
    """Root mean square distance [m] of the motion from the target, weighted with ``areas`` (n_out,).

    ``positions`` (n_out, 2 or 3) [m]. Depends on the grid: compare only results on the same grid. NaN areas are left
    out; NaN where the target is unknown or nothing moves. DataError for other shapes and for a target that is none of
    the outputs.
    """
    _check_target(areas, target)
    if positions.ndim != 2 or len(positions) != len(areas):
        raise DataError(f"a spot of {len(areas)} outputs needs as many positions, got {positions.shape}")
    distance = np.linalg.norm(positions - positions[target], axis=1)
    known = np.isfinite(areas)
    if not known[target] or not areas[known].sum() > 0:
        return float("nan")
    return float(np.sqrt(np.sum(areas[known] * distance[known] ** 2) / np.sum(areas[known])))


def _check_target(areas: FloatArray, target: int) -> None:
    if areas.ndim != 1 or not 0 <= target < len(areas):
        raise DataError(f"a spot needs areas (n_out,) and one of the outputs as target, got {areas.shape}, {target}")


@checked
def fwhm(position: FloatArray, value: FloatArray) -> float:
    """Full width [m] at half of the maximum of ``value`` (n,) at increasing ``position`` (n,) [m], linear
    between points.

    NaN if the values do not fall to half on both sides: the spot is wider than the line; and where one is unknown or
    none is positive. Raises DataError for bad lengths.
    """
    if value.shape != position.shape or len(value) < 3 or np.any(np.diff(position) <= 0):
        raise DataError("a width needs at least 3 values at increasing positions")
    peak = int(np.argmax(value))
    if not np.isfinite(value).all() or not value[peak] > 0:
        return float("nan")
    left = _crossing(position[peak::-1], value[peak::-1])
    right = _crossing(position[peak:], value[peak:])
    return abs(right - left)


def _crossing(position: FloatArray, value: FloatArray) -> float:
    """Position at which the values, falling from the first one, first reach half of it."""
    below = np.nonzero(value <= value[0] / 2)[0]
    if len(below) == 0:
        return float("nan")
    i = int(below[0])
    share = (value[i - 1] - value[0] / 2) / (value[i - 1] - value[i])
    return float(position[i - 1] + share * (position[i] - position[i - 1]))
