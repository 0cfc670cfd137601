"""How fronts are shared among threads, and where each keeps what is left of them.

Whole subtrees of the elimination tree go to single threads; the few large fronts above them come last, each with all
threads of BLAS.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....typing import FloatArray, IntArray
from ...kernels.jit import kernel
from .supernodes import Fronts, Symbolic

_SPLITS = 20  # divisions tried, times the number of threads
_SLOWER = 1.25  # what fronts take longer with all threads of BLAS on one, assembly and short products not shared


class ThreadPart(NamedTuple):
    """Supernodes of one thread in the order of their elimination, and its stretch of the stack of remainders."""

    number: int
    supernodes: IntArray
    begin: int
    end: int


@dataclass(frozen=True)
class Parts:
    """``subtrees`` for a thread each, then the ``top``; ``owner`` (n,) is the number of each unknown's part, and
    ``remainder`` (n_supernode,) where what is left of each front stands on the stack."""

    subtrees: tuple[ThreadPart, ...]
    top: ThreadPart
    owner: NDArray[np.int32]
    remainder: IntArray

    @property
    def stack(self) -> int:
        """Entries that the stack needs."""
        return self.top.end


def divided(symbolic: Symbolic, threads: int) -> Parts:
    """Subtrees of about equal arithmetic for each thread, and what remains above them."""
    chosen, top = _subtrees(symbolic, threads)
    fronts = symbolic.fronts
    remainder, owner = np.zeros(len(symbolic.parent), np.int64), np.empty(fronts.first[-1], np.int32)
    found, begin = list[ThreadPart](), 0
    for number, supernodes in enumerate([*chosen, top]):
        end = int(_stacked(supernodes, fronts, remainder, begin))
        found.append(ThreadPart(number, supernodes, begin, end))
        owner[_columns(supernodes, fronts.first)] = number
        begin = end
    return Parts(tuple(found[:-1]), found[-1], owner, remainder)


def _subtrees(symbolic: Symbolic, threads: int) -> tuple[list[IntArray], IntArray]:
    """Supernodes of each thread, and those above all subtrees.

    The largest subtree is split again and again; what is kept is the division that should take the least time.
    """
    fronts, parent, own = symbolic.fronts, symbolic.parent, symbolic.arithmetic
    work, size = _whole(own, parent), _whole(np.ones(len(parent)), parent)
    roots = [(-work[s], int(s)) for s in np.flatnonzero(parent < 0)]
    heapq.heapify(roots)
    top, best, found = list[int](), np.inf, (list[list[int]](), list[int]())
    for _ in range(_SPLITS * threads):
        shares, load = _shared(roots, threads)
        seconds = _SLOWER * own[top].sum() / threads + load.max()
        if seconds < best:
            best, found = seconds, (shares, sorted(top))
        if not roots:
            break
        s = heapq.heappop(roots)[1]
        top.append(s)
        c = int(fronts.child[s])
        while c != -1:
            heapq.heappush(roots, (-work[c], c))
            c = int(fronts.following[c])
    return [_descendants(sorted(some), size) for some in found[0]], np.array(found[1], np.int64)


def _shared(roots: list[tuple[float, int]], threads: int) -> tuple[list[list[int]], FloatArray]:
    """Roots of each thread's subtrees, the largest first to whom has least, and the threads' loads (threads,)."""
    mine, load = [list[int]() for _ in range(threads)], np.zeros(threads)
    for negative, s in sorted(roots):
        least = int(np.argmin(load))
        mine[least].append(s)
        load[least] -= negative
    return mine, load


def _whole(own: FloatArray, parent: IntArray) -> FloatArray:
    """Sums (n,) over each node and all below it, for children before parents."""
    total = own.copy()
    for s, p in enumerate(parent):
        if p >= 0:
            total[p] += total[s]
    return total


def _descendants(roots: list[int], size: FloatArray) -> IntArray:
    """Nodes of the subtrees with these roots, in postorder."""
    return np.concatenate([np.empty(0, np.int64), *(np.arange(s + 1 - int(size[s]), s + 1) for s in roots)])


def _columns(supernodes: IntArray, first: IntArray) -> IntArray:
    none = np.empty(0, np.int64)
    return np.concatenate([none, *(np.arange(first[s], first[s + 1]) for s in supernodes)])


@kernel
def _stacked(supernodes: IntArray, fronts: Fronts, remainder: IntArray, begin: int) -> int:
    """End of the stack where these fronts are eliminated in turn; notes where each leaves its remainder.

    A front's remainder is made above those of its children and then takes their place.
    """
    free, end = begin, begin
    for s in supernodes:
        size = (fronts.below[s + 1] - fronts.below[s]) ** 2
        end = max(end, free + size)
        lowest = lowest_child(s, fronts, remainder, begin, free)
        remainder[s] = lowest
        free = lowest + size
    return end


@kernel
def lowest_child(s: int, fronts: Fronts, remainder: IntArray, begin: int, free: int) -> int:
    """The lowest place of a child's remainder in this stretch of the stack, ``free`` where none is in it."""
    lowest, c = free, fronts.child[s]
    while c != -1:
        if begin <= remainder[c] < lowest:
            lowest = remainder[c]
        c = fronts.following[c]
    return lowest
