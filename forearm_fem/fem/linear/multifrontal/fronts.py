"""Frontal matrices: assembly from children, and parts of the tree for threads."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....typing import FloatArray, IntArray
from ...kernels.jit import inner_kernel, kernel
from .blas import BLOCK, SECOND, Arguments, invert_block, set_product, subtract_product
from .symbolic import Entries, Fronts, Symbolic

# Sharing of fronts among threads, and their scratch memory.
# Whole subtrees of the elimination tree go to single threads; the few large fronts above them come last, each with all
# threads of BLAS.

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
        end = int(stacked(supernodes, fronts, remainder, begin))
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
def stacked(supernodes: IntArray, fronts: Fronts, remainder: IntArray, begin: int) -> int:
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


@inner_kernel
def lowest_child(s: int, fronts: Fronts, remainder: IntArray, begin: int, free: int) -> int:
    """The lowest place of a child's remainder in this stretch of the stack, ``free`` where none is in it."""
    lowest, c = free, fronts.child[s]
    while c != -1:
        if begin <= remainder[c] < lowest:
            lowest = remainder[c]
        c = fronts.following[c]
    return lowest


# Numerical factorisation of fronts: assembly, elimination block by block, and what is left for the parent.
# Fronts are stored by columns. A supernode's ``panel`` holds its k columns of a front with k + m rows; the remainder,
# m by m, lies on a stack. Only lower triangles are worked out.

_OUTER = 512  # columns that are eliminated before the panel's others hear of them
_TILE, _NARROW = 256, 64  # a triangle is worked out in tiles of so many columns, those on its diagonal in narrow strips


class FrontStore(NamedTuple):
    """Factors: each supernode's panel from ``panels[start[s]]`` on, its inverted blocks from ``inverses[block[s]]``.

    complex64, or float32 for real matrices.
    """

    panels: NDArray[Any]
    start: IntArray
    inverses: NDArray[Any]
    block: IntArray


class Scratch(NamedTuple):
    """Scratch arrays of one thread.

    ``place`` (n,): of unknowns in its front.
    ``outer``: D L^T of a panel's current columns.
    ``under``: D L^T of all columns under the panel.
    """

    call: Arguments
    place: NDArray[np.int32]
    outer: NDArray[Any]
    under: NDArray[Any]


def block_entries(columns: IntArray) -> IntArray:
    """Entries of the inverted blocks (n_supernode,) of supernodes with so many columns."""
    return np.asarray(columns // BLOCK * BLOCK**2 + (columns % BLOCK) ** 2)


def scratch_entries(columns: IntArray, remaining: IntArray) -> tuple[int, int]:
    """Sizes of ``outer`` and ``under`` in :class:`Scratch` for these fronts."""
    outer = (columns + remaining) * np.minimum(columns, _OUTER)
    return int(outer.max(initial=1)), int((columns * remaining).max(initial=1))


@kernel
def factorise_part(
    part: ThreadPart, fronts: Fronts, entries: Entries, data: Any, scale: FloatArray, store: FrontStore,
    remainder: IntArray, stack: NDArray[Any], scratch: Scratch,
) -> int:  # fmt: skip
    """Factorise a part's fronts of the matrix with values ``data`` (nnz,), rows and columns multiplied by ``scale``.

    Returns how many blocks were singular.
    """
    singular, free = 0, part.begin
    for s in part.supernodes:
        bad, free = factorise_front(s, part.begin, free, fronts, entries, data, scale, store, remainder, stack, scratch)
        singular += bad
    return singular


@inner_kernel
def factorise_front(
    s: int, begin: int, free: int, fronts: Fronts, entries: Entries, data: Any, scale: FloatArray, store: FrontStore,
    remainder: IntArray, stack: NDArray[Any], scratch: Scratch,
) -> tuple[int, int]:  # fmt: skip
    """Factorise supernode ``s``, whose remainder is made from ``free`` on of a stack that begins at ``begin``.

    Returns how many blocks were singular, and the end of the stack.
    """
    k, m = fronts.first[s + 1] - fronts.first[s], fronts.below[s + 1] - fronts.below[s]
    _placed(s, fronts, scratch.place)
    _start_panel(s, fronts, entries, data, scale, store, scratch.place)
    for c in range(m):
        stack[free + c * m + c : free + (c + 1) * m] = 0
    child = fronts.child[s]
    while child != -1:
        _add_child(s, child, remainder[child], free, fronts, store, stack, scratch.place)
        child = fronts.following[child]
    singular = _eliminate(k, m, store, s, stack.ctypes.data + stack.itemsize * free, scratch)
    lowest = lowest_child(s, fronts, remainder, begin, free)
    _moved(stack, free, lowest, m)
    remainder[s] = lowest
    return singular, lowest + m * m


@inner_kernel
def _placed(s: int, fronts: Fronts, place: NDArray[np.int32]) -> None:
    k = 0
    for i in range(fronts.first[s], fronts.first[s + 1]):
        place[i] = k
        k += 1
    for p in range(fronts.below[s], fronts.below[s + 1]):
        place[fronts.rows[p]] = k
        k += 1


@inner_kernel
def _start_panel(
    s: int, fronts: Fronts, entries: Entries, data: Any, scale: FloatArray, store: FrontStore, place: NDArray[np.int32]
) -> None:
    """The panel with A's own entries."""
    k, column = fronts.first[s + 1] - fronts.first[s], store.start[s]
    size = k + fronts.below[s + 1] - fronts.below[s]
    store.panels[column : column + k * size] = 0
    for j in range(fronts.first[s], fronts.first[s + 1]):
        for p in range(entries.start[j], entries.start[j + 1]):
            i = entries.row[p]
            store.panels[column + place[i]] = data[entries.source[p]] * (scale[i] * scale[j])
        column += size


@inner_kernel
def _add_child(
    s: int, child: int, source: int, target: int, fronts: Fronts, store: FrontStore, stack: NDArray[Any],
    place: NDArray[np.int32],
) -> None:  # fmt: skip
    """Add a child's remainder to the panel and the remainder of its parent ``s``."""
    k, m = fronts.first[s + 1] - fronts.first[s], fronts.below[s + 1] - fronts.below[s]
    rows = fronts.rows[fronts.below[child] : fronts.below[child + 1]]
    for c in range(len(rows)):
        column = place[rows[c]]
        if column < k:
            to, base = store.panels, store.start[s] + column * (k + m)
        else:
            to, base = stack, target + (column - k) * m - k
        for r in range(c, len(rows)):
            to[base + place[rows[r]]] += stack[source + r]
        source += len(rows)


@inner_kernel
def _moved(stack: NDArray[Any], source: int, target: int, m: int) -> None:
    """Move a lower triangle down the stack."""
    if source == target:
        return
    for c in range(m):
        for r in range(c * m + c, (c + 1) * m):
            stack[target + r] = stack[source + r]


@inner_kernel
def _eliminate(k: int, m: int, store: FrontStore, s: int, remainder: int, scratch: Scratch) -> int:
    """Eliminate a front's first k unknowns; its panel becomes L, with D's inverted blocks beside it.

    ``remainder`` is the address of the other m by m, which becomes the Schur complement.
    """
    size, call, singular, bytes_ = k + m, scratch.call, 0, store.panels.itemsize
    panel = store.panels.ctypes.data + bytes_ * store.start[s]
    outer, under = scratch.outer.ctypes.data, scratch.under.ctypes.data
    inverse = store.block[s]
    for o in range(0, k, _OUTER):
        end = min(o + _OUTER, k)
        for j in range(o, end, BLOCK):
            width = min(BLOCK, end - j)
            singular += not _block(store, store.start[s] + j * (size + 1), size, width, inverse, call)
            inverse += width * width
            _kept(store.panels, store.start[s] + j * size, j + width, size, width, (j - o) * size, k, m, j, scratch)
            rest, at = size - j - width, outer + bytes_ * ((j - o) * size + j + width)
            below = panel + bytes_ * (j * size + j + width)
            set_product(call, (rest, width, width), at, size, call.block.ctypes.data, width, below, size)
            right = panel + bytes_ * (j + width) * (size + 1)
            subtract_product(call, (rest, end - j - width, width), below, size, at, size, right, size, SECOND)
        left, at = panel + bytes_ * (o * size + end), outer + bytes_ * end
        right = panel + bytes_ * end * (size + 1)
        _subtract_lower(call, size - end, k - end, end - o, left, size, at, size, right, size)
    left = panel + bytes_ * k
    _subtract_lower(call, m, m, k, left, size, under, m, remainder, m)
    return singular


@inner_kernel
def _subtract_lower(
    call: Arguments, rows: int, columns: int, inner: int, a: int, lda: int, b: int, ldb: int, c: int, ldc: int
) -> None:
    """C -= A B^T where C (rows, columns) lies on or below its diagonal, and a little above."""
    bytes_ = call.scalars.itemsize
    for t in range(0, columns, _TILE):
        end = min(t + _TILE, columns)
        for j in range(t, end, _NARROW):
            shape = (end - j, min(_NARROW, end - j), inner)
            target = c + bytes_ * j * (ldc + 1)
            subtract_product(call, shape, a + bytes_ * j, lda, b + bytes_ * j, ldb, target, ldc, SECOND)
        target = c + bytes_ * (t * ldc + end)
        subtract_product(
            call, (rows - end, end - t, inner), a + bytes_ * end, lda, b + bytes_ * t, ldb, target, ldc, SECOND
        )


@inner_kernel
def _block(store: FrontStore, corner: int, size: int, width: int, inverse: int, call: Arguments) -> bool:
    """Invert the diagonal block at ``corner`` of the panels into ``call.block`` and the store."""
    for c in range(width):
        for r in range(c, width):
            value = store.panels[corner + c * size + r]
            call.block[c * width + r] = value
            call.block[r * width + c] = value
    regular = invert_block(call, width)
    for q in range(width * width):
        store.inverses[inverse + q] = call.block[q]
    return regular


@inner_kernel
def _kept(
    panels: NDArray[Any], source: int, low: int, size: int, width: int, target: int, k: int, m: int, j: int,
    scratch: Scratch,
) -> None:  # fmt: skip
    """Copy what is below a block before L takes its place: L D, by which other columns change."""
    for c in range(width):
        for r in range(low, size):
            scratch.outer[target + c * size + r] = panels[source + c * size + r]
        for r in range(k, size):
            scratch.under[(j + c) * m + r - k] = panels[source + c * size + r]
