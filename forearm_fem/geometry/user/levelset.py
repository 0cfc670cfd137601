"""Cutting a mesh along a surface given by signed distances, so that tetrahedra lie on one side of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...errors import MeshError
from ...typing import BoolArray, FloatArray, IntArray
from ..mesh.refinement import independent, split_edges
from ..mesh.tissue_mesh import TissueMesh
from ..mesh.topology import EDGES, boundary_faces, edges_of, triangle_normals

Distance = Callable[[FloatArray], FloatArray]
_SNAP = 0.3  # a vertex nearer to the surface than this part of an edge across it moves onto it
_YIELD = 0.1  # a vertex still closer than this that cannot move is taken to lie on the surface
_ROUNDS = 200


def cut_along(mesh: TissueMesh, distance: Distance, *, name: str) -> tuple[TissueMesh, BoolArray]:
    """The mesh with edges cut where ``distance`` (n, 3) -> (n,) [m], negative inside, changes sign.

    Returns it with a flag (n_tet,) for the tetrahedra inside. Between cut points the interface is plane, so it lies
    within h^2 / (8 R) of a surface of curvature radius R; features smaller than an edge are lost.
    """
    mesh, value = _snapped(mesh, distance)
    for _ in range(_ROUNDS):
        edges = edges_of(mesh.tetrahedra, EDGES)
        crossing = edges[np.prod(np.sign(value[edges]), axis=1) < 0]
        if not len(crossing):
            total = value[mesh.tetrahedra].sum(axis=1)
            return mesh, np.asarray(total < 0)
        chosen = independent(mesh, crossing)
        a, b = value[chosen].T
        t = (a / (a - b))[:, None]
        middles = mesh.points[chosen[:, 0]] * (1 - t) + mesh.points[chosen[:, 1]] * t
        mesh = split_edges(mesh, chosen, middles)[0]
        value = np.concatenate([value, np.zeros(len(chosen))])
    raise MeshError(f"the mesh could not be cut along the surface '{name}'; set smaller mesh sizes")


def _snapped(mesh: TissueMesh, distance: Distance) -> tuple[TissueMesh, FloatArray]:
    """Vertices close to the surface moved onto it, within the plane of the boundary where they lie on it.

    Corners of the boundary and vertices of earlier interfaces stay; where they are very close the surface gives way to
    them by up to a tenth of an edge, rather than leave slivers.
    """
    value = distance(mesh.points)
    close = _close(mesh, value, _SNAP)
    step = value[close, None] * _gradient(distance, mesh.points[close])
    free, normal = _freedom(mesh)
    along = step - (step * normal[close]).sum(axis=1, keepdims=True) * normal[close]
    stretch = (step**2).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-30)  # the full way, sideways
    movable = free[close] & (stretch < 4)
    close, along, stretch = close[movable], along[movable], stretch[movable]
    moved = mesh.points.copy()
    moved[close] -= stretch[:, None] * along
    for _ in range(5):  # putting one back may spoil a neighbour
        trial = replace(mesh, points=moved)
        bad = np.intersect1d(mesh.tetrahedra[trial.volumes < 0.2 * mesh.volumes], close)
        moved[bad] = mesh.points[bad]
        close = np.setdiff1d(close, bad)
    value[close] = 0.0
    value[_close(mesh, value, _YIELD)] = 0.0
    return replace(mesh, points=moved), value


def _close(mesh: TissueMesh, value: FloatArray, part: float) -> IntArray:
    """Vertices nearer to the surface than ``part`` of an edge that crosses it."""
    edges = edges_of(mesh.tetrahedra, EDGES)
    across = edges[np.prod(np.sign(value[edges]), axis=1) < 0]
    size = np.abs(value[across])
    return np.unique(across[size < part * size.sum(axis=1, keepdims=True)])


def _freedom(mesh: TissueMesh) -> tuple[BoolArray, FloatArray]:
    """Which vertices (n_point,) may move, and the normal (n_point, 3) they must not move along (zero inside)."""
    n = len(mesh.points)
    faces, _ = boundary_faces(mesh.tetrahedra)
    normal = triangle_normals(mesh.points, faces)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    total, count = np.zeros((n, 3)), np.bincount(faces.ravel(), minlength=n)
    for corner in faces.T:
        np.add.at(total, corner, normal)
    length = np.linalg.norm(total, axis=1)
    flat = length > 0.9999 * count  # all facets around face the same way; true inside, where there are none
    low, high = np.full(n, len(mesh.region_names)), np.full(n, -1)
    np.minimum.at(low, mesh.tetrahedra, mesh.region[:, None])
    np.maximum.at(high, mesh.tetrahedra, mesh.region[:, None])
    inside = count == 0
    return (inside | flat) & (low == high), total / np.where(inside, 1.0, np.maximum(length, 1e-30))[:, None]


def _gradient(distance: Distance, points: FloatArray) -> FloatArray:
    """Unit gradient (n, 3) of the distance by central differences."""
    step = 1e-6  # [m]
    slopes = [(distance(points + d) - distance(points - d)) / (2 * step) for d in step * np.eye(3)]
    raw = np.column_stack(slopes) if len(points) else np.zeros((0, 3))
    return np.asarray(raw / np.maximum(np.linalg.norm(raw, axis=1), 1e-12)[:, None])
