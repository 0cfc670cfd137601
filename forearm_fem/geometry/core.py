"""Tetrahedra of the muscle core by fTetWild, fine under the device, its boundary moved onto the exact
surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..typing import BoolArray, FloatArray, IntArray
from .sizing import Sizes
from .tetwild import ENVELOPE, background_grid, tetrahedralise
from .topology import boundary_faces
from .tube import BoneAxis, Tube, lattice

# Facets of the surfaces handed to fTetWild: they, not the wanted sizes, limit elements far from the ports.
_ALONG = 12  # at least, along the limb
_STRETCH = 2.0  # length over width near the ports
_BONE_FACET = 2.0  # relative to those of the skin, which bends less
Size3 = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Core:
    """Core mesh; ``lateral`` (m, 3) are the triangles on which layers grow, ``angle`` (n_point,) their
    columns, ``bulge`` (n_point,) how far [m] these stand out of the analytic surfaces (:func:`_bulges`).

    ``bone`` (n_tet,) numbers the bone each tetrahedron lies in, -1 for muscle.
    """

    points: FloatArray
    tetrahedra: IntArray
    bone: IntArray
    lateral: IntArray
    angle: FloatArray
    bulge: FloatArray
    on_bone: BoolArray


def core_mesh(tube: Tube, size: Size3, sizes: Sizes, *, elastic: bool) -> Core:
    """Mesh of everything inside the layers; bones are left out unless ``elastic``."""
    around = max(6, round(2 * np.pi / (_BONE_FACET * sizes.facet)))
    vertices, faces = _surfaces(tube, size, sizes.facet, around, elastic)
    grid, cells = background_grid(vertices.min(axis=0), vertices.max(axis=0), 3e-3)
    points, tetrahedra = tetrahedralise(vertices, faces, grid, cells, size(grid), sizes.far)
    return _fitted(tube, points, tetrahedra, around, elastic)


def _surfaces(tube: Tube, size: Size3, facet: float, around: int, elastic: bool) -> tuple[FloatArray, IntArray]:
    """Closed triangulated surfaces: the core outwards; bones inwards and longer (holes), or outwards
    (kept)."""
    half = tube.length / 2
    angle, x = _facet_angles(tube, size, facet), _stations(tube, size)
    wall = tube.place(np.repeat(x, len(angle)), np.tile(angle, len(x)), tube.thickness)
    parts = [_capped(wall, len(x) - 1, len(angle))]
    for bone in tube.bones:
        reach = half if elastic else half * 1.02
        wall = _bone_wall(tube, bone, np.linspace(-reach, reach, _ALONG + 1), around)
        points, faces = _capped(wall, _ALONG, around)
        parts.append((points, faces if elastic else faces[:, ::-1]))
    starts = np.cumsum([0, *(len(p) for p, _ in parts)])
    faces = np.vstack([f + start for (_, f), start in zip(parts, starts[:-1], strict=True)])
    return np.vstack([p for p, _ in parts]), faces


def _facet_angles(tube: Tube, size: Size3, widest: float) -> FloatArray:
    """Angles around the section at x = 0, a fine element apart: facets much finer would force small
    elements."""
    angle = np.linspace(0, 2 * np.pi, 1001)
    ring = tube.place(np.zeros(1001), angle, tube.thickness)
    step = np.linalg.norm(np.diff(ring, axis=0), axis=1)
    wanted = np.minimum(size((ring[1:] + ring[:-1]) / 2), widest * np.linalg.norm(ring[1:], axis=1))
    total = np.concatenate([[0], np.cumsum(step / wanted)])
    count = max(12, round(total[-1]))
    return np.asarray(np.interp(np.arange(count) / count * total[-1], total, angle))


def _stations(tube: Tube, size: Size3) -> FloatArray:
    """Where the skin's facets begin and end along the limb: long facets near the ports would spoil the mesh there."""
    x = np.linspace(-tube.length / 2, tube.length / 2, 1001)
    middle = (x[1:] + x[:-1]) / 2
    wanted = np.minimum(_STRETCH * size(tube.place(middle, np.zeros(1000), tube.thickness)), tube.length / _ALONG)
    total = np.concatenate([[0], np.cumsum(np.diff(x) / wanted)])
    return np.asarray(np.interp(np.linspace(0, total[-1], round(total[-1]) + 1), total, x))


def _bone_wall(tube: Tube, bone: BoneAxis, x: FloatArray, around: int) -> FloatArray:
    angle = 2 * np.pi * np.arange(around) / around
    ring = bone.radius * np.column_stack([np.sin(angle), np.cos(angle)])
    centres = tube.bone_centre(bone, x)
    section = (centres[:, None] + ring).reshape(-1, 2)
    return np.column_stack([np.repeat(x, around), section])


def _capped(wall: FloatArray, n: int, m: int) -> tuple[FloatArray, IntArray]:
    """A tube of n spacings and m points around, closed by fans at both ends, normals outwards."""
    ends = np.vstack([wall[:m].mean(axis=0), wall[-m:].mean(axis=0)])
    j = np.arange(m)
    k = (j + 1) % m
    low = np.column_stack([np.full(m, len(wall)), j, k])
    high = np.column_stack([np.full(m, len(wall) + 1), n * m + k, n * m + j])
    return np.vstack([wall, ends]), np.vstack([lattice(n, m), low, high])


def _fitted(tube: Tube, points: FloatArray, tetrahedra: IntArray, around: int, elastic: bool) -> Core:
    """Boundary vertices moved onto the analytic surfaces and end planes."""
    bone = _bone_of(tube, points[tetrahedra].mean(axis=1)) if elastic else np.full(len(tetrahedra), -1)
    faces, _ = boundary_faces(tetrahedra)
    slack = _slack(tube, around)
    ended = _is_end(tube, points, faces, slack)
    bony = ~ended & _near_bone(tube, points, faces, slack)
    wall = faces[~ended & ~bony]
    if elastic:
        bony_vertices = np.intersect1d(tetrahedra[bone >= 0], tetrahedra[bone < 0])
    else:
        bony_vertices = np.unique(faces[bony])
    moved = points.copy()
    ends = np.unique(faces[ended])
    moved[ends, 0] = np.sign(points[ends, 0]) * tube.length / 2
    walls = boundary_faces(tetrahedra[bone >= 0])[0] if elastic and tube.bones else faces[bony]
    moved[bony_vertices] = _onto_bones(tube, moved[bony_vertices], _radii(tube))
    moved[bony_vertices] = _onto_bones(tube, moved[bony_vertices], _faceted_radii(tube, moved, walls))
    lateral = np.unique(wall)
    angle = np.zeros(len(points))
    angle[lateral] = tube.angle_of(moved[lateral])
    bulge = _bulges(tube, moved, wall, angle)
    moved[lateral] = tube.place(moved[lateral, 0], angle[lateral], tube.thickness - bulge[lateral])
    on_bone = np.zeros(len(points), dtype=bool)
    on_bone[bony_vertices] = not elastic
    return Core(moved, tetrahedra, bone, wall, angle, bulge, on_bone)


def _bulges(tube: Tube, points: FloatArray, wall: IntArray, angle: FloatArray) -> FloatArray:
    """Outward shift (n_point,) [m] that gives the flat triangles ``wall`` (m, 3) the volume under the true surface.

    A chord lies below y^2/2R by sum (y_i - y_j)^2 / 24R on average over a triangle, y = R angle; each vertex takes the
    mean of its triangles.
    """
    turn = angle[wall]
    apart = np.angle(np.exp(1j * (turn - np.roll(turn, 1, axis=1))))
    radius = np.linalg.norm(points[wall][:, :, 1:], axis=2).mean(axis=1)
    below = radius * (apart**2).sum(axis=1) / 24
    total = np.bincount(wall.ravel(), np.repeat(below, 3), len(points))
    return np.asarray(total / np.maximum(np.bincount(wall.ravel(), minlength=len(points)), 1))


def _slack(tube: Tube, around: int) -> float:
    """How far fTetWild's boundary may lie off the analytic surfaces [m]; bones have ``around`` facets."""
    widest = max((bone.radius for bone in tube.bones), default=0.0)
    arc = float(widest * (1 - np.cos(np.pi / around)))
    return 2 * ENVELOPE * (tube.length + 2 * float(tube.heights.max())) + arc


def _is_end(tube: Tube, points: FloatArray, faces: IntArray, slack: float) -> BoolArray:
    a, b, c = points[faces].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    along = np.abs(normal[:, 0]) > 0.7 * np.linalg.norm(normal, axis=1)
    near = (np.abs(points[faces][:, :, 0]) > tube.length / 2 - slack).all(axis=1)
    return np.asarray(along & near)


def _from_bones(tube: Tube, points: FloatArray) -> FloatArray:
    """Distance (n, n_bone) [m] from each bone's axis within the section."""
    away = [np.linalg.norm(points[:, 1:] - tube.bone_centre(b, points[:, 0]), axis=1) for b in tube.bones]
    return np.column_stack(away) if away else np.full((len(points), 1), np.inf)


def _near_bone(tube: Tube, points: FloatArray, faces: IntArray, slack: float) -> BoolArray:
    radii = _radii(tube)
    near = _from_bones(tube, points) < radii + slack
    per_bone = np.asarray(near)[faces].all(axis=1)
    inwards = [_flux(points[faces], tube.bone_centre(bone, points[:, 0])[faces]) < 0 for bone in tube.bones]
    return np.asarray(np.any(per_bone & np.column_stack(inwards or [np.zeros(len(faces), bool)]), axis=1))


def _bone_of(tube: Tube, places: FloatArray) -> IntArray:
    radii = _radii(tube)
    inside = _from_bones(tube, places) < radii
    return np.where(inside.any(axis=1), inside.argmax(axis=1), -1)


def _radii(tube: Tube) -> FloatArray:
    return np.array([b.radius for b in tube.bones] or [0.0])


def _flux(corners: FloatArray, centres: FloatArray | float = 0.0) -> FloatArray:
    """Half the flux (n,) of (0, y, z), measured from ``centres`` (n, 3, 2), through triangles (n, 3, 3).

    Summed over a tube with flat ends this is its volume.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    arms = (corners[:, :, 1:] - centres).mean(axis=1)
    return np.asarray((normal[:, 1:] * arms).sum(axis=1) / 2)


def _faceted_radii(tube: Tube, points: FloatArray, walls: IntArray) -> FloatArray:
    """Radii (n_bone,) of the vertices that give each bone's flat ``walls`` (n, 3) the volume of its cylinder.

    ``points`` lie on the cylinders now, so that facets cut some of it off.
    """
    if not len(walls):
        return _radii(tube)
    nearest = (_from_bones(tube, points[walls].mean(axis=1)) - _radii(tube)).argmin(axis=1)
    held = np.abs(np.bincount(nearest, _flux(points[walls]), len(tube.bones)))
    exact = np.pi * _radii(tube) ** 2 * tube.length
    return np.asarray(_radii(tube) * np.sqrt(np.where(held > 0, exact / np.where(held > 0, held, 1.0), 1.0)))


def _onto_bones(tube: Tube, points: FloatArray, radii: FloatArray) -> FloatArray:
    """Each point moved within its section onto the nearest bone's circle with one of the ``radii`` (n_bone,)."""
    if not len(points):
        return points
    which = (_from_bones(tube, points) - _radii(tube)).argmin(axis=1)
    centres = np.stack([tube.bone_centre(b, points[:, 0]) for b in tube.bones], axis=1)
    centre = centres[np.arange(len(points)), which]
    away = points[:, 1:] - centre
    away = away * (radii[which] / np.linalg.norm(away, axis=1))[:, None]
    return np.column_stack([points[:, 0], centre + away])
