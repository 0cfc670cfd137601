"""Edges of a limb's mesh bent along its walls: flat facets would cut off what a finer mesh does not.

In the layers an edge's middle gets the mean of its ends' place along the limb, angle and depth, so that prisms bend as
a whole; on a bone it goes out to the wall. What facets cost, and what bending gains, is in decision 0017.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...scenario import Scenario
from ...scenario.limb import CylinderLimb, ForearmLimb
from ...typing import FloatArray, IntArray
from ..mesh.refinement import Middle, midpoints
from ..mesh.tissue_mesh import Bends, TissueMesh, bent_jacobians, straight_jacobians
from ..mesh.topology import EDGES, SIDES, boundary_faces, keys
from .tube import Tube, tube_of

_FLAT = 0.01  # of an edge's length: offsets below are left out; an arc of 0.08 rad
_THICKER = 0.02  # of the layers' thickness: vertices of refined edges lie on chords, so much below the core's wall
_ON_WALL = 0.1  # of a bone's radius, the same
_LEAST = 0.3  # of its determinant: an element that bending would flatten more keeps straight edges
_PROBES = np.vstack([np.eye(4), (np.eye(4)[EDGES[:, 0]] + np.eye(4)[EDGES[:, 1]]) / 2, np.full((1, 4), 0.25)])[:, 1:].T


def with_bends(scenario: Scenario, mesh: TissueMesh) -> TissueMesh:
    """``mesh`` with the bends that the scenario's limb gives it, as files do not hold them."""
    limb = scenario.limb
    return bent(mesh, tube_of(limb)) if isinstance(limb, ForearmLimb | CylinderLimb) else mesh


def bent(mesh: TissueMesh, tube: Tube) -> TissueMesh:
    """``mesh`` of ``tube`` with the edges in its layers and on its bones' walls bent as these are.

    Edges of tetrahedra whose determinant would fall below a share of what it was, anywhere, stay straight.
    """
    mesh = replace(mesh, bends=_bends(mesh, tube))
    straight, n = straight_jacobians(mesh.points, mesh.tetrahedra), len(mesh.points)
    while True:
        offsets = mesh.bends.of(mesh.tetrahedra)
        some = np.flatnonzero(offsets.any(axis=(1, 2)))
        determinants = np.linalg.det(bent_jacobians(straight[some], offsets[some], _PROBES))
        folded = some[determinants.min(axis=1) < _LEAST * np.linalg.det(straight[some])]
        if not len(folded):
            return mesh
        touched = keys(mesh.tetrahedra[folded][:, EDGES].reshape(-1, 2), n)
        mesh = replace(mesh, bends=mesh.bends.chosen(~np.isin(keys(mesh.bends.edges, n), touched)))


def bent_middles(tube: Tube) -> Middle:
    """Points that bisect edges of a mesh of ``tube``: on their parabolas, as chords may lie deep below the skin."""
    return lambda mesh, edges: midpoints(mesh, edges) + _bends(mesh, tube).on(edges)


def _bends(mesh: TissueMesh, tube: Tube) -> Bends:
    edges, middles = (
        np.concatenate(parts) for parts in zip(_in_layers(mesh, tube), *_on_bones(mesh, tube), strict=True)
    )
    ends = mesh.points[edges]
    offsets = middles - ends.mean(axis=1)
    far = np.linalg.norm(offsets, axis=1) > _FLAT * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return Bends(edges[far], offsets[far])


def _in_layers(mesh: TissueMesh, tube: Tube) -> tuple[IntArray, FloatArray]:
    """Edges (k, 2) of tetrahedra in the layers and of the skin, which may have none, and their true middles (k, 3)."""
    tissues = [i for i, name in enumerate(mesh.region_names) if name in {each.tissue for each in tube.layers}]
    tetrahedra = mesh.tetrahedra[np.isin(mesh.region, tissues)]
    skin = mesh.facets["skin"]
    used = np.union1d(tetrahedra, skin)
    angle, depth = np.zeros(len(mesh.points)), np.zeros(len(mesh.points))
    angle[used] = tube.angle_of(mesh.points[used])
    depth[used] = tube.depth_of(mesh.points[used], angle[used])
    slack = _THICKER * tube.thickness
    deep = depth[tetrahedra]  # the core may be of a layer's tissue
    layer = (deep <= tube.thickness + slack).all(axis=1) & (deep < tube.thickness - slack).any(axis=1)
    pairs = np.vstack([tetrahedra[layer][:, EDGES].reshape(-1, 2), skin[:, SIDES].reshape(-1, 2)])
    a, b = (edges := _each_once(pairs)).T
    middle = angle[a] + _turn(angle[b] - angle[a]) / 2
    x = mesh.points[edges, 0].mean(axis=1)
    return edges, tube.place(x, middle, depth[edges].mean(axis=1))


def _on_bones(mesh: TissueMesh, tube: Tube) -> list[tuple[IntArray, FloatArray]]:
    """Edges (k, 2) on each bone's wall, be it left out of the mesh or a region of it, and their true middles (k, 3)."""
    points, found = mesh.points, []
    if "bone" in mesh.region_names:
        walls, _ = boundary_faces(mesh.tetrahedra[mesh.region == mesh.region_names.index("bone")])
        walls = walls[np.ptp(points[walls, 0], axis=1) > 0]
    else:
        walls = mesh.facets.get("bone", np.zeros((0, 3), dtype=np.int64))
    edges = _each_once(walls[:, SIDES].reshape(-1, 2))
    for bone in tube.bones:
        away = points[:, 1:] - tube.bone_centre(bone, points[:, 0])
        radius, angle = np.linalg.norm(away, axis=1), np.arctan2(away[:, 0], away[:, 1])
        mine = edges[(np.abs(radius[edges] / bone.radius - 1) < _ON_WALL).all(axis=1)]
        a, b = mine.T
        middle, x = angle[a] + _turn(angle[b] - angle[a]) / 2, points[mine, 0].mean(axis=1)
        outward = np.column_stack([np.sin(middle), np.cos(middle)])
        place = tube.bone_centre(bone, x) + radius[mine].mean(axis=1)[:, None] * outward
        found.append((mine, np.column_stack([x, place])))
    return found


def _each_once(pairs: IntArray) -> IntArray:
    """Each edge (k, 2) among ``pairs`` (n, 2) once."""
    ordered = np.sort(pairs, axis=1)
    _, first = np.unique(keys(ordered, 1 + int(ordered.max(initial=0))), return_index=True)
    return np.asarray(ordered[first])


def _turn(angle: FloatArray) -> FloatArray:
    """Angles between -pi and pi."""
    return np.asarray(np.angle(np.exp(1j * angle)))
