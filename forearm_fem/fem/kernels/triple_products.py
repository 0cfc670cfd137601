"""Sums and products of sparse matrices in compiled code; ``operator`` and :mod:`.sparse` have the same by scipy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...typing import ComplexArray, FloatArray, IntArray
from .jit import kernel
from .sorting import sort_in_place


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
    start = np.cumsum(start)
    seen[:] = -1
    end, indices, data = start[:-1].copy(), np.empty(start[width], np.int32), np.empty(start[width])
    for i in range(n):
        for j in found[: _row(i, rows, matrix, columns, seen, found, total)]:
            indices[end[j]], data[end[j]] = i, total[j]
            end[j] += 1
            total[j] = 0.0
    return Sparse(start, indices, data)


@kernel
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
    start = np.cumsum(start)
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


@kernel
def add_at(total: ComplexArray, places: IntArray, weight: complex, values: FloatArray) -> None:
    """Add ``weight`` times ``values`` (m,) at ``places`` (m,) of ``total``."""
    for k in range(len(places)):
        total[places[k]] += weight * values[k]
