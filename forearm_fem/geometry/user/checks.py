"""Checks of users' surfaces and meshes: crossing, extent, direction, boundary."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import GeometryError, MeshError
from ...typing import BoolArray, FloatArray, IntArray
from ..device.layout import Layout
from ..limb.core import underside
from ..mesh.tissue_mesh import (
    SIDES,
    TissueMesh,
    boundary_faces,
    edge_lengths,
    is_member,
    meeting,
    pieces,
    triangle_normals,
)

# Tissues of the user's own limb under the device and on the far side: files stand upside down.

_UPRIGHT = 1e-30  # m^2: twice the area of a face seen from above
_SLACK = 1e-9  # a place on an edge of the faces is over both
_FROM_OUTSIDE = ("skin", "fat", "muscle", "bone")


def turned_over(mesh: TissueMesh, places: FloatArray) -> str:
    """A sentence where under most of ``places`` (n, 2) [m], seen from above, lies a deeper tissue than on the far side;
    empty where not, and where tissues are none of those whose order is known."""
    faces, owner = boundary_faces(mesh.tetrahedra)
    pairs = [pair for place in places if (pair := _met(mesh, faces, owner, place)) is not None]
    deeper = [(a, b) for a, b in pairs if _depth(a) > _depth(b) >= 0]
    if 2 * len(deeper) <= len(pairs):
        return ""
    above, below = deeper[0]
    return (
        f"limb: the device presses on {above}, and {below} lies on the far side, as where a file is upside down; turn "
        "it so that +z points out of the volar skin, unless that is meant"
    )


def _depth(tissue: str) -> int:
    return _FROM_OUTSIDE.index(tissue) if tissue in _FROM_OUTSIDE else -1


def _met(mesh: TissueMesh, faces: IntArray, owner: IntArray, place: FloatArray) -> tuple[str, str] | None:
    """Tissues of the ``owner`` cells of the uppermost and the lowest of the boundary ``faces`` over ``place`` (2,)."""
    a, b, c = mesh.points[faces].transpose(1, 0, 2)
    u, v, w = (b - a)[:, :2], (c - a)[:, :2], place - a[:, :2]
    twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    twice = np.where(np.abs(twice) < _UPRIGHT, np.nan, twice)
    s, r = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / twice, (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / twice
    hit = np.flatnonzero((s > -_SLACK) & (r > -_SLACK) & (s + r < 1 + _SLACK))
    if not len(hit):
        return None
    height = (a + s[:, None] * (b - a) + r[:, None] * (c - a))[hit, 2]
    top, bottom = (mesh.region_names[mesh.region[owner[hit[k]]]] for k in (height.argmax(), height.argmin()))
    return top, bottom


# Do triangles cross? Edges of one against faces of the other, for pairs that are near.

_INSIDE = 1e-7  # touching in a corner, an edge or a plane is not crossing


def crossing_faces(first: FloatArray, second: FloatArray | None, faces: IntArray | None) -> IntArray:
    """Pairs (k, 2) of triangles (n, 3, 3) of ``first`` and (m, 3, 3) of ``second`` that cross, by their numbers.

    Without ``second``, ``first`` is tested against itself; pairs that share a vertex (``faces``) do not count.
    """
    other = first if second is None else second
    a, b = meeting(*_ball(first), *_ball(other))
    low = np.maximum(first.min(axis=1)[a], other.min(axis=1)[b])
    boxes_meet = (low <= np.minimum(first.max(axis=1)[a], other.max(axis=1)[b])).all(axis=1)
    a, b = a[boxes_meet], b[boxes_meet]
    if second is None:
        assert faces is not None
        once = a < b
        a, b = a[once], b[once]
        apart = (faces[a][:, :, None] != faces[b][:, None, :]).all(axis=(1, 2))
        a, b = a[apart], b[apart]
    crosses = np.zeros(len(a), dtype=bool)
    for edge in ((0, 1), (1, 2), (2, 0)):
        crosses |= _pierces(first[a][:, edge], other[b]) | _pierces(other[b][:, edge], first[a])
    return np.column_stack([a[crosses], b[crosses]])


def _ball(triangles: FloatArray) -> tuple[FloatArray, FloatArray]:
    centre = triangles.mean(axis=1)
    return centre, np.asarray(np.linalg.norm(triangles - centre[:, None], axis=2).max(axis=1))


def _pierces(edge: FloatArray, triangle: FloatArray) -> BoolArray:
    """True where edges (k, 2, 3) pass strictly through triangles (k, 3, 3) (Moeller and Trumbore)."""
    start, along = edge[:, 0], edge[:, 1] - edge[:, 0]
    u, v = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    p = np.cross(along, v)
    det = np.einsum("ij,ij->i", u, p)
    scale = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) * np.linalg.norm(along, axis=1)
    flat = np.abs(det) < 1e-9 * scale
    inverse = 1 / np.where(flat, 1.0, det)
    away = start - triangle[:, 0]
    q = np.cross(away, u)
    s, r = np.einsum("ij,ij->i", away, p) * inverse, np.einsum("ij,ij->i", along, q) * inverse
    t = np.einsum("ij,ij->i", v, q) * inverse
    inside = (s > _INSIDE) & (r > _INSIDE) & (s + r < 1 - _INSIDE) & (t > _INSIDE) & (t < 1 - _INSIDE)
    return np.asarray(inside & ~flat)


# Sizes and places of a user's geometry that no limb has: almost always a wrong unit, and a mesher that never ends.

_LEAST, _MOST = 1e-3, 2.0  # m: a thin bone, a whole leg
_FLAT = 1e-4  # m: thinner than any bone
_UNITS = ((1.0, "metres"), (0.01, "centimetres"), (0.001, "millimetres"), (0.0254, "inches"))


def check_extent(file: Path, points: FloatArray, unit: float = 1.0) -> None:
    """Raise :class:`GeometryError` where ``points`` (n, 3) [m] are not finite, span no limb's size, or are flat.

    ``unit`` [m] is the file's, for the advice.
    """
    if not np.isfinite(points).all():
        bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
        raise GeometryError(f"{file}: {len(bad)} points are not finite, the first is vertex {bad[0]}; repair the file")
    spans = np.ptp(points, axis=0)
    longest = float(spans.max())
    if not _LEAST <= longest <= _MOST:
        sizes = [(u, name, u * (longest / unit)) for u, name in _UNITS]
        fitting = [f"{u:g} ({name}) makes it {size:.2g} m" for u, name, size in sizes if 0.02 <= size <= 1.0]
        raise GeometryError(
            f"{file}: is {longest:.3g} m long with limb.unit = {unit:g}, expected {_LEAST:g} to {_MOST:g} m; set "
            f"limb.unit, the metres per unit of the file{': ' if fitting else ''}{', '.join(fitting)}"
        )
    if spans.min() < _FLAT:
        raise GeometryError(
            f"{file}: is flat, {spans.min() * 1e3:.3g} mm in {'xyz'[int(spans.argmin())]}; expected a body with a "
            "volume, its x along the limb"
        )


def check_room(file: Path, points: FloatArray, layout: Layout, unit: float) -> None:
    """Raise :class:`GeometryError` where the limb of ``points`` (n, 3) [m] cannot hold the device, seen from above."""
    low, high = (f(points[:, :2], axis=0) for f in (np.min, np.max))
    need_low = np.minimum((layout.contacts - layout.radius).min(axis=0), layout.points.min(axis=0, initial=np.inf))
    need_high = np.maximum((layout.contacts + layout.radius).max(axis=0), layout.points.max(axis=0, initial=-np.inf))
    if ((low <= need_low) & (need_high <= high)).all():
        return
    limb, device = _spans(low, high), _spans(need_low, need_high)
    if (high - low < need_high - need_low).any():
        room = max(float(((need_high - need_low) / np.maximum(high - low, 1e-9)).max()), 1.0) * unit  # least that fits
        most = _MOST * unit / float(np.ptp(points, axis=0).max())
        larger = " or ".join(f"{u:g} ({name})" for u, name in _UNITS if room <= u <= most and u != unit)
        other = f", or should it be {larger}" if larger else ""
        tall, lacking = float(np.ptp(points[:, 2])), (high - low < need_high - need_low)
        if (tall >= (need_high - need_low)[lacking]).all():  # turned, it would have room
            other += f", or the file to be turned (z, out of the volar skin, spans {tall * 1e3:.0f} mm)"
        advice = f"is limb.unit = {unit:g} right{other}? else use a smaller device"
    else:
        advice = "move the limb so that the device's middle is over x = y = 0, the elbow towards +x"
    raise GeometryError(f"{file}: spans {limb}, the device needs {device}; {advice}")


def _spans(low: FloatArray, high: FloatArray) -> str:
    """Ranges in millimetres."""
    return " and ".join(f"{n} {a * 1e3:.0f} to {b * 1e3:.0f}" for n, a, b in zip("xy", low, high, strict=True)) + " mm"


# Naming the boundary of a limb that the user brought: skin, underside, ends, bones.

_ACROSS = 0.9  # cosine between a facet's normal and x from which on it lies across
_ROUGH, _PLANE = 1e-3, 1e-6  # of the limb's length: how far from plane a cut end may be, and one without an edge


def without_bone(mesh: TissueMesh) -> TissueMesh:
    """The mesh with the region "bone" taken out: its walls are the facets "bone", where what remains is held."""
    if "bone" not in mesh.region_names:
        return mesh
    number = mesh.region_names.index("bone")
    keep = mesh.region != number
    if not keep.any():
        raise MeshError("every region of the mesh is 'bone'; map at least one region to a soft tissue")
    left = boundary_faces(mesh.tetrahedra[keep])[0]
    wall = left[~is_member(left, boundary_faces(mesh.tetrahedra)[0], len(mesh.points))]
    used, renumbered = np.unique(mesh.tetrahedra[keep], return_inverse=True)
    region = mesh.region[keep]
    names = tuple(name for name in mesh.region_names if name != "bone")
    region = region - (region > number)
    facets = {"bone": np.searchsorted(used, wall)}
    return TissueMesh(mesh.points[used], renumbered.reshape(-1, 4), region, names, facets)


def with_boundaries(mesh: TissueMesh) -> TissueMesh:
    """The mesh with its boundary named, facets "bone" that it has among them.

    Ends are flat pieces across x at the extreme x; of what remains skin is the outermost, and other pieces enclose
    cavities that are held like bones.
    """
    faces, _ = boundary_faces(mesh.tetrahedra)
    wall = is_member(faces, mesh.facets.get("bone", np.zeros((0, 3), dtype=np.int64)), len(mesh.points))
    bones, faces = faces[wall], faces[~wall]
    end = _ends(mesh.points, faces)
    rest = faces[~end]
    if not len(rest):
        raise MeshError(
            "the mesh has no skin: all its boundary lies on its two ends in x; turn it so that x runs along it"
        )
    piece = pieces(len(mesh.points), rest[:, SIDES[:2]].reshape(-1, 2))[rest[:, 0]]
    numbers = np.unique(piece)
    extent = [np.linalg.norm(np.ptp(mesh.points[np.unique(rest[piece == k])], axis=0)) for k in numbers]
    outer = piece == numbers[int(np.argmax(extent))]
    named = {"skin": rest[outer], "bone": np.vstack([bones, rest[~outer]]), "end": faces[end]}
    named["underside"] = underside(mesh.points, named["skin"])
    return replace(mesh, facets={name: each for name, each in named.items() if len(each)})


def _ends(points: FloatArray, faces: IntArray) -> BoolArray:
    """Facets of the two cut ends: across x, within a thousandth of the limb's length of its extreme x.

    fTetWild keeps planes to that only. A rounded end goes on across x beyond it: of such only what is exactly plane is
    an end, and its pole is skin.
    """
    normal = triangle_normals(points, faces)
    across = np.abs(normal[:, 0]) > _ACROSS * np.linalg.norm(normal, axis=1)
    found = np.zeros(len(faces), dtype=bool)
    for beyond in (points[:, 0] - points[:, 0].min(), points[:, 0].max() - points[:, 0]):
        most = beyond[faces].max(axis=1) / beyond.max()
        piece = across & (most < _ROUGH)
        found |= piece if _cut_off(points, faces, piece, across) else across & (most < _PLANE)
    return found


def _cut_off(points: FloatArray, faces: IntArray, piece: BoolArray, across: BoolArray) -> bool:
    """True if most of the ``piece``'s rim, by length, is an edge where the surface turns away from x."""
    sides = np.sort(faces[:, SIDES].reshape(-1, 2), axis=1)
    of = np.repeat(np.arange(len(faces)), 3)
    edges, count = np.unique(sides[piece[of]], axis=0, return_counts=True)
    beside = ~piece[of] & is_member(sides, edges[count == 1], len(points))
    length = edge_lengths(points, sides[beside])
    return bool(length[~across[of[beside]]].sum() > 0.5 * length.sum())
