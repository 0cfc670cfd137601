"""Users' tetrahedra: cells, regions, facets."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ...errors import AccuracyWarning, MeshError
from ...scenario.limb import MeshLimb
from ...typing import FloatArray, IntArray
from ..device.layout import Layout
from ..limb.filling import oriented
from ..mesh.files import read_quietly
from ..mesh.formats import volumes_of_gmsh
from ..mesh.tissue_mesh import FACES, SIDES, TissueMesh, boundary_faces, keys, mean_ratios, pieces
from .checks import check_extent, check_room, with_boundaries, without_bone
from .surfaces import at_words

# Checks of a foreign mesh: tetrahedra make one whole body; faults are named by the cell's number in the file.

_JOINED = 1e-7  # of the body's size: vertices closer than this are one
_HOLE = 24  # fewer facets around a cavity are cells that were lost, not a bone that was left out


def check_indices(file: Path, cells: IntArray, count: int) -> None:
    """Raise :class:`MeshError` for ``cells`` (m, 4) that name vertices beyond ``count``, one twice, or a set twice."""
    wrong = np.flatnonzero((cells < 0).any(axis=1) | (cells >= count).any(axis=1))
    if len(wrong):
        named = cells[wrong[0]]
        vertex = int(named[(named < 0) | (named >= count)][0])
        raise MeshError(
            f"{file}: {len(wrong)} tetrahedra name vertices that are not in the file, the first is number {wrong[0]} "
            f"with vertex {vertex} of {count}; export the mesh again"
        )
    ordered = np.sort(cells, axis=1)
    _check_distinct(file, ordered)
    _, first, inverse, often = np.unique(ordered, axis=0, return_index=True, return_inverse=True, return_counts=True)
    if (often > 1).any():
        again = np.setdiff1d(np.arange(len(cells)), first)
        raise MeshError(
            f"{file}: {len(again)} tetrahedra occur twice, the first is number {again[0]}, the same as "
            f"{first[inverse.ravel()[again[0]]]}; remove duplicate cells"
        )


def _check_distinct(file: Path, ordered: IntArray) -> None:
    twice = np.flatnonzero((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))
    if len(twice):
        raise MeshError(
            f"{file}: {len(twice)} tetrahedra have no volume, as two of their corners are one vertex; the first is "
            f"number {twice[0]}; remove them"
        )


def joined(points: FloatArray, cells: IntArray) -> tuple[FloatArray, IntArray]:
    """Points that are used, those that coincide made one, and ``cells`` (m, 4) of them.

    Programs that mesh tissue by tissue double the vertices between them: the tissues would not be joined.
    """
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = points[used], cells.reshape(-1, 4)
    pairs = cKDTree(points).query_pairs(_JOINED * float(np.ptp(points, axis=0).max()), output_type="ndarray")
    if not len(pairs):
        return points, cells
    _, first, label = np.unique(pieces(len(points), pairs), return_index=True, return_inverse=True)
    return points[first], label[cells]


def check_body(file: Path, points: FloatArray, cells: IntArray, least: float) -> None:
    """Raise :class:`MeshError` unless positively oriented ``cells`` (m, 4) fill one body without flaws, each of a mean
    ratio of at least ``least``.

    Not seen: cells lost at the surface, which leave a dent; and what touches without sharing vertices.
    """
    _check_distinct(file, np.sort(cells, axis=1))
    ratio = mean_ratios(points, cells)
    if (flat := np.flatnonzero(ratio < least)).size:
        worst = int(ratio.argmin())
        raise MeshError(
            f"{file}: {len(flat)} tetrahedra are flatter than mesh.min_quality = {least:g} allows, the worst is number "
            f"{worst} at {at_words(points[cells[worst]])} with quality {max(ratio[worst], 0):.1g}; remesh there"
        )
    _check_faces(file, points, cells)
    _check_boundary(file, points, cells)


def _check_faces(file: Path, points: FloatArray, cells: IntArray) -> None:
    """At most two cells share a face, from either side of it; all hang together by faces."""
    faces = cells[:, FACES].reshape(-1, 3)
    _, inverse, often = np.unique(keys(faces, len(points)), return_inverse=True, return_counts=True)
    order = np.argsort(inverse, kind="stable")
    if often.max() > 2:
        owners = order[inverse[order] == int(often.argmax())] // 4
        raise MeshError(
            f"{file}: tetrahedra {', '.join(map(str, owners[:4]))} all share one face, at most two can; remove cells "
            "that overlap"
        )
    shared = order[np.repeat(often == 2, often)].reshape(-1, 2)
    same = shared[_turns(faces[shared[:, 0]]) == _turns(faces[shared[:, 1]])]
    if len(same):
        a, b = same[0] // 4
        raise MeshError(
            f"{file}: tetrahedra {a} and {b} lie on the same side of the face they share, at "
            f"{at_words(points[cells[a]])} ({len(same)} such pairs); the mesh is folded over: remesh"
        )
    label = pieces(len(cells), shared // 4)
    if label.max():
        sizes = np.bincount(label)
        first = int(np.flatnonzero(label == sizes.argmin())[0])
        raise MeshError(
            f"{file}: falls into {len(sizes)} parts that share no face, the smallest of {sizes.min()} tetrahedra, "
            f"number {first} among them, at {at_words(points[cells[first]])}; join the parts or remove them"
        )


def _turns(faces: IntArray) -> IntArray:
    """+1 or -1 (n,): which way round the faces (n, 3) name their vertices."""
    a, b, c = faces.T
    return np.asarray(np.sign((b - a) * (c - b) * (a - c)))


def _check_boundary(file: Path, points: FloatArray, cells: IntArray) -> None:
    """The boundary is closed surfaces that do not touch themselves; cavities are large enough to be meant."""
    faces, owner = boundary_faces(cells)
    sides = faces[:, SIDES].reshape(-1, 2)
    _, inverse, often = np.unique(keys(sides, len(points)), return_inverse=True, return_counts=True)
    if (often != 2).any():
        at = int(owner[int(np.flatnonzero(often[inverse] != 2)[0]) // 3])
        raise MeshError(
            f"{file}: the boundary touches itself along {int((often != 2).sum())} edges, the first of tetrahedron {at} "
            f"at {at_words(points[cells[at]])}; cells are missing there, or parts meet in an edge only"
        )
    order = np.argsort(inverse, kind="stable").reshape(-1, 2) // 3
    piece = pieces(len(faces), order)
    a, b, c = points[faces].transpose(1, 0, 2)
    volume = np.bincount(piece, weights=np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)
    facets = np.bincount(piece)
    if (small := np.flatnonzero((volume < 0) & (facets < _HOLE))).size:
        where = points[faces[piece == small[0]]].reshape(-1, 3)
        raise MeshError(
            f"{file}: {len(small)} cavities, the first at {at_words(where)} with {facets[small[0]]} facets; tetrahedra "
            f"are missing there (a bone that is left out has {_HOLE} facets or more)"
        )


# The user's own tetrahedral mesh: regions named or numbered in the file become tissues.

_NUMBERED = ("gmsh:physical", "region", "medit:ref", "cell_tags", "tetgen:ref", "su2:tag", "nastran:ref",
             "avsucd:material", "gmsh:geometrical", "material", "subdomain")  # fmt: skip
ALL = "*"  # of limb.regions: what is not named
_KINDS, _FLAT_KINDS = ("tetra", "tetra10"), ("line", "triangle", "quad", "polygon")
_MIDDLES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))  # whose middles the nodes 4 to 9 of a tetra10 are (VTK)
_BENT = 1e-3  # of an edge: a middle further off its chord than this is meant


def user_mesh(limb: MeshLimb, base: Path, layout: Layout, least: float, *, keep_bone: bool) -> TissueMesh:
    """Mesh of ``limb.file``: tissues by ``limb.regions``, metres, positive tetrahedra, named boundaries.

    It must have room for the device of ``layout`` and no cell of a quality below ``least``. Cells may turn either way
    round, and vertices between tissues may be doubled. Raises :class:`MeshError` or :class:`GeometryError` with the
    number of the cell or vertex at fault, counted from 0 over all tetrahedra.
    """
    file = base / limb.file
    if not file.is_file():
        raise MeshError(f"{file}: no such mesh file; limb.file is relative to the scenario's folder")
    read = read_quietly(file)
    tetrahedra = _tetrahedra(file, read)
    points = np.asarray(read.points, dtype=float) * limb.unit
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshError(f"{file}: points have {points.shape[-1]} coordinates, need 3; give a volume mesh")
    tetrahedra, read = _once(tetrahedra, read, limb)
    check_indices(file, tetrahedra, len(points))
    names = tuple(dict.fromkeys(limb.regions.values()))
    region = _tissues(file, limb, _labels(file, read, limb, len(tetrahedra)), names)
    check_extent(file, points[np.unique(tetrahedra)], limb.unit)
    _check_straight(file, read, points)
    points, tetrahedra = joined(points, tetrahedra)
    tetrahedra = oriented(points, tetrahedra)
    check_body(file, points, tetrahedra, least)
    mesh = TissueMesh(points, tetrahedra, region, names, {})
    mesh = mesh if keep_bone else without_bone(mesh)
    check_room(file, mesh.points, layout, limb.unit)
    return with_boundaries(mesh)


def _tetrahedra(file: Path, read: Any) -> IntArray:
    """Corner nodes of all tetrahedra; the middles of quadratic ones are looked at by :func:`_check_straight`."""
    blocks = [c.data[:, :4] for c in read.cells if c.type in _KINDS and len(c.data)]
    kinds = {str(c.type) for c in read.cells}
    others = kinds - {*_KINDS, "vertex"} - {k for k in kinds if k.startswith(_FLAT_KINDS)}
    if others:
        raise MeshError(f"{file}: contains {_some(sorted(others))} cells, but only tetrahedra can be used; split them")
    if not blocks:
        found = f" (only {_some(sorted(kinds))})" if kinds else ""
        raise MeshError(f"{file}: contains no tetrahedra{found}; mesh the volume, not the surface")
    return np.vstack(blocks).astype(np.int64)


def _once(cells: IntArray, read: Any, limb: MeshLimb) -> tuple[IntArray, Any]:
    """Cells that gmsh wrote once for each of their physical groups, once: with the group that limb.regions names."""
    if "gmsh:physical" not in read.cell_data:
        return cells, read
    chosen = [i for i, c in enumerate(read.cells) if c.type in _KINDS and len(c.data)]
    _, first, again = np.unique(np.sort(cells, axis=1), axis=0, return_index=True, return_inverse=True)
    if len(first) == len(cells):
        return cells, read
    tags = np.concatenate([np.abs(np.ravel(read.cell_data["gmsh:physical"][i])) for i in chosen])
    names = _names(read)
    meant = np.array([any(n in limb.regions for n in (*names.get(int(k), ()), str(int(k)))) for k in tags])
    keep = np.zeros(len(cells), dtype=bool)
    groups = again.ravel()
    for group in np.unique(groups[np.bincount(groups)[groups] > 1]):
        members = np.flatnonzero(groups == group)
        if len(set(tags[members].tolist())) < len(members):
            return cells, read  # twice in one group: that is no way to write several
        keep[members[meant[members]] if meant[members].any() else members[:1]] = True
    keep |= np.bincount(groups)[groups] == 1
    start = 0
    for i in chosen:
        size = len(read.cells[i].data)
        rows = keep[start : start + size]
        read.cells[i].data = read.cells[i].data[rows]
        for values in read.cell_data.values():
            values[i] = np.asarray(values[i])[rows]
        start += size
    return cells[keep], read


def _check_straight(file: Path, read: Any, points: FloatArray) -> None:
    """Edges of quadratic tetrahedra must be straight, as the elements made of them will be."""
    start = 0
    for block in read.cells:
        if block.type == "tetra10" and len(block.data):
            nodes = np.asarray(block.data, dtype=np.int64)
            if nodes.min() < 0 or nodes.max() >= len(points):
                raise MeshError(f"{file}: tetra10 cells name middles that are not in the file; export the mesh again")
            a, b = (points[nodes[:, k]] for k in np.array(_MIDDLES).T)
            off = np.linalg.norm(points[nodes[:, 4:]] - (a + b) / 2, axis=2) / np.linalg.norm(a - b, axis=2)
            bent = np.flatnonzero(~(off < _BENT).all(axis=1))
            if len(bent):
                raise MeshError(
                    f"{file}: {len(bent)} tetra10 cells have bent edges, the first is number {start + bent[0]}, off "
                    f"its chord by {100 * off[bent[0]].max():.2g} % of its length; export straight ones (first order)"
                )
        start += len(block.data) if block.type in _KINDS else 0


def _labels(file: Path, read: Any, limb: MeshLimb, count: int) -> list[str]:
    """Region name or number of every tetrahedron, as text; names of groups win over numbers."""
    chosen = [i for i, c in enumerate(read.cells) if c.type in _KINDS and len(c.data)]
    key = limb.region_array
    if key is not None:
        if key not in read.cell_data:
            found = _some([k for k in read.cell_data if not k.startswith("gmsh:bounding")]) or "none"
            raise MeshError(f"{file}: has no cell data '{key}' (limb.region_array); it has {found}")
    elif set(limb.regions) == {ALL}:
        return [ALL] * count
    else:
        key = _recognised(file, read, limb, chosen)
        if key is None:
            return _from_sets(file, read, limb, chosen, count)
    parts = []
    for i in chosen:
        stored = np.asarray(read.cell_data[key][i])
        if stored.dtype.kind not in "iufb" or stored.ndim > 2 or stored.shape[1:] not in ((), (1,)):
            raise MeshError(
                f"{file}: cell data '{key}' has the shape {stored.shape} and type {stored.dtype}, expected one number "
                "for each tetrahedron"
            )
        parts.append(stored.reshape(len(stored)))
    numbers = np.concatenate(parts)
    if len(numbers) != count:
        raise MeshError(f"{file}: cell data '{key}' has {len(numbers)} entries for {count} tetrahedra; need one each")
    broken = np.flatnonzero(~np.isfinite(numbers) | (numbers != np.round(numbers)))
    if len(broken):
        raise MeshError(
            f"{file}: cell data '{key}' of {len(broken)} tetrahedra are no whole numbers, the first is "
            f"{numbers[broken[0]]:g} of number {broken[0]}; give each region a whole number"
        )
    whole = numbers.astype(np.int64)
    if key == "gmsh:physical":  # a negative one is the same group, its cells turned round
        whole = np.abs(whole)
    names = _names(read)
    several = _groups(file, read, chosen) if key == "gmsh:physical" else {}
    return [_said(k, _named(k, several.get((k, e), (k,)), names), limb) for k, e in zip(
        whole.tolist(), _entities(read, chosen, count), strict=True)]  # fmt: skip


def _recognised(file: Path, read: Any, limb: MeshLimb, chosen: list[int]) -> str | None:
    """The cell data that number regions: by a usual name, else the one array of whole numbers, with a warning."""
    here = {k: [np.asarray(v[i]) for i in chosen] for k, v in read.cell_data.items()}
    usual = [k for k in _NUMBERED if k in here]
    for k in usual:  # groups that no volume is in leave the entities
        if any(np.any(v) for v in here[k]) or len(usual) == 1:
            return str(k)
    if usual:
        return str(usual[0])
    if any(n in limb.regions for n in read.cell_sets):
        return None
    whole = [k for k, parts in here.items() if not k.startswith(("gmsh:", "cell_")) and all(
        v.ndim == 1 and v.dtype.kind in "iub" for v in parts)]  # fmt: skip
    fitting = [k for k in whole if {str(int(n)) for v in here[k] for n in np.unique(v)} <= {*limb.regions}]
    if len(fitting) == 1 or (len(whole) == 1 and not fitting):
        key = str((fitting or whole)[0])
        warnings.warn(
            f"{file}: regions are taken from the cell data '{key}'; limb.region_array = '{key}' says so",
            AccuracyWarning, stacklevel=5,
        )  # fmt: skip
        return key
    return None


def _entities(read: Any, chosen: list[int], count: int) -> list[int]:
    """gmsh's entity of each tetrahedron; 0 where there is none."""
    if "gmsh:geometrical" not in read.cell_data:
        return [0] * count
    return [int(e) for i in chosen for e in np.ravel(read.cell_data["gmsh:geometrical"][i])]


def _groups(file: Path, read: Any, chosen: list[int]) -> dict[tuple[int, int], tuple[int, ...]]:
    """All physical groups of gmsh's volumes, (first group, entity) -> groups, of which meshio keeps the first alone."""
    if file.suffix.lower() != ".msh" or "gmsh:geometrical" not in read.cell_data:
        return {}
    several = volumes_of_gmsh(file)
    return {(groups[0], entity): groups for entity, groups in several.items() if groups}


def _named(number: int, groups: tuple[int, ...], names: dict[int, tuple[str, ...]]) -> tuple[str, ...]:
    """Names of a number, and of other groups of the same cells, numbers among them."""
    if groups == (number,):
        return names.get(number, ())
    return tuple(n for g in groups for n in (*names.get(g, ()), str(g)))


def _names(read: Any) -> dict[int, tuple[str, ...]]:
    """Names of the file's numbers: gmsh's physical volumes, or the groups of MED's families, several a cell perhaps."""
    gmsh = {n: t for n, t in read.field_data.items() if np.shape(t) == (2,) and np.asarray(t).dtype.kind in "iu"}
    volumes = {int(tag[0]): (name,) for name, tag in gmsh.items() if int(tag[1]) == 3}
    return {**volumes, **{int(k): tuple(v) for k, v in getattr(read, "cell_tags", {}).items()}}


def _said(number: int, names: tuple[str, ...], limb: MeshLimb) -> str:
    """A region as ``limb.regions`` calls it: by one of its names or its number; else by its first name."""
    known = [n for n in (*names, str(number)) if n in limb.regions]
    if len(set(known)) > 1 and len({limb.regions[n] for n in known}) > 1:
        raise MeshError(
            f"cells are in the groups {_some(dict.fromkeys(known))} at once, and limb.regions gives these several "
            "tissues; name one of them only"
        )
    if not known and ALL in limb.regions:
        return ALL
    return known[0] if known else (*names, str(number))[0]


def _from_sets(file: Path, read: Any, limb: MeshLimb, chosen: list[int], count: int) -> list[str]:
    """Names of the cell sets: of those in limb.regions if there are any, as files hold sets of other kinds too."""
    sets = {n: m for n, m in read.cell_sets.items() if n in limb.regions} or dict(read.cell_sets)
    labels = [""] * count
    start = 0
    for i in chosen:
        for name, members in sets.items():
            for k in np.asarray(members[i] if members[i] is not None else [], dtype=np.int64):
                if labels[start + int(k)] not in ("", name):
                    raise MeshError(
                        f"{file}: tetrahedron {start + int(k)} is in the sets '{labels[start + int(k)]}' and "
                        f"'{name}'; name only one of them in limb.regions, or make them disjoint"
                    )
                labels[start + int(k)] = name
        start += len(read.cells[i].data)
    if ALL in limb.regions:
        labels = [label if label in limb.regions else ALL for label in labels]
    if "" in labels:
        found = _some([*read.cell_data, *read.cell_sets])
        raise MeshError(
            f"{file}: {labels.count('')} tetrahedra carry no region, the first is number {labels.index('')}; expected "
            f"cell data such as {', '.join(_NUMBERED[:2])} or named cell sets, found {found or 'none'}; name the array "
            "by limb.region_array, or give one tissue to all: limb.regions = {'*' = 'muscle'}"
        )
    return labels


def _tissues(file: Path, limb: MeshLimb, label: list[str], names: tuple[str, ...]) -> IntArray:
    unknown = sorted(set(label) - set(limb.regions))
    if unknown:
        raise MeshError(
            f"{file}: regions {_some(unknown)} have no tissue, the first is of tetrahedron {label.index(unknown[0])}; "
            f"add them to limb.regions (it maps {_some(limb.regions) or 'nothing'})"
        )
    absent = sorted(set(limb.regions) - set(label) - {ALL})
    if absent:
        raise MeshError(
            f"{file}: limb.regions names {_some(absent)}, but the file holds {_some(sorted(set(label)))}; "
            "correct the name or number"
        )
    number = {key: names.index(tissue) for key, tissue in limb.regions.items()}
    return np.array([number[k] for k in label], dtype=np.int64)


def _some(names: Iterable[str]) -> str:
    """The first names, short enough for a sentence."""
    short = [name if len(name) <= 20 else f"{name[:19]}..." for name in names]
    return ", ".join(short[:3]) + (f" and {len(short) - 3} more" if len(short) > 3 else "")
