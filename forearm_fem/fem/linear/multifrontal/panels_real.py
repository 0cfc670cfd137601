"""Products of real panels with few right-hand sides; see :mod:`.panels`.

Eight right-hand sides are 32 bytes: sums of eight columns stay in registers on every processor with AVX2. With AVX-512
sixteen are taken at once where there are as many, in half the time.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm

from ...kernels import simd as _lanes
from ...kernels.jit import inner_kernel, kernel
from .blas import REAL

lanes: Any = _lanes  # intrinsics, which type checkers do not follow
_VECTOR = 32  # bytes: eight right-hand sides
_WIDE = 64 if llvm.get_host_cpu_features().get("avx512f", False) else 1 << 30  # the same of long registers
_TILE = 512  # rows: their right-hand sides and those of eight columns stay in the nearest cache


@kernel
def subtract_real_product(
    rows: int, columns: int, panel: int, leading: int, own: int, below: int, row: int, width: int
) -> None:
    """below (rows) -= panel own (columns)."""
    wide = width // _WIDE * _WIDE
    for r in range(0, rows, _TILE):
        count, part = min(_TILE, rows - r), panel + REAL * r
        for v in range(0, wide, _WIDE):
            _subtract(count, columns, part, leading, own + v, below + row * r + v, row, lanes.no_floats())
        for v in range(wide, width, _VECTOR):
            _subtract(count, columns, part, leading, own + v, below + row * r + v, row, lanes.no_eight_floats())


@kernel
def subtract_real_transposed(
    rows: int, columns: int, panel: int, leading: int, below: int, own: int, row: int, width: int
) -> None:
    """own (columns) -= panel^T below (rows)."""
    wide = width // _WIDE * _WIDE
    for r in range(0, rows, _TILE):
        count, part = min(_TILE, rows - r), panel + REAL * r
        for v in range(0, wide, _WIDE):
            _gather(count, columns, part, leading, below + row * r + v, own + v, row, lanes.no_floats())
        for v in range(wide, width, _VECTOR):
            _gather(count, columns, part, leading, below + row * r + v, own + v, row, lanes.no_eight_floats())


@inner_kernel
def _subtract(rows: int, columns: int, panel: int, leading: int, own: int, below: int, row: int, none: Any) -> None:
    """The product for as many right-hand sides as there are zeros in the vector ``none``."""
    for k in range(0, columns - 7, 8):
        _subtract_eight(rows, panel + leading * k, leading, own + row * k, below, row, none)
    for k in range(columns // 8 * 8, columns):
        _subtract_one(rows, panel + leading * k, own + row * k, below, row, none)


@inner_kernel
def _gather(rows: int, columns: int, panel: int, leading: int, below: int, own: int, row: int, none: Any) -> None:
    for k in range(0, columns - 7, 8):
        _gather_eight(rows, panel + leading * k, leading, below, own + row * k, row, none)
    for k in range(columns // 8 * 8, columns):
        _gather_one(rows, panel + leading * k, below, own + row * k, row, none)


@inner_kernel
def _negative(address: int, none: Any) -> Any:
    return lanes.minus(none, lanes.vector_at(address, none))


@inner_kernel
def _subtract_eight(rows: int, panel: int, leading: int, own: int, below: int, row: int, none: Any) -> None:
    a, b, c = _negative(own, none), _negative(own + row, none), _negative(own + 2 * row, none)
    d, e, f = _negative(own + 3 * row, none), _negative(own + 4 * row, none), _negative(own + 5 * row, none)
    g, h = _negative(own + 6 * row, none), _negative(own + 7 * row, none)
    for _ in range(rows):
        at = panel
        one, two = lanes.plus_scaled_by(lanes.vector_at(below, none), a, at), none
        at += leading
        two = lanes.plus_scaled_by(two, b, at)
        at += leading
        one = lanes.plus_scaled_by(one, c, at)
        at += leading
        two = lanes.plus_scaled_by(two, d, at)
        at += leading
        one = lanes.plus_scaled_by(one, e, at)
        at += leading
        two = lanes.plus_scaled_by(two, f, at)
        at += leading
        one = lanes.plus_scaled_by(one, g, at)
        at += leading
        two = lanes.plus_scaled_by(two, h, at)
        lanes.store(below, lanes.plus(one, two))
        below += row
        panel += REAL


@inner_kernel
def _subtract_one(rows: int, panel: int, own: int, below: int, row: int, none: Any) -> None:
    a = _negative(own, none)
    for _ in range(rows):
        lanes.store(below, lanes.plus_scaled_by(lanes.vector_at(below, none), a, panel))
        below += row
        panel += REAL


@inner_kernel
def _gather_eight(rows: int, panel: int, leading: int, below: int, own: int, row: int, none: Any) -> None:
    a, b, c, d, e, f, g, h = none, none, none, none, none, none, none, none
    for _ in range(rows):
        right, at = lanes.vector_at(below, none), panel
        a = lanes.plus_scaled_by(a, right, at)
        at += leading
        b = lanes.plus_scaled_by(b, right, at)
        at += leading
        c = lanes.plus_scaled_by(c, right, at)
        at += leading
        d = lanes.plus_scaled_by(d, right, at)
        at += leading
        e = lanes.plus_scaled_by(e, right, at)
        at += leading
        f = lanes.plus_scaled_by(f, right, at)
        at += leading
        g = lanes.plus_scaled_by(g, right, at)
        at += leading
        h = lanes.plus_scaled_by(h, right, at)
        below += row
        panel += REAL
    _subtract_from(own, a)
    _subtract_from(own + row, b)
    _subtract_from(own + 2 * row, c)
    _subtract_from(own + 3 * row, d)
    _subtract_from(own + 4 * row, e)
    _subtract_from(own + 5 * row, f)
    _subtract_from(own + 6 * row, g)
    _subtract_from(own + 7 * row, h)


@inner_kernel
def _gather_one(rows: int, panel: int, below: int, own: int, row: int, none: Any) -> None:
    a = none
    for _ in range(rows):
        a = lanes.plus_scaled_by(a, lanes.vector_at(below, none), panel)
        below += row
        panel += REAL
    _subtract_from(own, a)


@inner_kernel
def _subtract_from(place: int, sums: Any) -> None:
    lanes.store(place, lanes.minus(lanes.vector_at(place, sums), sums))
