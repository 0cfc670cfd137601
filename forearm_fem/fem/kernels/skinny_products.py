"""Products of long columns with few others in compiled code, which BLAS would pack the long ones for.

Columns may be in single or double precision. Sums and the few others are in double precision; ``rough`` kernels, for
columns in single precision, have both in it too and take half the time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ...typing import FloatArray
from . import simd as _lanes

lanes: Any = _lanes  # intrinsics, which type checkers do not follow
Floats = NDArray[np.float32]
PAIR = 16  # doubles in two vectors, floats in one
_ROWS = 64  # at a time: with as many columns of a block they stay in the nearest cache
_VECTOR = 64  # bytes


@njit(cache=True, nogil=True)
def add_inner(block: FloatArray, columns: FloatArray, total: FloatArray) -> None:
    """total (k, w) += block (n, k)^T columns (n, m), where w is m or the next multiple of 16."""
    part = np.zeros((_ROWS, total.shape[1]))
    for begin in range(0, len(block), _ROWS):
        count = min(_ROWS, len(block) - begin)
        _copy(columns[begin : begin + count], part)
        _add_product(block[begin : begin + count].T, part, total)


@njit(cache=True, nogil=True)
def add_combination(block: FloatArray, known: FloatArray, total: FloatArray) -> None:
    """total (n, m) += block (n, k) known (k, w), where w is m or the next multiple of 16."""
    part = np.zeros((_ROWS, known.shape[1]))
    for begin in range(0, len(block), _ROWS):
        count = min(_ROWS, len(block) - begin)
        _copy(total[begin : begin + count], part)
        _add_product(block[begin : begin + count], known, part)
        _copy(part[:count, : total.shape[1]], total[begin : begin + count])


@njit(cache=True, nogil=True)
def _copy(source: FloatArray, to: NDArray[np.floating[Any]]) -> None:
    """Put ``source`` into the corner of ``to``; written out, as slices of arrays take numba seconds more to compile."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            to[i, j] = source[i, j]


@njit(cache=True, nogil=True)
def _add_product(left: FloatArray, right: FloatArray, total: FloatArray) -> None:
    """total (m, w) += left (m, k) right (k, w) for a multiple w of 16."""
    row = 8 * total.shape[1]
    for at in range(0, row, 2 * _VECTOR):
        source, to = right.ctypes.data + at, total.ctypes.data + at
        for i in range(0, len(left) - 3, 4):
            _add_four(left[i : i + 4], source, to + row * i, row)
        for i in range(len(left) // 4 * 4, len(left)):
            _add_one(left[i], source, to + row * i, row)


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _add_one(left: FloatArray, right: int, to: int, row: int) -> None:
    a, b = lanes.no_doubles(), lanes.no_doubles()
    for k in range(len(left)):
        factor = np.float64(left[k])
        a = lanes.plus_scaled(a, lanes.doubles_at(right), factor)
        b = lanes.plus_scaled(b, lanes.doubles_at(right + _VECTOR), factor)
        right += row
    _add_to(to, a, b)


@njit(cache=True, nogil=True)
def _add_to(place: int, one: Any, two: Any) -> None:
    lanes.store(place, lanes.plus(lanes.doubles_at(place), one))
    lanes.store(place + _VECTOR, lanes.plus(lanes.doubles_at(place + _VECTOR), two))


@njit(cache=True, nogil=True)
def add_rough_inner(block: Floats, columns: FloatArray, total: FloatArray) -> None:
    """As :func:`add_inner`; sums over some hundred rows are in single precision."""
    part = np.zeros((_ROWS, total.shape[1]), np.float32)
    sums = np.zeros(total.shape, np.float32)
    for begin in range(0, len(block), _ROWS):
        count = min(_ROWS, len(block) - begin)
        _copy(columns[begin : begin + count], part)
        _add_rough_product(block[begin : begin + count].T, part, sums)
    for i in range(total.shape[0]):
        for j in range(total.shape[1]):
            total[i, j] += sums[i, j]


@njit(cache=True, nogil=True)
def add_rough_combination(block: Floats, known: Floats, total: FloatArray) -> None:
    """As :func:`add_combination`; what a block adds is summed in single precision."""
    part = np.zeros((_ROWS, known.shape[1]), np.float32)
    for begin in range(0, len(block), _ROWS):
        count = min(_ROWS, len(block) - begin)
        part[:] = 0.0
        _add_rough_product(block[begin : begin + count], known, part)
        for i in range(count):
            for j in range(total.shape[1]):
                total[begin + i, j] += part[i, j]


@njit(cache=True, nogil=True)
def _add_rough_product(left: Floats, right: Floats, total: Floats) -> None:
    """As :func:`_add_product`, all in single precision; ``left`` may be a transposed block."""
    row, (down, across) = 4 * total.shape[1], left.strides
    for at in range(0, row, _VECTOR):
        source, to = right.ctypes.data + at, total.ctypes.data + at
        for i in range(0, len(left) - 7, 8):
            _add_eight_rough(left.ctypes.data + down * i, down, across, left.shape[1], source, to + row * i, row)
        for i in range(len(left) // 8 * 8, len(left)):
            _add_one_rough(left.ctypes.data + down * i, across, left.shape[1], source, to + row * i, row)


@njit(cache=True, nogil=True)
def _add_eight_rough(left: int, down: int, across: int, count: int, right: int, to: int, row: int) -> None:
    none = lanes.no_floats()
    a, b, c, d, e, f, g, h = none, none, none, none, none, none, none, none
    for _ in range(count):
        one = lanes.floats_at(right)
        a, b = lanes.plus_scaled_by(a, one, left), lanes.plus_scaled_by(b, one, left + down)
        c, d = lanes.plus_scaled_by(c, one, left + 2 * down), lanes.plus_scaled_by(d, one, left + 3 * down)
        e, f = lanes.plus_scaled_by(e, one, left + 4 * down), lanes.plus_scaled_by(f, one, left + 5 * down)
        g, h = lanes.plus_scaled_by(g, one, left + 6 * down), lanes.plus_scaled_by(h, one, left + 7 * down)
        right, left = right + row, left + across
    _add_rough(to, a)
    _add_rough(to + row, b)
    _add_rough(to + 2 * row, c)
    _add_rough(to + 3 * row, d)
    _add_rough(to + 4 * row, e)
    _add_rough(to + 5 * row, f)
    _add_rough(to + 6 * row, g)
    _add_rough(to + 7 * row, h)


@njit(cache=True, nogil=True)
def _add_one_rough(left: int, across: int, count: int, right: int, to: int, row: int) -> None:
    a = lanes.no_floats()
    for _ in range(count):
        a = lanes.plus_scaled_by(a, lanes.floats_at(right), left)
        right, left = right + row, left + across
    _add_rough(to, a)


@njit(cache=True, nogil=True)
def _add_rough(place: int, vector: Any) -> None:
    lanes.store(place, lanes.plus(lanes.floats_at(place), vector))
