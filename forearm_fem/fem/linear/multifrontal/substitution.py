"""Forward and backward substitution with the factors of :mod:`.fronts`, for many right-hand sides at once.

Right-hand sides are (n, count) by rows, with zeros up to a multiple of eight: a supernode's own are next to each other.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....typing import FloatArray, IntArray
from ...kernels.jit import kernel
from .blas import BLOCK
from .fronts import FrontStore
from .panels import subtract_panel, subtract_panel_transposed
from .parts import ThreadPart
from .supernodes import Fronts

LANES = 8  # numbers in a vector


class Local(NamedTuple):
    """Right-hand sides (rows, count) below one supernode, and those of one block of pivots."""

    below: NDArray[Any]
    block: NDArray[Any]


@kernel
def take_in(right: NDArray[Any], order: IntArray, scale: FloatArray, x: NDArray[Any], begin: int, end: int) -> None:
    """Rows of ``right`` (n, count) in the order of elimination, scaled, to rows ``begin`` to ``end`` of ``x``, whose
    further columns become zero."""
    count = right.shape[1]
    for i in range(begin, end):
        for c in range(count):
            x[i, c] = right[order[i], c] * scale[i]
        x[i, count:] = 0


@kernel
def put_back(x: NDArray[Any], order: IntArray, scale: FloatArray, right: NDArray[Any], begin: int, end: int) -> None:
    """Rows ``begin`` to ``end`` of ``x`` back in the usual order to ``right`` (n, count), scaled."""
    for i in range(begin, end):
        for c in range(right.shape[1]):
            right[order[i], c] = x[i, c] * scale[i]


@kernel
def forward(
    part: ThreadPart, fronts: Fronts, store: FrontStore, owner: NDArray[np.int32], x: NDArray[Any],
    others: NDArray[Any], local: Local, some: tuple[int, int],
) -> None:  # fmt: skip
    """L x = b for a part's columns; what it gives to unknowns of other parts is added to ``others`` (n, count).

    Right-hand sides from ``some[0]`` up to ``some[1]``, multiples of eight.
    """
    for s in part.supernodes:
        forward_front(s, part.number, fronts, store, owner, x, others, local, some)


@kernel
def forward_front(
    s: int, number: int, fronts: Fronts, store: FrontStore, owner: NDArray[np.int32], x: NDArray[Any],
    others: NDArray[Any], local: Local, some: tuple[int, int],
) -> None:  # fmt: skip
    """The same for the columns of supernode ``s`` of part ``number``."""
    bytes_ = x.itemsize
    row, skipped, width = bytes_ * x.shape[1], bytes_ * some[0], bytes_ * (some[1] - some[0])
    below = local.below.ctypes.data + skipped
    k, m = fronts.first[s + 1] - fronts.first[s], fronts.below[s + 1] - fronts.below[s]
    size, panel = k + m, store.panels.ctypes.data + bytes_ * store.start[s]
    own = x.ctypes.data + row * fronts.first[s] + skipped
    local.below[:m, some[0] : some[1]] = 0
    for j in range(0, k, BLOCK):
        e, column = min(j + BLOCK, k), panel + bytes_ * j * size
        left = column + bytes_ * e
        subtract_panel(bytes_, k - e, e - j, left, bytes_ * size, own + row * j, own + row * e, row, width)
        subtract_panel(bytes_, m, e - j, column + bytes_ * k, bytes_ * size, own + row * j, below, row, width)
    for i in range(m):
        to = fronts.rows[fronts.below[s] + i]
        target = x if owner[to] == number else others
        for c in range(some[0], some[1]):
            target[to, c] += local.below[i, c]


@kernel
def backward(
    part: ThreadPart, fronts: Fronts, store: FrontStore, x: NDArray[Any], local: Local, some: tuple[int, int]
) -> None:
    """D L^T x = b for a part's columns, those above them known; see :func:`forward`."""
    bytes_ = x.itemsize
    row, skipped, width = bytes_ * x.shape[1], bytes_ * some[0], bytes_ * (some[1] - some[0])
    below, block = local.below.ctypes.data + skipped, local.block.ctypes.data + skipped
    for s in part.supernodes[::-1]:
        k, m = fronts.first[s + 1] - fronts.first[s], fronts.below[s + 1] - fronts.below[s]
        first, size, panel = fronts.first[s], k + m, store.panels.ctypes.data + bytes_ * store.start[s]
        own = x.ctypes.data + row * first + skipped
        for i in range(m):
            above = fronts.rows[fronts.below[s] + i]
            for c in range(some[0], some[1]):  # written out: slices of arrays take numba seconds more to compile
                local.below[i, c] = x[above, c]
        inverse = store.inverses.ctypes.data + bytes_ * store.block[s + 1]
        for j in range((k - 1) // BLOCK * BLOCK, -1, -BLOCK):
            e, column = min(j + BLOCK, k), panel + bytes_ * j * size
            pivots, target = e - j, own + row * j
            inverse -= bytes_ * pivots * pivots
            for i in range(pivots):
                for c in range(some[0], some[1]):
                    local.block[i, c] = -x[first + j + i, c]
                    x[first + j + i, c] = 0
            left = column + bytes_ * e
            subtract_panel(bytes_, pivots, pivots, inverse, bytes_ * pivots, block, target, row, width)
            subtract_panel_transposed(bytes_, k - e, pivots, left, bytes_ * size, own + row * e, target, row, width)
            subtract_panel_transposed(bytes_, m, pivots, column + bytes_ * k, bytes_ * size, below, target, row, width)
