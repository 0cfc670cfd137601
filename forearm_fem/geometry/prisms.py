"""Prisms standing on a triangulation, cut into tetrahedra so that neighbours fit."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..typing import FloatArray, IntArray


def stack_prisms(triangles: IntArray, levels: IntArray) -> tuple[IntArray, IntArray]:
    """Tetrahedra (3 m k, 4) of prisms between successive levels, and the level (3 m k,) each lies under.

    ``triangles`` (m, 3) index the columns, ``levels`` (k + 1, n_column) the vertex of each column at each
    level.
    Every quadrilateral is cut from its lower column on one level to its higher column on the next (Kuhn), so
    prisms side by side share their diagonals. Orientation is left to :func:`oriented`.
    """
    a, b, c = np.sort(triangles, axis=1).T
    blocks = []
    for low, high in pairwise(levels):
        blocks.append(
            np.vstack(
                [
                    np.column_stack([low[a], low[b], low[c], high[c]]),
                    np.column_stack([low[a], low[b], high[b], high[c]]),
                    np.column_stack([low[a], high[a], high[b], high[c]]),
                ]
            )
        )
    which = np.repeat(np.arange(len(blocks)), 3 * len(triangles))
    return np.vstack(blocks), which


def oriented(points: FloatArray, tetrahedra: IntArray) -> IntArray:
    """The same tetrahedra with positive volume."""
    corner = points[tetrahedra]
    negative = np.linalg.det(corner[:, 1:] - corner[:, :1]) < 0
    return np.where(negative[:, None], tetrahedra[:, [0, 1, 3, 2]], tetrahedra)
