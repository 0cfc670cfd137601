"""Meshes in Abaqus' input files (.inp), of which meshio 5.3 reads some only and mistakes others.

It keeps the last ``*NODE`` block alone, gives the elements of a named block to the block of its number, takes one name
of a set of sets, reads comments among data as data, and does not see that an instance is moved.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from ...errors import MeshError
from ...typing import IntArray

_TETRA = re.compile(r"^(A?C|DC)3D(4|10)[A-Z]*$")
_VOLUME = re.compile(r"^((A?C|DC)3D|COH3D|SC[68])")  # others are lines, shells and springs
_MOVING = ("SYSTEM", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY")  # make or move what is not written out
_DEPTH = 9  # files within files


@dataclass
class _Found:
    """What was read so far; ``sets`` hold numbers of elements, ``nested`` names of sets, by names in capitals."""

    nodes: dict[int, tuple[float, ...]] = field(default_factory=dict)
    elements: dict[int, tuple[int, ...]] = field(default_factory=dict)
    others: set[str] = field(default_factory=set)
    sets: dict[str, set[int]] = field(default_factory=dict)
    nested: dict[str, set[str]] = field(default_factory=dict)
    spelled: dict[str, str] = field(default_factory=dict)
    parts: int = 0
    closed: bool = False  # the part ended: what follows is the assembly's, whose numbers are its own
    instances: int = 0


def read_inp(file: Path) -> meshio.Mesh:
    """Tetrahedra of an Abaqus file, first and second order, and its element sets; lines and shells are left out.

    Files that it includes are read, too. Raises :class:`MeshError` with the line for what is no number, and for other
    volumes, several parts, an instance that is moved, what is generated, and nodes that are not there.
    """
    found = _Found()
    for keyword, options, lines in _blocks(file, 0):
        _take(file, found, keyword, options, lines)
    number = {n: k for k, n in enumerate(found.nodes)}
    for e, nodes in found.elements.items():
        if lost := next((n for n in nodes if n not in number), None):
            raise MeshError(f"{file}: element {e} names node {lost}, which is not in the file; export the mesh again")
    cells, where = list[tuple[str, IntArray]](), dict[int, tuple[int, int]]()
    for kind, size in (("tetra", 4), ("tetra10", 10)):
        some = {e: [number[n] for n in nodes] for e, nodes in found.elements.items() if len(nodes) == size}
        if some:
            where |= {e: (len(cells), k) for k, e in enumerate(some)}
            cells.append((kind, np.array(list(some.values()), dtype=np.int64)))
    sets = {found.spelled[name]: _members(_resolved(found, name), where, len(cells)) for name in found.spelled}
    if found.others:
        raise MeshError(
            f"{file}: contains elements of the type {', '.join(sorted(found.others)[:3])}, but only tetrahedra (C3D4, "
            "C3D10) can be used; split them"
        )
    return meshio.Mesh(np.array(list(found.nodes.values())).reshape(len(found.nodes), -1), cells, cell_sets=sets)


def _members(elements: set[int], where: dict[int, tuple[int, int]], blocks: int) -> list[IntArray]:
    """Places of ``elements`` in each of the ``blocks`` of cells."""
    places = [where[e] for e in sorted(elements) if e in where]
    return [np.array([k for b, k in places if b == block], dtype=np.int64) for block in range(blocks)]


def _resolved(found: _Found, name: str, above: tuple[str, ...] = ()) -> set[int]:
    """Elements of a set, with those of the sets that it names."""
    inner = [n for n in found.nested.get(name, ()) if n not in above]
    return found.sets.get(name, set()).union(*(_resolved(found, n, (*above, name)) for n in inner))


def _blocks(file: Path, depth: int) -> Iterator[tuple[str, dict[str, str], list[tuple[int, str]]]]:
    """Each keyword in capitals, with its options and the numbered lines of data below it."""
    if not file.is_file():
        raise MeshError(f"{file}: no such file; the mesh includes it")
    if depth > _DEPTH:
        raise MeshError(f"{file}: files that include one another; write one file")
    head, data = "", list[tuple[int, str]]()
    for number, line in enumerate([*file.read_text(encoding="utf-8", errors="replace").splitlines(), "*"], start=1):
        text = line.strip()
        if not text or text.startswith("**"):
            continue
        if head.endswith(",") and not data:  # a keyword of two lines
            head += text
        elif text.startswith("*"):
            if head:
                yield from _block(file, head, data, depth)
            head, data = text, []
        else:
            data.append((number, text))


def _block(
    file: Path, head: str, data: list[tuple[int, str]], depth: int
) -> Iterator[tuple[str, dict[str, str], list[tuple[int, str]]]]:
    keyword, *words = [w.strip() for w in head[1:].split(",")]
    pairs = [w.partition("=") for w in words if w]
    options = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
    if keyword.upper() == "INCLUDE":
        yield from _blocks(file.parent / options.get("INPUT", ""), depth + 1)
    else:
        yield keyword.upper(), options, data


def _take(file: Path, found: _Found, keyword: str, options: dict[str, str], lines: list[tuple[int, str]]) -> None:
    """One block into ``found``."""
    if keyword in _MOVING or (keyword == "NODE" and options.get("SYSTEM", "R").upper() != "R"):
        raise MeshError(f"{file}: makes or turns its nodes by *{keyword}, which is not read; export all, in x, y, z")
    if keyword == "PART":
        found.parts, found.closed = found.parts + 1, False
    if keyword == "END PART":
        found.closed = True
    if keyword == "INSTANCE":
        found.instances += 1
        if found.instances > 1:
            raise MeshError(f"{file}: places its part {found.instances} times; export one flat mesh, without parts")
    if found.closed and found.nodes and keyword in ("NODE", "ELEMENT"):
        if keyword == "ELEMENT" and _VOLUME.match(options.get("TYPE", "").upper()):
            raise MeshError(f"{file}: has elements beside its part; export one flat mesh, without parts")
        return  # reference points, springs and masses
    if keyword == "INSTANCE" and any(v for k, text in lines for v in _numbers(file, k, text)[:6]):
        raise MeshError(f"{file}: *INSTANCE moves or turns its part, which is not read; export a mesh without parts")
    if found.parts > 1 and keyword in ("NODE", "ELEMENT"):
        raise MeshError(f"{file}: holds several parts, whose numbers begin anew; join them, or export without parts")
    if keyword == "NODE":
        for number, text in lines:
            label, *place = _numbers(file, number, text)
            found.nodes[int(label)] = tuple(place[:3])
    elif keyword == "ELEMENT":
        _elements(file, found, options, lines)
    elif keyword == "ELSET":
        _set(file, found, options, lines)


def _elements(file: Path, found: _Found, options: dict[str, str], lines: list[tuple[int, str]]) -> None:
    kind = options.get("TYPE", "").upper()
    match = _TETRA.match(kind)
    if match is None:
        found.others |= {kind} if _VOLUME.match(kind) else set()
        return
    size = int(match[2]) + 1
    flat = [int(v) for number, text in lines for v in _numbers(file, number, text)]
    if len(flat) % size:
        raise MeshError(f"{file}: the *ELEMENT block that ends in line {lines[-1][0]} is cut short; export it again")
    cells = {flat[k]: tuple(flat[k + 1 : k + size]) for k in range(0, len(flat), size)}
    found.elements |= cells
    if name := options.get("ELSET"):
        _named(found, name).update(cells)


def _set(file: Path, found: _Found, options: dict[str, str], lines: list[tuple[int, str]]) -> None:
    members = _named(found, options.get("ELSET", ""))
    for number, text in lines:
        words = [w.strip() for w in text.split(",") if w.strip()]
        if "GENERATE" in options:
            first, last, *step = (int(v) for v in _numbers(file, number, text))
            members.update(range(first, last + 1, step[0] if step else 1))
            continue
        members.update(int(w) for w in words if w.isdigit())
        found.nested.setdefault(options["ELSET"].upper(), set()).update(w.upper() for w in words if not w.isdigit())


def _named(found: _Found, name: str) -> set[int]:
    found.spelled.setdefault(name.upper(), name)
    return found.sets.setdefault(name.upper(), set())


def _numbers(file: Path, line: int, text: str) -> list[float]:
    try:
        return [float(w) for w in text.split(",") if w.strip()]
    except ValueError:
        raise MeshError(f"{file}, line {line}: '{text[:40]}' are no numbers; export the mesh again") from None
