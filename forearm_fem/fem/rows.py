"""Products of sparse matrices with columns, row by row in compiled code: sums stay in registers.

``x`` and results are given by their addresses, with ``width`` doubles in a row, eight at least. Where that is no
multiple of eight, the last eight of a row are worked out with the others and overlap them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numba.np.numpy_support import carray

from ..typing import ComplexArray, FloatArray, IntArray
from . import lanes as _lanes

lanes: Any = _lanes  # intrinsics, which type checkers do not follow
_BYTES = 64  # of a vector


@njit(cache=True, nogil=True)
def row_product(low: int, high: int, indices: IntArray, data: FloatArray, x: int, width: int, to: int) -> None:
    """Row of the product, for a matrix row with the entries ``low`` to ``high``."""
    at, last = 0, 8 * width - _BYTES
    while at <= last:
        if at + _BYTES < last:
            steps = min(_BYTES, last - at), min(2 * _BYTES, last - at), min(3 * _BYTES, last - at)
            _four(low, high, indices, data, x + at, 8 * width, to + at, steps)
            at += 4 * _BYTES
        else:
            _one(low, high, indices, data, x + at, 8 * width, to + at)
            at += _BYTES
        if last < at < last + _BYTES:
            at = last


@njit(cache=True, nogil=True)
def _four(
    low: int, high: int, indices: IntArray, data: FloatArray, x: int, row: int, to: int, steps: tuple[int, int, int]
) -> None:
    """Four vectors of a row of the product, ``steps`` bytes after the first."""
    a, b, c, d = lanes.no_doubles(), lanes.no_doubles(), lanes.no_doubles(), lanes.no_doubles()
    for p in range(low, high):
        at = x + row * indices[p]
        a = lanes.plus_scaled(a, lanes.doubles_at(at), data[p])
        b = lanes.plus_scaled(b, lanes.doubles_at(at + steps[0]), data[p])
        c = lanes.plus_scaled(c, lanes.doubles_at(at + steps[1]), data[p])
        d = lanes.plus_scaled(d, lanes.doubles_at(at + steps[2]), data[p])
    lanes.store(to, a)
    lanes.store(to + steps[0], b)
    lanes.store(to + steps[1], c)
    lanes.store(to + steps[2], d)


@njit(cache=True, nogil=True)
def _one(low: int, high: int, indices: IntArray, data: FloatArray, x: int, row: int, to: int) -> None:
    total = lanes.no_doubles()
    for p in range(low, high):
        total = lanes.plus_scaled(total, lanes.doubles_at(x + row * indices[p]), data[p])
    lanes.store(to, total)


@njit(cache=True, nogil=True)
def add_weighted_rows(
    rows: tuple[int, int], indptr: IntArray, indices: IntArray, data: FloatArray, x: int, width: int,
    weights: ComplexArray, totals: IntArray,
) -> None:  # fmt: skip
    """Add sum_t weights[o, t] A_t x to the complex columns at the address totals[o], for ``rows`` from and up to.

    Rows of A_t are entries indptr[t, i] to indptr[t, i + 1]; doubles are real and imaginary parts in turn.
    """
    padded = -(-width // 8) * 8
    row, turned, sums = np.zeros(padded), np.zeros(padded), np.zeros((len(totals), padded))
    used = [t for t in range(len(indptr)) if np.any(weights[:, t] != 0)]
    for i in range(rows[0], rows[1]):
        sums[:] = 0
        for t in used:
            if indptr[t, i] < indptr[t, i + 1]:
                row_product(indptr[t, i], indptr[t, i + 1], indices, data, x, width, row.ctypes.data)
                for c in range(0, width, 2):
                    turned[c], turned[c + 1] = -row[c + 1], row[c]
                for o in range(len(totals)):
                    _add_combined(weights[o, t], row, turned, sums[o])
        for o in range(len(totals)):
            total = carray(lanes.pointer(totals[o] + 8 * width * i), (width,), np.float64)
            for c in range(width):
                total[c] += sums[o, c]


@njit(cache=True, nogil=True)
def _add_combined(weight: complex, row: FloatArray, turned: FloatArray, total: FloatArray) -> None:
    """Add ``weight`` times a row of complex numbers to ``total``; ``turned`` is i times the row."""
    if weight == 0:
        return
    for c in range(0, 8 * len(total), _BYTES):
        at = total.ctypes.data + c
        part = lanes.plus_scaled(lanes.doubles_at(at), lanes.doubles_at(row.ctypes.data + c), weight.real)
        lanes.store(at, lanes.plus_scaled(part, lanes.doubles_at(turned.ctypes.data + c), weight.imag))


@njit(cache=True, nogil=True)
def chosen_rows(
    chosen: IntArray, indptr: IntArray, indices: IntArray, data: FloatArray, x: int, width: int, to: int
) -> None:
    """The ``chosen`` (m,) rows of A x at the address ``to``."""
    for k in range(len(chosen)):
        i = chosen[k]
        row_product(indptr[i], indptr[i + 1], indices, data, x, width, to + 8 * width * k)


@njit(cache=True, nogil=True)
def mirrored(indptr: IntArray, indices: IntArray, data: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """The whole of a symmetric matrix in CSR, columns ascending, from its upper triangle with them ascending."""
    n = len(indptr) - 1
    start = np.zeros(n + 1, np.int64)
    for i in range(n):
        for p in range(indptr[i], indptr[i + 1]):
            start[i + 1] += 1
            start[indices[p] + 1] += indices[p] != i
    start = np.cumsum(start)
    free, columns, values = start[:-1].copy(), np.empty(start[n], np.int32), np.empty(start[n])
    for i in range(n):
        for p in range(indptr[i], indptr[i + 1]):
            j = indices[p]
            columns[free[i]], values[free[i]] = j, data[p]
            free[i] += 1
            if j != i:
                columns[free[j]], values[free[j]] = i, data[p]
                free[j] += 1
    return start, columns, values
