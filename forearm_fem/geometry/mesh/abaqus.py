"""Meshes in Abaqus' input files (.inp), of which meshio 5.3 reads some only and mistakes others.

It keeps the last ``*NODE`` block alone and gives the elements of a named block to the block of its number. It takes
one name of a set of sets, reads comments among data as data, and does not see that an instance is moved.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np
from scipy.spatial.transform import Rotation

from ...errors import MeshError
from ...typing import FloatArray, IntArray

_TETRA = re.compile(r"^(A?C|DC)3D(4|10)[A-Z]*$")
_VOLUME = re.compile(r"^((A?C|DC)3D|COH3D|SC[68])")  # others are lines, shells and springs
_MOVING = ("SYSTEM", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY")  # make or move what is not written out
_DEPTH = 9  # files within files


Lines = list[tuple[int, str]]


@dataclass
class _Body:
    """Nodes and elements of a part, or of a file without parts.

    ``sets`` hold numbers of elements, ``nested`` names of sets, both by names in capitals; ``spelled`` has the names as
    the file writes them.
    """

    nodes: dict[int, tuple[float, ...]] = field(default_factory=dict)
    elements: dict[int, tuple[int, ...]] = field(default_factory=dict)
    others: set[str] = field(default_factory=set)
    sets: dict[str, set[int]] = field(default_factory=dict)
    nested: dict[str, set[str]] = field(default_factory=dict)
    spelled: dict[str, str] = field(default_factory=dict)

    def resolved(self, name: str, above: tuple[str, ...] = ()) -> set[int]:
        """Elements of a set, with those of the sets that it names."""
        inner = [n for n in self.nested.get(name, ()) if n not in above]
        return self.sets.get(name, set()).union(*(self.resolved(n, (*above, name)) for n in inner))


@dataclass
class _File:
    """A file as read so far: parts by their names in capitals, what lies outside of them, and the assembly."""

    flat: _Body = field(default_factory=_Body)
    parts: dict[str, _Body] = field(default_factory=dict)
    now: str | None = None  # the part that is open
    placed: list[tuple[str, str, list[float]]] = field(default_factory=list)  # instance, part, where
    assembled: dict[str, list[tuple[str, set[int], set[str]]]] = field(default_factory=dict)  # sets of instances
    spelled: dict[str, str] = field(default_factory=dict)

    @property
    def body(self) -> _Body:
        """Body that nodes and elements belong to now."""
        return self.flat if self.now is None else self.parts[self.now]


def read_inp(file: Path) -> meshio.Mesh:
    """Tetrahedra of an Abaqus file, first and second order, and its element sets; lines and shells are left out.

    Files that it includes are read, too. Parts stand where their instances place them; each of several is a set of its
    name. Raises :class:`MeshError` with the line for what is no number, and for other volumes, parts that nothing
    places, what is generated, and nodes that are not there.
    """
    found = _File()
    for keyword, options, lines in _blocks(file, 0):
        _take(file, found, keyword, options, lines)
    bodies = _placed(file, found)
    points, cells = list[FloatArray](), dict[int, list[list[int]]]()
    where, begin = list[dict[int, tuple[int, int]]](), 0  # of each body: element -> (size, place)
    for _, body, at in bodies:
        number = {n: begin + k for k, n in enumerate(body.nodes)}
        points.append(_moved(file, np.array(list(body.nodes.values()), dtype=float).reshape(-1, 3), at))
        begin += len(number)
        where.append({})
        for e, nodes in body.elements.items():
            if lost := next((n for n in nodes if n not in number), None):
                raise MeshError(f"{file}: element {e} names node {lost}, which is not in the file; export it again")
            block = cells.setdefault(len(nodes), [])
            where[-1][e] = (len(nodes), len(block))
            block.append([number[n] for n in nodes])
    if others := set[str]().union(*(body.others for _, body, _ in bodies)):
        raise MeshError(
            f"{file}: contains elements of the type {', '.join(sorted(others)[:3])}, but only tetrahedra (C3D4, C3D10) "
            "can be used; split them"
        )
    sets, sizes = dict[str, set[tuple[int, int]]](), sorted(cells)
    for (name, body, _), known in zip(bodies, where, strict=True):
        for key, spelled in body.spelled.items():
            sets.setdefault(spelled, set()).update(known[e] for e in body.resolved(key) if e in known)
        if len(bodies) > 1:
            sets.setdefault(name, set()).update(known.values())
    for key, members in found.assembled.items():
        for instance, elements, names in members:
            for (name, body, _), known in zip(bodies, where, strict=True):
                if name.upper() == instance:
                    inner = elements.union(*(body.resolved(n) for n in names))
                    sets.setdefault(found.spelled[key], set()).update(known[e] for e in inner if e in known)
    kinds = {4: "tetra", 10: "tetra10"}
    return meshio.Mesh(
        np.concatenate(points) if points else np.zeros((0, 3)),
        [(kinds[size], np.array(cells[size], dtype=np.int64)) for size in sizes],
        cell_sets={name: _members(places, sizes) for name, places in sets.items()},
    )


def _placed(file: Path, found: _File) -> list[tuple[str, _Body, list[float]]]:
    """Bodies with their instances' names and numbers that move them."""
    if found.placed:
        if lost := next((p for _, p, _ in found.placed if p.upper() not in found.parts), None):
            raise MeshError(f"{file}: *INSTANCE places the part '{lost}', which is not in the file; write one file")
        bodies = [(name, found.parts[part.upper()], at) for name, part, at in found.placed]
    elif len(found.parts) > 1:
        raise MeshError(
            f"{file}: holds {len(found.parts)} parts and no *INSTANCE that places them; write the assembly, or export "
            "one mesh"
        )
    else:
        bodies = [("", body, []) for body in found.parts.values()]
    if found.parts and (found.flat.elements or found.flat.others):
        raise MeshError(f"{file}: has elements beside its parts; export one flat mesh, without parts")
    return bodies or [("", found.flat, [])]


def _moved(file: Path, points: FloatArray, at: Sequence[float]) -> FloatArray:
    """``points`` (n, 3) shifted, then turned by ``at``: three numbers, then two points of an axis and degrees."""
    if not at:
        return points
    if len(at) not in (3, 10):
        raise MeshError(f"{file}: *INSTANCE is placed by {len(at)} numbers, expected 3 (a shift), or 7 more (a turn)")
    moved: FloatArray = points + np.array(at[:3])
    if len(at) == 3:
        return moved
    a, b, angle = np.array(at[3:6]), np.array(at[6:9]), np.radians(at[9])
    length = float(np.linalg.norm(b - a))
    if length == 0:
        raise MeshError(f"{file}: *INSTANCE is turned about an axis whose two points are one; export it again")
    return np.asarray(a + Rotation.from_rotvec((b - a) / length * angle).apply(moved - a), dtype=float)


def _members(places: set[tuple[int, int]], sizes: Sequence[int]) -> list[IntArray]:
    """Places of a set's elements in each block of cells."""
    return [np.array(sorted(k for s, k in places if s == size), dtype=np.int64) for size in sizes]


def _blocks(file: Path, depth: int) -> Iterator[tuple[str, dict[str, str], Lines]]:
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


def _block(file: Path, head: str, data: Lines, depth: int) -> Iterator[tuple[str, dict[str, str], Lines]]:
    keyword, *words = [w.strip() for w in head[1:].split(",")]
    pairs = [w.partition("=") for w in words if w]
    options = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
    if keyword.upper() == "INCLUDE":
        yield from _blocks(file.parent / options.get("INPUT", ""), depth + 1)
    else:
        yield keyword.upper(), options, data


def _take(file: Path, found: _File, keyword: str, options: Mapping[str, str], lines: Lines) -> None:
    """One block into ``found``."""
    if keyword in _MOVING or (keyword == "NODE" and options.get("SYSTEM", "R").upper() != "R"):
        raise MeshError(f"{file}: makes or turns its nodes by *{keyword}, which is not read; export all, in x, y, z")
    if keyword == "PART":
        found.now = options.get("NAME", "").upper()
        if found.now in found.parts:
            raise MeshError(f"{file}: holds two parts of the name '{options.get('NAME', '')}'; rename one")
        found.parts[found.now] = _Body()
    elif keyword == "END PART":
        found.now = None
    elif keyword == "INSTANCE":
        at = [v for number, text in lines for v in _numbers(file, number, text)]
        found.placed.append((options.get("NAME", ""), options.get("PART", ""), at))
    elif keyword == "NODE" and (found.now is not None or not found.parts):  # else reference points of the assembly
        for number, text in lines:
            label, *place = _numbers(file, number, text)
            found.body.nodes[int(label)] = tuple([*place[:3], 0.0, 0.0, 0.0][:3])
    elif keyword == "ELEMENT":
        _elements(file, found.body, options, lines)
    elif keyword == "ELSET":
        _set(file, found, options, lines)


def _elements(file: Path, body: _Body, options: Mapping[str, str], lines: Lines) -> None:
    kind = options.get("TYPE", "").upper()
    match = _TETRA.match(kind)
    if match is None:
        body.others |= {kind} if _VOLUME.match(kind) else set()
        return
    size = int(match[2]) + 1
    flat = [int(v) for number, text in lines for v in _numbers(file, number, text)]
    if len(flat) % size:
        raise MeshError(f"{file}: the *ELEMENT block that ends in line {lines[-1][0]} is cut short; export it again")
    cells = {flat[k]: tuple(flat[k + 1 : k + size]) for k in range(0, len(flat), size)}
    body.elements |= cells
    if name := options.get("ELSET"):
        body.spelled.setdefault(name.upper(), name)
        body.sets.setdefault(name.upper(), set()).update(cells)


def _set(file: Path, found: _File, options: Mapping[str, str], lines: Lines) -> None:
    numbers, names, key = set[int](), set[str](), options.get("ELSET", "").upper()
    for number, text in lines:
        words = [w.strip() for w in text.split(",") if w.strip()]
        if "GENERATE" in options:
            first, last, *step = (int(v) for v in _numbers(file, number, text))
            numbers.update(range(first, last + 1, step[0] if step else 1))
            continue
        numbers.update(int(w) for w in words if w.isdigit())
        names.update(w.upper() for w in words if not w.isdigit())
    instance = options.get("INSTANCE", "").upper()
    if instance or (found.now is None and found.placed):
        found.spelled.setdefault(key, options.get("ELSET", ""))
        members = found.assembled.setdefault(key, [])
        if instance:
            members.append((instance, numbers, names))
        for name in () if instance else names:  # a set of the assembly's sets, or of an instance's
            owner, _, inner = name.rpartition(".")
            members += [(owner, set(), {inner})] if owner else found.assembled.get(name, [])
        return
    body = found.body
    body.spelled.setdefault(key, options.get("ELSET", ""))
    body.sets.setdefault(key, set()).update(numbers)
    body.nested.setdefault(key, set()).update(names)


def _numbers(file: Path, line: int, text: str) -> list[float]:
    try:
        return [float(w) for w in text.split(",") if w.strip()]
    except ValueError:
        raise MeshError(f"{file}, line {line}: '{text[:40]}' are no numbers; export the mesh again") from None
