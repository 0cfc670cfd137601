"""Compiled scatter of element matrices into sparse ones, and sparse triple products."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...typing import FloatArray, IntArray
from .jit import inner_kernel, kernel

# Short rows of column numbers put in order in compiled code: numba's own sort takes seconds to compile.


@inner_kernel
def sort_in_place(keys: IntArray) -> None:
    """Put ``keys`` (m,) in ascending order; m is a row's entries, some hundreds (Shell 1959, gaps of Knuth)."""
    gap = 1
    while 3 * gap + 1 < len(keys):
        gap = 3 * gap + 1
    while gap:
        for k in range(gap, len(keys)):
            key, at = keys[k], k
            while at >= gap and keys[at - gap] > key:
                keys[at] = keys[at - gap]
                at -= gap
            keys[at] = key
        gap //= 3


@inner_kernel
def add_up(counts: IntArray) -> None:
    """Running sums in place: starts of rows from a zero and the entries of each. NumPy's take longer to compile."""
    for k in range(1, len(counts)):
        counts[k] += counts[k - 1]


# Sums and products of sparse matrices in compiled code; ``operator`` and :mod:`.sparse` have the same by scipy.


class Sparse(NamedTuple):
    """A sparse matrix by rows."""

    indptr: IntArray
    indices: IntArray
    data: FloatArray


@kernel
def transposed_product(rows: Sparse, matrix: Sparse, columns: Sparse, width: int) -> Sparse:
    """Transpose (width, n) of the product of three matrices, columns ascending.

    Rows (n) of the product come one after the other, so each entry is put at the end of the row that its column names.
    """
    n = len(rows.indptr) - 1
    seen, found, total = np.full(width, -1), np.empty(width, np.int64), np.zeros(width)
    start = np.zeros(width + 1, np.int64)
    for i in range(n):
        for j in found[: _row(i, rows, matrix, columns, seen, found, total)]:
            start[j + 1] += 1
            total[j] = 0.0
    add_up(start)
    seen[:] = -1
    end, indices, data = start[:-1].copy(), np.empty(start[width], np.int32), np.empty(start[width])
    for i in range(n):
        for j in found[: _row(i, rows, matrix, columns, seen, found, total)]:
            indices[end[j]], data[end[j]] = i, total[j]
            end[j] += 1
            total[j] = 0.0
    return Sparse(start, indices, data)


@inner_kernel
def _row(
    i: int, rows: Sparse, matrix: Sparse, columns: Sparse, seen: IntArray, found: IntArray, total: FloatArray
) -> int:
    """Add row i of the product to ``total`` (n,), where it lies to ``found``, and return how many those are."""
    count = 0
    for p in range(rows.indptr[i], rows.indptr[i + 1]):
        k = rows.indices[p]
        for q in range(matrix.indptr[k], matrix.indptr[k + 1]):
            k2, weight = matrix.indices[q], rows.data[p] * matrix.data[q]
            for r in range(columns.indptr[k2], columns.indptr[k2 + 1]):
                j = columns.indices[r]
                if seen[j] != i:
                    seen[j] = i
                    found[count] = j
                    count += 1
                total[j] += weight * columns.data[r]
    return count


@kernel
def sorted_upper(indptr: IntArray, indices: IntArray, data: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Upper triangle in CSR, columns ascending, of a matrix whose columns are in any order."""
    n = len(indptr) - 1
    start = np.zeros(n + 1, np.int64)
    for i in range(n):
        for p in range(indptr[i], indptr[i + 1]):
            start[i + 1] += indices[p] >= i
    add_up(start)
    columns, values, row = np.empty(start[n], np.int32), np.empty(start[n]), np.empty(n)
    for i in range(n):
        k = start[i]
        for p in range(indptr[i], indptr[i + 1]):
            if indices[p] >= i:
                columns[k], row[indices[p]] = indices[p], data[p]
                k += 1
        sort_in_place(columns[start[i] : k])
        for p in range(start[i], k):
            values[p] = row[columns[p]]
    return start, columns, values


@kernel
def merged(starts: IntArray, columns: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Row starts and columns, ascending, of several patterns together, and the place of every entry among them.

    Row i of pattern t is ``columns[starts[t, i] : starts[t, i + 1]]``, ascending.
    """
    count, n = starts.shape[0], starts.shape[1] - 1
    indptr, indices = np.zeros(n + 1, np.int64), np.empty(len(columns), np.int32)
    places, at, stop = np.empty(len(columns), np.int32), np.empty(count, np.int64), np.empty(count, np.int64)
    k = 0
    for i in range(n):
        left = 0  # patterns that have some of this row left
        for t in range(count):
            if starts[t, i] < starts[t, i + 1]:
                at[left], stop[left] = starts[t, i], starts[t, i + 1]
                left += 1
        while left:
            lowest = columns[at[0]]
            for t in range(1, left):
                lowest = min(lowest, columns[at[t]])
            indices[k] = lowest
            for t in range(left - 1, -1, -1):
                if columns[at[t]] == lowest:
                    places[at[t]] = k
                    at[t] += 1
                    if at[t] == stop[t]:
                        left -= 1
                        at[t], stop[t] = at[left], stop[left]
            k += 1
        indptr[i + 1] = k
    return indptr, indices[:k].copy(), places


# Element matrices summed into sparse ones in compiled code; ``tissues`` has the same in NumPy, by sorting.
# Patterns are those of node pairs: 3x3 blocks share one, and so do shear and mass.


class Pattern(NamedTuple):
    """Row starts and columns, ascending, of pairs; ``place`` (n_tet, nr, nc) of each element's pairs among them."""

    indptr: IntArray
    indices: IntArray
    place: IntArray


@kernel
def pattern(rows: IntArray, columns: IntArray, n_rows: int, n_columns: int) -> Pattern:
    """Pairs of ``rows`` (n_tet, nr) and ``columns`` (n_tet, nc) of the same element."""
    start, touching = _elements_of(rows, n_rows)
    n_tet, nr, nc = rows.shape[0], rows.shape[1], columns.shape[1]
    seen, where = np.full(n_columns, -1), np.empty(n_columns, np.int32)
    indptr = np.zeros(n_rows + 1, np.int64)
    for r in range(n_rows):
        count = 0
        for q in range(start[r], start[r + 1]):
            for b in range(nc):
                c = columns[touching[q] // nr, b]
                count += seen[c] != r
                seen[c] = r
        indptr[r + 1] = indptr[r] + count
    indices, place = np.empty(indptr[n_rows], np.int32), np.empty((n_tet, nr, nc), np.int32)
    seen[:] = -1
    for r in range(n_rows):
        k = indptr[r]
        for q in range(start[r], start[r + 1]):
            for b in range(nc):
                c = columns[touching[q] // nr, b]
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


@inner_kernel
def _elements_of(rows: IntArray, n_rows: int) -> tuple[IntArray, IntArray]:
    """Starts, and element times nr plus number in it, of all that have each of the rows."""
    n_tet, nr = rows.shape
    start = np.zeros(n_rows + 1, np.int64)
    for t in range(n_tet):
        for a in range(nr):
            start[rows[t, a] + 1] += 1
    add_up(start)
    touching, free = np.empty(n_tet * nr, np.int64), start[:-1].copy()
    for t in range(n_tet):
        for a in range(nr):
            r = rows[t, a]
            touching[free[r]] = nr * t + a
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


@inner_kernel
def _combine(total: FloatArray, weights: FloatArray, parts: FloatArray) -> None:
    """Set ``total`` (m,) to the weighted sum of nine ``parts`` (9, m), in one pass."""
    w = weights
    for q in range(len(total)):
        total[q] = (
            w[0] * parts[0, q] + w[1] * parts[1, q] + w[2] * parts[2, q]
            + w[3] * parts[3, q] + w[4] * parts[4, q] + w[5] * parts[5, q]
            + w[6] * parts[6, q] + w[7] * parts[7, q] + w[8] * parts[8, q]
        )  # fmt: skip


@inner_kernel
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
