"""The multifrontal factorisation behind the interface of direct solvers."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ....errors import SolverError
from ....typing import ComplexArray, FloatArray, IntArray
from ...kernels.heap import give_back
from ...kernels.jit import kernel
from ...kernels.threads import in_threads, thread_count
from .blas import BLOCK, arguments
from .elimination import eliminate_part, passing_store, pivot_products
from .fronts import FrontStore, Scratch, block_entries, factorise_part, scratch_entries
from .parts import ThreadPart, divided
from .substitution import LANES, Local, backward, forward, put_back, take_in
from .supernodes import Symbolic, symbolic_factor

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
        fronts, entries, remainder = self.symbolic.fronts, self.symbolic.entries, self._parts.remainder

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
        fronts, entries, owner = self.symbolic.fronts, self.symbolic.entries, self._parts.owner

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

    def harden(self) -> bool:
        """See :class:`..factor.Factor`; this one cannot."""
        return False

    def release(self) -> None:
        """See :class:`..factor.Factor`."""
        self._store = None

    @property
    def entries(self) -> int:
        """Entries of the factors as they are stored, a supernode's own square included."""
        return int(self.symbolic.panel_entries.sum())

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
