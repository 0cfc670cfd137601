"""Unknowns that are not free: held nodes, symmetry planes, and discs that move as one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array, csr_array

from ...errors import GeometryError
from ...typing import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class LinearConstraints:
    """Displacements u = T q: ``transform`` T (n_u, n_free) and the column of each rigid disc's displacement."""

    transform: csr_array
    masters: dict[str, int]

    def renumbered(self, order: IntArray) -> LinearConstraints:
        """The same rules with unknown ``order[i]`` as number i."""
        place = np.argsort(order)
        return LinearConstraints(self.transform[:, order], {name: int(place[i]) for name, i in self.masters.items()})


@dataclass(frozen=True)
class RigidDisc:
    """Nodes that move along ``axis`` (3,) by one unknown; ``bonded`` also holds their tangential motion at zero."""

    name: str
    nodes: IntArray
    axis: FloatArray
    bonded: bool


@dataclass(frozen=True)
class Triplets:
    """Entries of a sparse matrix under construction."""

    rows: IntArray
    columns: IntArray
    values: FloatArray


def constraints(
    n_nodes: int, held: IntArray, planes: dict[int, IntArray], discs: tuple[RigidDisc, ...]
) -> LinearConstraints:
    """Transform for nodes ``held`` still, nodes with component ``planes[component]`` zero, and rigid discs.

    Raises :class:`GeometryError` where a disc touches a held node or another disc.
    """
    seen: dict[int, str] = {int(n): "a held boundary" for n in held}
    for disc in discs:
        if len(disc.nodes) == 0:
            raise GeometryError(f"contact {disc.name} covers no mesh node; refine the mesh (mesh.size_contact)")
        for node in disc.nodes:
            if (other := seen.get(int(node))) is not None:
                raise GeometryError(f"contact {disc.name} touches {other}; move it or make its radius smaller")
            seen[int(node)] = f"contact {disc.name}"
    free = np.ones(3 * n_nodes, dtype=bool)
    free[(3 * held[:, None] + np.arange(3)).ravel()] = False
    for component, nodes in planes.items():
        free[3 * nodes + component] = False
    symmetric = free.copy()
    for disc in discs:
        free[(3 * disc.nodes[:, None] + np.arange(3)).ravel()] = False
    kept = np.flatnonzero(free)
    parts = [Triplets(kept, np.arange(len(kept)), np.ones(len(kept)))]
    masters, count = {}, len(kept)
    for disc in discs:
        masters[disc.name] = count
        part, count = _disc_entries(disc, symmetric, count)
        parts.append(part)
    rows, columns, values = (np.concatenate([getattr(p, k) for p in parts]) for k in ("rows", "columns", "values"))
    return LinearConstraints(csr_array(coo_array((values, (rows, columns)), shape=(3 * n_nodes, count))), masters)


def _disc_entries(disc: RigidDisc, allowed: BoolArray, first: int) -> tuple[Triplets, int]:
    """Columns of one disc: its displacement, then (frictionless) two tangential unknowns per node."""
    rows = (3 * disc.nodes[:, None] + np.arange(3)).ravel()
    normal = Triplets(rows, np.full(len(rows), first), np.tile(disc.axis, len(disc.nodes)))
    parts, count = [normal], first + 1
    for tangent in () if disc.bonded else tangents(disc.axis):
        usable = disc.nodes[[bool(np.all(allowed[3 * n + np.flatnonzero(np.abs(tangent) > 1e-9)])) for n in disc.nodes]]
        index = np.repeat(count + np.arange(len(usable)), 3)
        parts.append(Triplets((3 * usable[:, None] + np.arange(3)).ravel(), index, np.tile(tangent, len(usable))))
        count += len(usable)
    whole = [np.concatenate([getattr(p, k) for p in parts]) for k in ("rows", "columns", "values")]
    keep = allowed[whole[0]] & (whole[2] != 0)
    return replace(normal, rows=whole[0][keep], columns=whole[1][keep], values=whole[2][keep]), count


def tangents(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors that complete ``axis`` (3,) to an orthonormal frame; exact axes for a vertical one."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(axis, helper)
    first = first / np.linalg.norm(first)
    return first, np.cross(axis, first)
