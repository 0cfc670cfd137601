"""Limbs whose layers are thicker or thinner than a mesh has them: what stretches, and the mesh that follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...errors import GeometryError
from ...scenario.limb import CylinderLimb, ForearmLimb, Limb, SlabLimb
from ...typing import FloatArray
from ..mesh.tissue_mesh import TissueMesh, straight_jacobians
from .tube import Tube, folded_edges, tube_of

_DEEPEST = 0.5  # of a limb's radius: how deep its core moves where no bone is nearer
_LEAST = 0.3  # of its depth: what thicker layers must leave of the core that moves
_SLACK = 1e-6  # [m]


@dataclass(frozen=True)
class Stretch:
    """A tissue's thickness over that of the mesh (``scale``), and by how much deeper it begins (``offset`` [m])."""

    scale: float = 1.0
    offset: float = 0.0


def stretches(limb: Limb, other: Limb) -> Mapping[str, Stretch] | None:
    """Stretch of each tissue from ``limb`` to ``other``; None where these differ in more than layers' thicknesses, or a
    tissue comes in more than one part."""
    if not isinstance(limb, ForearmLimb | CylinderLimb | SlabLimb) or type(other) is not type(limb):
        return None
    names = [layer.tissue for layer in limb.layers]
    if len({*names, limb.core}) <= len(names) or [layer.tissue for layer in other.layers] != names:
        return None
    if other.changed({"layers": limb.layers}) != limb:
        return None
    found, offset = dict[str, Stretch](), 0.0
    for mine, its in zip(limb.layers, other.layers, strict=True):
        found[mine.tissue] = Stretch(its.thickness / mine.thickness, offset)
        offset += its.thickness - mine.thickness
    whole = sum(layer.thickness for layer in limb.layers)
    core = (limb.depth - whole - offset) / (limb.depth - whole) if isinstance(limb, SlabLimb) else 1.0
    return {**found, limb.core: Stretch(core, offset)}


def stretched(mesh: TissueMesh, limb: Limb, other: Limb) -> TissueMesh:
    """The ``mesh`` of ``limb`` with the layers of ``other``: skin, device and bones stay, all between them moves.

    Raises GeometryError where too little of the core would be left.
    """
    assert isinstance(limb, ForearmLimb | CylinderLimb | SlabLimb)
    assert type(other) is type(limb)
    if isinstance(limb, SlabLimb):
        old, new = (_interfaces(x, limb.depth) for x in (limb, other))
        points = mesh.points.copy()
        points[:, 2] = -np.interp(-points[:, 2], old, new)
        return _checked(mesh, replace(mesh, points=points), old, new)
    tube = tube_of(limb)
    angle = tube.angle_of(mesh.points)
    depth = tube.depth_of(mesh.points, angle)
    old, new = (_interfaces(x, _moving(mesh, tube, depth)) for x in (limb, other))
    mine = np.flatnonzero(depth < old[-1] - _SLACK)
    to = np.where(depth > 0, np.interp(depth, old, new), depth)  # rims of polygons lie above the skin
    points = mesh.points.copy()
    points[mine] = tube.place(points[mine, 0], angle[mine], to[mine])
    ends = mesh.bends.edges
    layer = (depth[ends] <= old[-2] + (old[-1] - old[-2]) / 4).all(axis=1) if len(ends) else np.zeros(0, dtype=bool)
    a, b = ends[layer].T
    middle = angle[a] + np.angle(np.exp(1j * (angle[b] - angle[a]))) / 2
    offsets = mesh.bends.offsets.copy()
    on = tube.place(points[ends[layer], 0].mean(axis=1), middle, to[ends[layer]].mean(axis=1))
    offsets[layer] = on - points[ends[layer]].mean(axis=1)
    return _checked(mesh, replace(mesh, points=points, bends=replace(mesh.bends, offsets=offsets)), old, new)


def unfolded(mesh: TissueMesh, limb: Limb, others: Sequence[Limb]) -> TissueMesh:
    """The ``mesh`` without the bends that would fold an element where layers are as thin as those of ``others``."""
    left = list(others)
    while left and len(mesh.bends.edges):
        moved = stretched(mesh, limb, left[-1])
        folded = folded_edges(moved)
        if not folded.any():
            left.pop()
        mesh = replace(mesh, bends=mesh.bends.chosen(~folded))
    return mesh


def _interfaces(limb: ForearmLimb | CylinderLimb | SlabLimb, deepest: float) -> FloatArray:
    """Depths (n + 2,) [m] of the skin, of each layer's lower side, and of where nothing moves."""
    return np.array([0.0, *np.cumsum([layer.thickness for layer in limb.layers]), deepest])


def _moving(mesh: TissueMesh, tube: Tube, depth: FloatArray) -> float:
    """Depth [m] down to which the core moves: to the nearest bone, or half of the radius."""
    bone = [mesh.facets.get("bone", np.zeros(0, dtype=np.int64)).ravel()]
    if "bone" in mesh.region_names:
        bone.append(mesh.tetrahedra[mesh.region == mesh.region_names.index("bone")].ravel())
    x = np.linspace(-tube.length / 2, tube.length / 2, 101)
    least = float(min(1.0, tube.aspect) * tube.height(x).min())
    return min([_DEEPEST * least, *(float(depth[b].min()) for b in bone if len(b))])


def _checked(mesh: TissueMesh, found: TissueMesh, old: FloatArray, new: FloatArray) -> TissueMesh:
    left = (new[-1] - new[-2]) / (old[-1] - old[-2])
    turned = np.linalg.det(straight_jacobians(found.points, found.tetrahedra)).min() <= 0
    if left < _LEAST or turned:
        raise GeometryError(
            f"limb.layers: layers of {1e3 * new[-2]:.3g} mm leave too little of the core of a mesh made for "
            f"{1e3 * old[-2]:.3g} mm; mesh the limb anew"
        )
    return found
