"""Products of long columns with few others in compiled code, which BLAS would pack the long ones for.

Columns may be in single or double precision; sums and the few others are in double precision.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...typing import FloatArray
from . import simd as _lanes
from .jit import kernel

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


@kernel
def _copy(source: FloatArray, to: FloatArray) -> None:
    """Put ``source`` into the corner of ``to``; written out, as slices of arrays take numba seconds more to compile."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            to[i, j] = source[i, j]


@kernel
def _add_product(left: FloatArray, right: FloatArray, total: FloatArray) -> None:
    """total (m, w) += left (m, k) right (k, w) for a multiple w of 16."""
    row = 8 * total.shape[1]
    for at in range(0, row, 2 * _VECTOR):
        source, to = right.ctypes.data + at, total.ctypes.data + at
        for i in range(0, len(left) - 3, 4):
            _add_four(left[i : i + 4], source, to + row * i, row)
        for i in range(len(left) // 4 * 4, len(left)):
            _add_one(left[i], source, to + row * i, row)


@kernel
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


@kernel
def _add_one(left: FloatArray, right: int, to: int, row: int) -> None:
    a, b = lanes.no_doubles(), lanes.no_doubles()
    for k in range(len(left)):
        factor = np.float64(left[k])
        a = lanes.plus_scaled(a, lanes.doubles_at(right), factor)
        b = lanes.plus_scaled(b, lanes.doubles_at(right + _VECTOR), factor)
        right += row
    _add_to(to, a, b)


@kernel
def _add_to(place: int, one: Any, two: Any) -> None:
    lanes.store(place, lanes.plus(lanes.doubles_at(place), one))
    lanes.store(place + _VECTOR, lanes.plus(lanes.doubles_at(place + _VECTOR), two))
