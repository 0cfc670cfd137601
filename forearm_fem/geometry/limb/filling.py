"""Columns of prisms between two walls, cut into tetrahedra."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from ...errors import MeshError
from ...typing import BoolArray, FloatArray, IntArray
from ..mesh.tissue_mesh import EDGES, boundary_faces, edges_of, mean_ratios
from .planar import spring_forces

# Prisms standing on a triangulation, cut into tetrahedra so that neighbours fit.


def stack_prisms(triangles: IntArray, levels: IntArray) -> tuple[IntArray, IntArray]:
    """Tetrahedra (at most 3 m k, 4) of prisms between successive levels, and the level each lies under.

    ``triangles`` (m, 3) index the columns, ``levels`` (k + 1, n_column) the vertex of each column at each level. Every
    quadrilateral is cut from its lower column on one level to its higher column on the next (Kuhn). So prisms side by
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


# Tetrahedra between given boundary points: graded points inside, pushed apart by springs, joined by Delaunay.

Size = Callable[[FloatArray], FloatArray]
Allowed = Callable[[FloatArray, FloatArray], BoolArray]
_ROUNDS, _STEP, _STRETCH = 40, 0.2, 1.15  # of the springs, see planar.py
_GROWTH = 0.66  # of the sizes inside, per metre away from the boundary's own spacing
_CLOSE = 0.6  # of its size: how near to a boundary point an inner one may start; below it faces would be lost
_PER_CELL = 0.72  # points per size^3 and lattice that the springs spread about a size apart
_REPAIRS = 4
_TRIALS = 200  # of moves that make flat tetrahedra rounder
_ROUND = 0.35  # mean ratio above which a tetrahedron is left alone
_SMALLEST, _LARGEST = -2.5, -0.6  # powers of ten of the moves, relative to the size wanted


@dataclass(frozen=True)
class Shell:
    """Boundary points (n, 3) [m], the surfaces (n, n_surface) each lies on, and which of these end the mesh.

    Behind ``closed`` (n_surface,) surfaces nothing is meshed: tetrahedra with all corners on one are dropped.
    """

    points: FloatArray
    on: BoolArray
    closed: BoolArray

    def behind(self, tetrahedra: IntArray) -> BoolArray:
        """Tetrahedra (m,) with all corners on one closed surface: flat ones on it, or inside a hole."""
        on = self.on_of(int(tetrahedra.max()) + 1)
        return np.asarray((on[tetrahedra].all(axis=1) & self.closed).any(axis=1))

    def on_of(self, n: int) -> BoolArray:
        """``on`` for the first ``n`` points of a mesh (n, n_surface); inner points lie on none."""
        return np.vstack([self.on, np.zeros((max(n - len(self.on), 0), self.on.shape[1]), dtype=bool)])


def fill(shell: Shell, size: Size, allowed: Allowed, *, seed: int = 1) -> tuple[FloatArray, IntArray]:
    """Points (n, 3), the shell's first, and positive tetrahedra (m, 4) of edges about ``size(points)`` [m].

    ``allowed(points, gaps)`` tells which points lie inside by their gap at least. Springs after Persson and Strang
    (2004), slivers removed by :func:`without_slivers`. The same at every call with one ``seed``. Raises
    :class:`MeshError` where a surface of the shell is not made of faces: its points were too far apart.
    """
    wanted = _graded(shell, size)
    rng = np.random.default_rng(seed)
    points = _relaxed(shell, _scattered(shell, wanted, allowed, rng), wanted, allowed)
    movable = np.arange(len(points)) >= len(shell.points)
    for _ in range(_REPAIRS):
        tetrahedra = oriented(points, _joined(shell, points))
        points = without_slivers(points, tetrahedra, movable, wanted, rng)
    faces, _ = boundary_faces(tetrahedra)
    on = shell.on_of(int(faces.max()) + 1)
    if not (on[faces].all(axis=1) & shell.closed).any(axis=1).all():
        raise MeshError("points on the limb's surfaces are too far apart to be joined; set mesh.size_far smaller")
    return points, tetrahedra


def _graded(shell: Shell, size: Size) -> Size:
    """``size``, but growing away from the boundary points from their own spacing."""
    tree = cKDTree(shell.points)
    spacing = tree.query(shell.points, 7)[0][:, 1:].mean(axis=1)

    def wanted(points: FloatArray) -> FloatArray:
        """Edge lengths (n,) [m] at ``points`` (n, 3)."""
        away, nearest = tree.query(points)
        return np.asarray(np.minimum(size(points), spacing[nearest] + _GROWTH * away))

    return wanted


def _scattered(shell: Shell, size: Size, allowed: Allowed, rng: np.random.Generator) -> FloatArray:
    """Points of a fine body-centred lattice kept with probability ~ 1/h^3, away from the boundary."""
    finest = float(size(shell.points).min())
    low, high = shell.points.min(axis=0), shell.points.max(axis=0)
    axes = [np.arange(a, b, finest) for a, b in zip(low, high, strict=True)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    lattice = np.vstack([lattice, lattice + finest / 2])
    lattice = lattice[allowed(lattice, np.full(len(lattice), finest / 2))]
    h = size(lattice)
    kept = rng.random(len(h)) < _PER_CELL * (finest / h) ** 3
    lattice, h = lattice[kept], h[kept]
    clear = cKDTree(shell.points).query(lattice)[0] > _CLOSE * h
    return np.asarray(lattice[clear & allowed(lattice, 0.5 * h)])


def _relaxed(shell: Shell, inner: FloatArray, size: Size, allowed: Allowed) -> FloatArray:
    """Shell and inner points, these moved by the forces of springs along the edges."""
    points, n = np.vstack([shell.points, inner]), len(shell.points)
    for _ in range(_ROUNDS):
        tetrahedra = _joined(shell, points)
        edges = edges_of(tetrahedra, EDGES)
        moved = inner + _STEP * spring_forces(points, edges, size(points[edges].mean(axis=1)), _STRETCH)[n:]
        legal = allowed(moved, 0.45 * size(moved))
        inner = np.where(legal[:, None], moved, inner)
        points = np.vstack([shell.points, inner])
    return points


def _joined(shell: Shell, points: FloatArray) -> IntArray:
    tetrahedra = np.asarray(Delaunay(points).simplices, dtype=np.int64)
    return tetrahedra[~shell.behind(tetrahedra)]


def without_slivers(
    points: FloatArray,
    tetrahedra: IntArray,
    movable: BoolArray,
    size: Size,
    rng: np.random.Generator,
) -> FloatArray:
    """Points (n, 3) with the ``movable`` corners of flat ``tetrahedra`` (m, 4) moved, their connections kept.

    A move stays if the flattest tetrahedron around its point becomes rounder, so none ever gets flatter than the
    flattest one beside it was. Delaunay maximises no angle in space: one tetrahedron in a hundred is a sliver before.
    """
    points, quality = points.copy(), mean_ratios(points, tetrahedra)
    for _ in range(_TRIALS):
        flat = np.unique(tetrahedra[quality < _ROUND])
        chosen = _alone(tetrahedra, flat[movable[flat]], rng, len(points))
        if not chosen.any():
            break
        around = chosen[tetrahedra].any(axis=1)
        near = tetrahedra[around]
        owner = np.where(chosen[near], near, -1).max(axis=1)
        count, trial = int(chosen.sum()), points.copy()
        lengths = size(points[chosen]) * 10 ** rng.uniform(_SMALLEST, _LARGEST, count)
        trial[chosen] += rng.normal(size=(count, 3)) * lengths[:, None]
        before, after = np.full((2, len(points)), np.inf)
        np.minimum.at(before, owner, quality[around])
        np.minimum.at(after, owner, mean_ratios(trial, near))
        better = chosen & (after > before)
        points[better] = trial[better]
        quality[around] = mean_ratios(points, near)
    return points


def _alone(tetrahedra: IntArray, candidates: IntArray, rng: np.random.Generator, n: int) -> BoolArray:
    """True where one of ``n`` points moves now: candidates of which no two share a tetrahedron."""
    rank = np.full(n, -1.0)
    rank[candidates] = rng.random(len(candidates))
    beaten = (rank[tetrahedra] >= 0) & (rank[tetrahedra] < rank[tetrahedra].max(axis=1, keepdims=True))
    chosen = rank >= 0
    chosen[tetrahedra[beaten]] = False
    return chosen
