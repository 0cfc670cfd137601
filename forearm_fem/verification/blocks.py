"""Structured blocks and spherical shells of tetrahedra for verification."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..geometry.limb.filling import oriented, stack_prisms
from ..geometry.mesh.tissue_mesh import EDGES, Bends, TissueMesh, boundary_faces
from ..typing import FloatArray, IntArray


def block_mesh(
    counts: Sequence[int],
    size: Sequence[float],
    *,
    facets: Mapping[str, Sequence[str]],
    regions: Sequence[str] = ("block",),
    bend: float = 0.0,
) -> TissueMesh:
    """Box [0, size] cut into ``counts`` cells per axis, six tetrahedra each.

    ``facets`` names boundaries as unions of :data:`FACES`; "skin" defaults to "z1". Several ``regions`` divide the
    box into equal slices along x. ``bend`` moves inner nodes smoothly (0.1 = a tenth of the box), so that
    tetrahedra are not all alike.
    """
    x, y, z = (np.linspace(0, 1, n + 1) for n in counts)
    xy = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    low = np.arange((len(x) - 1) * len(y)).reshape(len(x) - 1, len(y))[:, :-1].ravel()
    triangles = np.vstack(
        [np.column_stack([low, low + 1, low + len(y) + 1]), np.column_stack([low, low + len(y), low + len(y) + 1])]
    )
    levels = np.arange(len(xy)) + len(xy) * np.arange(len(z))[:, None]
    unit = np.column_stack([np.tile(xy, (len(z), 1)), np.repeat(z, len(xy))])
    tetrahedra = stack_prisms(triangles, levels)[0]  # not yet oriented
    region = np.minimum((unit[tetrahedra].mean(axis=1)[:, 0] * len(regions)).astype(int), len(regions) - 1)
    faces, _ = boundary_faces(oriented(unit, tetrahedra))
    named, corner = {}, unit[faces]
    for name, sides in {"skin": ("z1",), **facets}.items():
        chosen = np.zeros(len(faces), dtype=bool)
        for side in sides:
            chosen |= (corner[:, :, "xyz".index(side[0])] == float(side[1])).all(axis=1)
        named[name] = faces[chosen]
    bump = bend * np.prod(np.sin(np.pi * unit), axis=1)[:, None]  # smooth, and nothing on the boundary
    points = (unit + bump * np.array([1.0, -0.7, 0.5])) * np.asarray(size)
    return TissueMesh(points, oriented(points, tetrahedra), region, tuple(regions), named)


def shell_mesh(radii: FloatArray, splits: int, *, curved: bool = False) -> TissueMesh:
    """Quarter (x, y > 0) of the space between spheres: "contact A1" inside, "end" outside, symmetry planes.

    ``radii`` (k,) [m] are the radial levels; each of the two octahedron faces is split ``splits`` times per edge. The
    vertices lie on the spheres; unless edges are ``curved`` slightly outwards, so that the polyhedron has the sphere's
    volume.
    """
    directions, triangles = _quarter_sphere(splits)
    volume = np.abs(np.linalg.det(directions[triangles])).sum() / 6  # pi / 3 of a quarter ball
    unit = directions * (1.0 if curved else float((np.pi / 3 / volume) ** (1 / 3)))
    levels = np.arange(len(unit)) + len(unit) * np.arange(len(radii))[:, None]
    points = (np.asarray(radii)[:, None, None] * unit).reshape(-1, 3)
    tetrahedra = oriented(points, stack_prisms(triangles, levels)[0])
    faces, _ = boundary_faces(tetrahedra)
    corner = points[faces]
    depth = faces // len(unit)
    planes = {f"symmetry {'xy'[i]}": faces[(corner[:, :, i] == 0).all(axis=1)] for i in range(2)}
    inner, outer = faces[(depth == 0).all(axis=1)], faces[(depth == len(radii) - 1).all(axis=1)]
    facets = {**planes, "contact A1": inner, "end": outer, "skin": inner}
    bends = _around_origin(points, tetrahedra) if curved else Bends()
    return TissueMesh(points, tetrahedra, np.zeros(len(tetrahedra), dtype=int), ("block",), facets, bends)


def _around_origin(points: FloatArray, tetrahedra: IntArray) -> Bends:
    """Bends that put the middle of each edge as far from the origin as its ends are on average."""
    edges = np.unique(np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1), axis=0)
    chord = points[edges].mean(axis=1)
    away = np.linalg.norm(points[edges], axis=2).mean(axis=1)
    return Bends(edges, chord * (away / np.linalg.norm(chord, axis=1) - 1)[:, None])


def _quarter_sphere(splits: int) -> tuple[FloatArray, IntArray]:
    """Unit directions (n, 3) and triangles of the quarter sphere x, y >= 0."""
    points: dict[tuple[int, int, int], int] = {}
    triangles = []
    for sign in (1, -1):
        for i in range(splits):
            for j in range(splits - i):
                cells = [((i, j), (i + 1, j), (i, j + 1))]
                if i + j < splits - 1:
                    cells.append(((i + 1, j), (i + 1, j + 1), (i, j + 1)))
                for cell in cells:
                    keys = [(a, b, sign * (splits - a - b)) for a, b in cell]
                    triangles.append([points.setdefault(k, len(points)) for k in keys])
    lattice = np.array(list(points), dtype=float)
    return lattice / np.linalg.norm(lattice, axis=1)[:, None], np.array(triangles)
