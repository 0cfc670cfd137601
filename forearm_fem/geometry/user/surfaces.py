"""Users' surfaces: reading, nesting, shells."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import AccuracyWarning, GeometryError
from ...progress import Progress, tell
from ...scenario.limb import SurfacesLimb
from ...typing import FloatArray, IntArray
from ..limb.core import Size3
from ..mesh.tissue_mesh import SIDES, TissueMesh, boundary_faces, keys, pieces
from .checks import check_extent, crossing_faces, with_boundaries, without_bone
from .triangles import read_triangles
from .volume import background_grid, cut_along, tetrahedralise

# Checks of a foreign surface: triangles close around a volume; faults are named by number and place.

_LEAST = 1e-12  # m^3


def check_vertices(file: Path, vertices: FloatArray, faces: IntArray) -> None:
    """Raise :class:`GeometryError` for ``vertices`` (n, 3) that are not finite, and ``faces`` (m, 3) beyond them."""
    if faces.min() < 0 or faces.max() >= len(vertices):
        at = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))[0])
        raise GeometryError(
            f"{file}: triangle {at} names a vertex that is not among the file's {len(vertices)}; export it again"
        )
    used = np.unique(faces)
    bad = used[~np.isfinite(vertices[used]).all(axis=1)]
    if len(bad):
        raise GeometryError(f"{file}: {len(bad)} vertices are not finite, the first is {bad[0]}; repair the file")


def closed(file: Path, tissue: str, vertices: FloatArray, faces: IntArray) -> IntArray:
    """Triangles (m, 3) with outward normals; those that shrank to an edge or a point are dropped.

    Bodies that are inside out are turned. Raises :class:`GeometryError` for triangles given twice, holes, edges with
    more than two triangles, triangles that face both ways, hollow bodies, and surfaces around nothing.
    """
    faces = faces[(faces[:, [0, 1, 2]] != faces[:, [1, 2, 0]]).all(axis=1)]
    if not len(faces):
        raise GeometryError(f"{file}: all triangles of '{tissue}' have shrunk to lines; is limb.unit right?")
    _, first, inverse = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_inverse=True)
    again = np.setdiff1d(np.arange(len(faces)), first)
    if len(again):
        raise GeometryError(
            f"{file}: {len(again)} triangles of '{tissue}' occur twice, the first is number {again[0]}, the same as "
            f"{first[inverse.ravel()[again[0]]]}; remove duplicate faces"
        )
    sides = faces[:, SIDES].reshape(-1, 2)
    _, inverse, often = np.unique(keys(sides, len(vertices)), return_inverse=True, return_counts=True)
    _check_sides(file, tissue, vertices, sides, often[inverse])
    order = np.argsort(inverse, kind="stable").reshape(-1, 2)
    opposite = sides[order[:, 0], 0] == sides[order[:, 1], 1]
    if not opposite.all():
        raise GeometryError(
            f"{file}: triangles of '{tissue}' face both ways along {int((~opposite).sum())} edges, the first at "
            f"{at_words(vertices[sides[order[~opposite][0, 0]]])}; make their winding consistent"
        )
    body = pieces(len(faces), order // 3)
    a, b, c = vertices[faces].transpose(1, 0, 2)
    volume = np.bincount(body, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6).astype(float)
    if np.abs(volume).sum() < _LEAST:
        raise GeometryError(
            f"{file}: the surface of '{tissue}' encloses no volume; check limb.unit (metres per file unit)"
        )
    _check_hollow(file, tissue, vertices, faces, body, volume)
    turned = (volume < 0)[body]
    return np.where(turned[:, None], faces[:, ::-1], faces)


def check_one_body(tissue: str, vertices: FloatArray, faces: IntArray) -> None:
    """Raise :class:`GeometryError` where the closed surface of the outermost tissue is several bodies."""
    order = np.argsort(keys(faces[:, SIDES].reshape(-1, 2), len(vertices)), kind="stable").reshape(-1, 2) // 3
    body = pieces(len(faces), order)
    if body.max():
        smallest = int(np.bincount(body).argmin())
        raise GeometryError(
            f"the surface of '{tissue}', the outermost, is {body.max() + 1} separate bodies, one of "
            f"{int((body == smallest).sum())} triangles at "
            f"{at_words(vertices[faces[body == smallest]].reshape(-1, 3))}; keep the limb only"
        )


def at_words(points: FloatArray) -> str:
    """The middle of ``points`` (n, 3) [m] in words."""
    x, y, z = np.round(points.mean(axis=0) * 1e3, 1) + 0.0  # no -0.0
    return f"({x:.1f}, {y:.1f}, {z:.1f}) mm"


def _check_sides(file: Path, tissue: str, vertices: FloatArray, sides: IntArray, often: IntArray) -> None:
    """Two triangles along every side."""
    if (open_ := np.flatnonzero(often == 1)).size:
        raise GeometryError(
            f"{file}: the surface of '{tissue}' is not closed (watertight): {len(open_)} open edges, the first at "
            f"{at_words(vertices[sides[open_[0]]])}; fill its holes"
        )
    if (many := np.flatnonzero(often > 2)).size:
        raise GeometryError(
            f"{file}: more than two triangles of '{tissue}' meet in an edge, the first at "
            f"{at_words(vertices[sides[many[0]]])}; remove inner walls, or separate bodies that touch"
        )


def _check_hollow(
    file: Path, tissue: str, vertices: FloatArray, faces: IntArray, body: IntArray, volume: FloatArray
) -> None:
    """No body lies within the box of another: what a cavity holds is a tissue, and has a surface of its own."""
    corner = [vertices[faces[body == k]].reshape(-1, 3) for k in range(len(volume))]
    low, high = np.array([c.min(axis=0) for c in corner]), np.array([c.max(axis=0) for c in corner])
    within = (low[:, None] >= low[None]).all(axis=2) & (high[:, None] <= high[None]).all(axis=2)
    inner = np.argwhere(within & ~np.eye(len(volume), dtype=bool) & (np.sign(volume)[:, None] != np.sign(volume)[None]))
    if len(inner):
        raise GeometryError(
            f"{file}: the surface of '{tissue}' has a cavity at {at_words(corner[inner[0, 0]])}; give what is inside "
            "as a surface and tissue of its own, or fill it"
        )


# The user's closed surfaces, one per tissue: read, checked, meshed, and cut into regions.

_REGULAR = 0.1179  # volume of a regular tetrahedron over its edge cubed
_THINNEST = 5e-5  # m: a layer that is nowhere thicker is a surface given twice
_SAME = 1e-9  # of the surface's size: vertices closer than this are one
_FEW, _FEW_SHARE = 12, 0.02  # crossing triangles, and their share of all, that are a slip and not a wrong surface
_PER_WIDTH = 0.25  # edge length over the smallest extent of an inner body


@dataclass(frozen=True)
class ClosedSurface:
    """A closed triangulated surface with outward normals; everything inside belongs to ``tissue`` or deeper ones."""

    tissue: str
    vertices: FloatArray
    faces: IntArray

    @cached_property
    def volume(self) -> float:
        """Enclosed volume [m^3]."""
        a, b, c = self.vertices[self.faces].transpose(1, 0, 2)
        return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)

    @cached_property
    def shell(self) -> Any:
        """The same surface for VTK."""
        import pyvista

        padded = np.column_stack([np.full(len(self.faces), 3), self.faces])
        return pyvista.PolyData(self.vertices, padded.ravel())

    def distance(self, points: FloatArray) -> FloatArray:
        """Signed distance (n,) [m] of ``points`` (n, 3), negative inside."""
        import pyvista

        cloud = pyvista.PolyData(np.ascontiguousarray(points))
        return np.asarray(cloud.compute_implicit_distance(self.shell)["implicit_distance"], dtype=float)

    def closest(self, points: FloatArray) -> FloatArray:
        """Closest points (n, 3) on the surface."""
        return np.asarray(self.shell.find_closest_cell(points, return_closest_point=True)[1], dtype=float)


def read_surfaces(limb: SurfacesLimb, base: Path) -> tuple[ClosedSurface, ...]:
    """Checked surfaces, the outermost first; raises :class:`GeometryError` naming the file or tissue at fault."""
    if not limb.surfaces:
        raise GeometryError("limb.surfaces is empty; give at least one closed surface, e.g. {skin = 'skin.stl'}")
    found = [_read(tissue, base / file, limb.unit) for tissue, file in limb.surfaces.items()]
    found.sort(key=lambda s: -s.volume)
    if found[0].tissue == "bone":
        raise GeometryError("the largest surface is the bone's; give the surface of the tissue around it too")
    check_one_body(found[0].tissue, found[0].vertices, found[0].faces)
    found = [_uncrossed(surface) for surface in found]
    for i, outer in enumerate(found):
        for inner in found[i + 1 :]:
            _check_nested(outer, inner)
    return tuple(found)


def _read(tissue: str, file: Path, unit: float) -> ClosedSurface:
    if not file.is_file():
        raise GeometryError(
            f"{file}: no such surface for '{tissue}'; limb.surfaces is relative to the scenario's folder"
        )
    vertices, faces = read_triangles(file)
    check_vertices(file, vertices, faces)
    used = np.unique(faces)
    vertices, faces = _merged(vertices[used], np.searchsorted(used, faces))
    vertices = vertices * unit
    check_extent(file, vertices, unit)
    return ClosedSurface(tissue, vertices, closed(file, tissue, vertices, faces))


def _uncrossed(surface: ClosedSurface) -> ClosedSurface:
    """``surface``, its few crossing triangles repaired by fTetWild, with a warning of how far that moved it.

    GeometryError for many, which are no slip of a segmentation.
    """
    pairs = crossing_faces(surface.vertices[surface.faces], None, surface.faces)
    if not len(pairs):
        return surface
    where = at_words(surface.vertices[surface.faces[pairs[0, 0]]])
    touched = len(np.unique(pairs))
    if touched > max(_FEW, _FEW_SHARE * len(surface.faces)):
        raise GeometryError(
            f"the surface of '{surface.tissue}' crosses itself in {len(pairs)} pairs of triangles, the first at "
            f"{where}; "
            "repair it"
        )
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    sides = surface.vertices[surface.faces][:, [0, 1, 2]] - surface.vertices[surface.faces][:, [1, 2, 0]]
    size = float(np.median(np.linalg.norm(sides, axis=2)))
    grid, cells = background_grid(low, high, float((high - low).max()) / 10)
    points, tetrahedra = tetrahedralise(surface.vertices, surface.faces, grid, cells, np.full(len(grid), size), size)
    rim = boundary_faces(tetrahedra)[0]
    used, faces = np.unique(rim, return_inverse=True)
    whole = closed(Path(surface.tissue), surface.tissue, points[used], np.asarray(faces.reshape(-1, 3), dtype=np.int64))
    made = ClosedSurface(surface.tissue, points[used], whole)
    off = surface.distance(made.vertices), made.distance(surface.vertices)
    moved = max(float(np.abs(d).max()) for d in off)
    warnings.warn(
        f"the surface of '{surface.tissue}' crossed itself in {len(pairs)} pairs of triangles, the first at {where}; "
        f"it was repaired, which moved it by {moved * 1e3:.2g} mm at most",
        AccuracyWarning, stacklevel=3,
    )  # fmt: skip
    return made


def _merged(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Vertices that coincide as one, where edges between textures or triangles of STL doubled them."""
    grid = max(float(np.ptp(vertices, axis=0).max()), 1e-300) * _SAME
    _, first, label = np.unique(np.round(vertices / grid), axis=0, return_index=True, return_inverse=True)
    return vertices[first], np.asarray(label.ravel()[faces], dtype=np.int64)


def _check_nested(outer: ClosedSurface, inner: ClosedSurface) -> None:
    pairs = crossing_faces(outer.vertices[outer.faces], inner.vertices[inner.faces], None)
    if len(pairs):
        raise GeometryError(
            f"the surfaces of '{outer.tissue}' and '{inner.tissue}' cross in {len(pairs)} pairs of triangles, the "
            f"first at {at_words(inner.vertices[inner.faces[pairs[0, 1]]])}; one must lie inside the other"
        )
    slack = 1e-6 * float(np.ptp(outer.vertices, axis=0).max())
    away = outer.distance(inner.vertices)
    both_bones = outer.tissue.startswith("bone") and inner.tissue.startswith("bone")
    if away.max() > slack and not (both_bones and away.min() > -slack):
        raise GeometryError(
            f"the surface of '{inner.tissue}' reaches {away.max() * 1e3:.3g} mm out of '{outer.tissue}'; "
            "each smaller surface must lie inside every larger one; several bones go into one file, limb.unit is of all"
        )
    depth = -float(outer.distance(inner.vertices[inner.faces].mean(axis=1)).min())
    if not both_bones and max(depth, -float(away.min())) < _THINNEST:
        raise GeometryError(
            f"the surfaces of '{outer.tissue}' and '{inner.tissue}' are the same to {_THINNEST * 1e3:g} mm, so "
            f"nothing is left for '{outer.tissue}'; give '{inner.tissue}' its own surface, or leave it out"
        )


def surfaces_mesh(
    surfaces: tuple[ClosedSurface, ...],
    size: Size3,
    far: float,
    most: float,
    progress: Progress | None,
    *,
    keep_bone: bool,
) -> TissueMesh:
    """Outermost surface by fTetWild, boundary moved onto it, regions cut along the inner surfaces.

    Interfaces are plane within elements: exact to h^2 / (8 R), see :func:`.levelset.cut_along`. Raises
    :class:`GeometryError` before the long work where ``size`` asks for more than ``most`` tetrahedra.
    """
    outer = surfaces[0]
    low, high = outer.vertices.min(axis=0), outer.vertices.max(axis=0)
    grid, cells = background_grid(low, high, float((high - low).max()) / 40)
    wanted = size(grid)
    for inner in surfaces[1:]:  # what resolves a slender inner body such as a bone, growing away from it
        width = float(np.ptp(inner.vertices, axis=0).min())
        wanted = np.minimum(wanted, _PER_WIDTH * width + 0.5 * np.abs(inner.distance(grid)))
    _check_count(outer, grid, wanted, most)
    points, tetrahedra = tetrahedralise(outer.vertices, outer.faces, grid, cells, wanted, far)
    mesh = _on_surface(
        TissueMesh(points, tetrahedra, np.zeros(len(tetrahedra), dtype=np.int64), (outer.tissue,), {}), outer
    )
    for inner in surfaces[1:]:
        tell(progress, f"cutting along the surface of {inner.tissue}", 0, 0)
        mesh, inside = cut_along(mesh, _stretched(inner, low[0], high[0]).distance, name=inner.tissue)
        if not inside.any():
            raise GeometryError(f"no element lies inside the surface of '{inner.tissue}'; set mesh.size_grid smaller")
        names = tuple(dict.fromkeys([*mesh.region_names, inner.tissue]))
        region = np.where(inside, names.index(inner.tissue), mesh.region)
        mesh = replace(mesh, region=region, region_names=names)
    mesh = mesh if keep_bone else without_bone(mesh)
    return with_boundaries(mesh)


def _check_count(outer: ClosedSurface, grid: FloatArray, wanted: FloatArray, most: float) -> None:
    """Refuse what would take hours: a limb in the wrong unit, or sizes meant for a smaller one."""
    inside = outer.distance(grid) < 0
    cell = float(np.ptp(outer.vertices, axis=0).max() / 40) ** 3
    count = float((cell / (_REGULAR * wanted[inside] ** 3)).sum())
    if count > most:
        raise GeometryError(
            f"a limb of {np.ptp(outer.vertices[:, 0]):.2g} m would need about {count:.2g} tetrahedra, "
            f"mesh.max_elements allows {most:.2g}; enlarge mesh.size_far and mesh.size_grid, or correct limb.unit"
        )


def _on_surface(mesh: TissueMesh, outer: ClosedSurface) -> TissueMesh:
    """Boundary vertices moved to the closest points of the surface where that flattens nothing."""
    rim = np.unique(boundary_faces(mesh.tetrahedra)[0])
    moved = mesh.points.copy()
    moved[rim] = outer.closest(mesh.points[rim])
    trial = replace(mesh, points=moved)
    bad = np.intersect1d(mesh.tetrahedra[trial.volumes < 0.2 * mesh.volumes], rim)
    moved[bad] = mesh.points[bad]
    return replace(mesh, points=moved)


def _stretched(inner: ClosedSurface, low: float, high: float) -> ClosedSurface:
    """Caps that coincide with the limb's cut ends pushed out, or distances there would be to the cap."""
    reach, length = 0.1 * (high - low), high - low
    x = inner.vertices[:, 0]
    moved = inner.vertices.copy()
    moved[:, 0] += reach * ((x > high - 1e-4 * length).astype(float) - (x < low + 1e-4 * length))
    return ClosedSurface(inner.tissue, moved, inner.faces)
