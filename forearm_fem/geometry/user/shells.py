"""Whether somebody else's triangles close around a volume; what is wrong is named by number and place."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import GeometryError
from ...typing import FloatArray, IntArray
from ..mesh.topology import SIDES, keys, pieces

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
