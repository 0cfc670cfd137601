"""Naming the boundary of a limb that the user brought: skin, underside, ends, bones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import MeshError
from ...typing import BoolArray, FloatArray, IntArray
from ..limb.layered import underside
from ..mesh.tissue_mesh import TissueMesh
from ..mesh.topology import SIDES, boundary_faces, edge_lengths, is_member, pieces, triangle_normals

_ACROSS = 0.9  # cosine between a facet's normal and x from which on it lies across
_ROUGH, _PLANE = 1e-3, 1e-6  # of the limb's length: how far from plane a cut end may be, and one without an edge


def without_bone(mesh: TissueMesh) -> TissueMesh:
    """The mesh with the region "bone" taken out: its walls are the facets "bone", where what remains is held."""
    if "bone" not in mesh.region_names:
        return mesh
    number = mesh.region_names.index("bone")
    keep = mesh.region != number
    if not keep.any():
        raise MeshError("every region of the mesh is 'bone'; map at least one region to a soft tissue")
    left = boundary_faces(mesh.tetrahedra[keep])[0]
    wall = left[~is_member(left, boundary_faces(mesh.tetrahedra)[0], len(mesh.points))]
    used, renumbered = np.unique(mesh.tetrahedra[keep], return_inverse=True)
    region = mesh.region[keep]
    names = tuple(name for name in mesh.region_names if name != "bone")
    region = region - (region > number)
    facets = {"bone": np.searchsorted(used, wall)}
    return TissueMesh(mesh.points[used], renumbered.reshape(-1, 4), region, names, facets)


def with_boundaries(mesh: TissueMesh) -> TissueMesh:
    """The mesh with its boundary named, facets "bone" that it has among them.

    Ends are flat pieces across x at the extreme x; of what remains skin is the outermost, and other pieces enclose
    cavities that are held like bones.
    """
    faces, _ = boundary_faces(mesh.tetrahedra)
    wall = is_member(faces, mesh.facets.get("bone", np.zeros((0, 3), dtype=np.int64)), len(mesh.points))
    bones, faces = faces[wall], faces[~wall]
    end = _ends(mesh.points, faces)
    rest = faces[~end]
    if not len(rest):
        raise MeshError(
            "the mesh has no skin: all its boundary lies on its two ends in x; turn it so that x runs along it"
        )
    piece = pieces(len(mesh.points), rest[:, SIDES[:2]].reshape(-1, 2))[rest[:, 0]]
    numbers = np.unique(piece)
    extent = [np.linalg.norm(np.ptp(mesh.points[np.unique(rest[piece == k])], axis=0)) for k in numbers]
    outer = piece == numbers[int(np.argmax(extent))]
    named = {"skin": rest[outer], "bone": np.vstack([bones, rest[~outer]]), "end": faces[end]}
    named["underside"] = underside(mesh.points, named["skin"])
    return replace(mesh, facets={name: each for name, each in named.items() if len(each)})


def _ends(points: FloatArray, faces: IntArray) -> BoolArray:
    """Facets of the two cut ends: across x, within a thousandth of the limb's length of its extreme x.

    fTetWild keeps planes to that only. A rounded end goes on across x beyond it: of such only what is exactly plane is
    an end, and its pole is skin.
    """
    normal = triangle_normals(points, faces)
    across = np.abs(normal[:, 0]) > _ACROSS * np.linalg.norm(normal, axis=1)
    found = np.zeros(len(faces), dtype=bool)
    for beyond in (points[:, 0] - points[:, 0].min(), points[:, 0].max() - points[:, 0]):
        most = beyond[faces].max(axis=1) / beyond.max()
        piece = across & (most < _ROUGH)
        found |= piece if _cut_off(points, faces, piece, across) else across & (most < _PLANE)
    return found


def _cut_off(points: FloatArray, faces: IntArray, piece: BoolArray, across: BoolArray) -> bool:
    """Whether most of the ``piece``'s rim, by length, is an edge where the surface turns away from x."""
    sides = np.sort(faces[:, SIDES].reshape(-1, 2), axis=1)
    of = np.repeat(np.arange(len(faces)), 3)
    edges, count = np.unique(sides[piece[of]], axis=0, return_counts=True)
    beside = ~piece[of] & is_member(sides, edges[count == 1], len(points))
    length = edge_lengths(points, sides[beside])
    return bool(length[~across[of[beside]]].sum() > 0.5 * length.sum())
