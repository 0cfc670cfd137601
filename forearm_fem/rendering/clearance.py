"""Clearance of points from motors: near a rim a point moves with the motor, and S there is no focus."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..ports import Port, distances
from ..typing import BoolArray, FloatArray

CLEARANCE = 9e-3
"""Least distance [m] of a counted point from a rim: the corners of the thesis' device lie 9.5 mm off theirs."""
_SLACK = 1e-9  # m: rounding of places


def rim_gaps(outputs: Sequence[Port], inputs: Sequence[Port]) -> FloatArray:
    """Distance (n_out,) [m] of each output from the nearest rim, negative under a cone; NaN where places are unknown.

    ``inputs`` are the contacts that touch the skin; inf where there are none.
    """
    if not inputs:
        return np.full(len(outputs), np.inf)
    gaps = distances(tuple(outputs), tuple(inputs)) - np.array([p.radius for p in inputs])
    return np.asarray(np.where(np.isnan(gaps).any(axis=1), np.nan, gaps.min(axis=1)))


def counted_points(outputs: Sequence[Port], inputs: Sequence[Port], clearance: float = CLEARANCE) -> BoolArray:
    """Whether S towards each output (n_out,) counts: none under a cone or within ``clearance`` [m] of a rim does.

    Points whose places are unknown count.
    """
    return ~(rim_gaps(outputs, inputs) < clearance - _SLACK)


def not_counted_words(
    names: Sequence[str], outputs: Sequence[Port], inputs: Sequence[Port], clearance: float = CLEARANCE
) -> str:
    """E.g. ``points 4 and 6 are not counted: under a motor``, of those of ``outputs`` in ``names``; else empty."""
    gaps = dict(zip((p.name for p in outputs), rim_gaps(outputs, inputs), strict=True))
    under = [n for n in names if gaps[n] <= 0]
    near = [n for n in names if 0 < gaps[n] < clearance - _SLACK]
    told = [(under, "under a motor"), (near, f"within {1e3 * clearance:g} mm of a motor's rim")]
    parts = [f"{_listed(group)} not counted: {why}" for group, why in told if group]
    return "; ".join(parts)


def _listed(names: Sequence[str]) -> str:
    if len(names) == 1:
        return f"point {names[0]} is"
    return f"points {', '.join(names[:-1])} and {names[-1]} are"
