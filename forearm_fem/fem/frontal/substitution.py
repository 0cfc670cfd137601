"""Forward and backward substitution with the factors of :mod:`.fronts`, for many right-hand sides at once.

Right-hand sides are (n, count) by rows, so that rows are added as a whole; a front's own are copied and lie by columns,
which BLAS multiplies panels with in two thirds of the time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ...typing import ComplexArray, FloatArray, IntArray
from .blas import BLOCK, BYTES, FIRST, NEITHER, Arguments, set_product, subtract_product
from .fronts import Store
from .parts import Part
from .supernodes import Fronts


class Local(NamedTuple):
    """One front's right-hand sides, and those of its own unknowns apart."""

    front: NDArray[np.complex64]
    own: NDArray[np.complex64]


@njit(cache=True, nogil=True)
def gathered(right: ComplexArray, order: IntArray, scale: FloatArray) -> NDArray[np.complex64]:
    """Rows of ``right`` (n, count) in the order of elimination, scaled."""
    x = np.empty(right.shape, np.complex64)
    for i in range(len(order)):
        for c in range(right.shape[1]):
            x[i, c] = right[order[i], c] * scale[i]
    return x


@njit(cache=True, nogil=True)
def scattered(x: NDArray[np.complex64], order: IntArray, scale: FloatArray) -> ComplexArray:
    """Rows of ``x`` (n, count) back in the usual order, scaled."""
    right = np.empty(x.shape, np.complex128)
    for i in range(len(order)):
        for c in range(x.shape[1]):
            right[order[i], c] = x[i, c] * scale[i]
    return right


@njit(cache=True, nogil=True)
def forward(
    part: Part, fronts: Fronts, store: Store, owner: NDArray[np.int32], x: NDArray[np.complex64],
    others: NDArray[np.complex64], local: Local, call: Arguments,
) -> None:  # fmt: skip
    """L x = b for a part's columns; what it gives to unknowns of other parts is added to ``others`` (n, count)."""
    count, z = x.shape[1], local.front.ctypes.data
    for s in part.supernodes:
        k, m = fronts.first[s + 1] - fronts.first[s], fronts.below[s + 1] - fronts.below[s]
        size, panel = k + m, store.panels.ctypes.data + BYTES * store.start[s]
        _copy_own(x, fronts.first[s], k, local.front, size)
        for c in range(count):
            local.front[c * size + k : (c + 1) * size] = 0
        for j in range(0, k, BLOCK):
            e = min(j + BLOCK, k)
            below, shape = panel + BYTES * (j * size + e), (size - e, count, e - j)
            subtract_product(call, shape, below, size, z + BYTES * j, size, z + BYTES * e, size, NEITHER)
        _put_back(x, fronts.first[s], k, local.front, size)
        for i in range(m):
            row = fronts.rows[fronts.below[s] + i]
            to = x if owner[row] == part.number else others
            for c in range(count):
                to[row, c] += local.front[c * size + k + i]


@njit(cache=True, nogil=True)
def backward(part: Part, fronts: Fronts, store: Store, x: NDArray[np.complex64], local: Local, call: Arguments) -> None:
    """D L^T x = b for a part's columns, those above them known."""
    count, z, own = x.shape[1], local.front.ctypes.data, local.own.ctypes.data
    for s in part.supernodes[::-1]:
        k, m = fronts.first[s + 1] - fronts.first[s], fronts.below[s + 1] - fronts.below[s]
        size, panel = k + m, store.panels.ctypes.data + BYTES * store.start[s]
        _copy_own(x, fronts.first[s], k, local.own, k)
        for i in range(m):
            row = fronts.rows[fronts.below[s] + i]
            for c in range(count):
                local.front[c * size + k + i] = x[row, c]
        inverse = store.inverses.ctypes.data + BYTES * store.block[s + 1]
        for j in range((k - 1) // BLOCK * BLOCK, -1, -BLOCK):
            e = min(j + BLOCK, k)
            width, target = e - j, z + BYTES * j
            inverse -= BYTES * width * width
            set_product(call, (width, count, width), inverse, width, own + BYTES * j, k, target, size)
            below, shape = panel + BYTES * (j * size + e), (width, count, size - e)
            subtract_product(call, shape, below, size, z + BYTES * e, size, target, size, FIRST)
        _put_back(x, fronts.first[s], k, local.front, size)


@njit(cache=True, nogil=True)
def _copy_own(x: NDArray[np.complex64], first: int, k: int, to: NDArray[np.complex64], size: int) -> None:
    """A supernode's k rows, column by column, ``size`` apart."""
    for i in range(k):
        for c in range(x.shape[1]):
            to[c * size + i] = x[first + i, c]


@njit(cache=True, nogil=True)
def _put_back(x: NDArray[np.complex64], first: int, k: int, source: NDArray[np.complex64], size: int) -> None:
    for i in range(k):
        for c in range(x.shape[1]):
            x[first + i, c] = source[c * size + i]
