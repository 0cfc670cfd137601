"""Forward and backward substitution with the factors of :mod:`.fronts`, for many right-hand sides at once.

Right-hand sides are (n, count) by rows, so that a supernode's are together and rows are added as a whole.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ...typing import ComplexArray, FloatArray, IntArray
from .blas import BLOCK, BYTES, Arguments, set_product, subtract_product
from .fronts import Store
from .parts import Part
from .supernodes import Fronts


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
    others: NDArray[np.complex64], buffer: NDArray[np.complex64], call: Arguments,
) -> None:  # fmt: skip
    """L x = b for a part's columns; what it gives to unknowns of other parts is added to ``others`` (n, count)."""
    count, of_buffer = x.shape[1], buffer.ctypes.data
    for s in part.supernodes:
        k, m = fronts.first[s + 1] - fronts.first[s], fronts.below[s + 1] - fronts.below[s]
        panel = store.panels.ctypes.data + BYTES * store.start[s]
        mine = x.ctypes.data + BYTES * fronts.first[s] * count
        for j in range(0, k, BLOCK):
            e = min(j + BLOCK, k)
            below, at = panel + BYTES * (j * (k + m) + e), mine + BYTES * e * count
            subtract_product(call, (count, k - e, e - j), mine + BYTES * j * count, count, below, k + m, at, count, 1)
        if m == 0:
            continue
        set_product(call, (count, m, k), mine, count, panel + BYTES * k, k + m, of_buffer, count, 1)
        _subtract_rows(fronts.rows[fronts.below[s] : fronts.below[s + 1]], buffer, part.number, owner, x, others)


@njit(cache=True, nogil=True)
def _subtract_rows(
    rows: NDArray[np.int32], buffer: NDArray[np.complex64], number: int, owner: NDArray[np.int32],
    x: NDArray[np.complex64], others: NDArray[np.complex64],
) -> None:  # fmt: skip
    count = x.shape[1]
    for i in range(len(rows)):
        to = x if owner[rows[i]] == number else others
        for c in range(count):
            to[rows[i], c] -= buffer[i * count + c]


@njit(cache=True, nogil=True)
def backward(
    part: Part, fronts: Fronts, store: Store, x: NDArray[np.complex64], buffer: NDArray[np.complex64], call: Arguments
) -> None:
    """D L^T x = b for a part's columns, those above them known."""
    count, of_buffer = x.shape[1], buffer.ctypes.data
    for s in part.supernodes[::-1]:
        k, m = fronts.first[s + 1] - fronts.first[s], fronts.below[s + 1] - fronts.below[s]
        panel = store.panels.ctypes.data + BYTES * store.start[s]
        mine = x.ctypes.data + BYTES * fronts.first[s] * count
        _divided(s, fronts.first[s], k, store, x, buffer, call)
        if m:
            _taken(fronts.rows[fronts.below[s] : fronts.below[s + 1]], x, buffer)
            subtract_product(call, (count, k, m), of_buffer, count, panel + BYTES * k, k + m, mine, count, 0)
        for j in range((k - 1) // BLOCK * BLOCK, -1, -BLOCK):
            e = min(j + BLOCK, k)
            below, above = panel + BYTES * (j * (k + m) + e), mine + BYTES * e * count
            target = mine + BYTES * j * count
            subtract_product(call, (count, e - j, k - e), above, count, below, k + m, target, count, 0)


@njit(cache=True, nogil=True)
def _divided(
    s: int, first: int, k: int, store: Store, x: NDArray[np.complex64], buffer: NDArray[np.complex64], call: Arguments
) -> None:
    """Multiply a supernode's rows by the inverted blocks of D."""
    count, inverse = x.shape[1], store.inverses.ctypes.data + BYTES * store.block[s]
    for j in range(0, k, BLOCK):
        width = min(BLOCK, k - j)
        for i in range(width):
            for c in range(count):
                buffer[i * count + c] = x[first + j + i, c]
        at = x.ctypes.data + BYTES * (first + j) * count
        set_product(call, (count, width, width), buffer.ctypes.data, count, inverse, width, at, count, 0)
        inverse += BYTES * width * width


@njit(cache=True, nogil=True)
def _taken(rows: NDArray[np.int32], x: NDArray[np.complex64], buffer: NDArray[np.complex64]) -> None:
    count = x.shape[1]
    for i in range(len(rows)):
        for c in range(count):
            buffer[i * count + c] = x[rows[i], c]
