"""Naming the boundary of a limb that the user brought: skin, underside, ends, bones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...errors import MeshError
from ...typing import BoolArray, FloatArray, IntArray
from ..limb.layered import underside
from ..mesh.tissue_mesh import TissueMesh
from ..mesh.topology import boundary_faces


def without_bone(mesh: TissueMesh) -> TissueMesh:
    """The mesh with the region "bone" taken out: what remains is held at the holes' walls."""
    if "bone" not in mesh.region_names:
        return mesh
    number = mesh.region_names.index("bone")
    keep = mesh.region != number
    if not keep.any():
        raise MeshError("every region of the mesh is 'bone'; map at least one region to a soft tissue")
    used, renumbered = np.unique(mesh.tetrahedra[keep], return_inverse=True)
    region = mesh.region[keep]
    names = tuple(name for name in mesh.region_names if name != "bone")
    region = region - (region > number)
    return TissueMesh(mesh.points[used], renumbered.reshape(-1, 4), region, names, {})


def with_boundaries(mesh: TissueMesh, tolerance: float) -> TissueMesh:
    """Ends are plane facets at the extreme x (within ``tolerance`` [m]); skin the outermost of what remains."""
    faces, _ = boundary_faces(mesh.tetrahedra)
    end = _plane_end(mesh.points, faces, tolerance)
    rest = faces[~end]
    if not len(rest):
        raise MeshError(
            "the mesh has no skin: all its boundary lies on its two ends in x; turn it so that x runs along it"
        )
    outer = _outermost(mesh.points, rest)
    named = {"skin": rest[outer], "bone": rest[~outer], "end": faces[end]}
    named["underside"] = underside(mesh.points, named["skin"])
    return replace(mesh, facets={name: each for name, each in named.items() if len(each)})


def _plane_end(points: FloatArray, faces: IntArray, tolerance: float) -> BoolArray:
    a, b, c = points[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    across = np.abs(normal[:, 0]) > 0.9 * np.linalg.norm(normal, axis=1)
    x = points[faces][:, :, 0]
    low, high = x.min(), x.max()
    return np.asarray(across & ((x < low + tolerance).all(axis=1) | (x > high - tolerance).all(axis=1)))


def _outermost(points: FloatArray, faces: IntArray) -> BoolArray:
    """Facets of the connected piece with the largest extent; the others enclose cavities."""
    n = len(points)
    rows, columns = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    graph = coo_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(n, n))
    piece = connected_components(graph, directed=False)[1][faces[:, 0]]
    labels = np.unique(piece)
    extent = [np.linalg.norm(np.ptp(points[np.unique(faces[piece == k])], axis=0)) for k in labels]
    return np.asarray(piece == labels[int(np.argmax(extent))])
