"""Triangles of surface files: STL and OBJ read here and counted, PLY, VTP and others by libraries."""

from __future__ import annotations

import logging
import re
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import GeometryError
from ...store.text import text_of, whole
from ...typing import FloatArray, IntArray
from ..mesh.files import by_vtk

Triangles = tuple[FloatArray, IntArray]
_VERTEX = re.compile(r"^\s*vertex\s+(\S+)\s+(\S+)\s+(\S+)", re.MULTILINE | re.IGNORECASE)
_FACET = re.compile(r"^\s*facet\b", re.MULTILINE | re.IGNORECASE)
_HEADER, _RECORD = 84, 50  # bytes of a binary STL: header with the count, and one triangle
_BY_VTK = (".vtp", ".vtk", ".vtu")
_OTHERS = {
    ".step": "a shape of CAD without triangles; export STL there", ".stp": "a shape of CAD without triangles; export "
    "STL there", ".iges": "a shape of CAD without triangles; export STL there", ".igs": "a shape of CAD without "
    "triangles; export STL there", ".dcm": "a picture of a scanner; segment it, and export STL", ".nii": "a picture of "
    "a "
    "scanner; segment it, and export STL", ".nrrd": "a picture of a scanner; segment it, and export STL",
    ".zip": "an archive; unpack it first", ".msh": "a mesh of tetrahedra; use limb.shape = 'mesh'",
}  # fmt: skip


def read_triangles(file: Path) -> Triangles:
    """Vertices (n, 3) and triangles (m, 3) in ``file``, all bodies of it; GeometryError in one sentence."""
    ending = file.suffix.lower()
    if ending in _OTHERS:
        raise GeometryError(f"{file}: is {_OTHERS[ending]}")
    try:
        content = whole(file)
    except ValueError as problem:
        raise GeometryError(f"{file}: {problem}") from None
    if ending == ".stl":
        vertices, faces = _stl(file, content)
    elif ending == ".obj":
        vertices, faces = _obj(file, content)
    elif ending in _BY_VTK:
        vertices, faces = _vtk(file)
    else:
        vertices, faces = _trimesh(file)
    if not len(faces):
        raise GeometryError(f"{file}: holds no triangles; export a triangulated surface")
    return vertices, faces


def _stl(file: Path, content: bytes) -> Triangles:
    """All solids of an STL file, binary or ASCII; bytes around the triangles are no harm, missing ones are."""
    count = struct.unpack("<I", content[80:84])[0] if len(content) >= _HEADER else -1
    rest = len(content) - _HEADER
    ascii_ = content.lstrip()[:5].lower() == b"solid" and _FACET.search(content[:4096].decode("latin-1")) is not None
    if not ascii_ and count >= 0 and 0 < count * _RECORD <= rest:
        kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
        corners = np.frombuffer(content, kind, count, _HEADER)["corners"].astype(float)
        return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
    try:
        text = text_of(content)
    except ValueError:
        text = ""
    facets = len(_FACET.findall(text))
    if not facets:
        if not ascii_ and count > 0 and rest < count * _RECORD:
            raise GeometryError(
                f"{file}: says it holds {count} triangles, and has bytes of {max(rest, 0) // _RECORD}; it is cut "
                "short, or "
                "no STL file"
            )
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    found = _VERTEX.findall(text)
    if len(found) != 3 * facets:
        raise GeometryError(
            f"{file}: {facets} facets begin in it, with {len(found)} corners instead of {3 * facets}; it is cut short "
            "or "
            "damaged"
        )
    try:
        corners = np.array(found, dtype=float)
    except ValueError:
        bad = next(w for row in found for w in row if not _is_number(w))
        raise GeometryError(
            f"{file}: '{bad[:30]}' among its corners is no number; export with decimal points"
        ) from None
    return corners, np.arange(len(corners)).reshape(-1, 3)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _obj(file: Path, content: bytes) -> Triangles:
    """All objects of an OBJ file; polygons become fans, and relative indices count back from where they stand."""
    vertices, faces = list[list[float]](), list[tuple[int, int, int]]()
    try:
        text = text_of(content)
    except ValueError as problem:
        raise GeometryError(f"{file}: is no text ({problem}), and OBJ is text") from None
    for number, line in enumerate(text.replace("\\\n", " ").split("\n"), start=1):
        words = line.split("#")[0].split()
        try:
            if words[:1] == ["v"]:
                vertices.append([float(w) for w in words[1:4]])
                if len(words) < 4:
                    raise ValueError(f"{len(words) - 1} coordinates")
            elif words[:1] == ["f"]:
                given = [int(w.split("/")[0]) for w in words[1:]]
                corners = [k - 1 if k > 0 else len(vertices) + k for k in given]
                if len(corners) < 3 or 0 in given:
                    raise ValueError("no face of three corners, counted from 1")
                faces += [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
        except ValueError as problem:
            raise GeometryError(f"{file}, line {number}: '{line[:40].strip()}' ({problem}); export it again") from None
    if not vertices:
        raise GeometryError(f"{file}: holds no line of a vertex (v x y z); it is no OBJ file, or has no triangles")
    return np.array(vertices, dtype=float).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3)


def _vtk(file: Path) -> Triangles:
    """Triangles of a surface of VTK; its other polygons are cut into triangles."""
    import pyvista

    try:
        body: Any = by_vtk(file)
    except Exception as problem:
        said = " ".join(str(problem).split())[:100]
        raise GeometryError(f"{file}: cannot be read as a surface of VTK ({said})") from None
    if isinstance(body, pyvista.MultiBlock):
        raise GeometryError(f"{file}: holds {body.n_blocks} blocks; give one surface")
    if not isinstance(body, pyvista.PolyData):
        if not isinstance(body, pyvista.UnstructuredGrid) or not set(body.celltypes.tolist()) <= {5, 7, 9}:
            raise GeometryError(f"{file}: holds a {type(body).__name__}, expected triangles; extract its surface")
        body = body.extract_surface(algorithm=None)
    flat = body.triangulate()
    if body.n_strips:
        flat = body.strip().triangulate() if not flat.n_cells else flat
    return np.asarray(flat.points, dtype=float), np.asarray(flat.faces, dtype=np.int64).reshape(-1, 4)[:, 1:]


def _trimesh(file: Path) -> Triangles:
    import trimesh

    log = logging.getLogger("trimesh.util")
    before, log.disabled = log.disabled, True  # a picture of the skin's colour that is missing is no harm
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            body = trimesh.load_mesh(file, process=False)
    except Exception as problem:
        said = " ".join(str(problem).split())[:100]
        raise GeometryError(f"{file}: cannot be read as STL, OBJ, PLY or VTP ({said})") from None
    finally:
        log.disabled = before
    if not isinstance(body, trimesh.Trimesh):
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    told = _told_by_ply(file)
    faces = np.asarray(body.faces, dtype=np.int64)
    if told is not None and told[1] and (told[0] > len(body.vertices) or told[1] > len(faces)):  # seams double some
        raise GeometryError(
            f"{file}: says it holds {told[0]} vertices and {told[1]} faces, and {len(body.vertices)} and {len(faces)} "
            "could be read; it is cut short"
        )
    return np.asarray(body.vertices, dtype=float), faces


def _told_by_ply(file: Path) -> tuple[int, int] | None:
    """Vertices and faces that the header of a PLY file names; None of other files."""
    head = file.read_bytes()[:4096]
    found = [re.search(rb"element\s+%s\s+(\d+)" % what, head) for what in (b"vertex", b"face")]
    if not head.startswith(b"ply") or None in found:
        return None
    return int(found[0][1]), int(found[1][1])  # type: ignore[index]
