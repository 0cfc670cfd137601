"""Triangles in the plane: points spread by springs, joined by Delaunay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from ...errors import MeshError
from ...typing import BoolArray, FloatArray, IntArray
from ..mesh.tissue_mesh import SIDES, edges_of

# Forces of springs along the edges of a mesh, in the plane or in space (Persson and Strang 2004).


def spring_forces(points: FloatArray, edges: IntArray, wanted: FloatArray, stretch: float) -> FloatArray:
    """Sum of the pushes (n, d) on ``points`` (n, d), d = 2 or 3, of ``edges`` (m, 2) shorter than they want to be.

    ``wanted`` (m,) lengths count relative to one another: they are scaled to fill the area or volume there is, and by
    ``stretch`` more, so that nearly all edges push.
    """
    along = points[edges[:, 0]] - points[edges[:, 1]]
    length = np.linalg.norm(along, axis=1)
    power, root = (2, np.sqrt) if points.shape[1] == 2 else (3, np.cbrt)
    rest = wanted * stretch * root((length**power).sum() / (wanted**power).sum())
    push = (np.maximum(rest - length, 0) / length)[:, None] * along
    total = np.zeros_like(points)
    np.add.at(total, edges[:, 0], push)
    np.add.at(total, edges[:, 1], -push)
    return total


# Graded triangulations of a rectangle whose edges follow circles: the footprint of a slab.

_RELAXATIONS = 60
_STEP = 0.2
_STRETCH = 1.2  # distmesh: springs want to be this much longer than they are, so that all push


@dataclass(frozen=True)
class Rectangle:
    """The box low <= (x, y) <= high [m]."""

    low: tuple[float, float]
    high: tuple[float, float]

    def inside(self, xy: FloatArray, margin: FloatArray | float = 0.0) -> BoolArray:
        """True where ``xy`` (n, 2) lie at least ``margin`` inside."""
        gap = np.minimum(xy - self.low, np.asarray(self.high) - xy).min(axis=1)
        return np.asarray(gap >= margin)


Size = Callable[[FloatArray], FloatArray]


def triangulate(
    box: Rectangle, size: Size, circles: FloatArray, radius: float, fixed: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Points (n, 2) and counter-clockwise triangles (m, 3) of edge length ``size``, the same at every call.

    Edges follow the circles of ``radius`` about ``circles`` (k, 2); ``fixed`` points (j, 2) become vertices
    unless they fall too close to a circle or the border.
    """
    held = _held(box, size, circles, radius, fixed)
    free = _scatter(box, size, held, circles, radius, np.random.default_rng(1))
    xy = _relax(box, size, held, free, circles, radius)
    return xy, _delaunay(xy)


def _held(box: Rectangle, size: Size, circles: FloatArray, radius: float, fixed: FloatArray) -> FloatArray:
    """Vertices that do not move: border, rings on, inside and outside each rim, wanted points."""
    rings = [_rings(c, radius, float(size(c[None])[0])) for c in circles]
    ringed = np.vstack(rings) if rings else np.zeros((0, 2))
    ringed = ringed[box.inside(ringed, -1e-12)]
    (x0, y0), (x1, y1) = box.low, box.high
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    border = np.vstack([_along(a, b, size) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    edge = (np.abs(border - box.low) < 1e-12) | (np.abs(border - np.asarray(box.high)) < 1e-12)
    gap = np.where(edge.all(axis=1), 1e-9, 0.6) * size(border)  # a corner stays unless a ring is centred on it
    border = border[_clear_of(border, ringed, gap)]
    wanted = fixed[box.inside(fixed, -1e-12)]
    taken = np.vstack([ringed, border])
    wanted = wanted[_clear_of(wanted, taken, 0.6 * size(wanted))]
    return np.vstack([ringed, border, wanted])


def _rings(centre: FloatArray, radius: float, h: float) -> FloatArray:
    """Rings at equal spacing about ``h``: through the disc, on its rim, and one outside."""
    count = max(2, round(radius / (0.9 * h)))
    rows = [centre[None]]
    for k in range(1, count + 2):
        n = 4 * max(2, round(2 * np.pi * k * radius / count / h / 4))
        angle = 2 * np.pi * np.arange(n) / n
        ring = np.column_stack([np.cos(angle), np.sin(angle)])
        ring[np.abs(ring) < 1e-12] = 0.0
        rows.append(centre + k * radius / count * ring)
    return np.vstack(rows)


def _along(a: FloatArray, b: FloatArray, size: Size) -> FloatArray:
    """Points from ``a`` up to, not including, ``b``, spaced by ``size`` (equal parts of the integral of 1/h)."""
    t = np.linspace(0, 1, 2001)
    line = a + t[:, None] * (b - a)
    density = float(np.linalg.norm(b - a)) / size(line)
    total = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(t))])
    count = max(1, round(total[-1]))
    at = np.interp(np.arange(count) / count * total[-1], total, t)
    return np.asarray(a + at[:, None] * (b - a))


def _clear_of(xy: FloatArray, others: FloatArray, gap: FloatArray) -> BoolArray:
    if not len(others) or not len(xy):
        return np.ones(len(xy), dtype=bool)
    return np.asarray(cKDTree(others).query(xy)[0] > gap)


def _scatter(
    box: Rectangle, size: Size, held: FloatArray, circles: FloatArray, radius: float, rng: np.random.Generator
) -> FloatArray:
    """Points of a fine hexagonal lattice kept with probability ~ 1/h^2, away from what is held (distmesh)."""
    sampled = np.meshgrid(*(np.linspace(a, b, 101) for a, b in zip(box.low, box.high, strict=True)))
    finest = float(min(size(held).min(), size(np.stack(sampled, axis=-1).reshape(-1, 2)).min()))
    x = np.arange(box.low[0], box.high[0], finest)
    y = np.arange(box.low[1], box.high[1], finest * np.sqrt(3) / 2)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    grid[1::2, :, 0] += finest / 2
    xy = grid.reshape(-1, 2)
    h = size(xy)
    keep = rng.random(len(xy)) < (finest / h) ** 2
    keep &= box.inside(xy, 0.5 * h) & _clear_of(xy, held, 0.6 * h) & ~_in_rings(xy, circles, radius, size)
    return np.asarray(xy[keep])


def _in_rings(xy: FloatArray, circles: FloatArray, radius: float, size: Size) -> BoolArray:
    """Discs and the first ring outside are meshed by rings alone."""
    inside = np.zeros(len(xy), dtype=bool)
    for c in circles:
        h = float(size(c[None])[0])
        inside |= np.linalg.norm(xy - c, axis=1) < radius * (1 + 1 / max(2, round(radius / (0.9 * h)))) + 0.3 * h
    return inside


def _relax(
    box: Rectangle, size: Size, held: FloatArray, free: FloatArray, circles: FloatArray, radius: float
) -> FloatArray:
    """Move the free points by the forces of springs along the edges (Persson and Strang 2004)."""
    xy = np.vstack([held, free])
    movable = np.arange(len(xy)) >= len(held)
    for _ in range(_RELAXATIONS):
        edges = edges_of(_delaunay(xy), SIDES)
        step = _STEP * spring_forces(xy, edges, size(xy[edges].mean(axis=1)), _STRETCH)
        moved = xy + np.where(movable[:, None], step, 0)
        h = size(moved)
        legal = box.inside(moved, 0.4 * h) & ~_in_rings(moved, circles, radius, size)
        xy = np.where((movable & legal)[:, None], moved, xy)
    return np.asarray(xy)


def _delaunay(xy: FloatArray) -> IntArray:
    """Counter-clockwise triangles; slivers along the straight border (collinear points) are dropped."""
    triangles = Delaunay(xy).simplices
    a, b, c = xy[triangles].transpose(1, 0, 2)
    twice = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    longest = np.maximum.reduce([((b - a) ** 2).sum(1), ((c - b) ** 2).sum(1), ((a - c) ** 2).sum(1)])
    good = np.abs(twice) > 1e-9 * longest
    if not good.any():
        raise MeshError("the slab's footprint could not be triangulated; check limb.length and limb.width")
    ordered = np.where((twice < 0)[:, None], triangles[:, [0, 2, 1]], triangles)
    return np.asarray(ordered[good])
