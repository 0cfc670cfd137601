"""Local conforming refinement by longest-edge bisection; regions and all boundaries are carried along."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ...errors import MeshError
from ...ports import Port
from ...typing import BoolArray, FloatArray, IntArray
from .tissue_mesh import EDGES, SIDES, TissueMesh, edge_lengths, edges_of, is_member, keys

Middle = Callable[[TissueMesh, IntArray], FloatArray]
_RIM_GRADING = 1.0  # size grows by this per metre away from a rim
_LONGEST = 2.5  # longest edge of a tetrahedron over the size asked for
_REACH = 10.0  # rim sizes: nothing is refined further away, but for keeping neighbours conforming
_LONG = 1.6  # longest edge on the skin near ports over the size asked for
_MAX_ROUNDS = 200


def midpoints(mesh: TissueMesh, edges: IntArray) -> FloatArray:
    """Midpoints (k, 3) of edges (k, 2)."""
    return np.asarray(mesh.points[edges].mean(axis=1))


def refine(mesh: TissueMesh, marked: BoolArray) -> TissueMesh:
    """The mesh with every ``marked`` (n_tet,) tetrahedron bisected at least once, neighbours as needed.

    Rivara's longest-edge propagation keeps the mesh conforming. New vertices are midpoints, so volumes
    and areas stay exactly as they were.
    """
    pending = np.asarray(marked, dtype=bool)
    while pending.any():
        edges = _terminal_edges(mesh, pending)
        mesh, parent, split = split_edges(mesh, edges, midpoints(mesh, edges))
        pending = (pending & ~split)[parent]
    return mesh


def split_edges(mesh: TissueMesh, edges: IntArray, middles: FloatArray) -> tuple[TissueMesh, IntArray, BoolArray]:
    """Bisect ``edges`` (k, 2), no two of one tetrahedron, at ``middles`` (k, 3).

    Returns the mesh, the parent (n_new_tet,) of each tetrahedron, and which old ones (n_tet,) were split.
    """
    n = len(mesh.points)
    key = keys(edges, n)
    order = np.argsort(key)
    table = _SplitTable(key[order], n + order, n)
    tetrahedra, parent, split = table.apply(mesh.tetrahedra, EDGES)
    triangle = np.array([[0, 1], [0, 2], [1, 2]])
    facets = {name: table.apply(each, triangle)[0] for name, each in mesh.facets.items()}
    points = np.vstack([mesh.points, middles])
    return TissueMesh(points, tetrahedra, mesh.region[parent], mesh.region_names, facets), parent, split


@dataclass(frozen=True)
class _SplitTable:
    """Sorted keys of the edges to split, and the new vertex of each."""

    key: IntArray
    vertex: IntArray
    n_point: int

    def apply(self, cells: IntArray, local: IntArray) -> tuple[IntArray, IntArray, BoolArray]:
        """Cells (tetrahedra or triangles) after the split, their parents, and which were split."""
        cells = np.asarray(cells, dtype=np.int64)
        found = keys(cells[:, local].reshape(-1, 2), self.n_point)
        at = np.minimum(np.searchsorted(self.key, found), len(self.key) - 1)
        hit = (self.key[at] == found).reshape(len(cells), len(local))
        assert hit.sum(axis=1).max(initial=0) <= 1, "two split edges in one cell"
        cell, edge = np.nonzero(hit)
        new = self.vertex[at.reshape(hit.shape)[cell, edge]]
        first, second = cells.copy(), cells[cell]
        first[cell, local[edge, 1]] = new
        second[np.arange(len(cell)), local[edge, 0]] = new
        parent = np.concatenate([np.arange(len(cells)), cell])
        return np.vstack([first, second]), parent, hit.any(axis=1)


def _terminal_edges(mesh: TissueMesh, marked: BoolArray) -> IntArray:
    """Edges (k, 2), longest in all their tetrahedra, reached from the marked ones along ever longer edges."""
    edges, of_tet, longest = _edge_table(mesh)
    count = np.bincount(of_tet.ravel(), minlength=len(edges))
    terminal = count == np.bincount(longest, minlength=len(edges))
    reached = np.zeros(len(edges), dtype=bool)
    wanted = np.unique(longest[marked])
    while len(wanted):
        reached[wanted] = True
        onward = np.zeros(len(edges), dtype=bool)
        onward[wanted[~terminal[wanted]]] = True
        wanted = np.unique(longest[onward[of_tet].any(axis=1)])
        wanted = wanted[~reached[wanted]]
    return np.asarray(edges[reached & terminal])


def independent(mesh: TissueMesh, edges: IntArray) -> IntArray:
    """Longest of ``edges`` (k, 2) in every tetrahedron that they touch: no two share one."""
    table, of_tet, _ = _edge_table(mesh)
    n = len(mesh.points)
    at = np.searchsorted(keys(table, n), keys(edges, n))
    rank = np.full(len(table), -1)
    rank[at[np.lexsort([at, np.round(edge_lengths(mesh.points, edges), 9)])]] = np.arange(len(edges))
    best = rank[of_tet].max(axis=1, keepdims=True)
    beaten = np.unique(of_tet[rank[of_tet] < best])
    return np.asarray(edges[~np.isin(at, beaten)])


def _edge_table(mesh: TissueMesh) -> tuple[IntArray, IntArray, IntArray]:
    """Unique edges (m, 2), those of each tetrahedron (n_tet, 6), and the longest of each (n_tet,)."""
    n = len(mesh.points)
    key, of_tet = np.unique(keys(mesh.tetrahedra[:, EDGES].reshape(-1, 2), n), return_inverse=True)
    edges = np.column_stack([key // n, key % n])
    rank = np.empty(len(edges), dtype=np.int64)  # ties are broken the same way everywhere
    rank[np.lexsort([key, np.round(edge_lengths(mesh.points, edges), 9)])] = np.arange(len(edges))
    of_tet = of_tet.reshape(-1, 6)
    longest = of_tet[np.arange(len(of_tet)), rank[of_tet].argmax(axis=1)]
    return edges, of_tet, longest


def refine_rims(
    mesh: TissueMesh, ports: tuple[Port, ...], rim_size: float, *, middle: Middle = midpoints
) -> TissueMesh:
    """Grade the mesh towards the rims of all contacts down to edges of ``rim_size`` [m].

    A rigid disc has a stress singularity ~ r^(-1/2) at its rim. New vertices on rim edges are moved onto the
    circle, so the contact's area approaches pi a^2; others stand at ``middle(mesh, edges)`` (k, 3) [m].
    """
    contacts = tuple(p for p in ports if p.kind == "contact" and f"contact {p.name}" in mesh.facets)
    if not contacts:
        return mesh
    for _ in range(_MAX_ROUNDS):
        marked = _too_long(mesh, contacts, rim_size)
        if not marked.any():
            break
        edges = _terminal_edges(mesh, marked)
        middles = middle(mesh, edges).copy()
        for port in contacts:  # those of a rim go out to its circle
            on = is_member(edges, rim_edges(mesh, port.name), len(mesh.points))
            middles[on] = onto_circle(middles[on], port)
        mesh = _unspoilt(split_edges(mesh, edges, middles)[0], midpoints(mesh, edges))
    if mesh.volumes.min() <= 0:
        raise MeshError(
            f"refining the contact rims to {rim_size * 1e3:.3g} mm inverted a tetrahedron; "
            "set mesh.size_contact smaller so that the rim starts rounder"
        )
    return mesh


def refine_near(mesh: TissueMesh, ports: tuple[Port, ...], size: float) -> TissueMesh:
    """Bisect until skin edges within 1.3 radii of each contact's centre are about ``size`` [m] long."""
    for _ in range(_MAX_ROUNDS):
        on_skin = np.zeros(len(mesh.points), dtype=bool)
        on_skin[mesh.facets["skin"]] = True
        close = np.zeros(len(mesh.points), dtype=bool)
        for port in ports:
            close |= np.linalg.norm(mesh.points - np.asarray(port.position), axis=1) < 1.3 * port.radius
        edges = mesh.tetrahedra[:, EDGES]
        length = np.linalg.norm(mesh.points[edges[:, :, 0]] - mesh.points[edges[:, :, 1]], axis=2)
        long = (length > _LONG * size) & on_skin[edges].all(axis=2) & close[edges].any(axis=2)
        if not long.any():
            return mesh
        mesh = refine(mesh, long.any(axis=1))
    return mesh


def refine_skin(mesh: TissueMesh, size: Callable[[FloatArray], FloatArray]) -> TissueMesh:
    """Bisect until no skin edge is longer than 1.6 times what ``size`` (places (n, 3) -> lengths (n,) [m]) asks for.

    On the user's own surfaces fTetWild keeps sizes on average; here and there an edge is 2.4 times as long, and one
    such place next to a grid point made that point's receptance 30 % wrong at 400 Hz.
    """
    for _ in range(_MAX_ROUNDS):
        edges = edges_of(mesh.facets["skin"], SIDES)
        long = edges[edge_lengths(mesh.points, edges) > _LONG * size(midpoints(mesh, edges))]
        if not len(long):
            break
        found = is_member(mesh.tetrahedra[:, EDGES].reshape(-1, 2), long, len(mesh.points))
        mesh = refine(mesh, np.asarray(found.reshape(-1, len(EDGES)).any(axis=1)))
    return mesh


def _unspoilt(mesh: TissueMesh, middles: FloatArray) -> TissueMesh:
    """Newest vertices put back to the ``middles`` (k, 3) of their edges where moving them flattens an element."""
    points = mesh.points.copy()
    start = len(points) - len(middles)
    points[start:] = middles
    straight = replace(mesh, points=points)
    bad = np.unique(mesh.tetrahedra[mesh.volumes < 0.3 * straight.volumes])
    bad = bad[bad >= start]
    restored = mesh.points.copy()
    restored[bad] = middles[bad - start]
    return replace(mesh, points=restored)


def rim_edges(mesh: TissueMesh, name: str) -> IntArray:
    """Edges (k, 2) around the contact called ``name``; edges on a symmetry plane do not count."""
    n = len(mesh.points)
    pairs = mesh.facets[f"contact {name}"][:, SIDES].reshape(-1, 2)
    _, first, count = np.unique(keys(pairs, n), return_index=True, return_counts=True)
    rim = pairs[first[count == 1]]
    planes = [mesh.facets[f] for f in mesh.facets if f.startswith("symmetry")]
    for plane in planes:
        rim = rim[~np.isin(rim, plane).all(axis=1)]
    return np.asarray(rim)


def _too_long(mesh: TissueMesh, contacts: tuple[Port, ...], rim_size: float) -> BoolArray:
    """Tetrahedra whose longest edge, or whose edge on a rim, exceeds what its place asks for."""
    rims = np.vstack([rim_edges(mesh, p.name) for p in contacts])
    places = np.vstack([mesh.points[rims[:, 0]], mesh.points[rims[:, 1]], midpoints(mesh, rims)])
    distance = cKDTree(places).query(mesh.points)[0][mesh.tetrahedra].min(axis=1)
    near = np.flatnonzero(distance < _REACH * rim_size)
    edges = mesh.tetrahedra[near][:, EDGES]
    ends = mesh.points[edges]
    length = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)
    on_rim = is_member(edges.reshape(-1, 2), rims, len(mesh.points)).reshape(length.shape)
    too_long = length.max(axis=1) > _LONGEST * (rim_size + _RIM_GRADING * distance[near])
    marked = np.zeros(len(mesh.tetrahedra), dtype=bool)
    marked[near] = too_long | (on_rim & (length > rim_size)).any(axis=1)
    return marked


def onto_circle(points: FloatArray, port: Port) -> FloatArray:
    """Points (n, 3) moved straight away from (or towards) the contact's axis to its radius; one on the axis stays."""
    centre, axis = np.asarray(port.position), np.asarray(port.axis)
    along = np.outer((points - centre) @ axis, axis)
    across = points - centre - along
    away = np.maximum(np.linalg.norm(across, axis=1), 1e-300)
    return np.asarray(centre + along + across * (port.radius / away)[:, None])
