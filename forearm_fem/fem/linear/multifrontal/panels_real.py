"""Products of real panels with few right-hand sides; see :mod:`.panels`.

Eight right-hand sides are 32 bytes: sums of eight columns stay in registers on every processor with AVX2.
"""

from __future__ import annotations

from typing import Any

from ...kernels import simd as _lanes
from ...kernels.jit import kernel
from .blas import REAL

lanes: Any = _lanes  # intrinsics, which type checkers do not follow
_VECTOR = 32  # bytes: eight right-hand sides
_TILE = 512  # rows: their right-hand sides and those of eight columns stay in the nearest cache


@kernel
def subtract_real_product(
    rows: int, columns: int, panel: int, leading: int, own: int, below: int, row: int, width: int
) -> None:
    """below (rows) -= panel own (columns)."""
    for r in range(0, rows, _TILE):
        count, part = min(_TILE, rows - r), panel + REAL * r
        for v in range(0, width, _VECTOR):
            target, source = below + row * r + v, own + v
            for k in range(0, columns - 7, 8):
                _subtract_eight(count, part + leading * k, leading, source + row * k, target, row)
            for k in range(columns // 8 * 8, columns):
                _subtract_one(count, part + leading * k, source + row * k, target, row)


@kernel
def subtract_real_transposed(
    rows: int, columns: int, panel: int, leading: int, below: int, own: int, row: int, width: int
) -> None:
    """own (columns) -= panel^T below (rows)."""
    for r in range(0, rows, _TILE):
        count, part = min(_TILE, rows - r), panel + REAL * r
        for v in range(0, width, _VECTOR):
            source, target = below + row * r + v, own + v
            for k in range(0, columns - 7, 8):
                _gather_eight(count, part + leading * k, leading, source, target + row * k, row)
            for k in range(columns // 8 * 8, columns):
                _gather_one(count, part + leading * k, source, target + row * k, row)


@kernel
def _negative(address: int) -> Any:
    return lanes.minus(lanes.no_eight_floats(), lanes.eight_floats_at(address))


@kernel
def _subtract_eight(rows: int, panel: int, leading: int, own: int, below: int, row: int) -> None:
    a, b, c, d = _negative(own), _negative(own + row), _negative(own + 2 * row), _negative(own + 3 * row)
    e, f, g, h = (
        _negative(own + 4 * row), _negative(own + 5 * row), _negative(own + 6 * row), _negative(own + 7 * row)
    )  # fmt: skip
    for _ in range(rows):
        at = panel
        one, two = lanes.plus_scaled_by(lanes.eight_floats_at(below), a, at), lanes.no_eight_floats()
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


@kernel
def _subtract_one(rows: int, panel: int, own: int, below: int, row: int) -> None:
    a = _negative(own)
    for _ in range(rows):
        lanes.store(below, lanes.plus_scaled_by(lanes.eight_floats_at(below), a, panel))
        below += row
        panel += REAL


@kernel
def _gather_eight(rows: int, panel: int, leading: int, below: int, own: int, row: int) -> None:
    none = lanes.no_eight_floats()
    a, b, c, d, e, f, g, h = none, none, none, none, none, none, none, none
    for _ in range(rows):
        right, at = lanes.eight_floats_at(below), panel
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


@kernel
def _gather_one(rows: int, panel: int, below: int, own: int, row: int) -> None:
    a = lanes.no_eight_floats()
    for _ in range(rows):
        a = lanes.plus_scaled_by(a, lanes.eight_floats_at(below), panel)
        below += row
        panel += REAL
    _subtract_from(own, a)


@kernel
def _subtract_from(place: int, sums: Any) -> None:
    lanes.store(place, lanes.minus(lanes.eight_floats_at(place), sums))
