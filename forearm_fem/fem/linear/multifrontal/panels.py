"""Products of panels with few right-hand sides in compiled code, which BLAS would pack each panel for.

Panels (rows, columns) are complex64, or float32, by columns, ``leading`` bytes apart. Right-hand sides lie by rows
``row`` bytes apart; ``width`` bytes of each take part, a multiple of eight numbers of ``bytes_``. All is given by its
address.
"""

from __future__ import annotations

from typing import Any

import llvmlite.binding as llvm

from ...kernels import simd as _lanes
from ...kernels.jit import inner_kernel, kernel
from .blas import REAL
from .panels_real import subtract_real_product, subtract_real_transposed

lanes: Any = _lanes  # intrinsics, which type checkers do not follow
BYTES = 8  # of a complex64
VECTOR = 64  # bytes: eight right-hand sides
_TILE = 256  # rows: their right-hand sides and those of eight columns stay in the nearest cache
_GATHERED = 8 if llvm.get_host_cpu_features().get("avx512f", False) else 2  # columns whose sums registers can hold


@inner_kernel
def subtract_panel(
    bytes_: int, rows: int, columns: int, panel: int, leading: int, own: int, below: int, row: int, width: int
) -> None:
    """below (rows) -= panel own (columns)."""
    if bytes_ == REAL:
        return subtract_real_product(rows, columns, panel, leading, own, below, row, width)
    for r in range(0, rows, _TILE):
        count, part = min(_TILE, rows - r), panel + BYTES * r
        for v in range(0, width, VECTOR):
            target, source = below + row * r + v, own + v
            for k in range(0, columns - 7, 8):
                _subtract_eight(count, part + leading * k, leading, source + row * k, target, row)
            for k in range(columns // 8 * 8, columns):
                _subtract_one(count, part + leading * k, source + row * k, target, row)


@inner_kernel
def subtract_panel_transposed(
    bytes_: int, rows: int, columns: int, panel: int, leading: int, below: int, own: int, row: int, width: int
) -> None:
    """own (columns) -= panel^T below (rows)."""
    if bytes_ == REAL:
        return subtract_real_transposed(rows, columns, panel, leading, below, own, row, width)
    for r in range(0, rows, _TILE):
        count, part = min(_TILE, rows - r), panel + BYTES * r
        for v in range(0, width, VECTOR):
            source, target = below + row * r + v, own + v
            for k in range(0, columns - _GATHERED + 1, _GATHERED):
                if _GATHERED == 8:
                    gather_eight(count, part + leading * k, leading, source, target + row * k, row)
                else:
                    gather_two(count, part + leading * k, leading, source, target + row * k, row)
            for k in range(columns // _GATHERED * _GATHERED, columns):
                _gather_one(count, part + leading * k, source, target + row * k, row)


@inner_kernel
def _subtract_eight(rows: int, panel: int, leading: int, own: int, below: int, row: int) -> None:
    """Eight columns of a panel and eight right-hand sides; what real and imaginary parts give is kept apart."""
    none = lanes.no_floats()
    a, b = lanes.minus(none, lanes.floats_at(own)), lanes.minus(none, lanes.floats_at(own + row))
    c, d = lanes.minus(none, lanes.floats_at(own + 2 * row)), lanes.minus(none, lanes.floats_at(own + 3 * row))
    e, f = lanes.minus(none, lanes.floats_at(own + 4 * row)), lanes.minus(none, lanes.floats_at(own + 5 * row))
    g, h = lanes.minus(none, lanes.floats_at(own + 6 * row)), lanes.minus(none, lanes.floats_at(own + 7 * row))
    for _ in range(rows):
        at = panel
        re, im = lanes.plus_scaled_by(lanes.floats_at(below), a, at), lanes.plus_scaled_by(none, a, at + 4)
        at += leading
        re, im = lanes.plus_scaled_by(re, b, at), lanes.plus_scaled_by(im, b, at + 4)
        at += leading
        re, im = lanes.plus_scaled_by(re, c, at), lanes.plus_scaled_by(im, c, at + 4)
        at += leading
        re, im = lanes.plus_scaled_by(re, d, at), lanes.plus_scaled_by(im, d, at + 4)
        at += leading
        re, im = lanes.plus_scaled_by(re, e, at), lanes.plus_scaled_by(im, e, at + 4)
        at += leading
        re, im = lanes.plus_scaled_by(re, f, at), lanes.plus_scaled_by(im, f, at + 4)
        at += leading
        re, im = lanes.plus_scaled_by(re, g, at), lanes.plus_scaled_by(im, g, at + 4)
        at += leading
        re, im = lanes.plus_scaled_by(re, h, at), lanes.plus_scaled_by(im, h, at + 4)
        lanes.store(below, lanes.plus_turned(re, im))
        below += row
        panel += BYTES


@inner_kernel
def _subtract_one(rows: int, panel: int, own: int, below: int, row: int) -> None:
    none = lanes.no_floats()
    a = lanes.minus(none, lanes.floats_at(own))
    for _ in range(rows):
        re, im = lanes.plus_scaled_by(lanes.floats_at(below), a, panel), lanes.plus_scaled_by(none, a, panel + 4)
        lanes.store(below, lanes.plus_turned(re, im))
        below += row
        panel += BYTES


@kernel
def gather_eight(rows: int, panel: int, leading: int, below: int, own: int, row: int) -> None:
    """Eight columns of a transposed panel and eight right-hand sides."""
    none = lanes.no_floats()
    a, b, c, d, e, f, g, h = none, none, none, none, none, none, none, none
    s, t, u, v, w, x, y, z = none, none, none, none, none, none, none, none
    for _ in range(rows):
        right, at = lanes.floats_at(below), panel
        a, s = lanes.plus_scaled_by(a, right, at), lanes.plus_scaled_by(s, right, at + 4)
        at += leading
        b, t = lanes.plus_scaled_by(b, right, at), lanes.plus_scaled_by(t, right, at + 4)
        at += leading
        c, u = lanes.plus_scaled_by(c, right, at), lanes.plus_scaled_by(u, right, at + 4)
        at += leading
        d, v = lanes.plus_scaled_by(d, right, at), lanes.plus_scaled_by(v, right, at + 4)
        at += leading
        e, w = lanes.plus_scaled_by(e, right, at), lanes.plus_scaled_by(w, right, at + 4)
        at += leading
        f, x = lanes.plus_scaled_by(f, right, at), lanes.plus_scaled_by(x, right, at + 4)
        at += leading
        g, y = lanes.plus_scaled_by(g, right, at), lanes.plus_scaled_by(y, right, at + 4)
        at += leading
        h, z = lanes.plus_scaled_by(h, right, at), lanes.plus_scaled_by(z, right, at + 4)
        below += row
        panel += BYTES
    _subtract_from(own, a, s)
    _subtract_from(own + row, b, t)
    _subtract_from(own + 2 * row, c, u)
    _subtract_from(own + 3 * row, d, v)
    _subtract_from(own + 4 * row, e, w)
    _subtract_from(own + 5 * row, f, x)
    _subtract_from(own + 6 * row, g, y)
    _subtract_from(own + 7 * row, h, z)


@kernel
def gather_two(rows: int, panel: int, leading: int, below: int, own: int, row: int) -> None:
    """Two columns: short registers hold no more sums."""
    none, other = lanes.no_floats(), panel + leading
    a, b, s, t = none, none, none, none
    for _ in range(rows):
        right = lanes.floats_at(below)
        a, s = lanes.plus_scaled_by(a, right, panel), lanes.plus_scaled_by(s, right, panel + 4)
        b, t = lanes.plus_scaled_by(b, right, other), lanes.plus_scaled_by(t, right, other + 4)
        below += row
        panel += BYTES
        other += BYTES
    _subtract_from(own, a, s)
    _subtract_from(own + row, b, t)


@inner_kernel
def _gather_one(rows: int, panel: int, below: int, own: int, row: int) -> None:
    a, s = lanes.no_floats(), lanes.no_floats()
    for _ in range(rows):
        right = lanes.floats_at(below)
        a, s = lanes.plus_scaled_by(a, right, panel), lanes.plus_scaled_by(s, right, panel + 4)
        below += row
        panel += BYTES
    _subtract_from(own, a, s)


@inner_kernel
def _subtract_from(place: int, real: Any, imaginary: Any) -> None:
    """Subtract what real and imaginary parts of a panel gave."""
    lanes.store(place, lanes.minus(lanes.floats_at(place), lanes.plus_turned(real, imaginary)))
