"""Inside of a limb: conformal chart of its walls, core of tetrahedra, layers around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...errors import MeshError
from ...typing import BoolArray, FloatArray, IntArray
from ..device.layout import Layout
from ..device.sizing import Sizes
from ..mesh.tissue_mesh import DOWN, SIDES, TissueMesh, boundary_faces, edges_of, triangle_normals
from .filling import Shell, fill, oriented, stack_prisms
from .planar import Rectangle, triangulate
from .tube import BoneAxis, Tube

# A limb's skin or a bone's wall unrolled into a plane without distorting angles, and points spread evenly on it.

Place = tuple[FloatArray, FloatArray]  # x [m] and angle [rad] (n,) of points on a tube
_STATIONS = 4001
_NONE = np.zeros((0, 2))


@dataclass(frozen=True)
class Chart:
    """Conformal map of a tube's surface to the rectangle 0 <= u <= end, -pi <= v <= pi; the seam is dorsal.

    With radius r(x), du = sqrt(1 + r'^2) dx / r and v the share of the section's arc: ds^2 = r^2 (du^2 + dv^2), exact
    for round sections. Even triangles of the plane are even on the surface. ``x``, ``u``, ``radius`` and ``angle``,
    ``v`` are tables, joined linearly.
    """

    x: FloatArray
    u: FloatArray
    radius: FloatArray
    angle: FloatArray
    v: FloatArray

    @classmethod
    def of_skin(cls, tube: Tube) -> Chart:
        """The skin; an elliptic section counts by its arc length."""
        x = np.linspace(-tube.length / 2, tube.length / 2, _STATIONS)
        angle = np.linspace(-np.pi, np.pi, _STATIONS)
        ring = tube.place(np.zeros(_STATIONS), angle, 0.0)
        arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))])
        radius = arc[-1] / (2 * np.pi) * tube.height(x) / tube.height(np.zeros(1))
        return cls(x, _stretched(x, radius), radius, angle, (2 * arc / arc[-1] - 1) * np.pi)

    @classmethod
    def of_bone(cls, tube: Tube, bone: BoneAxis) -> Chart:
        """A bone's wall, taken as a straight cylinder: its axis leans by a few degrees at most."""
        x = np.linspace(-tube.length / 2, tube.length / 2, _STATIONS)
        around = np.linspace(-np.pi, np.pi, _STATIONS)
        radius = np.full(_STATIONS, bone.radius)
        return cls(x, _stretched(x, radius), radius, around, around)

    def surface(self, uv: FloatArray) -> Place:
        """x and angle of points of the plane (n, 2)."""
        return np.interp(uv[:, 0], self.u, self.x), np.interp(uv[:, 1], self.v, self.angle)

    def plane(self, x: FloatArray, angle: FloatArray) -> FloatArray:
        """Points of the plane (n, 2) at ``x`` and ``angle`` (n,)."""
        return np.column_stack([np.interp(x, self.x, self.u), np.interp(angle, self.angle, self.v)])

    def scale(self, uv: FloatArray) -> FloatArray:
        """Metres on the surface per unit of the plane (n,)."""
        return np.interp(uv[:, 0], self.u, self.radius)


def _stretched(x: FloatArray, radius: FloatArray) -> FloatArray:
    middle = (radius[1:] + radius[:-1]) / 2
    return np.concatenate([[0], np.cumsum(np.hypot(np.diff(x), np.diff(radius)) / middle)])


def spread(
    chart: Chart,
    size: Callable[[FloatArray, FloatArray], FloatArray],
    *,
    circles: Place | None = None,
    radius: float = 0.0,
    fixed: Place | None = None,
) -> Place:
    """x and angle (n,) of points about ``size(x, angle)`` [m] apart that triangulate evenly, the same at every call.

    Rings of points follow the circles of ``radius`` [m] about ``circles``; ``fixed`` places become points too.
    """
    centres = chart.plane(*circles) if circles else _NONE
    wanted = chart.plane(*fixed) if fixed else _NONE
    rim = radius / float(chart.scale(centres).mean()) if len(centres) else 1.0
    box = Rectangle((0.0, -np.pi), (float(chart.u[-1]), np.pi))
    uv, _ = triangulate(box, lambda uv: size(*chart.surface(uv)) / chart.scale(uv), centres, rim, wanted)
    low, high = (np.sort(uv[np.abs(uv[:, 1] - seam) < 1e-9, 0]) for seam in (-np.pi, np.pi))
    if len(low) != len(high):
        raise MeshError("the limb's skin could not be unrolled, its seam has two sides; set mesh.size_far smaller")
    u, v = uv[uv[:, 1] < np.pi - 1e-9].T  # the seam's points at v = pi are those at -pi again
    u = np.where(u < 1e-9, 0.0, np.where(u > chart.u[-1] - 1e-9, chart.u[-1], u))
    return chart.surface(np.column_stack([u, v]))


# Tetrahedra of the muscle core: even triangles on its surface, graded tetrahedra inside.

_BONE_FACET = 2.0  # far from contacts, relative to the facets near them: eight at accuracy 0.05
_BONE_SHARE = 0.5  # of the size around: a contact over 4 mm of muscle felt the octagon by 2 % at 60 Hz
_BONE_WIDEST = 2 * np.pi / 4  # a limit that both meshes of an error estimate reach hides what it costs
_PER_GAP = 2.2  # edges on two surfaces near one another, relative to the gap: longer ones would reach across
_INSET = 0.5  # grid of points on the cut ends: how many spacings they keep from walls
Size3 = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Core:
    """Core mesh; ``lateral`` (m, 3) are the triangles on which layers grow, ``angle`` (n_point,) their columns.

    ``bone`` (n_tet,) numbers the bone each tetrahedron lies in, -1 for muscle.
    """

    points: FloatArray
    tetrahedra: IntArray
    bone: IntArray
    lateral: IntArray
    angle: FloatArray
    on_bone: BoolArray


def core_mesh(tube: Tube, size: Size3, sizes: Sizes, layout: Layout, *, elastic: bool, seed: int = 1) -> Core:
    """Mesh of everything inside the layers; bones are left out unless ``elastic``. The same at every call.

    Columns of the layers stand on the core's surface, so its triangles are what the skin gets: they are spread evenly,
    with rings under the contacts of ``layout`` and a column through each of its points.
    """
    shell = _shell(tube, size, sizes, layout, elastic)
    points, tetrahedra = fill(shell, size, lambda p, gap: _inside(tube, p, gap), seed=seed)
    n_bone, on = len(tube.bones), shell.on_of(len(points))
    in_bone = on[:, 1 : n_bone + 1]
    bone = _which(in_bone[tetrahedra])
    faces, _ = boundary_faces(tetrahedra)
    lateral = faces[on[faces, 0].all(axis=1) & (_which(on[faces][:, :, n_bone + 1 :]) < 0)]
    faces, _ = boundary_faces(tetrahedra[bone < 0])
    faces = faces[_which(on[faces][:, :, n_bone + 1 :]) < 0]
    walls = [faces[of[faces].all(axis=1)] for of in in_bone.T]  # of each bone, towards the muscle's outside
    _check_tubes([lateral, *walls])
    column = np.unique(lateral)
    angle, on_bone = np.zeros(len(points)), np.zeros(len(points), dtype=bool)
    angle[column] = tube.angle_of(points[column])
    for faces in walls:
        on_bone[faces] = not elastic
    return Core(points, tetrahedra, bone, lateral, angle, on_bone)


def _shell(tube: Tube, size: Size3, sizes: Sizes, layout: Layout, elastic: bool) -> Shell:
    """Points on the core's wall, the bones' walls, the cut ends and, where they are ``elastic``, inside the bones.

    Surfaces are the wall, each bone (with what is inside it) and the two ends.
    """
    x, angle = _wall(tube, size, sizes.wall, layout)
    parts = [tube.place(x, angle, tube.thickness)]
    parts += [_bone_wall(tube, bone, size, sizes.facet) for bone in tube.bones]
    parts += [_end(tube, parts[0], side) for side in (-1, 1)]
    surface = np.repeat(np.arange(len(parts)), [len(p) for p in parts])
    for number, bone in enumerate(tube.bones if elastic else ()):
        # along its axis, ends included, no closer than its radius: bone hardly deforms
        x = np.linspace(-tube.length / 2, tube.length / 2, max(2, round(tube.length / bone.radius)) + 1)
        parts.append(np.column_stack([x, tube.bone_centre(bone, x)]))
        surface = np.append(surface, np.full(len(x), 1 + number))
    points, n_bone = np.vstack(parts), len(tube.bones)
    on = surface[:, None] == np.arange(n_bone + 3)
    on[:, n_bone + 1] |= points[:, 0] == -tube.length / 2
    on[:, n_bone + 2] |= points[:, 0] == tube.length / 2
    closed = np.array([True] + [not elastic] * n_bone + [True, True])
    return Shell(points, on, closed)


def _wall(tube: Tube, size: Size3, widest: float, layout: Layout) -> Place:
    """Columns' x and angle on the core's wall: sizes are those of the skin above, where the device presses."""

    def wanted(x: FloatArray, angle: FloatArray) -> FloatArray:
        """Edge lengths (n,) [m] there, shorter on a narrow core and beside bones."""
        under = tube.place(x, angle, tube.thickness)
        arc = widest * np.linalg.norm(under[:, 1:], axis=1)
        gap = (_from_bones(tube, under) - _radii(tube)).min(axis=1)
        return np.asarray(np.minimum.reduce([size(under), arc, _PER_GAP * gap]))

    return spread(
        Chart.of_skin(tube),
        wanted,
        circles=_on_skin(tube, layout.contacts),
        radius=layout.radius,
        fixed=_on_skin(tube, layout.points),
    )


def _on_skin(tube: Tube, xy: FloatArray) -> Place | None:
    if not len(xy):
        return None
    skin, _ = tube.volar(xy)
    return xy[:, 0], tube.angle_of(skin)


def _bone_wall(tube: Tube, bone: BoneAxis, size: Size3, facet: float) -> FloatArray:
    """Points (n, 3) on a bone's wall, closer together where the limb's wall or another bone is near."""
    narrow, wide = (min(factor * facet, _BONE_WIDEST) * bone.radius for factor in (1.0, _BONE_FACET))
    others = [k for k, each in enumerate(tube.bones) if each is not bone]

    def place(x: FloatArray, angle: FloatArray) -> FloatArray:
        """Points (n, 3) of the bone's wall."""
        ring = bone.radius * np.column_stack([np.sin(angle), np.cos(angle)])
        return np.column_stack([x, tube.bone_centre(bone, x) + ring])

    def wanted(x: FloatArray, angle: FloatArray) -> FloatArray:
        """Edge lengths (n,) [m] there, shorter where the wall or another bone is near."""
        at = place(x, angle)
        gaps = np.column_stack([_below(tube, at), (_from_bones(tube, at) - _radii(tube))[:, others]])
        arc = np.clip(_BONE_SHARE * size(at), narrow, wide)
        return np.asarray(np.minimum(arc, _PER_GAP * gaps.min(axis=1)))

    return place(*spread(Chart.of_bone(tube, bone), wanted))


def _below(tube: Tube, points: FloatArray) -> FloatArray:
    """Depth (n,) [m] of points (n, 3) below the core's wall, negative outside."""
    skin = tube.place(points[:, 0], tube.angle_of(points), 0.0)
    inward = skin[:, 1:] - points[:, 1:]
    sign = np.sign((skin[:, 1:] * inward).sum(axis=1))
    return np.asarray(sign * np.linalg.norm(inward, axis=1) - tube.thickness)


def _inside(tube: Tube, points: FloatArray, gap: FloatArray) -> BoolArray:
    """Points (n, 3) in the muscle and at least ``gap`` (n,) from its walls, bones and ends."""
    clear = (np.abs(points[:, 0]) < tube.length / 2 - gap) & (_below(tube, points) > gap)
    return np.asarray(clear & (_from_bones(tube, points) > _radii(tube) + gap[:, None]).all(axis=1))


def _end(tube: Tube, wall: FloatArray, side: int) -> FloatArray:
    """Points (n, 3) of a triangular grid on a cut end, as far apart as the wall's points around it."""
    rim = wall[wall[:, 0] == side * tube.length / 2]
    h = float(np.median(np.linalg.norm(rim - np.roll(rim, 1, axis=0), axis=1)))
    reach = float(np.abs(rim[:, 1:]).max())
    rows = np.arange(-reach, reach, h)
    grid = np.stack(np.meshgrid(rows, rows * np.sqrt(3) / 2 * 1.2), axis=-1)
    grid[1::2, :, 0] += h / 2
    plane = np.column_stack([np.full(rows.size**2, side * tube.length / 2), grid.reshape(-1, 2)])
    clear = _below(tube, plane) > _INSET * h
    clear &= (_from_bones(tube, plane) > _radii(tube) + _INSET * h).all(axis=1)
    return np.asarray(plane[clear])


def _which(corners_on: BoolArray) -> IntArray:
    """The first surface (m,) that all corners of a cell lie on, from flags (m, n_corner, n_surface); -1 for none."""
    whole = np.asarray(corners_on.all(axis=1))
    return np.asarray(
        np.where(whole.any(axis=1), whole.argmax(axis=1), -1) if whole.shape[1] else np.full(len(whole), -1)
    )


def _check_tubes(walls: list[IntArray]) -> None:
    """Raise :class:`MeshError` unless each set of faces (m, 3) is one unbroken tube: V - E + F = 0."""
    for faces in walls:
        if not len(faces) or len(np.unique(faces)) - len(edges_of(faces, SIDES)) + len(faces) != 0:
            raise MeshError(
                "points on the limb's wall or on a bone are too far apart to be joined; set mesh.size_far smaller, or "
                "leave more muscle between bones and wall"
            )


def _from_bones(tube: Tube, points: FloatArray) -> FloatArray:
    """Distance (n, n_bone) [m] from each bone's axis within the section."""
    away = [np.linalg.norm(points[:, 1:] - tube.bone_centre(b, points[:, 0]), axis=1) for b in tube.bones]
    return np.column_stack(away) if away else np.full((len(points), 1), np.inf)


def _radii(tube: Tube) -> FloatArray:
    return np.array([b.radius for b in tube.bones] or [0.0])


# Forearm and cylinder: prism layers of exact thickness grown outwards from the core.

_COARSE = 2.0  # where columns are further apart than this many sizes between the ports, layers are not divided


def limb_mesh(
    tube: Tube, size: Size3, sizes: Sizes, layout: Layout, *, elastic_bones: bool, seed: int = 1
) -> TissueMesh:
    """Core, and on it layers of prisms cut into tetrahedra; contacts are imprinted afterwards.

    Away from the device each tissue layer is one prism thick: there the levels inside a layer fall together.
    """
    core = core_mesh(tube, size, sizes, layout, elastic=elastic_bones, seed=seed)
    depths, tissues = _depths(tube, sizes)
    column = np.unique(core.lateral)
    points = [core.points]
    levels = np.zeros((len(depths), len(core.points)), dtype=np.int64)
    levels[0] = np.arange(len(core.points))
    for k, depth in enumerate(depths[1:], start=1):
        levels[k, column] = len(core.points) + (k - 1) * len(column) + np.arange(len(column))
        points.append(tube.place(core.points[column, 0], core.angle[column], depth))
    coarse = column[size(core.points[column]) > _COARSE * sizes.grid]
    merged = levels.copy()
    for k in range(1, len(tissues)):
        if tissues[k] == tissues[k - 1]:  # the level between two sublayers falls onto the layer's lower face
            merged[k, coarse] = merged[k - 1, coarse]
    stacked, under = stack_prisms(core.lateral, merged)
    inner = ["bone" if b >= 0 else tube.core for b in core.bone]
    names = tuple(dict.fromkeys([*(each.tissue for each in tube.layers), tube.core, *inner]))
    region = np.array([names.index(t) for t in [*inner, *(tissues[u] for u in under)]])
    places = np.vstack(points)
    on_skin, on_bone = np.zeros((2, len(places)), dtype=bool)
    on_skin[levels[-1, column]] = True
    on_bone[: len(core.points)] = core.on_bone
    used, renumbered = np.unique(oriented(places, np.vstack([core.tetrahedra, stacked])), return_inverse=True)
    places, tetrahedra = places[used], renumbered.reshape(-1, 4)
    return TissueMesh(places, tetrahedra, region, names, boundaries(places, tetrahedra, on_skin[used], on_bone[used]))


def _depths(tube: Tube, sizes: Sizes) -> tuple[FloatArray, list[str]]:
    """Depths (k + 1,) from the core's surface up to the skin, and the tissue between each pair of them."""
    depths, tissues, depth = [tube.thickness], [], tube.thickness
    for layer, count in reversed(list(zip(tube.layers, sizes.sublayers, strict=True))):
        depths += [depth - layer.thickness * (i + 1) / count for i in range(count)]
        tissues += [layer.tissue] * count
        depth = depths[-1]
    depths[-1] = 0.0 if tissues else depths[-1]
    return np.array(depths), tissues


def boundaries(points: FloatArray, tetrahedra: IntArray, on_skin: BoolArray, on_bone: BoolArray) -> dict[str, IntArray]:
    """Skin, underside, bone and end from flags per vertex (n_point,); ends are what remains."""
    faces, _ = boundary_faces(tetrahedra)
    skin = on_skin[faces].all(axis=1)
    bone = ~skin & on_bone[faces].all(axis=1) & (np.ptp(points[faces, 0], axis=1) > 0)
    named = {"skin": faces[skin], "bone": faces[bone], "end": faces[~skin & ~bone]}
    named["underside"] = underside(points, named["skin"])
    return {name: each for name, each in named.items() if len(each)}


def underside(points: FloatArray, skin: IntArray) -> IntArray:
    """Skin triangles whose outward normal points down, n_z < :data:`DOWN`: they may be held."""
    normal = triangle_normals(points, skin)
    return np.asarray(skin[normal[:, 2] < DOWN * np.linalg.norm(normal, axis=1)])
