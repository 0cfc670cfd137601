"""Meshes as files: .vtu for ParaView and for ourselves, .msh for gmsh; both read back exactly."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ...errors import MeshError
from ...store.folder import atomic_path
from ...typing import IntArray
from .abaqus import read_inp
from .tissue_mesh import TissueMesh

_REGION, _BOUNDARY = "region {} {}", "boundary {}"


def write_mesh(mesh: TissueMesh, path: str | Path) -> None:
    """Write ``mesh`` to ``path`` (.vtu or .msh), all at once or not at all.

    In a .vtu, cell data "region" numbers the tissues, "region <i> <tissue>" and "boundary <name>" mark cells;
    in a .msh (gmsh 2.2, binary) tissues and boundaries ("boundary <name>") are physical groups.
    """
    file = Path(path)
    writer = _by_ending(file, {".vtu": _write_vtu, ".msh": _write_msh})
    with atomic_path(file) as beside:
        writer(mesh, str(beside))


def read_mesh(path: str | Path) -> TissueMesh:
    """A mesh written by :func:`write_mesh`, bit for bit, facets and their order included."""
    file = Path(path)
    reader = _by_ending(file, {".vtu": _from_vtu, ".msh": _from_msh})
    if not file.is_file():
        raise MeshError(f"{file}: no such mesh file; expected one written by write_mesh")
    try:
        mesh: TissueMesh = reader(read_quietly(file))
        return mesh
    except (KeyError, IndexError, ValueError) as problem:
        raise MeshError(f"{file}: not a mesh written by this program ({problem}); rebuild it") from None


def read_quietly(file: Path) -> Any:
    """meshio's mesh; anything it cannot make sense of becomes a :class:`MeshError`."""
    try:
        with warnings.catch_warnings(), redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            warnings.simplefilter("ignore")
            return read_inp(file) if file.suffix.lower() == ".inp" else meshio.read(file)
    except MeshError:
        raise
    except SystemExit:  # meshio prints and ends the program on damaged files and unknown formats
        raise MeshError(
            f"{file}: cannot be read as a mesh, it is damaged or of a format that meshio does not know; "
            "use .msh, .vtu or .inp"
        ) from None
    except Exception as problem:
        if half := re.search("Incompatible cell data '([^']*)'", str(problem)):
            raise MeshError(
                f"{file}: only some of its blocks of cells have a '{half[1]}'; give every volume one (in gmsh, a "
                "physical group)"
            ) from None
        said = f"{type(problem).__name__}: {problem}"[:100]
        raise MeshError(
            f"{file}: cannot be read as a mesh ({said}); it is damaged or odd: export it as .vtu, .msh or .inp"
        ) from None


def _by_ending(file: Path, known: dict[str, Callable[..., Any]]) -> Callable[..., Any]:
    if file.suffix not in known:
        raise MeshError(f"{file}: meshes are kept as {' or '.join(known)}, not '{file.suffix}'; rename it")
    return known[file.suffix]


def _cells(mesh: TissueMesh) -> list[tuple[str, IntArray]]:
    triangles = [np.asarray(f, dtype=np.int64) for f in mesh.facets.values()]
    return [("tetra", np.asarray(mesh.tetrahedra, dtype=np.int64)), ("triangle", np.vstack(triangles))]


def _write_vtu(mesh: TissueMesh, path: str) -> None:
    owner = np.repeat(np.arange(len(mesh.facets)), [len(f) for f in mesh.facets.values()])
    n = len(mesh.tetrahedra)
    data = {"region": [mesh.region.astype(np.int32), np.full(len(owner), -1, dtype=np.int32)]}
    for i, name in enumerate(mesh.region_names):
        data[_REGION.format(i, name)] = [(mesh.region == i).astype(np.int8), np.zeros(len(owner), np.int8)]
    for i, name in enumerate(mesh.facets):
        data[_BOUNDARY.format(name)] = [np.zeros(n, np.int8), (owner == i).astype(np.int8)]
    whole = meshio.Mesh(mesh.points, _cells(mesh), cell_data=data)
    meshio.write(path, whole, file_format="vtu", compression="lzma")


def _from_vtu(read: Any) -> TissueMesh:
    kinds = [c.type for c in read.cells]
    tetra, triangle = kinds.index("tetra"), kinds.index("triangle")
    region = np.asarray(read.cell_data["region"][tetra], dtype=np.int64)
    matches = [re.fullmatch(r"region (\d+) (.+)", name) for name in read.cell_data]
    names = tuple(m[2] for m in sorted((m for m in matches if m), key=lambda m: int(m[1])))
    triangles = np.asarray(read.cells[triangle].data, dtype=np.int64)
    facets = {
        name.removeprefix("boundary "): triangles[np.asarray(flag[triangle]) == 1]
        for name, flag in read.cell_data.items()
        if name.startswith("boundary ")
    }
    return TissueMesh(
        np.asarray(read.points, float), np.asarray(read.cells[tetra].data, np.int64), region, names, facets
    )


def _write_msh(mesh: TissueMesh, path: str) -> None:
    first = len(mesh.region_names) + 1
    owner = first + np.repeat(np.arange(len(mesh.facets)), [len(f) for f in mesh.facets.values()])
    tags = [mesh.region + 1, owner]
    data = {
        "gmsh:physical": [t.astype(np.int32) for t in tags],
        "gmsh:geometrical": [t.astype(np.int32) for t in tags],
    }
    groups = {name: np.array([i + 1, 3]) for i, name in enumerate(mesh.region_names)}
    groups |= {_BOUNDARY.format(name): np.array([first + i, 2]) for i, name in enumerate(mesh.facets)}
    whole = meshio.Mesh(mesh.points, _cells(mesh), cell_data=data, field_data=groups)
    meshio.write(path, whole, file_format="gmsh22", binary=True)


def _from_msh(read: Any) -> TissueMesh:
    kinds = [c.type for c in read.cells]
    groups = sorted((int(tag), int(dim), name) for name, (tag, dim) in read.field_data.items())
    names = tuple(name for _, dim, name in groups if dim == 3)
    tags = read.cell_data["gmsh:physical"]
    tetra = [i for i, kind in enumerate(kinds) if kind == "tetra"]
    flat = [i for i, kind in enumerate(kinds) if kind == "triangle"]
    triangles = np.vstack([read.cells[i].data for i in flat]).astype(np.int64)
    owner = np.concatenate([tags[i] for i in flat])
    facets = {name.removeprefix("boundary "): triangles[owner == tag] for tag, dim, name in groups if dim == 2}
    tetrahedra = np.vstack([read.cells[i].data for i in tetra]).astype(np.int64)
    region = np.concatenate([tags[i] for i in tetra]).astype(np.int64) - 1
    return TissueMesh(np.asarray(read.points, float), tetrahedra, region, names, facets)
