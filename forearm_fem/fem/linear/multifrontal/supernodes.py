"""Which unknowns are eliminated together, and what they couple to: all that the pattern tells before any value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ....typing import BoolArray, FloatArray, IntArray
from ...kernels.jit import kernel
from .tree import (
    Entries,
    children,
    column_counts,
    elimination_tree,
    lower_entries,
    postorder,
    transposed_rows,
)

# A supernode takes its parent in while it has at most so many columns, and fewer zeros than this share of its entries.
_COLUMNS = (16, 64, 192)
_ZEROS = (0.5, 0.2, 0.05)


class Fronts(NamedTuple):
    """Supernodes in postorder: columns ``first[s]`` to ``first[s + 1]``, ``rows`` below them from ``below[s]`` on,
    the first ``child`` (n_supernode,) of each in the elimination tree and the ``following`` sibling, or -1."""

    first: IntArray
    below: IntArray
    rows: NDArray[np.int32]
    child: IntArray
    following: IntArray


@dataclass(frozen=True)
class Symbolic:
    """``order`` (n,): unknowns in the order of their elimination; A's ``entries`` and the ``fronts`` in that order;
    ``parent`` (n_supernode,), -1 at roots."""

    order: IntArray
    entries: Entries
    fronts: Fronts
    parent: IntArray

    @property
    def columns(self) -> IntArray:
        """Unknowns (n_supernode,) of each supernode."""
        return np.diff(self.fronts.first)

    @property
    def remaining(self) -> IntArray:
        """Unknowns (n_supernode,) that each front leaves to its parent."""
        return np.diff(self.fronts.below)

    @property
    def panel_entries(self) -> IntArray:
        """Entries (n_supernode,) of each supernode's panel."""
        return np.asarray(self.columns * (self.columns + self.remaining))

    @property
    def arithmetic(self) -> FloatArray:
        """Real operations (n_supernode,) of each front, multiplication and addition counted apart."""
        k, m = self.columns.astype(float), self.remaining.astype(float)
        return np.asarray(4 * (k**3 / 3 + k**2 * m + k * m**2))


def symbolic_factor(upper: csr_array, order: IntArray) -> Symbolic:
    """Symbolic factorisation of a symmetric pattern, its diagonal stored, for unknowns eliminated in about ``order``.

    The order kept is a postorder of the elimination tree, which leaves the same entries in the factor.
    """
    indptr, indices = upper.indptr.astype(np.int64), upper.indices.astype(np.int64)
    parent = elimination_tree(*transposed_rows(lower_entries(indptr, indices, np.argsort(order))))
    post = postorder(parent)
    above, rank = parent[post], np.argsort(post)
    parent = np.where(above >= 0, rank[above], -1)
    order = order[post]
    entries = lower_entries(indptr, indices, np.argsort(order))
    count = column_counts(entries, parent)
    chains, above = _fundamental(parent, count)
    kept, size = _merged(np.diff(chains), count[chains[:-1]], above, np.array(_COLUMNS), np.array(_ZEROS))
    first = chains[np.append(kept, True)]
    below = np.concatenate([[0], np.cumsum(size[kept] - np.diff(first))])
    rows, above = _rows(first, below, entries)
    rows = rows[np.lexsort((rows, np.repeat(np.arange(len(above)), np.diff(below))))]
    return Symbolic(order, entries, Fronts(first, below, rows, *children(above)), above)


def _fundamental(parent: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
    """Where chains of columns with the same pattern start (n_chain + 1,), and each chain's parent (n_chain,)."""
    n = len(parent)
    starts = (parent[:-1] != np.arange(1, n)) | (count[:-1] != count[1:] + 1)
    first = np.concatenate([[0], np.flatnonzero(starts) + 1, [n]])
    chain = np.repeat(np.arange(len(first) - 1), np.diff(first))
    above = parent[first[1:] - 1]
    return first, np.where(above >= 0, chain[above], -1)


@kernel
def _worth_merging(columns: int, new: float, zeros: float, size: float, limits: IntArray, shares: FloatArray) -> bool:
    if new == 0 or columns <= limits[0]:
        return True
    share = zeros / size
    if (columns <= limits[1] and share < shares[0]) or (columns <= limits[2] and share < shares[1]):
        return True
    return bool(share < shares[2])


@kernel
def _merged(
    columns: IntArray, size: IntArray, above: IntArray, limits: IntArray, shares: FloatArray
) -> tuple[BoolArray, IntArray]:
    """Which chains (n_chain,) start a supernode, and the size (n_chain,) of its front.

    Chains of so many ``columns``, with a front of ``size``, take in the parent ``above`` them, where that stands next
    to them and few zeros are added (as CHOLMOD's relaxed supernodes).
    """
    n = len(columns)
    columns, size, zeros, kept = columns.copy(), size.copy(), np.zeros(n), np.ones(n, np.bool_)
    into, after = np.arange(n), np.arange(1, n + 1)
    for s in range(n - 2, -1, -1):
        p = above[s]
        while p != -1 and into[p] != p:
            p = into[p]
        if p == -1 or p != after[s]:
            continue
        together = columns[s] + columns[p]
        new = columns[s] * float(size[p] + columns[s] - size[s])
        entries = together * (together + 1) / 2.0 + together * float(size[p] - columns[p])
        if _worth_merging(together, new, zeros[p] + new, entries, limits, shares):
            kept[p], into[p], zeros[s], after[s] = False, s, zeros[p] + new, after[p]
            size[s], columns[s] = columns[s] + size[p], together
    return kept, size


@kernel
def _rows(first: IntArray, below: IntArray, entries: Entries) -> tuple[NDArray[np.int32], IntArray]:
    """Rows below each supernode, in any order, and the supernode (n_supernode,) that the least of them belongs to."""
    n = len(first) - 1
    owner = np.empty(first[n], np.int64)
    for s in range(n):
        owner[first[s] : first[s + 1]] = s
    rows, mark = np.empty(below[n], np.int32), np.full(first[n], -1, np.int64)
    parent, child, following = np.full(n, -1, np.int64), np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    for s in range(n):
        end, q = first[s + 1], below[s]
        q = _noted(entries.row[entries.start[first[s]] : entries.start[end]], end, s, mark, rows, q)
        c = child[s]
        while c != -1:
            q = _noted(rows[below[c] : below[c + 1]], end, s, mark, rows, q)
            c = following[c]
        if q > below[s]:
            p = owner[rows[below[s] : q].min()]
            parent[s], following[s], child[p] = p, child[p], s
    return rows, parent


@kernel
def _noted(some: NDArray[np.int32], end: int, s: int, mark: IntArray, rows: NDArray[np.int32], q: int) -> int:
    """Put what is new among ``some`` rows from ``end`` on at ``rows[q]`` and after; the next free place."""
    for i in some:
        if i >= end and mark[i] != s:
            mark[i], rows[q] = s, i
            q += 1
    return q
