"""Meshes as files: .vtu for ParaView and for ourselves, .msh for gmsh; both read back exactly."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from types import MappingProxyType
from typing import Any

import meshio
import numpy as np

from ...errors import MeshError, MissingExtra
from ...store.folder import atomic_path
from ...store.text import stand_in
from ...typing import IntArray
from .abaqus import read_inp
from .formats import read_exodus, read_febio, read_nastran, read_unv, read_xdmf
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
    with file.open("rb") as stream:
        head = stream.read(1 << 16)
    if said := stand_in(head):
        raise MeshError(f"{file}: {said}")
    ending = file.suffix.lower()
    if other := _OTHERS.get(ending) or next((w for mark, w in _BEGINNINGS if head.lstrip().startswith(mark)), ""):
        raise MeshError(f"{file}: {other}")
    try:
        with warnings.catch_warnings(), redirect_stdout(StringIO()), redirect_stderr(StringIO()):
            warnings.simplefilter("ignore")
            return _by_kind(file, ending, head)
    except (MeshError, MissingExtra):
        raise
    except SystemExit:  # meshio prints and ends the program on damaged files and unknown formats
        raise MeshError(
            f"{file}: cannot be read as a mesh, it is cut short or of a format that meshio does not know; "
            "use .msh, .vtu or .inp"
        ) from None
    except Exception as problem:
        if half := re.search("Incompatible cell data '([^']*)'", str(problem)):
            raise MeshError(
                f"{file}: only some of its blocks of cells have a '{half[1]}'; give every volume one (in gmsh, a "
                "physical group)"
            ) from None
        if head.startswith(b"$MeshFormat") and head.split()[1].startswith((b"1", b"2.0")):
            raise MeshError(
                f"{file}: is of gmsh's format {head.split()[1].decode()}, whose names have no dimension; open it in "
                "gmsh and save it as version 4.1"
            ) from None
        said = f"{type(problem).__name__}: {problem}"[:100]
        raise MeshError(
            f"{file}: cannot be read as a mesh ({said}); it is cut short, or of a dialect that is not known: export it "
            "as .vtu, .msh or .inp"
        ) from None


_READERS: Mapping[str, Callable[[Path], Any]] = MappingProxyType(
    {
        ".bdf": read_nastran, ".nas": read_nastran, ".fem": read_nastran, ".unv": read_unv, ".feb": read_febio,
        ".xdmf": read_xdmf, ".xmf": read_xdmf, ".e": read_exodus, ".ex2": read_exodus, ".exo": read_exodus,
    }
)  # fmt: skip
_OTHERS: Mapping[str, str] = MappingProxyType(
    {
        ".stl": "is a surface, and limb.shape = 'mesh' is of tetrahedra; give surfaces with limb.shape = 'surfaces'",
        ".obj": "is a surface, and limb.shape = 'mesh' is of tetrahedra; give surfaces with limb.shape = 'surfaces'",
        ".step": "is a shape of CAD without a mesh; mesh it first, in gmsh for one",
        ".stp": "is a shape of CAD without a mesh; mesh it first, in gmsh for one",
        ".iges": "is a shape of CAD without a mesh; mesh it first, in gmsh for one",
        ".geo": "is gmsh's description of a shape, without a mesh; mesh it there and save .msh",
        ".cdb": "is of Ansys, which is not read; export Abaqus .inp, Nastran .bdf or .vtu",
        ".k": "is of LS-DYNA, which is not read; export Abaqus .inp, Nastran .bdf or .vtu",
        ".mphtxt": "is of COMSOL, which is not read; export Nastran .bdf there",
        ".mph": "is of COMSOL, which is not read; export Nastran .bdf there",
        ".odb": "holds results of Abaqus; give the .inp file",
        ".cgns": "is CGNS, which is not read; export .vtu or .msh",
    }
)
_BEGINNINGS = (
    (b"$NOD", "is of gmsh's version 1, of before 2007; save it again: gmsh old.msh -save -format msh2 -o new.msh"),
    (b"(0 ", "is a mesh of Ansys Fluent, which is not read; export Abaqus .inp, Nastran .bdf or .vtu"),
    (b"/COM,ANSYS", "is of Ansys, which is not read; export Abaqus .inp, Nastran .bdf or .vtu"),
    (b"PK\x03\x04", "is an archive; unpack it first"),
    (b"# COMSOL", "is of COMSOL, which is not read; export Nastran .bdf there"),
    (b"*KEYWORD", "is of LS-DYNA, which is not read; export Abaqus .inp, Nastran .bdf or .vtu"),
)


_TEXTS = (".inp", ".msh", ".txt", ".dat")
_EXODUS = (".e", ".g", ".gen", ".ex2", ".exo", ".exii", ".exodus")
_MARKS_OF_NETCDF = (b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF")
_AVS = re.compile(rb"\s*(#.*\n)*\s*\d+\s+\d+(\s+\d+){3}\s*\n")
_ABAQUS = re.compile(rb"\s*(\*\*.*\n)*\s*\*(NODE|HEADING|PART|INCLUDE|ELEMENT)\b", re.IGNORECASE)


def _by_kind(file: Path, ending: str, head: bytes) -> Any:
    """The mesh by the reader of its kind, told by how it begins where an ending is of several; VTK reads its own."""
    if ending in _TEXTS and _ABAQUS.match(head):
        return read_inp(file)
    if ending == ".inp" and (_AVS.match(head) or b"\0" in head[:64]):
        mesh = _vtk(file)
        mesh.cell_data = {k.replace("Material Id", "avsucd:material"): v for k, v in mesh.cell_data.items()}
        return mesh
    if ending == ".inp":
        return read_inp(file)
    if ending in _EXODUS and head.startswith(_MARKS_OF_NETCDF):
        return read_exodus(file)
    if ending in _READERS:
        return _READERS[ending](file)
    if ending == ".dat" and re.search(rb"^\s*(GRID|BEGIN\s+BULK)", head, re.MULTILINE | re.IGNORECASE):
        return read_nastran(file)
    if ending in (".vtk", ".vtu", ".pvtu"):
        return _vtk(file)
    if ending not in meshio.extension_to_filetypes:
        raise MeshError(
            f"{file}: '{ending}' is no kind of mesh that is known; export it as .vtu, .msh or .inp, in gmsh, ParaView "
            "or the program that made it"
        )
    return meshio.read(file)


def by_vtk(file: Path) -> Any:
    """Data set that VTK's own library reads from ``file``, of any version; its complaints are raised."""
    import pyvista  # half a second, which no run needs that reads no foreign mesh and draws nothing
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        with pyvista.VtkErrorCatcher(raise_errors=True, send_to_logging=False), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return pyvista.read(file)
    finally:
        vtkLogger.SetStderrVerbosity(before)


_OF_VTK: Mapping[int, str] = MappingProxyType({
    1: "vertex", 3: "line", 5: "triangle", 9: "quad", 10: "tetra", 12: "hexahedron", 13: "wedge", 14: "pyramid",
    21: "line3", 22: "triangle6", 23: "quad8", 24: "tetra10",
})  # fmt: skip
_FLAT_OF_VTK = frozenset({0, 2, 4, 6, 7, 8, 28, 30, 34, 35, 36, 51, 52, 53, 54, 60, 61, 62, 63, 68, 69, 70, 75, 76, 77})


def _vtk(file: Path) -> Any:
    """A mesh of VTK, or of AVS, which VTK reads, too; lines and surfaces of kinds without use are left out."""
    import pyvista

    grid = by_vtk(file)
    if isinstance(grid, pyvista.MultiBlock):
        raise MeshError(f"{file}: holds {grid.n_blocks} blocks; give one unstructured grid")
    if not isinstance(grid, pyvista.UnstructuredGrid):
        raise MeshError(f"{file}: holds a {type(grid).__name__}, expected an unstructured grid of tetrahedra")
    if not grid.n_cells:
        raise MeshError(f"{file}: holds no cells")
    kinds = np.unique(grid.celltypes).tolist()
    if others := [k for k in kinds if k not in _OF_VTK and k not in _FLAT_OF_VTK]:
        named = ", ".join(pyvista.CellType(k).name.lower().replace("_", " ") for k in others[:3])
        raise MeshError(f"{file}: contains {named} cells, but only tetrahedra can be used; split them")
    if flat := _FLAT_OF_VTK & {*kinds}:
        if not {10, 24} & {*kinds}:
            raise MeshError(f"{file}: contains no tetrahedra, but lines or surfaces; mesh the volume")
        grid = grid.extract_cells([k for k, kind in enumerate(grid.celltypes.tolist()) if kind not in flat])
    cells, data = list[Any](), dict[str, list[Any]]()
    for kind, nodes in grid.cells_dict.items():
        cells.append(meshio.CellBlock(_OF_VTK[int(kind)], np.asarray(nodes, dtype=np.int64)))
        rows = np.flatnonzero(grid.celltypes == kind)
        for name, values in grid.cell_data.items():
            data.setdefault(name, []).append(np.asarray(values)[rows])
    mesh = meshio.Mesh(np.asarray(grid.points, dtype=float), [])
    mesh.cells, mesh.cell_data = cells, data
    return mesh


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
