"""Faces and edges of tetrahedra as integer tables, and their shape."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ...typing import BoolArray, FloatArray, IntArray

# Faces of a positive tetrahedron, normals outwards; edges in lexicographic order.
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
SIDES = np.array([[0, 1], [1, 2], [2, 0]])  # of a triangle


def keys(rows: IntArray, n_point: int) -> IntArray:
    """One integer per row of vertex numbers (n, k), whatever their order (k <= 3)."""
    ordered = np.sort(np.asarray(rows, dtype=np.int64), axis=1)
    key = ordered[:, 0]
    for column in ordered.T[1:]:
        key = key * n_point + column
    return np.asarray(key)


def edges_of(cells: IntArray, local: IntArray) -> IntArray:
    """Edges (k, 2) of ``cells`` (m, j) between their ``local`` corners (:data:`EDGES` or :data:`SIDES`), each once, in
    the order of their vertices."""
    n = 1 + int(cells.max(initial=0))
    return np.column_stack(np.divmod(np.unique(keys(cells[:, local].reshape(-1, 2), n)), n))


def edge_lengths(points: FloatArray, edges: IntArray) -> FloatArray:
    """Lengths (k,) of edges (k, 2)."""
    return np.asarray(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1))


def triangle_normals(points: FloatArray, triangles: IntArray) -> FloatArray:
    """Normals (m, 3) of ``triangles`` (m, 3) of ``points`` (n, 3), each as long as twice its area."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return np.asarray(np.cross(b - a, c - a))


def pieces(count: int, pairs: IntArray) -> IntArray:
    """Number (count,) of the connected piece that each of so many things belongs to, by ``pairs`` (k, 2) that touch."""
    graph = coo_array((np.ones(len(pairs), dtype=np.int8), tuple(pairs.T)), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def boundary_faces(tetrahedra: IntArray) -> tuple[IntArray, IntArray]:
    """Faces (m, 3) that belong to one tetrahedron only, normals outwards, and that tetrahedron (m,)."""
    faces = tetrahedra[:, FACES].reshape(-1, 3)
    _, inverse, count = np.unique(keys(faces, int(tetrahedra.max()) + 1), return_inverse=True, return_counts=True)
    single = np.flatnonzero(count[inverse] == 1)
    return faces[single], single // 4


def is_member(rows: IntArray, of: IntArray, n_point: int) -> BoolArray:
    """True where a row of ``rows`` (n, k) occurs among ``of`` (m, k), whatever the order within it."""
    return np.asarray(np.isin(keys(rows, n_point), keys(of, n_point)))


def vertex_areas(points: FloatArray, facets: IntArray) -> FloatArray:
    """Area (n_point,) that each vertex stands for: a third of the ``facets`` (m, 3) that meet there."""
    third = np.linalg.norm(triangle_normals(points, facets), axis=1) / 6
    return np.bincount(facets.ravel(), np.repeat(third, 3), minlength=len(points)).astype(float)


def mean_ratios(points: FloatArray, tetrahedra: IntArray) -> FloatArray:
    """Mean-ratio quality (n_tet,): 12 (3 V)^(2/3) / sum of squared edges; 1 regular, 0 flat, negative inverted."""
    corner = points[tetrahedra]
    a, b, c = (corner[:, 1:] - corner[:, :1]).transpose(1, 0, 2)
    half_volume = np.einsum("ij,ij->i", np.cross(a, b), c) / 2  # 3 V
    squared = ((corner[:, EDGES[:, 0]] - corner[:, EDGES[:, 1]]) ** 2).sum(axis=(1, 2))
    return np.asarray(12 * np.sign(half_volume) * np.abs(half_volume) ** (2 / 3) / squared)
