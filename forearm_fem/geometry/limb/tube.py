"""Tubes: limbs of round sections about an axis, and edges of their meshes bent along the walls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.special import ellipe

from ...errors import GeometryError
from ...scenario import Scenario
from ...scenario.limb import CylinderLimb, ForearmLimb, LayerThickness
from ...typing import BoolArray, FloatArray, IntArray
from ..mesh.refinement import Middle, midpoints
from ..mesh.tissue_mesh import EDGES, SIDES, Bends, TissueMesh, bent_jacobians, boundary_faces, keys, straight_jacobians

# The analytic limb: elliptic sections along x, layers of exact thickness, bones that follow the taper.

_SLOPE_STEP = 1e-5  # [m] for the derivative of the profile


@dataclass(frozen=True)
class BoneAxis:
    """A bone of circular section; ``y``, ``z`` [m] place its axis at x = 0, from where it follows the taper."""

    name: str
    y: float
    z: float
    radius: float


@dataclass(frozen=True)
class Tube:
    """Limb with its axis on y = z = 0: at each x an ellipse of half height b(x) and half width aspect * b(x).

    ``stations`` (n,) and ``heights`` (n,) [m] are joined by a monotone cubic (smooth normals) and continued
    as constants. A point of the limb has coordinates x, angle (0 = volar, towards +y) and depth [m] below the
    skin. Depth runs inside the section x = const, stretched so that layers are as thick as asked for when
    measured along the surface's normal; cut ends therefore stay plane.
    """

    stations: FloatArray
    heights: FloatArray
    aspect: float
    length: float
    layers: tuple[LayerThickness, ...]
    core: str
    bones: tuple[BoneAxis, ...]

    @property
    def thickness(self) -> float:
        """All layers together [m]."""
        return sum(layer.thickness for layer in self.layers)

    @cached_property
    def _profile(self) -> PchipInterpolator | None:
        return PchipInterpolator(self.stations, self.heights) if len(self.stations) > 1 else None

    def height(self, x: FloatArray) -> FloatArray:
        """Half height b (n,) [m] of the section at ``x`` (n,)."""
        if self._profile is None:
            return np.full(np.shape(x), self.heights[0])
        return np.asarray(self._profile(np.clip(x, self.stations[0], self.stations[-1])))

    def normal(self, x: FloatArray, angle: FloatArray) -> FloatArray:
        """Outward unit normal (n, 3) of the skin."""
        slope = (self.height(x + _SLOPE_STEP) - self.height(x - _SLOPE_STEP)) / (2 * _SLOPE_STEP)
        raw = np.column_stack([-slope, np.sin(angle) / self.aspect, np.cos(angle)])
        return np.asarray(raw / np.linalg.norm(raw, axis=1)[:, None])

    def place(self, x: FloatArray, angle: FloatArray, depth: FloatArray | float) -> FloatArray:
        """Points (n, 3) at ``x``, ``angle`` and ``depth`` (n,) below the skin."""
        normal, b = self.normal(x, angle), self.height(x)
        inward = normal[:, 1:] / (normal[:, 1:] ** 2).sum(axis=1, keepdims=True)
        section = np.column_stack([self.aspect * b * np.sin(angle), b * np.cos(angle)])
        return np.column_stack([x, section - np.reshape(depth, (-1, 1)) * inward])

    def angle_of(self, points: FloatArray) -> FloatArray:
        """Angle (n,) of the column that passes through each point (n, 3): foot of the normal in its section."""
        b = self.height(points[:, 0])
        a, y, z = self.aspect * b, points[:, 1], points[:, 2]
        angle = np.arctan2(y / a, z / b)
        if self.aspect == 1:
            return np.asarray(angle)
        for _ in range(30):  # Newton on (p - s) . s' = 0
            s, c = np.sin(angle), np.cos(angle)
            value = (y - a * s) * a * c - (z - b * c) * b * s
            slope = -((a * c) ** 2) - (b * s) ** 2 - (y - a * s) * a * s - (z - b * c) * b * c
            angle = angle - np.clip(value / slope, -0.3, 0.3)
        return np.asarray(angle)

    def depth_of(self, points: FloatArray, angle: FloatArray) -> FloatArray:
        """Depth (n,) [m] of points (n, 3) below the skin, in the columns at their ``angle`` (n,)."""
        skin = self.place(points[:, 0], angle, 0.0)
        return np.asarray(((skin - points)[:, 1:] * self.normal(points[:, 0], angle)[:, 1:]).sum(axis=1))

    def volar(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (n, 3) and outward normals (n, 3) of the volar skin over ``xy`` (n, 2); NaN off the limb."""
        x, y = xy.T
        with np.errstate(invalid="ignore"):
            angle = np.arcsin(y / (self.aspect * self.height(x)))
        angle = np.where(np.abs(x) <= self.length / 2, angle, np.nan)
        return self.place(x, angle, 0.0), self.normal(x, angle)

    def bone_centre(self, bone: BoneAxis, x: FloatArray) -> FloatArray:
        """(y, z) of the bone's axis (n, 2) at ``x`` (n,): its offset shrinks with the section."""
        scale = self.height(x) / self.height(np.zeros(1))
        return np.column_stack([bone.y * scale, bone.z * scale])

    def section_area(self, x: float, depth: float) -> float:
        """Area [m^2] inside the surface at ``depth``, in the section at ``x``."""
        angle = np.linspace(0, 2 * np.pi, 721)[:-1]
        _, y, z = self.place(np.full(720, x), angle, depth).T
        return float(abs(np.dot(y, np.roll(z, -1)) - np.dot(z, np.roll(y, -1))) / 2)

    def volumes(self, *, bones_kept: bool) -> Mapping[str, float]:
        """Exact volume [m^3] of every region (quadrature along x)."""
        depths = np.concatenate([[0], np.cumsum([layer.thickness for layer in self.layers])])
        at, weight = np.polynomial.legendre.leggauss(40)
        inside = [
            sum(
                w * self.length / 2 * self.section_area(self.length / 2 * t, d) for t, w in zip(at, weight, strict=True)
            )
            for d in depths
        ]
        bone = sum(np.pi * b.radius**2 for b in self.bones) * self.length
        total: dict[str, float] = {}
        for layer, outer, inner in zip(self.layers, inside[:-1], inside[1:], strict=True):
            total[layer.tissue] = total.get(layer.tissue, 0.0) + outer - inner
        total[self.core] = total.get(self.core, 0.0) + inside[-1] - bone
        return {**total, "bone": float(bone)} if bones_kept and self.bones else total


def tube_of(limb: ForearmLimb | CylinderLimb) -> Tube:
    """The analytic limb of a scenario; raises :class:`GeometryError` when it cannot exist."""
    if isinstance(limb, CylinderLimb):
        stations, heights, aspect = np.zeros(1), np.array([limb.diameter / 2]), 1.0
    else:
        aspect = limb.aspect
        stations, around = np.array(limb.circumference, dtype=float).T
        heights = around / (4 * max(aspect, 1.0) * ellipe(1 - min(aspect, 1 / aspect) ** 2))
    bare = Tube(stations, heights, aspect, limb.length, limb.layers, limb.core, ())
    volar = float(bare.height(np.zeros(1))[0])
    bones = tuple(BoneAxis(b.name, b.y, volar - b.depth, b.diameter / 2) for b in limb.bones)
    tube = Tube(stations, heights, aspect, limb.length, limb.layers, limb.core, bones)
    check_tube(tube)
    return tube


_CLEARANCE = 1e-3  # [m] of muscle around a bone, or elements become needles


def check_tube(tube: Tube) -> None:
    """Raise :class:`GeometryError` when layers or bones do not fit."""
    x = np.linspace(-tube.length / 2, tube.length / 2, 201)
    b = tube.height(x)
    a = tube.aspect * b
    tightest = float(np.min(np.minimum(a, b) ** 2 / np.maximum(a, b)))  # radius of curvature: inward offsets end there
    if tube.thickness > 0.9 * tightest:
        raise GeometryError(
            f"the layers are {tube.thickness * 1e3:.3g} mm thick together, but the limb bends with a radius of "
            f"{tightest * 1e3:.3g} mm at its tightest; thin limb.layers, enlarge the limb or bring limb.aspect nearer 1"
        )
    angle = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    for bone in tube.bones:
        gap = np.inf
        for at, centre in zip(x[::10], tube.bone_centre(bone, x)[::10], strict=True):
            wall = tube.place(np.full(180, at), angle, tube.thickness)[:, 1:]
            away = float(np.linalg.norm(wall - centre, axis=1).min()) - bone.radius
            along, towards = np.roll(wall, -1, axis=0) - wall, centre - wall
            side = along[:, 0] * towards[:, 1] - along[:, 1] * towards[:, 0]
            inside = (side > 0).all() or (side < 0).all()  # of the section, which is convex
            gap = min(gap, away if inside else -np.inf)
        if gap < _CLEARANCE:
            raise GeometryError(
                f"bone '{bone.name}' does not lie inside the {tube.core} with {_CLEARANCE * 1e3:g} mm to spare (its "
                f"axis at y = {bone.y * 1e3:.3g} mm, diameter {2e3 * bone.radius:.3g} mm); in limb.bones move it "
                "towards the middle (y, depth) or make it thinner, or reduce limb.length"
            )
    for first, second in combinations(tube.bones, 2):
        apart = np.linalg.norm(tube.bone_centre(first, x) - tube.bone_centre(second, x), axis=1).min()
        gap = float(apart) - first.radius - second.radius
        if gap < _CLEARANCE:
            how = f"overlap by {-gap * 1e3:.3g} mm" if gap < 0 else f"come within {gap * 1e3:.3g} mm of each other"
            raise GeometryError(
                f"bones '{first.name}' and '{second.name}' {how}, expected {_CLEARANCE * 1e3:g} mm "
                f"of {tube.core} between them; in limb.bones move them apart (y, depth) or make them thinner"
            )


# Edges of a limb's mesh bent along its walls: flat facets would cut off what a finer mesh does not.
# In the layers an edge's middle gets the mean of its ends' place along the limb, angle and depth, so that prisms bend
# as a whole; on a bone it goes out to the wall. What facets cost, and what bending gains, is in decision 0017.

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
    while (folded := folded_edges(mesh)).any():
        mesh = replace(mesh, bends=mesh.bends.chosen(~folded))
    return mesh


def folded_edges(mesh: TissueMesh) -> BoolArray:
    """True for bends (k,) of elements whose determinant falls below a share of what it is with straight edges."""
    straight, n = straight_jacobians(mesh.points, mesh.tetrahedra), len(mesh.points)
    offsets = mesh.bends.of(mesh.tetrahedra)
    some = np.flatnonzero(offsets.any(axis=(1, 2)))
    determinants = np.linalg.det(bent_jacobians(straight[some], offsets[some], _PROBES))
    folded = some[determinants.min(axis=1, initial=np.inf) < _LEAST * np.linalg.det(straight[some])]
    touched = keys(mesh.tetrahedra[folded][:, EDGES].reshape(-1, 2), n)
    return np.asarray(np.isin(keys(mesh.bends.edges, n), touched))


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
