"""Element matrices summed into sparse ones in compiled code; ``tissues`` has the same in NumPy, by sorting.

Patterns are those of node pairs: 3x3 blocks share one, and so do shear and mass.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...typing import FloatArray, IntArray
from .jit import kernel
from .sorting import sort_in_place


class Pattern(NamedTuple):
    """Row starts and columns, ascending, of pairs; ``place`` (n_tet, nr, nc) of each element's pairs among them."""

    indptr: IntArray
    indices: IntArray
    place: IntArray


@kernel
def pattern(rows: IntArray, columns: IntArray, n_rows: int, n_columns: int) -> Pattern:
    """Pairs of ``rows`` (n_tet, nr) and ``columns`` (n_tet, nc) of the same element."""
    start, touching = _elements_of(rows, n_rows)
    (n_tet, nr), nc = rows.shape, columns.shape[1]
    seen, where = np.full(n_columns, -1), np.empty(n_columns, np.int32)
    indptr = np.zeros(n_rows + 1, np.int64)
    for r in range(n_rows):
        count = 0
        for q in range(start[r], start[r + 1]):
            for c in columns[touching[q] // nr]:
                count += seen[c] != r
                seen[c] = r
        indptr[r + 1] = indptr[r] + count
    indices, place = np.empty(indptr[n_rows], np.int32), np.empty((n_tet, nr, nc), np.int32)
    seen[:] = -1
    for r in range(n_rows):
        k = indptr[r]
        for q in range(start[r], start[r + 1]):
            for c in columns[touching[q] // nr]:
                if seen[c] != r:
                    seen[c] = r
                    indices[k] = c
                    k += 1
        sort_in_place(indices[indptr[r] : k])
        for k in range(indptr[r], indptr[r + 1]):
            where[indices[k]] = k
        for q in range(start[r], start[r + 1]):
            t, a = touching[q] // nr, touching[q] % nr
            for b in range(nc):
                place[t, a, b] = where[columns[t, b]]
    return Pattern(indptr, indices, place)


@kernel
def _elements_of(rows: IntArray, n_rows: int) -> tuple[IntArray, IntArray]:
    """Starts, and element times nr plus number in it, of all that have each of the rows."""
    flat = np.ascontiguousarray(rows).ravel()
    start = np.zeros(n_rows + 1, np.int64)
    for r in flat:
        start[r + 1] += 1
    start = np.cumsum(start)
    touching, free = np.empty(len(flat), np.int64), start[:-1].copy()
    for k, r in enumerate(flat):
        touching[free[r]] = k
        free[r] += 1
    return start, touching


@kernel
def scalars(pairs: Pattern, volume: FloatArray, reference: FloatArray) -> FloatArray:
    """Values (nnz,) of element matrices ``volume`` (n_tet,) times ``reference`` (nr, nc)."""
    n_tet, nr, nc = pairs.place.shape
    values = np.zeros(len(pairs.indices))
    for t in range(n_tet):
        for a in range(nr):
            for b in range(nc):
                values[pairs.place[t, a, b]] += volume[t] * reference[a, b]
    return values


@kernel
def gradients(pairs: Pattern, inverse: FloatArray, volume: FloatArray, reference: FloatArray) -> FloatArray:
    """Values (3 nnz,), component fastest, of |J| sum_a (J^-1)_ai R_apb: ``reference`` (3, np, nb)."""
    n_tet, n_p, nb = pairs.place.shape
    values = np.zeros(3 * len(pairs.indices))
    for t in range(n_tet):
        for p in range(n_p):
            for b in range(nb):
                for i in range(3):
                    total = 0.0
                    for a in range(3):
                        total += inverse[t, a, i] * reference[a, p, b]
                    values[3 * pairs.place[t, p, b] + i] += volume[t] * total
    return values


@kernel
def shear(
    nodes: IntArray, pairs: Pattern, inverse: FloatArray, volume: FloatArray, reference: FloatArray
) -> FloatArray:
    """Values (9 nnz,) of the deviatoric stiffness, as :func:`blocks_of` has them; ``reference`` (9, nb nb)."""
    n_tet, nb = nodes.shape
    values, local = np.zeros(9 * len(pairs.indices)), np.empty((9, nb * nb))
    for t in range(n_tet):
        weights = _shear_weights(inverse[t], volume[t])
        for ij in range(9):
            _combine(local[ij], weights[ij], reference)
        for a in range(nb):
            first = pairs.indptr[nodes[t, a]]
            width = 3 * (pairs.indptr[nodes[t, a] + 1] - first)
            for b in range(nb):
                at = 9 * first + 3 * (pairs.place[t, a, b] - first)
                for i in range(3):
                    for j in range(3):
                        values[at + i * width + j] += local[3 * i + j, a * nb + b]
    return values


@kernel
def add_blocks_in_place(
    values: FloatArray, pairs: Pattern, nodes: IntArray, tetrahedra: IntArray, blocks: FloatArray
) -> None:
    """Add ``blocks`` (3, 3, k, nb, nb) of some ``tetrahedra`` (k,) to ``values`` (9 nnz,) as :func:`shear` has them."""
    nb = nodes.shape[1]
    for e, t in enumerate(tetrahedra):
        for a in range(nb):
            first = pairs.indptr[nodes[t, a]]
            width = 3 * (pairs.indptr[nodes[t, a] + 1] - first)
            for b in range(nb):
                at = 9 * first + 3 * (pairs.place[t, a, b] - first)
                for i in range(3):
                    for j in range(3):
                        values[at + i * width + j] += blocks[i, j, e, a, b]


@kernel
def add_scalars_in_place(values: FloatArray, pairs: Pattern, tetrahedra: IntArray, matrices: FloatArray) -> None:
    """Add ``matrices`` (k, nr, nc) of some ``tetrahedra`` (k,) to ``values`` (nnz,)."""
    for e, t in enumerate(tetrahedra):
        for a in range(matrices.shape[1]):
            for b in range(matrices.shape[2]):
                values[pairs.place[t, a, b]] += matrices[e, a, b]


@kernel
def add_gradients_in_place(values: FloatArray, pairs: Pattern, tetrahedra: IntArray, matrices: FloatArray) -> None:
    """Add ``matrices`` (3, k, np, nb) of some ``tetrahedra`` (k,) to ``values`` (3 nnz,), component fastest."""
    for e, t in enumerate(tetrahedra):
        for p in range(matrices.shape[2]):
            for b in range(matrices.shape[3]):
                for i in range(3):
                    values[3 * pairs.place[t, p, b] + i] += matrices[i, e, p, b]


@kernel
def _combine(total: FloatArray, weights: FloatArray, parts: FloatArray) -> None:
    """Set ``total`` (m,) to the weighted sum of nine ``parts`` (9, m), in one pass."""
    w = weights
    for q in range(len(total)):
        total[q] = (
            w[0] * parts[0, q] + w[1] * parts[1, q] + w[2] * parts[2, q]
            + w[3] * parts[3, q] + w[4] * parts[4, q] + w[5] * parts[5, q]
            + w[6] * parts[6, q] + w[7] * parts[7, q] + w[8] * parts[8, q]
        )  # fmt: skip


@kernel
def _shear_weights(inverse: FloatArray, volume: float) -> FloatArray:
    """Of the products of gradients (9, ab) in the block's entries (9, ij); see ``tissues.shear_blocks``."""
    weights = np.empty((9, 9))
    for a in range(3):
        for b in range(3):
            trace = 0.0
            for i in range(3):
                trace += volume * inverse[a, i] * inverse[b, i]
                for j in range(3):
                    turned = volume * inverse[a, i] * inverse[b, j]
                    weights[3 * i + j, 3 * a + b] = volume * inverse[a, j] * inverse[b, i] - (2 / 3) * turned
            for i in range(3):
                weights[4 * i, 3 * a + b] += trace
    return weights


@kernel
def blocks_of(indptr: IntArray, indices: IntArray, high: int) -> tuple[IntArray, IntArray]:
    """Row starts and columns where every pair stands for a block of ``high`` rows and three columns."""
    n = len(indptr) - 1
    starts, columns = np.zeros(high * n + 1, np.int64), np.empty(3 * high * len(indices), np.int32)
    k = 0
    for r in range(n):
        for i in range(high):
            for p in range(indptr[r], indptr[r + 1]):
                for j in range(3):
                    columns[k] = 3 * indices[p] + j
                    k += 1
            starts[high * r + i + 1] = k
    return starts, columns


@kernel
def diagonals_of(indptr: IntArray, indices: IntArray, values: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Row starts, columns and values where every pair stands for its value times a 3x3 identity."""
    n = len(indptr) - 1
    starts, columns = np.zeros(3 * n + 1, np.int64), np.empty(3 * len(indices), np.int32)
    whole = np.empty(3 * len(values))
    k = 0
    for r in range(n):
        for i in range(3):
            for p in range(indptr[r], indptr[r + 1]):
                columns[k], whole[k] = 3 * indices[p] + i, values[p]
                k += 1
            starts[3 * r + i + 1] = k
    return starts, columns, whole
