"""Right-hand sides carried along while fronts are eliminated, whose factors are then given up.

A = L D L^T is symmetric, so B^T A^-1 B = Y^T D^-1 Y with L Y = B: compliances at the loads need no substitution
backwards, and each front's part of L is needed only until B has passed it. Fronts of a part take turns in one panel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....typing import ComplexArray, FloatArray, IntArray
from ...kernels.jit import kernel
from .blas import BLOCK
from .fronts import FrontStore, Scratch, block_entries, factorise_front
from .panels import subtract_panel
from .parts import Parts, ThreadPart
from .substitution import Local, forward_front
from .supernodes import Fronts, Symbolic
from .tree import Entries


def passing_store(symbolic: Symbolic, parts: Parts, number: type[np.complex64] | type[np.float32]) -> FrontStore:
    """Room for the largest panel of each part, where all its fronts begin, and for the inverted blocks of all."""
    panels, start, end = symbolic.panel_entries, np.zeros(len(symbolic.parent), np.int64), 0
    for part in (*parts.subtrees, parts.top):
        start[part.supernodes] = end
        end += int(panels[part.supernodes].max(initial=0))
    blocks = block_entries(symbolic.columns)
    places = np.concatenate([[0], np.cumsum(blocks)])
    return FrontStore(np.empty(end, number), start, np.empty(blocks.sum(), number), places)


@kernel
def eliminate_part(
    part: ThreadPart, fronts: Fronts, entries: Entries, data: Any, scale: FloatArray, store: FrontStore,
    remainder: IntArray, stack: NDArray[Any], scratch: Scratch, owner: NDArray[np.int32], x: NDArray[Any],
    others: NDArray[Any], local: Local,
) -> int:  # fmt: skip
    """Eliminate a part's fronts (:func:`.fronts.factorise_part`) and L Y = B for ``x`` (:func:`.substitution.forward`).

    Returns how many blocks were singular.
    """
    singular, free = 0, part.begin
    for s in part.supernodes:
        bad, free = factorise_front(s, part.begin, free, fronts, entries, data, scale, store, remainder, stack, scratch)
        forward_front(s, part.number, fronts, store, owner, x, others, local, (0, x.shape[1]))
        singular += bad
    return singular


@kernel
def pivot_products(fronts: Fronts, store: FrontStore, x: NDArray[Any], block: NDArray[Any]) -> ComplexArray:
    """Y^T D^-1 Y (k, k) of ``x`` (n, k), which is Y, summed in double precision; ``block`` is room for 64 rows."""
    bytes_, count = x.itemsize, x.shape[1]
    row, total = bytes_ * count, np.zeros((count, count), np.complex128)
    for s in range(len(fronts.first) - 1):
        inverse = store.inverses.ctypes.data + bytes_ * store.block[s]
        for j in range(fronts.first[s], fronts.first[s + 1], BLOCK):
            width = min(BLOCK, fronts.first[s + 1] - j)
            block[:width] = 0
            own = x.ctypes.data + row * j
            subtract_panel(bytes_, width, width, inverse, bytes_ * width, own, block.ctypes.data, row, row)
            for a in range(width):
                for c in range(count):
                    for d in range(count):
                        total[c, d] -= x[j + a, c] * block[a, d]
            inverse += bytes_ * width * width
    return total
