"""Whether somebody else's tetrahedra make one whole body; what is wrong is named by the cell's number in the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ...errors import MeshError
from ...typing import FloatArray, IntArray
from ..mesh.topology import FACES, SIDES, boundary_faces, keys, mean_ratios, pieces
from .shells import at_words

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
