"""Multifrontal LDL^T of a complex or real symmetric matrix in single precision: numeric factorisation and solves."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ....errors import SolverError
from ....typing import ComplexArray, FloatArray, IntArray
from ...kernels.compiled import give_back, in_threads, thread_count
from ...kernels.jit import inner_kernel, kernel
from .blas import BLOCK, arguments
from .fronts import (
    FrontStore,
    Parts,
    Scratch,
    ThreadPart,
    block_entries,
    divided,
    factorise_front,
    factorise_part,
    scratch_entries,
)
from .panels import subtract_panel, subtract_panel_transposed
from .symbolic import Entries, Fronts, Symbolic, lower_entries, symbolic_factor

# Forward and backward substitution with the factors of :mod:`.fronts`, for many right-hand sides at once.
# Right-hand sides are (n, count) by rows, with zeros up to a multiple of eight: a supernode's own are next to each
# other.

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


@inner_kernel
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


# Right-hand sides carried along while fronts are eliminated, whose factors are then given up.
# A = L D L^T is symmetric, so B^T A^-1 B = Y^T D^-1 Y with L Y = B: compliances at the loads need no substitution
# backwards, and each front's part of L is needed only until B has passed it. Fronts of a part take turns in one panel.


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


# The multifrontal factorisation behind the interface of direct solvers.

_MANY_ROWS = 20_000  # below, starting threads costs what they save
PRESSURES = 0.3  # entries that couple pressures are scaled to this at most; 0.1 and 1 leave more of point forces


class MultifrontalFactor:
    """One analysis, any number of factorisations in single precision of matrices with the same pattern.

    ``upper`` is the upper triangle in CSR, every diagonal entry stored; its first ``n_displacements`` unknowns are
    displacements, the others pressures, and ``order`` (n,) is that of elimination (:mod:`..ordering`). Every matrix is
    scaled: displacements by their diagonal, pressures by what couples them to displacements. Real matrices are
    factorised in real numbers, half the memory, and right-hand sides must be real then. Solving
    raises :class:`SolverError` where a block of pivots was singular. Not thread-safe.
    """

    name = "multifrontal"
    single = True

    def __init__(self, upper: csr_array, n_displacements: int, order: IntArray) -> None:
        self.n = int(upper.shape[0])
        self.symbolic = symbolic_factor(upper, order)
        self._indptr, self._indices, self._n_displacements = upper.indptr, upper.indices, n_displacements
        self._parts = divided(self.symbolic, thread_count())
        self._store: FrontStore | None = None

    def factorise(self, data: ComplexArray | FloatArray) -> None:
        """See :class:`..factor.Factor`."""
        number = np.complex64 if np.iscomplexobj(data) else np.float32
        scale = scales(self._indptr, self._indices, data, self._n_displacements)
        self._scale = scale[self.symbolic.order]
        if self._store is None or self._store.panels.dtype != number:
            self.release()
            give_back()  # what the ordering left, or factors of the other kind: these fit into neither's place
            self._store = _front_store(self.symbolic, number)
        store = self._store
        stack, parts = np.empty(self._parts.stack, number), (*self._parts.subtrees, self._parts.top)
        rooms = [_scratch(self.symbolic, part, number) for part in parts]
        fronts, entries, remainder = self.symbolic.fronts, self._entries(), self._parts.remainder

        def work(part: ThreadPart) -> int:
            """Factorise a part's fronts; how many blocks of pivots were singular."""
            room = rooms[part.number]
            return int(factorise_part(part, fronts, entries, data, self._scale, store, remainder, stack, room))

        self._singular = sum(in_threads(work, self._parts.subtrees)) + work(self._parts.top)

    def solve(self, right: NDArray[Any]) -> NDArray[Any]:
        """See :class:`..factor.Factor`."""
        if (store := self._store) is None:
            raise SolverError("there are no factors: factorise before solving")
        if self._singular:
            raise SolverError(f"blocks of pivots are singular in single precision (n = {self.n})")
        number = store.panels.dtype.type
        kind = float if number is np.float32 else complex
        columns = np.ascontiguousarray(right.reshape(self.n, -1), dtype=kind)
        x = np.empty((self.n, -(-columns.shape[1] // LANES) * LANES), number)
        self._by_rows(lambda a, b: take_in(columns, self.symbolic.order, self._scale, x, a, b))
        fronts, owner = self.symbolic.fronts, self._parts.owner
        locals_ = [self._local(part, x.shape[1], x.dtype) for part in (*self._parts.subtrees, self._parts.top)]
        whole, top = (0, x.shape[1]), self._parts.top

        def down(part: ThreadPart) -> NDArray[Any]:
            """Forward through a subtree; what it leaves to the rows above."""
            others = np.zeros_like(x)
            forward(part, fronts, store, owner, x, others, locals_[part.number], whole)
            return others

        def over_the_top(some: tuple[int, int]) -> None:
            """Forward and backward through the top for ``some`` columns."""
            forward(top, fronts, store, owner, x, x, locals_[top.number], some)
            backward(top, fronts, store, x, locals_[top.number], some)

        def up(part: ThreadPart) -> None:
            """Backward through a subtree."""
            backward(part, fronts, store, x, locals_[part.number], whole)

        subtrees, above = self._parts.subtrees, owner == top.number
        for others in in_threads(down, subtrees):
            x[above] += others[above]
        in_threads(over_the_top, _shared(x.shape[1], len(subtrees)))
        in_threads(up, subtrees)
        solution = np.empty_like(columns)
        self._by_rows(lambda a, b: put_back(x, self.symbolic.order, self._scale, solution, a, b))
        return solution.reshape(right.shape)

    def products(self, data: ComplexArray | FloatArray, right: NDArray[Any]) -> ComplexArray:
        """See :class:`..factor.Factor`; SolverError where a block of pivots was singular."""
        self.release()
        give_back()
        number = np.complex64 if np.iscomplexobj(data) else np.float32
        scale = scales(self._indptr, self._indices, data, self._n_displacements)[self.symbolic.order]
        store, parts = passing_store(self.symbolic, self._parts, number), (*self._parts.subtrees, self._parts.top)
        x = np.empty((self.n, -(-right.shape[1] // LANES) * LANES), number)
        columns = np.ascontiguousarray(right, dtype=float if number is np.float32 else complex)
        self._by_rows(lambda a, b: take_in(columns, self.symbolic.order, scale, x, a, b))
        stack = np.empty(self._parts.stack, number)
        rooms = [(_scratch(self.symbolic, p, number), self._local(p, x.shape[1], x.dtype)) for p in parts]
        fronts, entries, owner = self.symbolic.fronts, self._entries(), self._parts.owner

        def work(part: ThreadPart, others: NDArray[Any]) -> int:
            """Eliminate a part and its right-hand sides; how many blocks of pivots were singular."""
            scratch, local = rooms[part.number]
            whole = entries, data, scale, store, self._parts.remainder, stack
            return int(eliminate_part(part, fronts, *whole, scratch, owner, x, others, local))

        given = [np.zeros_like(x) for _ in self._parts.subtrees]
        singular = sum(in_threads(lambda part: work(part, given[part.number]), self._parts.subtrees))
        above = owner == self._parts.top.number
        for others in given:
            x[above] += others[above]
        singular += work(self._parts.top, x)
        if singular:
            raise SolverError(f"blocks of pivots are singular in single precision (n = {self.n})")
        count = right.shape[1]
        return np.asarray(pivot_products(fronts, store, x, rooms[-1][1].block)[:count, :count])

    def harden(self, data: ComplexArray | FloatArray) -> bool:
        """See :class:`..factor.Factor`; this one cannot."""
        return False

    def release(self) -> None:
        """See :class:`..factor.Factor`."""
        self._store = None

    @property
    def entries(self) -> int:
        """Entries of the factors as they are stored, a supernode's own square included."""
        return int(self.symbolic.panel_entries.sum())

    def _entries(self) -> Entries:
        """A's entries in the order of elimination: found in less than a second, and as large as its values."""
        return lower_entries(self._indptr, self._indices, np.argsort(self.symbolic.order))

    def _by_rows(self, work: Callable[[int, int], None]) -> None:
        """``work`` on ranges of rows, one for each thread where there are enough."""
        cuts = np.linspace(0, self.n, thread_count() + 1 if self.n > _MANY_ROWS else 2).astype(int).tolist()
        in_threads(lambda rows: work(*rows), list(pairwise(cuts)))

    def _local(self, part: ThreadPart, count: int, number: np.dtype[Any]) -> Local:
        rows = self.symbolic.remaining[part.supernodes].max(initial=0)
        return Local(np.empty((rows, count), number), np.empty((BLOCK, count), number))


def _front_store(symbolic: Symbolic, number: type[np.complex64] | type[np.float32]) -> FrontStore:
    """Room for the factors, which is kept between factorisations in such numbers."""
    panels, blocks = symbolic.panel_entries, block_entries(symbolic.columns)
    return FrontStore(
        np.empty(panels.sum(), number),
        np.concatenate([[0], np.cumsum(panels)]),
        np.empty(blocks.sum(), number),
        np.concatenate([[0], np.cumsum(blocks)]),
    )


def _scratch(symbolic: Symbolic, part: ThreadPart, number: type[np.complex64] | type[np.float32]) -> Scratch:
    some = part.supernodes
    outer, under = scratch_entries(symbolic.columns[some], symbolic.remaining[some])
    place = np.empty(len(symbolic.order), np.int32)
    return Scratch(arguments(number), place, np.empty(outer, number), np.empty(under, number))


def _shared(columns: int, threads: int) -> list[tuple[int, int]]:
    """Right-hand sides from and up to, whole vectors, for each thread that gets any."""
    cuts = np.linspace(0, columns // LANES, threads + 1).round().astype(int) * LANES
    return [(int(a), int(b)) for a, b in pairwise(cuts) if a < b]


@kernel
def scales(indptr: IntArray, indices: IntArray, data: ComplexArray | FloatArray, n_displacements: int) -> FloatArray:
    """Factors (n,) for rows and columns: displacements have a diagonal of 1 then, pressures a largest coupling of 0.3.

    Unknowns that have neither keep their scale.
    """
    n = len(indptr) - 1
    scale, largest = np.ones(n), np.zeros(n)
    for i in range(n_displacements):
        diagonal = abs(data[indptr[i]])
        scale[i] = 1 / np.sqrt(diagonal) if diagonal > 0 else 1.0
    for i in range(n_displacements):
        for p in range(indptr[i], indptr[i + 1]):
            j = indices[p]
            if j >= n_displacements:
                largest[j] = max(largest[j], abs(data[p]) * scale[i])
    for j in range(n_displacements, n):
        scale[j] = PRESSURES / largest[j] if largest[j] > 0 else 1.0
    return scale
