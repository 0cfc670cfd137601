"""Meshes of formats that meshio does not read, or reads by halves: Nastran, I-DEAS UNV, FEBio, XDMF of FEniCSx, Exodus.

Each counts what its file declares. Cells keep the order of nodes that VTK has; ``cell_tags`` are names of numbers.
"""

from __future__ import annotations

import re
import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np

from ...errors import MeshError, optional
from ...store.text import text_of, whole
from ...typing import FloatArray, IntArray

_SOLIDS = {"CHEXA": "hexahedron", "CPENTA": "wedge", "CPYRAM": "pyramid", "CPYRA": "pyramid"}
_EXPONENT = re.compile(r"(?<=[\d.])([+-]\d+)$")
_UNV_TETRA = {111: 4, 118: 10}
_UNV_118 = (0, 2, 4, 9, 1, 3, 5, 6, 7, 8)  # corners, then middles, among the nodes as I-DEAS lists them


def assembled(
    file: Path, nodes: Mapping[int, Sequence[float]], cells: dict[int, tuple[str, tuple[int, ...], int]],
    names: dict[int, tuple[str, ...]] | None = None,
) -> meshio.Mesh:  # fmt: skip
    """A mesh of numbered ``nodes`` and ``cells`` (kind, nodes, number of the region); MeshError for nodes that lack."""
    place = {n: k for k, n in enumerate(nodes)}
    for number, (_, corners, _) in cells.items():
        if lost := next((n for n in corners if n not in place), None):
            raise MeshError(f"{file}: element {number} names node {lost}, which is not in the file; export it again")
    blocks, regions = list[tuple[str, IntArray]](), list[IntArray]()
    for kind in dict.fromkeys(k for k, _, _ in cells.values()):
        some = [(corners, region) for k, corners, region in cells.values() if k == kind]
        blocks.append((kind, np.array([[place[n] for n in corners] for corners, _ in some], dtype=np.int64)))
        regions.append(np.array([region for _, region in some], dtype=np.int64))
    points = np.array([list(p) for p in nodes.values()], dtype=float).reshape(len(nodes), 3)
    mesh = meshio.Mesh(points, blocks, cell_data={"region": regions} if regions else {})
    mesh.cell_tags = names or {}
    return mesh


def text_mesh(file: Path) -> str:
    """The text of a mesh, whatever its encoding; MeshError where it is none."""
    try:
        return text_of(whole(file))
    except ValueError as problem:
        raise MeshError(f"{file}: {problem}") from None


# ---------------------------------------------------------------- Nastran
def read_nastran(file: Path) -> meshio.Mesh:
    """GRID, CTETRA and CORD2R of a bulk data file, in free, small or large fields; regions are numbers of properties.

    MeshError for coordinate systems that are not read, for included files, and where cells other than tetrahedra fill
    volume they are passed on by their kind.
    """
    nodes, cells = dict[int, tuple[float, ...]](), dict[int, tuple[str, tuple[int, ...], int]]()
    frames, placed, default = dict[int, Any](), dict[int, int](), 0
    text = text_mesh(file)
    for fields in _cards(file, text):
        name = fields[0].upper().rstrip("*")
        if name == "GRID":
            number = _whole(file, fields, 1)
            nodes[number] = tuple(_real(file, fields, k) for k in (3, 4, 5))
            placed[number] = _whole(file, fields, 2, -1)
        elif name == "GRDSET":
            default = _whole(file, fields, 2, 0)
        elif name == "CTETRA":
            corners = tuple(_whole(file, fields, k, 0) for k in range(3, 13))
            count = 10 if all(corners[4:]) else 4
            if count == 4 and any(corners[4:]):
                raise MeshError(
                    f"{file}: CTETRA {fields[1]} has {sum(map(bool, corners))} nodes, expected 4 or 10; export it with "
                    "all middles, or with none"
                )
            kind = "tetra10" if count == 10 else "tetra"
            cells[_whole(file, fields, 1)] = (kind, corners[:count], _whole(file, fields, 2, 0))
        elif name in _SOLIDS:
            size = {"hexahedron": 8, "wedge": 6, "pyramid": 5}[_SOLIDS[name]]
            corners = tuple(_whole(file, fields, k) for k in range(3, 3 + size))
            cells[_whole(file, fields, 1)] = (_SOLIDS[name], corners, _whole(file, fields, 2, 0))
        elif name == "CORD2R":
            frames[_whole(file, fields, 1)] = _frame(file, fields)
        elif name.startswith("CORD"):
            frames[_whole(file, fields, 1)] = name
        elif name == "INCLUDE":
            raise MeshError(f"{file}: includes another file ({fields[1] if len(fields) > 1 else ''}); write one file")
    for number, system in placed.items():
        system = default if system < 0 else system
        if system:
            nodes[number] = _turned(file, number, system, frames, nodes[number])
    names = {int(m[1]): (m[2].strip(),) for m in re.finditer(r'^\$HMNAME COMP\s+(\d+)\s*"([^"]*)"', text, re.M)}
    return assembled(file, nodes, cells, names)  # type: ignore[arg-type]


def _cards(file: Path, text: str) -> Iterator[list[str]]:
    """Fields of each card with those of its continuations, without the fields of continuation marks."""
    card: list[str] = []
    begun = re.search(r"^\s*BEGIN\s+BULK", text, re.M | re.I)
    for line in (text[begun.end() :] if begun else text).split("\n"):
        line = line.split("$")[0].rstrip()
        if not line.strip():
            continue
        if line.upper().startswith("ENDDATA"):
            break
        fields, more = _fields(line)
        if more and card:
            card += fields
        else:
            if card:
                yield card
            card = fields
    if card:
        yield card


def _fields(line: str) -> tuple[list[str], bool]:
    """Fields of a line, and whether it goes on with the card before."""
    line = line.expandtabs(8)
    if "," in line:
        fields = [f.strip() for f in line.split(",")]
        head = fields[0]
        more = not head or head[0] in "+*"
        body = fields[1:9] if not head.endswith("*") else fields[1:5]
        body += [""] * ((4 if head.endswith("*") or head.startswith("*") else 8) - len(body))
    else:
        head = line[:8].strip()
        wide = head.endswith("*") or head.startswith("*")
        more = not head or head[0] in "+*"
        width, count = (16, 4) if wide else (8, 8)
        body = [line[8 + width * k : 8 + width * (k + 1)].strip() for k in range(count)]
    return (body if more else [head, *body]), more


def _whole(file: Path, fields: list[str], at: int, otherwise: int | None = None) -> int:
    cell = fields[at] if at < len(fields) else ""
    if not cell and otherwise is not None:
        return otherwise
    try:
        return int(cell)
    except ValueError:
        raise MeshError(f"{file}: '{cell}' in field {at + 1} of {' '.join(fields[:2])} is no whole number") from None


def _real(file: Path, fields: list[str], at: int) -> float:
    cell = fields[at] if at < len(fields) else ""
    try:
        return float(_EXPONENT.sub(r"e\1", cell.upper().replace("D", "E")) or 0.0)
    except ValueError:
        raise MeshError(f"{file}: '{cell}' in field {at + 1} of {' '.join(fields[:2])} is no number") from None


def _frame(file: Path, fields: list[str]) -> tuple[int, FloatArray, FloatArray]:
    """The system that a rectangular one is given in, its origin and its axes as rows."""
    origin, along, plane = (np.array([_real(file, fields, k + i) for i in range(3)]) for k in (3, 6, 9))
    z = along - origin
    z /= np.linalg.norm(z)
    y = np.cross(z, plane - origin)
    y /= np.linalg.norm(y)
    return _whole(file, fields, 2, 0), origin, np.array([np.cross(y, z), y, z])


def _turned(file: Path, node: int, system: int, frames: dict[int, Any], point: Sequence[float]) -> tuple[float, ...]:
    """``point`` in the basic system."""
    for _ in range(len(frames) + 1):
        frame = frames.get(system)
        if not isinstance(frame, tuple):
            what = f"of the kind {frame}" if frame else "which is not in the file"
            raise MeshError(
                f"{file}: node {node} stands in the coordinate system {system}, {what}; only rectangular ones (CORD2R) "
                "are read: export in the basic system"
            )
        system, origin, axes = frame
        point = tuple(float(v) for v in origin + np.asarray(point) @ axes)
        if not system:
            return tuple(point)
    raise MeshError(f"{file}: coordinate systems that are given in one another; export in the basic system")


# ---------------------------------------------------------------- I-DEAS UNV
def read_unv(file: Path) -> meshio.Mesh:
    """Nodes (2411, 15), tetrahedra (2412) and groups of elements (2467, 2477, 2452, 2435) of an I-DEAS file."""
    nodes, cells = dict[int, tuple[float, ...]](), dict[int, tuple[str, tuple[int, ...], int]]()
    groups: dict[str, set[int]] = {}
    lines = text_mesh(file).split("\n")
    at = 0
    while at < len(lines):
        if lines[at].strip() != "-1":
            at += 1
            continue
        end = next((k for k in range(at + 2, len(lines)) if lines[k].strip() == "-1"), None)
        if end is None:
            raise MeshError(f"{file}: a dataset has no end mark (-1); the file is cut short")
        kind, body = lines[at + 1].strip(), lines[at + 2 : end]
        try:
            if kind in ("2411", "781"):
                for k in range(0, len(body) - 1, 2):
                    place = [float(w) for w in body[k + 1].upper().replace("D", "E").split()]
                    nodes[int(body[k].split()[0])] = tuple(place[:3])
            elif kind == "15":
                for line in body:
                    words = line.split()
                    nodes[int(words[0])] = tuple(float(w) for w in words[4:7])
            elif kind == "2412":
                _unv_cells(body, cells)
            elif kind in ("2467", "2477", "2452", "2435", "2430", "2429"):
                _unv_groups(body, groups)
        except (ValueError, IndexError) as problem:
            raise MeshError(
                f"{file}: dataset {kind} is damaged or of another layout ({problem}); export it again"
            ) from None
        at = end + 1
    if not cells:
        raise MeshError(f"{file}: holds no tetrahedra (dataset 2412); a file of functions (58) is a G and no mesh")
    mesh = assembled(file, nodes, cells)
    if groups:
        kinds = list(dict.fromkeys(k for k, _, _ in cells.values()))
        where = dict[int, tuple[int, int]]()
        for block, kind in enumerate(kinds):
            where |= {e: (block, k) for k, e in enumerate(e for e, c in cells.items() if c[0] == kind)}
        mesh.cell_sets = {
            name: [np.array([k for b, k in (where[e] for e in sorted(members) if e in where) if b == block], dtype=int)
                   for block in range(len(kinds))] for name, members in groups.items()
        }  # fmt: skip
        mesh.cell_data = {}
    return mesh


def _unv_cells(body: list[str], cells: dict[int, tuple[str, tuple[int, ...], int]]) -> None:
    at = 0
    while at < len(body):
        number, kind, physical, _, _, count = (int(w) for w in body[at].split()[:6])
        at += 1
        if kind in (11, 21, 22, 23, 24):  # beams have a line of their own
            at += 1
        nodes = list[int]()
        while len(nodes) < count:
            nodes += [int(w) for w in body[at].split()]
            at += 1
        if kind in _UNV_TETRA:
            order = nodes if kind == 111 else [nodes[k] for k in _UNV_118]
            cells[number] = ("tetra" if kind == 111 else "tetra10", tuple(order), physical)
        elif kind in (112, 113, 115, 116, 119):
            size, name = (6, "wedge") if kind in (112, 113) else (8, "hexahedron")
            cells[number] = (name, tuple(nodes[:size]), physical)


def _unv_groups(body: list[str], groups: dict[str, set[int]]) -> None:
    at = 0
    while at + 1 < len(body):
        count, name = int(body[at].split()[7]), body[at + 1].strip()
        at += 2
        words = list[int]()
        while len(words) < 4 * count:
            words += [int(w) for w in body[at].split()]
            at += 1
        members = {words[k + 1] for k in range(0, 4 * count, 4) if words[k] == 8}
        if members:
            groups.setdefault(name, set()).update(members)


# ---------------------------------------------------------------- FEBio
def read_febio(file: Path) -> meshio.Mesh:
    """Nodes and tet4, tet10 of an FEBio file (versions 2 to 4); regions are names of parts and their materials."""
    try:
        root = ElementTree.fromstring(whole(file))
    except ElementTree.ParseError as problem:
        raise MeshError(f"{file}: is no XML, or cut short ({problem})") from None
    nodes, cells = dict[int, tuple[float, ...]](), dict[int, tuple[str, tuple[int, ...], int]]()
    names: dict[int, tuple[str, ...]] = {}
    parts = {d.get("name"): d.get("mat") for d in root.iter("SolidDomain")}
    materials = {m.get("id"): m.get("name") for m in root.iter("material")}
    for group in root.iter("Nodes"):
        for node in group:
            if node.text:
                nodes[int(node.get("id", "0"))] = tuple(float(w) for w in node.text.split(","))
    for number, group in enumerate(root.iter("Elements"), start=1):
        kind = str(group.get("type", "")).lower()
        material = group.get("mat") or parts.get(group.get("name"))
        told = (group.get("name"), material, materials.get(material))
        names[number] = tuple(dict.fromkeys(n for n in told if n))
        for element in group:
            corners = tuple(int(w) for w in (element.text or "").split(","))
            form = {"tet4": "tetra", "tet10": "tetra10", "hex8": "hexahedron", "penta6": "wedge"}.get(kind)
            if form is None and not kind.startswith(("tri", "quad", "line", "truss")):
                raise MeshError(f"{file}: has elements of the type {kind}, but only tet4 and tet10 can be used")
            if form is not None:
                cells[int(element.get("id", "0"))] = (form, corners, number)
    return assembled(file, nodes, cells, names)


# ---------------------------------------------------------------- XDMF
def read_xdmf(file: Path) -> meshio.Mesh:
    """The mesh of an XDMF file with the tags of its cells, those of FEniCSx too, which stand in grids of their own."""
    root = ElementTree.fromstring(whole(file))
    grids = [g for g in root.iter("Grid") if g.find("Topology") is not None]
    if not grids:
        raise MeshError(f"{file}: holds no grid with a topology; export the mesh and its tags")
    volumes = [(g, *_topology(file, g, root)) for g in grids]
    mesh = next(((g, kind, cells) for g, kind, cells in volumes if kind.startswith("tetra")), None)
    if mesh is None:
        kinds = sorted({kind for _, kind, _ in volumes})
        raise MeshError(f"{file}: contains no tetrahedra (only {', '.join(kinds)}); mesh the volume")
    grid, kind, cells = mesh
    geometry = grid.find("Geometry")
    item = None if geometry is None else geometry.find("DataItem")
    points = _item(file, item, root)
    found = meshio.Mesh(points.reshape(-1, points.shape[-1] if points.ndim > 1 else 3), [(kind, cells)])
    order = {tuple(sorted(c)): k for k, c in enumerate(cells[:, :4].tolist())}
    for other, other_kind, own in volumes:
        if other_kind != kind:
            continue
        for attribute in other.findall("Attribute"):
            values = np.ravel(_item(file, attribute.find("DataItem"), root))
            if len(values) != len(own) or attribute.get("Center", "Cell") != "Cell":
                continue
            rows = [order.get(tuple(sorted(c))) for c in own[:, :4].tolist()]
            if None in rows:
                raise MeshError(f"{file}: '{attribute.get('Name')}' tags cells that the mesh lacks; export both anew")
            tags = np.full(len(cells), -1, dtype=values.dtype)
            tags[np.array(rows, dtype=int)] = values
            found.cell_data[str(attribute.get("Name", "region"))] = [tags]
    return found


def _topology(file: Path, grid: ElementTree.Element, root: ElementTree.Element) -> tuple[str, IntArray]:
    topology = grid.find("Topology")
    assert topology is not None
    kind = str(topology.get("TopologyType") or topology.get("Type")).lower()
    name = {"tetrahedron": "tetra", "tetrahedron_10": "tetra10", "tet_10": "tetra10"}.get(kind, kind)
    if not name.startswith("tetra"):
        return name, np.zeros((0, 1), dtype=np.int64)
    width = 10 if name == "tetra10" else 4
    cells = np.asarray(_item(file, topology.find("DataItem"), root), dtype=np.int64).reshape(-1, width)
    told = topology.get("NumberOfElements") or topology.get("Dimensions")
    if told is not None and int(told.split()[0]) != len(cells):
        raise MeshError(f"{file}: holds {len(cells)} tetrahedra, its topology says {told}; it is cut short")
    return name, cells


def _item(file: Path, item: ElementTree.Element | None, root: ElementTree.Element) -> Any:
    if item is None:
        raise MeshError(f"{file}: a part of it has no data; export it again")
    if (reference := item.get("Reference")) is not None:
        path = str(item.text).strip() if reference == "XML" else reference
        found = root.find(path.replace("/Xdmf/", "./"))
        return _item(file, found, root)
    text = (item.text or "").strip()
    if item.get("Format", "XML").upper() == "HDF":
        name, _, path = text.partition(":")
        beside = file.parent / name
        if not beside.is_file():
            raise MeshError(f"{file}: its numbers are in {name}, which is not beside it; copy that file too")
        with h5py.File(beside, "r") as content:
            return content[path][()]
    shape = [int(w) for w in item.get("Dimensions", "-1").split()]
    return np.array([float(w) for w in text.split()]).reshape(shape)


# ---------------------------------------------------------------- Exodus
def read_exodus(file: Path) -> meshio.Mesh:
    """Blocks of tetrahedra of an Exodus file, by their names and numbers; needs netCDF4 (extra ``exodus``)."""
    netcdf = optional("netCDF4", "exodus", "reading Exodus files", package="netCDF4")
    try:
        content = netcdf.Dataset(str(file))
    except OSError as problem:
        raise MeshError(f"{file}: is no Exodus file, or damaged ({problem.strerror or problem})") from None
    with content:
        return _exodus(file, content.variables, content.dimensions)


_SOLID_BLOCKS = (("TET", "tetra"), ("HEX", "hexahedron"), ("WEDGE", "wedge"), ("PRISM", "wedge"), ("PYR", "pyramid"))


def _exodus(file: Path, variables: Any, dimensions: Any) -> meshio.Mesh:
    if "coord" in variables:
        points = np.asarray(variables["coord"][:], dtype=float).T
    elif "coordx" in variables:
        points = np.column_stack([np.asarray(variables[f"coord{a}"][:], dtype=float) for a in "xyz"
                                  if f"coord{a}" in variables])  # fmt: skip
    else:
        raise MeshError(f"{file}: holds no coordinates; it is no mesh of Exodus")
    numbers = np.asarray(variables["eb_prop1"][:]).tolist() if "eb_prop1" in variables else []
    told = _names_of(variables["eb_names"]) if "eb_names" in variables else []
    blocks, regions, names = list[tuple[str, IntArray]](), list[IntArray](), dict[int, tuple[str, ...]]()
    left_out = set[str]()
    for k in range(1, len(dimensions["num_el_blk"]) + 1 if "num_el_blk" in dimensions else 1):
        stored = variables.get(f"connect{k}")
        if stored is None:
            continue
        kind = str(getattr(stored, "elem_type", "")).upper()
        form = next((form for begin, form in _SOLID_BLOCKS if kind.startswith(begin)), None)
        number = int(numbers[k - 1]) if k <= len(numbers) else k
        names[number] = tuple(n for n in told[k - 1 : k] if n)
        if form is None:
            left_out.add(kind.lower())
            continue
        if form != "tetra":
            raise MeshError(f"{file}: contains {kind.lower()} cells, but only tetrahedra can be used; split them")
        nodes = np.asarray(stored[:], dtype=np.int64) - 1
        if nodes.shape[1] not in (4, 10):
            raise MeshError(f"{file}: block {k} has tetrahedra of {nodes.shape[1]} nodes, expected 4 or 10")
        blocks.append((form if nodes.shape[1] == 4 else "tetra10", nodes))
        regions.append(np.full(len(nodes), number))
    if not blocks:
        found = ", ".join(sorted(left_out)) or "no cells at all"
        raise MeshError(f"{file}: contains no tetrahedra (only {found}); mesh the volume, not the surface")
    mesh = meshio.Mesh(points, [], cell_data={})
    mesh.cells = [meshio.CellBlock(form, nodes) for form, nodes in blocks]
    mesh.cell_data = {"region": regions}
    mesh.cell_tags = names
    return mesh


def _names_of(stored: Any) -> list[str]:
    rows = np.ma.filled(stored[:], b"")
    return ["".join(c.decode("utf-8", "replace") for c in row).strip("\0 ") for row in rows]


# ---------------------------------------------------------------- gmsh
def volumes_of_gmsh(file: Path) -> dict[int, tuple[int, ...]]:
    """Physical groups of each volume of a gmsh file of version 4.1; nothing of other versions."""
    content = file.read_bytes()
    head = re.search(rb"\$MeshFormat\s+(\S+)\s+(\d)", content)
    begun = re.search(rb"\$Entities[^\n]*\n", content)
    if head is None or head[1] != b"4.1" or begun is None:
        return {}
    if head[2] == b"1":
        return _binary_volumes(content[begun.end() :])
    entities = content[begun.end() : content.find(b"$EndEntities", begun.end())].decode("ascii", "replace")
    lines = [line.split() for line in entities.split("\n") if line.strip()]
    counts = [int(w) for w in lines[0]]
    found: dict[int, tuple[int, ...]] = {}
    for words in lines[1 + sum(counts[:3]) : 1 + sum(counts)]:
        number = int(words[7])
        found[int(words[0])] = tuple(abs(int(w)) for w in words[8 : 8 + number])
    return found


def _binary_volumes(content: bytes) -> dict[int, tuple[int, ...]]:
    """The same of the entities in binary, little end first: points, curves, surfaces, volumes."""
    at, found = 32, dict[int, tuple[int, ...]]()

    def many() -> tuple[int, ...]:
        """Numbers behind their count."""
        nonlocal at
        (count,) = struct.unpack_from("<Q", content, at)
        numbers = struct.unpack_from(f"<{count}i", content, at + 8)
        at += 8 + 4 * count
        return numbers

    for dimension, count in enumerate(struct.unpack_from("<4Q", content, 0)):
        for _ in range(count):
            (number,) = struct.unpack_from("<i", content, at)
            at += 4 + (24 if dimension == 0 else 48)  # a point, or the corners of a box
            groups = many()
            if dimension:
                many()  # what bounds it
            if dimension == 3:
                found[number] = tuple(abs(g) for g in groups)
    return found
