"""Patterns of sparse matrices put together in compiled code; :mod:`.operator` has the same by scipy."""

from __future__ import annotations

import numpy as np
from numba import njit

from ..typing import ComplexArray, FloatArray, IntArray


@njit(cache=True, nogil=True)
def sorted_upper(indptr: IntArray, indices: IntArray, data: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Upper triangle in CSR, columns ascending, without zeros, of a matrix whose columns are in any order."""
    n = len(indptr) - 1
    start = np.zeros(n + 1, np.int64)
    for i in range(n):
        for p in range(indptr[i], indptr[i + 1]):
            start[i + 1] += indices[p] >= i and data[p] != 0
    start = np.cumsum(start)
    columns, values = np.empty(start[n], np.int32), np.empty(start[n])
    for i in range(n):
        k = start[i]
        for p in range(indptr[i], indptr[i + 1]):
            if indices[p] >= i and data[p] != 0:
                columns[k], values[k] = indices[p], data[p]
                k += 1
        _sort_pairs(columns[start[i] : k], values[start[i] : k])
    return start, columns, values


@njit(cache=True, nogil=True)
def _sort_pairs(keys: IntArray, values: FloatArray) -> None:
    """Sort both by the keys where they lie, if they are not sorted yet."""
    for k in range(1, len(keys)):
        if keys[k] < keys[k - 1]:
            order = np.argsort(keys)
            keys[:], values[:] = keys[order], values[order]
            return


@njit(cache=True, nogil=True)
def union(a: IntArray, left: IntArray, b: IntArray, right: IntArray) -> tuple[IntArray, IntArray]:
    """Row starts and columns, ascending, of two patterns together: starts ``a`` with ``left``, ``b`` with ``right``."""
    start, columns = np.zeros_like(a), np.empty(len(left) + len(right), np.int32)
    k = 0
    for i in range(len(a) - 1):
        p, q = a[i], b[i]
        while p < a[i + 1] or q < b[i + 1]:
            if q == b[i + 1] or (p < a[i + 1] and left[p] <= right[q]):
                column = left[p]
            else:
                column = right[q]
            p += p < a[i + 1] and left[p] == column
            q += q < b[i + 1] and right[q] == column
            columns[k] = column
            k += 1
        start[i + 1] = k
    return start, columns[:k].copy()


@njit(cache=True, nogil=True)
def positions(indptr: IntArray, indices: IntArray, whole: IntArray, columns: IntArray) -> IntArray:
    """Where the entries of one pattern (nnz,) are in another that holds it, both with ascending columns."""
    found = np.empty(len(indices), np.int64)
    for i in range(len(indptr) - 1):
        q = whole[i]
        for p in range(indptr[i], indptr[i + 1]):
            while columns[q] != indices[p]:
                q += 1
            found[p] = q
    return found


@njit(cache=True, nogil=True)
def add_at(total: ComplexArray, places: IntArray, weight: complex, values: FloatArray) -> None:
    """Add ``weight`` times ``values`` (m,) at ``places`` (m,) of ``total``."""
    for k in range(len(places)):
        total[places[k]] += weight * values[k]
