"""Products of sparse matrices with columns, row by row in compiled code: sums stay in registers.

``x`` and results are given by their addresses, with ``width`` numbers in a row, eight at least. Where that is no
multiple of eight, the last eight of a row are worked out with the others and overlap them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.np.numpy_support import carray
from numpy.typing import NDArray

from ...typing import ComplexArray, FloatArray, IntArray
from . import simd as _lanes
from .jit import kernel

lanes: Any = _lanes  # intrinsics, which type checkers do not follow
_LANES = 8  # doubles of a vector
_BYTES = 64  # of a vector


@kernel
def row_product(
    low: int, high: int, indices: IntArray, data: FloatArray, x: int, like: NDArray[Any], width: int, to: int
) -> None:
    """Row of the product, for a matrix row with the entries ``low`` to ``high``; numbers of x are ``like`` these."""
    at, last = 0, width - _LANES
    while at <= last:
        if at + _LANES < last:
            steps = min(_LANES, last - at), min(2 * _LANES, last - at), min(3 * _LANES, last - at)
            _four(low, high, indices, data, x + like.itemsize * at, like, width, to + 8 * at, steps)
            at += 4 * _LANES
        elif at < last:
            _two(low, high, indices, data, x + like.itemsize * at, like, width, to + 8 * at, last - at)
            return
        else:
            _one(low, high, indices, data, x + like.itemsize * at, like, width, to + 8 * at)
            at += _LANES
        if last < at < last + _LANES:
            at = last


@kernel
def _four(
    low: int, high: int, indices: IntArray, data: FloatArray, x: int, like: NDArray[Any], width: int, to: int,
    steps: tuple[int, int, int],
) -> None:  # fmt: skip
    """Four vectors of a row of the product, ``steps`` columns after the first."""
    a, b, c, d = lanes.no_doubles(), lanes.no_doubles(), lanes.no_doubles(), lanes.no_doubles()
    size = like.itemsize
    for p in range(low, high):
        at = x + size * width * indices[p]
        a = lanes.plus_scaled(a, lanes.as_doubles(at, like), data[p])
        b = lanes.plus_scaled(b, lanes.as_doubles(at + size * steps[0], like), data[p])
        c = lanes.plus_scaled(c, lanes.as_doubles(at + size * steps[1], like), data[p])
        d = lanes.plus_scaled(d, lanes.as_doubles(at + size * steps[2], like), data[p])
    lanes.store(to, a)
    lanes.store(to + 8 * steps[0], b)
    lanes.store(to + 8 * steps[1], c)
    lanes.store(to + 8 * steps[2], d)


@kernel
def _two(
    low: int, high: int, indices: IntArray, data: FloatArray, x: int, like: NDArray[Any], width: int, to: int, step: int
) -> None:
    """Two vectors of a row of the product, ``step`` columns apart."""
    a, b = lanes.no_doubles(), lanes.no_doubles()
    for p in range(low, high):
        at = x + like.itemsize * width * indices[p]
        a = lanes.plus_scaled(a, lanes.as_doubles(at, like), data[p])
        b = lanes.plus_scaled(b, lanes.as_doubles(at + like.itemsize * step, like), data[p])
    lanes.store(to, a)
    lanes.store(to + 8 * step, b)


@kernel
def _one(
    low: int, high: int, indices: IntArray, data: FloatArray, x: int, like: NDArray[Any], width: int, to: int
) -> None:
    total = lanes.no_doubles()
    for p in range(low, high):
        total = lanes.plus_scaled(total, lanes.as_doubles(x + like.itemsize * width * indices[p], like), data[p])
    lanes.store(to, total)


@kernel
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
                row_product(indptr[t, i], indptr[t, i + 1], indices, data, x, data, width, row.ctypes.data)
                for c in range(0, width, 2):
                    turned[c], turned[c + 1] = -row[c + 1], row[c]
                for o in range(len(totals)):
                    _add_combined(weights[o, t], row, turned, sums[o])
        for o in range(len(totals)):
            total = carray(lanes.pointer(totals[o] + 8 * width * i), (width,), np.float64)
            for c in range(width):
                total[c] += sums[o, c]


@kernel
def _add_combined(weight: complex, row: FloatArray, turned: FloatArray, total: FloatArray) -> None:
    """Add ``weight`` times a row of complex numbers to ``total``; ``turned`` is i times the row."""
    if weight == 0:
        return
    for c in range(0, 8 * len(total), _BYTES):
        at = total.ctypes.data + c
        part = lanes.plus_scaled(lanes.doubles_at(at), lanes.doubles_at(row.ctypes.data + c), weight.real)
        lanes.store(at, lanes.plus_scaled(part, lanes.doubles_at(turned.ctypes.data + c), weight.imag))


@kernel
def weighted_rows(
    rows: tuple[int, int], indptr: IntArray, indices: IntArray, data: FloatArray, sources: IntArray,
    weights: FloatArray, total: FloatArray,
) -> None:  # fmt: skip
    """``rows`` from and up to of sum_j sum_t weights[j, t] A_t x_j, for real columns x_j at addresses sources[j]."""
    width = total.shape[1]
    row, sums = np.zeros(-(-width // _LANES) * _LANES), np.zeros(-(-width // _LANES) * _LANES)
    for i in range(rows[0], rows[1]):
        sums[:] = 0
        for t in range(len(indptr)):
            if indptr[t, i] < indptr[t, i + 1]:
                for j in range(len(sources)):
                    if weights[j, t] != 0:
                        low, high = indptr[t, i], indptr[t, i + 1]
                        row_product(low, high, indices, data, sources[j], data, width, row.ctypes.data)
                        _add_scaled(weights[j, t], row, sums)
        for c in range(width):
            total[i, c] = sums[c]


@kernel
def _add_scaled(weight: float, row: FloatArray, total: FloatArray) -> None:
    for c in range(0, 8 * len(total), _BYTES):
        at = total.ctypes.data + c
        lanes.store(at, lanes.plus_scaled(lanes.doubles_at(at), lanes.doubles_at(row.ctypes.data + c), weight))


@kernel
def some_rows(
    rows: tuple[int, int], indptr: IntArray, indices: IntArray, data: FloatArray, x: NDArray[Any], y: FloatArray
) -> None:
    """``rows`` from and up to of A x, for columns ``x`` in single or double precision."""
    for i in range(rows[0], rows[1]):
        to = y.ctypes.data + y.strides[0] * (i - rows[0])
        row_product(indptr[i], indptr[i + 1], indices, data, x.ctypes.data, x, x.shape[1], to)


@kernel
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
