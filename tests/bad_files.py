"""The wrong surfaces and meshes of :mod:`bad_inputs`, each a function that writes them into a folder."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import trimesh


def box(folder: Path, name: str, size: Iterable[float], *, at: Iterable[float] = (0, 0, 0), change: Any = None) -> None:
    body = trimesh.creation.box(extents=list(size))
    body = body.subdivide().subdivide()
    body.apply_translation(list(at))
    if change is not None:
        change(body)
    body.export(folder / name)


def good_outer(folder: Path) -> None:
    box(folder, "skin.stl", (0.12, 0.06, 0.05))


def open_surface(folder: Path) -> None:
    def cut(body: Any) -> None:
        body.update_faces(np.arange(len(body.faces)) > 3)

    box(folder, "skin.stl", (0.12, 0.06, 0.05), change=cut)
    box(folder, "muscle.stl", (0.12, 0.04, 0.03))


def some_inverted(folder: Path) -> None:
    def turn(body: Any) -> None:
        body.faces[::3] = body.faces[::3, ::-1]

    box(folder, "skin.stl", (0.12, 0.06, 0.05), change=turn)
    box(folder, "muscle.stl", (0.12, 0.04, 0.03))


def crossing(folder: Path) -> None:
    good_outer(folder)
    box(folder, "muscle.stl", (0.12, 0.04, 0.03), at=(0, 0.021, 0))


def separate(folder: Path) -> None:
    good_outer(folder)
    box(folder, "muscle.stl", (0.1, 0.04, 0.03), at=(0, 0.2, 0))


def missing_surface(folder: Path) -> None:
    good_outer(folder)


def text_surface(folder: Path) -> None:
    good_outer(folder)
    (folder / "muscle.stl").write_text("these are not triangles\n")


def self_crossing(folder: Path) -> None:
    def fold(body: Any) -> None:
        top = np.flatnonzero(np.isclose(body.vertices[:, 2], 0.025) & (np.abs(body.vertices[:, 0]) < 0.01))
        body.vertices[top, 2] = -0.04

    box(folder, "skin.stl", (0.12, 0.06, 0.05), change=fold)
    box(folder, "muscle.stl", (0.12, 0.04, 0.01), at=(0, 0, -0.01))


def millimetre_surfaces(folder: Path) -> None:
    box(folder, "skin.stl", (120, 60, 50))
    box(folder, "muscle.stl", (120, 40, 30))


def block() -> tuple[Any, Any]:
    """Points and tetrahedra (six per cell) of a block 80 x 80 x 20 mm with its top at z = 0."""
    n = (9, 9, 3)
    x, y, z = np.meshgrid(
        np.linspace(-0.04, 0.04, 9), np.linspace(-0.04, 0.04, 9), np.linspace(-0.02, 0, 3), indexing="ij"
    )
    index = np.arange(np.prod(n)).reshape(n)
    corner = [
        index[i : n[0] - 1 + i, j : n[1] - 1 + j, k : n[2] - 1 + k].ravel()
        for i in (0, 1)
        for j in (0, 1)
        for k in (0, 1)
    ]
    paths = ((0, 1, 3, 7), (0, 1, 5, 7), (0, 2, 3, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 4, 6, 7))
    cells = np.vstack([np.column_stack([corner[c] for c in path]) for path in paths])
    return np.column_stack([x.ravel(), y.ravel(), z.ravel()]), cells


CORNERS, TETRA = block()


def mesh(cells: Any = (("tetra", TETRA),), points: Any = CORNERS, label: int | None = 1) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        data = {} if label is None else {"region": [np.full(len(c), label) for _, c in cells]}
        meshio.Mesh(points, list(cells), cell_data=data).write(folder / "limb.vtu")

    return write


def damaged_mesh(folder: Path) -> None:
    mesh()(folder)
    whole = (folder / "limb.vtu").read_bytes()
    (folder / "limb.vtu").write_bytes(whole[: len(whole) // 2])


def flat_tetrahedron(folder: Path) -> None:
    flat = np.vstack([CORNERS, [[-0.039, -0.039, -0.0200001], [-0.038, -0.039, -0.02], [-0.039, -0.038, -0.02]]])
    extra = np.array([[0, len(flat) - 3, len(flat) - 2, len(flat) - 1]])
    mesh((("tetra", np.vstack([TETRA, extra])),), flat)(folder)


def wavelet_of_text(folder: Path) -> None:
    (folder / "wave.csv").write_text("hello\nworld\n")


TRIANGLE = (("triangle", np.array([[0, 1, 2]])),)
HEXAHEDRON = (("hexahedron", np.arange(8)[None]),)
CUBE = np.array([[x, y, z] for z in (0.0, 0.1) for x, y in ((0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1))])
NAN = np.where(np.arange(len(CORNERS))[:, None] == 40, np.nan, CORNERS)
