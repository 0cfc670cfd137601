"""Do triangles cross? Edges of one against faces of the other, for pairs that are near."""

from __future__ import annotations

import numpy as np

from ...typing import BoolArray, FloatArray, IntArray
from ..mesh.nearby import meeting

_INSIDE = 1e-7  # touching in a corner, an edge or a plane is not crossing


def crossing_faces(first: FloatArray, second: FloatArray | None, faces: IntArray | None) -> IntArray:
    """Pairs (k, 2) of triangles (n, 3, 3) of ``first`` and (m, 3, 3) of ``second`` that cross, by their numbers.

    Without ``second``, ``first`` is tested against itself; pairs that share a vertex (``faces``) do not count.
    """
    other = first if second is None else second
    a, b = meeting(*_ball(first), *_ball(other))
    low = np.maximum(first.min(axis=1)[a], other.min(axis=1)[b])
    boxes_meet = (low <= np.minimum(first.max(axis=1)[a], other.max(axis=1)[b])).all(axis=1)
    a, b = a[boxes_meet], b[boxes_meet]
    if second is None:
        assert faces is not None
        once = a < b
        a, b = a[once], b[once]
        apart = (faces[a][:, :, None] != faces[b][:, None, :]).all(axis=(1, 2))
        a, b = a[apart], b[apart]
    crosses = np.zeros(len(a), dtype=bool)
    for edge in ((0, 1), (1, 2), (2, 0)):
        crosses |= _pierces(first[a][:, edge], other[b]) | _pierces(other[b][:, edge], first[a])
    return np.column_stack([a[crosses], b[crosses]])


def _ball(triangles: FloatArray) -> tuple[FloatArray, FloatArray]:
    centre = triangles.mean(axis=1)
    return centre, np.asarray(np.linalg.norm(triangles - centre[:, None], axis=2).max(axis=1))


def _pierces(edge: FloatArray, triangle: FloatArray) -> BoolArray:
    """Whether edges (k, 2, 3) pass strictly through triangles (k, 3, 3) (Moeller and Trumbore)."""
    start, along = edge[:, 0], edge[:, 1] - edge[:, 0]
    u, v = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    p = np.cross(along, v)
    det = np.einsum("ij,ij->i", u, p)
    scale = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) * np.linalg.norm(along, axis=1)
    flat = np.abs(det) < 1e-9 * scale
    inverse = 1 / np.where(flat, 1.0, det)
    away = start - triangle[:, 0]
    q = np.cross(away, u)
    s, r = np.einsum("ij,ij->i", away, p) * inverse, np.einsum("ij,ij->i", along, q) * inverse
    t = np.einsum("ij,ij->i", v, q) * inverse
    inside = (s > _INSIDE) & (r > _INSIDE) & (s + r < 1 - _INSIDE) & (t > _INSIDE) & (t < 1 - _INSIDE)
    return np.asarray(inside & ~flat)
