"""Prisms standing on a triangulation, cut into tetrahedra so that neighbours fit."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ...typing import FloatArray, IntArray


def stack_prisms(triangles: IntArray, levels: IntArray) -> tuple[IntArray, IntArray]:
    """Tetrahedra (at most 3 m k, 4) of prisms between successive levels, and the level each lies under.

    ``triangles`` (m, 3) index the columns, ``levels`` (k + 1, n_column) the vertex of each column at each level. Every
    quadrilateral is cut from its lower column on one level to its higher column on the next (Kuhn), so prisms side by
    side share their diagonals. Where levels of a column fall together, what has no volume is left out. Orientation is
    left to :func:`oriented`.
    """
    a, b, c = np.sort(triangles, axis=1).T
    blocks = [np.zeros((0, 4), dtype=np.int64)]
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
    which = np.repeat(np.arange(len(blocks) - 1), 3 * len(triangles))
    tetrahedra = np.vstack(blocks)
    ordered = np.sort(tetrahedra, axis=1)
    solid = (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
    return tetrahedra[solid], which[solid]


def oriented(points: FloatArray, tetrahedra: IntArray) -> IntArray:
    """The same tetrahedra with positive volume."""
    corner = points[tetrahedra]
    negative = np.linalg.det(corner[:, 1:] - corner[:, :1]) < 0
    return np.where(negative[:, None], tetrahedra[:, [0, 1, 3, 2]], tetrahedra)
