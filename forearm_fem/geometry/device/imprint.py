"""Pressing the circle of a contact's rim into a mesh: skin vertices near it move onto it, edges across it split."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...errors import MeshError
from ...ports import Port
from ...typing import FloatArray, IntArray
from ..mesh.refinement import independent, onto_circle, split_edges
from ..mesh.tissue_mesh import SIDES, TissueMesh, edge_lengths, edges_of
from .place import from_axis, near

Lift = Callable[[FloatArray], FloatArray]
_SNAP = 0.3  # a vertex closer than this part of an edge moves onto the circle, else the edge is split
_YIELD = 0.06  # a vertex closer than this that could not move counts as lying on the circle
_DIP = 0.03  # relative to the radius: shallower cuts through the disc are left alone
_TOLERANCE = 1e-8  # relative to the radius


def imprint(mesh: TissueMesh, port: Port, lift: Lift) -> TissueMesh:
    """The mesh with edges following the rim of ``port``; ``lift`` returns points to the skin's true surface."""
    mesh = _snapped(mesh, port, lift)
    for _ in range(50):
        if len(crossing := _crossing(mesh, port)):
            chosen = independent(mesh, crossing)
            middles = _fit(_cut(mesh.points, chosen, port), port, lift)
        elif len(dipping := _dipping(mesh, port)):
            chosen = independent(mesh, dipping)
            middles = _nearest(mesh.points, chosen, port)
        else:
            return mesh
        mesh = split_edges(mesh, chosen, middles)[0]
    raise MeshError(f"the rim of contact {port.name} could not be followed; set mesh.size_contact smaller")


def _fit(points: FloatArray, port: Port, lift: Lift) -> FloatArray:
    """On the circle and, as far as both can be had, on the skin."""
    for _ in range(6):
        points = onto_circle(lift(points), port)
    return points


def _skin_edges(mesh: TissueMesh, port: Port) -> IntArray:
    skin = mesh.facets["skin"]
    return edges_of(skin[near(mesh.points, port)[skin].any(axis=1)], SIDES)


def _snapped(mesh: TissueMesh, port: Port, lift: Lift) -> TissueMesh:
    """Vertices close to the circle, measured along the edges that cross it, moved onto it."""
    edges = _crossing(mesh, port)
    distance = from_axis(mesh.points, port) - port.radius
    part = np.abs(distance[edges]) / np.abs(distance[edges]).sum(axis=1, keepdims=True)
    skin = _skin_edges(mesh, port)  # vertices nearer than part of their shortest edge, crossing the circle or not, too
    shortest = np.full(len(mesh.points), 0.0)
    shortest[np.unique(skin)] = np.inf
    np.minimum.at(shortest, skin.ravel(), np.repeat(edge_lengths(mesh.points, skin), 2))
    close = np.union1d(edges[part < _SNAP], np.flatnonzero(np.abs(distance) < _SNAP * shortest))
    if not len(close):
        return mesh
    moved = mesh.points.copy()
    moved[close] = _fit(moved[close], port, lift)
    trial = replace(mesh, points=moved)
    bad = np.unique(mesh.tetrahedra[trial.volumes <= 0.1 * mesh.volumes])
    moved[bad] = mesh.points[bad]
    return replace(mesh, points=moved)


def _crossing(mesh: TissueMesh, port: Port) -> IntArray:
    """Skin edges (k, 2) from inside the circle to outside; a vertex very close that could not move counts as on it."""
    edges = _skin_edges(mesh, port)
    side = (from_axis(mesh.points, port) / port.radius - 1)[edges]
    part = np.abs(side).min(axis=1) / np.maximum(np.abs(side).sum(axis=1), 1e-30)
    crosses = (side.min(axis=1) < -_TOLERANCE) & (side.max(axis=1) > _TOLERANCE) & (part > _YIELD)
    return np.asarray(edges[crosses])


def _dipping(mesh: TissueMesh, port: Port) -> IntArray:
    """Skin edges (k, 2) that pass through the disc although neither end lies inside (chords of the rim excepted)."""
    edges = _skin_edges(mesh, port)
    side = (from_axis(mesh.points, port) / port.radius - 1)[edges]
    outside = (side.min(axis=1) > -_TOLERANCE) & (side.max(axis=1) > _TOLERANCE)
    edges = edges[outside]
    lowest = from_axis(_nearest(mesh.points, edges, port), port) / port.radius - 1
    return np.asarray(edges[lowest < -_DIP])


def _projected(points: FloatArray, edges: IntArray, port: Port) -> tuple[FloatArray, FloatArray]:
    """Start and direction (k, 3) of edges seen along the contact's axis, from its centre."""
    axis, centre = np.asarray(port.axis), np.asarray(port.position)
    start, end = ((points[e] - centre) - np.outer((points[e] - centre) @ axis, axis) for e in edges.T)
    return start, end - start


def _nearest(points: FloatArray, edges: IntArray, port: Port) -> FloatArray:
    """The point of each edge nearest to the axis."""
    start, d = _projected(points, edges, port)
    length = (d**2).sum(axis=1)  # none of an edge along the axis
    t = np.clip(-(start * d).sum(axis=1) / np.where(length > 0, length, 1.0), 0, 1)[:, None]
    return np.asarray(points[edges[:, 0]] * (1 - t) + points[edges[:, 1]] * t)


def _cut(points: FloatArray, edges: IntArray, port: Port) -> FloatArray:
    """Intersections of edges (k, 2) with the cylinder about the contact's axis."""
    start, d = _projected(points, edges, port)
    a, b, c = (d**2).sum(1), (start * d).sum(1), (start**2).sum(1) - port.radius**2
    root = np.sqrt(np.maximum(b**2 - a * c, 0))
    t = np.where(c < 0, (-b + root) / a, (-b - root) / a)[:, None]
    return np.asarray(points[edges[:, 0]] * (1 - t) + points[edges[:, 1]] * t)
