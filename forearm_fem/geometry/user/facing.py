"""Which tissue of the user's own limb the device meets, and which lies on the far side: files stand upside down."""

from __future__ import annotations

import numpy as np

from ...typing import FloatArray, IntArray
from ..mesh.tissue_mesh import TissueMesh
from ..mesh.topology import boundary_faces

_UPRIGHT = 1e-30  # m^2: twice the area of a face seen from above
_SLACK = 1e-9  # a place on an edge of the faces is over both
_FROM_OUTSIDE = ("skin", "fat", "muscle", "bone")


def turned_over(mesh: TissueMesh, places: FloatArray) -> str:
    """A sentence where under most of ``places`` (n, 2) [m], seen from above, lies a deeper tissue than on the far side;
    empty where not, and where tissues are none of those whose order is known."""
    faces, owner = boundary_faces(mesh.tetrahedra)
    pairs = [pair for place in places if (pair := _met(mesh, faces, owner, place)) is not None]
    deeper = [(a, b) for a, b in pairs if _depth(a) > _depth(b) >= 0]
    if 2 * len(deeper) <= len(pairs):
        return ""
    above, below = deeper[0]
    return (
        f"limb: the device presses on {above}, and {below} lies on the far side, as where a file is upside down; turn "
        "it so that +z points out of the volar skin, unless that is meant"
    )


def _depth(tissue: str) -> int:
    return _FROM_OUTSIDE.index(tissue) if tissue in _FROM_OUTSIDE else -1


def _met(mesh: TissueMesh, faces: IntArray, owner: IntArray, place: FloatArray) -> tuple[str, str] | None:
    """Tissues of the ``owner`` cells of the uppermost and the lowest of the boundary ``faces`` over ``place`` (2,)."""
    a, b, c = mesh.points[faces].transpose(1, 0, 2)
    u, v, w = (b - a)[:, :2], (c - a)[:, :2], place - a[:, :2]
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    twice = np.where(np.abs(twice) < _UPRIGHT, np.nan, twice)
    s, r = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / twice, (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / twice
    hit = np.flatnonzero((s > -_SLACK) & (r > -_SLACK) & (s + r < 1 + _SLACK))
    if not len(hit):
        return None
    height = (a + s[:, None] * (b - a) + r[:, None] * (c - a))[hit, 2]
    top, bottom = (mesh.region_names[mesh.region[owner[hit[k]]]] for k in (height.argmax(), height.argmin()))
    return top, bottom
