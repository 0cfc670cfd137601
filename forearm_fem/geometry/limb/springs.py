"""Forces of springs along the edges of a mesh, in the plane or in space (Persson and Strang 2004)."""

from __future__ import annotations

import numpy as np

from ...typing import FloatArray, IntArray


def spring_forces(points: FloatArray, edges: IntArray, wanted: FloatArray, stretch: float) -> FloatArray:
    """Sum of the pushes (n, d) on ``points`` (n, d), d = 2 or 3, of ``edges`` (m, 2) shorter than they want to be.

    ``wanted`` (m,) lengths count relative to one another: they are scaled to fill the area or volume there is, and by
    ``stretch`` more, so that nearly all edges push.
    """
    along = points[edges[:, 0]] - points[edges[:, 1]]
    length = np.linalg.norm(along, axis=1)
    power, root = (2, np.sqrt) if points.shape[1] == 2 else (3, np.cbrt)
    rest = wanted * stretch * root((length**power).sum() / (wanted**power).sum())
    push = (np.maximum(rest - length, 0) / length)[:, None] * along
    total = np.zeros_like(points)
    np.add.at(total, edges[:, 0], push)
    np.add.at(total, edges[:, 1], -push)
    return total
