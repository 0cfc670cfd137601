"""Tetrahedra with tissues: the mesh, its faces and edges as integer tables, and its bent edges."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from ...typing import BoolArray, FloatArray, IntArray

# Faces and edges of tetrahedra as integer tables, and their shape.

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


# A mesh of tissues: tetrahedra with regions, named facets and bent edges; its nearest cells and finer skin.

# The mesh that everything after geometry works on: tetrahedra, named regions, named boundary facets.

DOWN = -0.5  # z of a unit outward normal below which skin belongs to the underside: a sixth of the way round each side


@dataclass(frozen=True)
class Bends:
    """Edges that are parabolas: ``edges`` (k, 2) of vertices, and how far [m] the middle of each lies off its chord,
    ``offsets`` (k, 3)."""

    edges: IntArray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    offsets: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def on(self, edges: IntArray) -> FloatArray:
        """Offsets (m, 3) [m] of ``edges`` (m, 2), zero where they are straight."""
        offsets = np.zeros((len(edges), 3))
        if len(self.edges):
            n = 1 + max(int(edges.max(initial=0)), int(self.edges.max()))
            known, wanted = keys(self.edges, n), keys(edges, n)
            order = np.argsort(known)
            at = order[np.minimum(np.searchsorted(known, wanted, sorter=order), len(known) - 1)]
            found = known[at] == wanted
            offsets[found] = self.offsets[at[found]]
        return offsets

    def of(self, tetrahedra: IntArray) -> FloatArray:
        """Offsets (n_tet, 6, 3) [m] of the edges, in the order of :data:`.topology.EDGES`, of ``tetrahedra``
        (n_tet, 4)."""
        return self.on(tetrahedra[:, EDGES].reshape(-1, 2)).reshape(-1, len(EDGES), 3)

    def chosen(self, which: BoolArray) -> Bends:
        """Bends of the edges marked in ``which`` (k,)."""
        return Bends(self.edges[which], self.offsets[which])


@dataclass(frozen=True)
class TissueMesh:
    """Conforming tetrahedra in metres, affine but for edges that bend; volar skin up (+z), x along the limb.

    ``points`` (n_point, 3) [m]; ``tetrahedra`` (n_tet, 4) positively oriented; ``region`` (n_tet,) indexes
    ``region_names`` (tissue names; a meshed bone is the region "bone"). ``facets`` maps boundary names to (k, 3) vertex
    triples: always "skin" (whole free surface), and where they exist "bone" (surface of a bone left out of the mesh),
    "end" (cut ends; a slab's sides and bottom), "underside" (the part of "skin" that may be held), "contact A1"
    ... (part of "skin" under a cone, exactly inside the disc's rim), "symmetry x" and "symmetry y". ``bends`` follow
    from these and the scenario's limb (:mod:`forearm_fem.geometry.limb.tube`): files do not hold them.
    """

    points: FloatArray
    tetrahedra: IntArray
    region: IntArray
    region_names: tuple[str, ...]
    facets: Mapping[str, IntArray] = field(default_factory=dict)
    bends: Bends = field(default_factory=Bends)

    @cached_property
    def digest(self) -> str:
        """SHA-256 over coordinates, connectivity, regions and facets; goes into every result."""
        sha = hashlib.sha256()
        for array in (self.points, self.tetrahedra, self.region, *(self.facets[k] for k in sorted(self.facets))):
            sha.update(np.ascontiguousarray(array).tobytes())
        return sha.hexdigest()

    @cached_property
    def volumes(self) -> FloatArray:
        """Volume of each tetrahedron (n_tet,) [m^3] with straight edges, positive."""
        corner = self.points[self.tetrahedra]
        edges = corner[:, 1:] - corner[:, :1]
        return np.asarray(np.linalg.det(edges) / 6)


# Tetrahedra whose edges are parabolas: places in them, what a step there is in space, and their volumes.
# x(r) = sum_i L_i x_i + sum_ab 4 L_a L_b d_ab with barycentric coordinates L_i of the reference point r and the edges'
# offsets d_ab (Zienkiewicz, Taylor, Zhu, The Finite Element Method, 6th ed., section 5.5).

_SLOPES = np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # of barycentric coordinates
# Determinants are cubic: Keast's rule of five points is exact for them.
_CUBIC = np.array([[1 / 4] * 3, [1 / 6] * 3, [1 / 2, 1 / 6, 1 / 6], [1 / 6, 1 / 2, 1 / 6], [1 / 6, 1 / 6, 1 / 2]]).T
_CUBIC_WEIGHTS = np.array([-2 / 15, *[3 / 40] * 4])


def barycentric(points: FloatArray) -> FloatArray:
    """Barycentric coordinates (4, q) of reference points (3, q)."""
    return np.vstack([1 - points.sum(axis=0), points])


def bent_places(corners: FloatArray, offsets: FloatArray, points: FloatArray) -> FloatArray:
    """Positions (n, q, 3) [m] of reference points (3, q) in tetrahedra with ``corners`` (n, 4, 3) and edges'
    ``offsets`` (n, 6, 3), in the order of :data:`.topology.EDGES`."""
    bary = barycentric(points)
    bumps = 4 * bary[EDGES[:, 0]] * bary[EDGES[:, 1]]
    return np.asarray(np.einsum("vq,nvi->nqi", bary, corners) + np.einsum("eq,nei->nqi", bumps, offsets))


def bent_jacobians(straight: FloatArray, offsets: FloatArray, points: FloatArray) -> FloatArray:
    """d(position)/d(reference) (n, q, 3, 3) [m] at reference points (3, q), from that of ``straight`` edges
    (n, 3, 3) and the edges' ``offsets`` (n, 6, 3)."""
    bary, (a, b) = barycentric(points), EDGES.T
    slopes = 4 * (bary[a, :, None] * _SLOPES[b, None] + bary[b, :, None] * _SLOPES[a, None])  # (6, q, 3)
    return np.asarray(straight[:, None] + np.einsum("nei,eqr->nqir", offsets, slopes, optimize=True))


def straight_jacobians(points: FloatArray, tetrahedra: IntArray) -> FloatArray:
    """d(position)/d(reference) (n_tet, 3, 3) [m] of tetrahedra (n_tet, 4) with straight edges."""
    corner = points[tetrahedra]
    return np.asarray(np.swapaxes(corner[:, 1:] - corner[:, :1], 1, 2))


def true_volumes(mesh: TissueMesh) -> FloatArray:
    """Volume of each tetrahedron (n_tet,) [m^3], its edges bent as they are."""
    jacobians = bent_jacobians(straight_jacobians(mesh.points, mesh.tetrahedra), mesh.bends.of(mesh.tetrahedra), _CUBIC)
    return np.asarray(np.linalg.det(jacobians) @ _CUBIC_WEIGHTS)


# Pairs of things that are near each other, whatever their sizes.


def meeting(centre_a: FloatArray, radius_a: FloatArray, centre_b: FloatArray, radius_b: FloatArray) -> IntArray:
    """Pairs (2, k) of balls a (n, d), (n,) and b (m, d), (m,) that touch or overlap.

    The second kind is sorted into sizes within a factor of two: one wide triangle among thousands of small ones would
    otherwise make each a neighbour of all (minutes for 16,000 triangles with fans at their ends).
    """
    size = np.floor(np.log2(np.maximum(radius_b, 1e-12)))
    found = [np.zeros((2, 0), dtype=np.int64)]
    for each in np.unique(size):
        group = np.flatnonzero(size == each)
        hits = cKDTree(centre_b[group]).query_ball_point(centre_a, radius_a + radius_b[group].max(), return_sorted=True)
        a = np.repeat(np.arange(len(centre_a)), [len(h) for h in hits])
        b = group[np.concatenate([np.asarray(h, dtype=np.int64) for h in hits])] if len(a) else a
        away = ((centre_a[a] - centre_b[b]) ** 2).sum(axis=1)
        found.append(np.stack([a, b])[:, away <= (radius_a[a] + radius_b[b]) ** 2])
    return np.concatenate(found, axis=1)


# The skin with its triangles cut in four: fields of higher order look like their vertices' alone where these are far
# apart.


def skin_edges(mesh: TissueMesh) -> IntArray:
    """Vertices (n, 2) of the skin's edges, each once, in the order of their keys."""
    return edges_of(mesh.facets["skin"], SIDES)


def with_finer_skin(mesh: TissueMesh) -> TissueMesh:
    """The mesh with the middles of :func:`skin_edges`, bent as they are, after its own points, and skin facets cut in
    four.

    For pictures and places on the skin: tetrahedra, and what is bounded by them, stay as they are.
    """
    edges, n = skin_edges(mesh), len(mesh.points)
    known = keys(edges, n)
    skin = mesh.facets["skin"]
    middle = [n + np.searchsorted(known, keys(skin[:, side], n)) for side in SIDES]
    (a, b, c), (ab, bc, ca) = skin.T, middle
    cut = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]).transpose(2, 0, 1).reshape(-1, 3)
    middles = mesh.points[edges].mean(axis=1) + mesh.bends.on(edges)
    return replace(mesh, points=np.vstack([mesh.points, middles]), facets={"skin": cut}, bends=Bends())
