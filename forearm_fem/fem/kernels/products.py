"""Compiled products of sparse matrices with few vectors, and of tall and skinny blocks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.np.numpy_support import carray
from numpy.typing import NDArray

from ...typing import ComplexArray, FloatArray, IntArray
from . import simd as _lanes
from .jit import inner_kernel, kernel
from .scatter import add_up

# Products of long columns with few others in compiled code, which BLAS would pack the long ones for.
# Columns may be in single or double precision; sums and the few others are in double precision.

lanes: Any = _lanes  # intrinsics, which type checkers do not follow
PAIR = 16  # doubles in two vectors
_ROWS = 64  # at a time: with as many columns of a block they stay in the nearest cache
_VECTOR = 64  # bytes


@kernel
def add_inner(block: FloatArray, columns: FloatArray, total: FloatArray) -> None:
    """total (k, w) += block (n, k)^T columns (n, m), where w is m or the next multiple of 16."""
    part = np.zeros((_ROWS, total.shape[1]))
    for begin in range(0, len(block), _ROWS):
        count = min(_ROWS, len(block) - begin)
        _copy(columns[begin : begin + count], part)
        _add_product(block[begin : begin + count].T, part, total)


@kernel
def add_combination(block: FloatArray, known: FloatArray, total: FloatArray) -> None:
    """total (n, m) += block (n, k) known (k, w), where w is m or the next multiple of 16."""
    part = np.zeros((_ROWS, known.shape[1]))
    for begin in range(0, len(block), _ROWS):
        count = min(_ROWS, len(block) - begin)
        _copy(total[begin : begin + count], part)
        _add_product(block[begin : begin + count], known, part)
        _copy(part[:count, : total.shape[1]], total[begin : begin + count])


@inner_kernel
def _copy(source: FloatArray, to: FloatArray) -> None:
    """Put ``source`` into the corner of ``to``; written out, as slices of arrays take numba seconds more to compile."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            to[i, j] = source[i, j]


@inner_kernel
def _add_product(left: FloatArray, right: FloatArray, total: FloatArray) -> None:
    """total (m, w) += left (m, k) right (k, w) for a multiple w of 16."""
    row = 8 * total.shape[1]
    for at in range(0, row, 2 * _VECTOR):
        source, to = right.ctypes.data + at, total.ctypes.data + at
        for i in range(0, len(left) - 3, 4):
            _add_four(left[i : i + 4], source, to + row * i, row)
        for i in range(len(left) // 4 * 4, len(left)):
            _add_one(left[i], source, to + row * i, row)


@inner_kernel
def _add_four(left: FloatArray, right: int, to: int, row: int) -> None:
    none = lanes.no_doubles()
    a, b, c, d, e, f, g, h = none, none, none, none, none, none, none, none
    for k in range(left.shape[1]):
        one, two = lanes.doubles_at(right), lanes.doubles_at(right + _VECTOR)
        factor = np.float64(left[0, k])
        a, b = lanes.plus_scaled(a, one, factor), lanes.plus_scaled(b, two, factor)
        factor = np.float64(left[1, k])
        c, d = lanes.plus_scaled(c, one, factor), lanes.plus_scaled(d, two, factor)
        factor = np.float64(left[2, k])
        e, f = lanes.plus_scaled(e, one, factor), lanes.plus_scaled(f, two, factor)
        factor = np.float64(left[3, k])
        g, h = lanes.plus_scaled(g, one, factor), lanes.plus_scaled(h, two, factor)
        right += row
    _add_to(to, a, b)
    _add_to(to + row, c, d)
    _add_to(to + 2 * row, e, f)
    _add_to(to + 3 * row, g, h)


@inner_kernel
def _add_one(left: FloatArray, right: int, to: int, row: int) -> None:
    a, b = lanes.no_doubles(), lanes.no_doubles()
    for k in range(len(left)):
        factor = np.float64(left[k])
        a = lanes.plus_scaled(a, lanes.doubles_at(right), factor)
        b = lanes.plus_scaled(b, lanes.doubles_at(right + _VECTOR), factor)
        right += row
    _add_to(to, a, b)


@inner_kernel
def _add_to(place: int, one: Any, two: Any) -> None:
    lanes.store(place, lanes.plus(lanes.doubles_at(place), one))
    lanes.store(place + _VECTOR, lanes.plus(lanes.doubles_at(place + _VECTOR), two))


# Products of sparse matrices with columns, row by row in compiled code: sums stay in registers.
# ``x`` and results are given by their addresses; rows of x lie ``row`` bytes apart, and ``width`` numbers of each,
# eight at least, are taken. Where that is no multiple of eight, the last eight overlap the others.

_LANES = 8  # doubles of a vector
_BYTES = 64  # of a vector


@inner_kernel
def row_product(
    low: int, high: int, indices: IntArray, data: FloatArray, x: int, like: NDArray[Any], row: int, width: int, to: int
) -> None:
    """Row of the product, for a matrix row with the entries ``low`` to ``high``; numbers of x are ``like`` these."""
    at, last = 0, width - _LANES
    while at <= last:
        if at + _LANES < last:
            steps = min(_LANES, last - at), min(2 * _LANES, last - at), min(3 * _LANES, last - at)
            _four(low, high, indices, data, x + like.itemsize * at, like, row, to + 8 * at, steps)
            at += 4 * _LANES
        elif at < last:
            _two(low, high, indices, data, x + like.itemsize * at, like, row, to + 8 * at, last - at)
            return
        else:
            _one(low, high, indices, data, x + like.itemsize * at, like, row, to + 8 * at)
            at += _LANES
        if last < at < last + _LANES:
            at = last


@inner_kernel
def _four(
    low: int, high: int, indices: IntArray, data: FloatArray, x: int, like: NDArray[Any], row: int, to: int,
    steps: tuple[int, int, int],
) -> None:  # fmt: skip
    """Four vectors of a row of the product, ``steps`` columns after the first."""
    a, b, c, d = lanes.no_doubles(), lanes.no_doubles(), lanes.no_doubles(), lanes.no_doubles()
    size = like.itemsize
    for p in range(low, high):
        at = x + row * indices[p]
        a = lanes.plus_scaled(a, lanes.as_doubles(at, like), data[p])
        b = lanes.plus_scaled(b, lanes.as_doubles(at + size * steps[0], like), data[p])
        c = lanes.plus_scaled(c, lanes.as_doubles(at + size * steps[1], like), data[p])
        d = lanes.plus_scaled(d, lanes.as_doubles(at + size * steps[2], like), data[p])
    lanes.store(to, a)
    lanes.store(to + 8 * steps[0], b)
    lanes.store(to + 8 * steps[1], c)
    lanes.store(to + 8 * steps[2], d)


@inner_kernel
def _two(
    low: int, high: int, indices: IntArray, data: FloatArray, x: int, like: NDArray[Any], row: int, to: int, step: int
) -> None:
    """Two vectors of a row of the product, ``step`` columns apart."""
    a, b = lanes.no_doubles(), lanes.no_doubles()
    for p in range(low, high):
        at = x + row * indices[p]
        a = lanes.plus_scaled(a, lanes.as_doubles(at, like), data[p])
        b = lanes.plus_scaled(b, lanes.as_doubles(at + like.itemsize * step, like), data[p])
    lanes.store(to, a)
    lanes.store(to + 8 * step, b)


@inner_kernel
def _one(
    low: int, high: int, indices: IntArray, data: FloatArray, x: int, like: NDArray[Any], row: int, to: int
) -> None:
    total = lanes.no_doubles()
    for p in range(low, high):
        total = lanes.plus_scaled(total, lanes.as_doubles(x + row * indices[p], like), data[p])
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
    used = np.zeros(len(indptr))
    for o in range(len(totals)):
        for t in range(len(indptr)):
            used[t] += weights[o, t] != 0
    for i in range(rows[0], rows[1]):
        sums[:] = 0
        for t in range(len(indptr)):
            if used[t] > 0 and indptr[t, i] < indptr[t, i + 1]:
                row_product(indptr[t, i], indptr[t, i + 1], indices, data, x, data, 8 * width, width, row.ctypes.data)
                for c in range(0, width, 2):
                    turned[c], turned[c + 1] = -row[c + 1], row[c]
                for o in range(len(totals)):
                    _add_combined(weights[o, t], row, turned, sums[o])
        for o in range(len(totals)):
            total = carray(lanes.pointer(totals[o] + 8 * width * i), (width,), np.float64)
            for c in range(width):
                total[c] += sums[o, c]


@inner_kernel
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
    like: NDArray[Any], apart: int, weights: FloatArray, total: FloatArray,
) -> None:  # fmt: skip
    """``rows`` from and up to of sum_j sum_t weights[j, t] A_t x_j, for real columns x_j at addresses sources[j].

    Their numbers are ``like`` these, their rows so many bytes ``apart``.
    """
    width = total.shape[1]
    row, sums = np.zeros(-(-width // _LANES) * _LANES), np.zeros(-(-width // _LANES) * _LANES)
    for i in range(rows[0], rows[1]):
        sums[:] = 0
        for t in range(len(indptr)):
            if indptr[t, i] < indptr[t, i + 1]:
                for j in range(len(sources)):
                    if weights[j, t] != 0:
                        low, high = indptr[t, i], indptr[t, i + 1]
                        row_product(low, high, indices, data, sources[j], like, apart, width, row.ctypes.data)
                        _add_scaled(weights[j, t], row, sums)
        for c in range(width):
            total[i, c] = sums[c]


@inner_kernel
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
        row_product(indptr[i], indptr[i + 1], indices, data, x.ctypes.data, x, x.strides[0], x.shape[1], to)


@kernel
def add_uppers(
    rows: tuple[int, int], indptr: IntArray, indices: IntArray, data: FloatArray, weights: NDArray[Any],
    starts: IntArray, columns: IntArray, total: NDArray[Any],
) -> None:  # fmt: skip
    """Add sum_t weights[t] A_t, on and above the diagonal, to ``total`` on a pattern; both have ascending columns."""
    for i in range(rows[0], rows[1]):
        for t in range(len(indptr)):
            if weights[t] != 0:
                k = starts[i]
                for p in range(indptr[t, i], indptr[t, i + 1]):
                    j = indices[p]
                    if j >= i:
                        while columns[k] < j:
                            k += 1
                        total[k] += weights[t] * data[p]


@kernel
def mirrored(indptr: IntArray, indices: IntArray, data: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """The whole of a symmetric matrix in CSR, columns ascending, from its upper triangle with them ascending."""
    n = len(indptr) - 1
    start = np.zeros(n + 1, np.int64)
    for i in range(n):
        for p in range(indptr[i], indptr[i + 1]):
            start[i + 1] += 1
            start[indices[p] + 1] += indices[p] != i
    add_up(start)
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
