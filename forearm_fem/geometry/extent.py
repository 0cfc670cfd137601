"""Sizes of a user's geometry that no limb has: almost always a wrong unit, and a mesher that never ends."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import GeometryError
from ..typing import FloatArray

_LEAST, _MOST = 1e-3, 2.0  # m: a thin bone, a whole leg


def check_extent(file: Path, points: FloatArray) -> None:
    """Raise :class:`GeometryError` where ``points`` (n, 3) [m] are not finite or span no limb's size."""
    if not np.isfinite(points).all():
        count = int((~np.isfinite(points)).any(axis=1).sum())
        raise GeometryError(f"{file}: {count} points are not finite; repair the file")
    longest = float(np.ptp(points, axis=0).max())
    if not _LEAST <= longest <= _MOST:
        raise GeometryError(
            f"{file}: is {longest:.3g} m long, expected {_LEAST:g} to {_MOST:g} m; set limb.unit, the metres per unit "
            "of the file (0.001 for millimetres)"
        )
