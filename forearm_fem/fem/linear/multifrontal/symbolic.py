"""Symbolic factorisation: elimination tree and supernodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ....typing import BoolArray, FloatArray, IntArray
from ...kernels.jit import inner_kernel, kernel
from ...kernels.scatter import add_up

# Elimination tree of a symmetric pattern and the number of entries in each column of its factor.
# Davis, Direct Methods for Sparse Linear Systems (2006), chapter 4. Patterns come as the upper triangle in CSR in the
# old numbering; ``rank`` gives each unknown's place in the new one.


class Entries(NamedTuple):
    """A's entries by columns of the new numbering: ``row`` (nnz,) not above the diagonal, ``source`` (nnz,) in the data
    of the old one; column j has those from ``start[j]`` to ``start[j + 1]``."""

    start: IntArray
    row: NDArray[np.int32]
    source: NDArray[np.int32]


@kernel
def lower_entries(indptr: IntArray, indices: IntArray, rank: IntArray) -> Entries:
    """Entries of the lower triangle in the numbering ``rank``, column by column."""
    n = len(rank)
    start = np.zeros(n + 1, np.int64)
    for r in range(n):
        for p in range(indptr[r], indptr[r + 1]):
            start[min(rank[r], rank[indices[p]]) + 1] += 1
    add_up(start)
    fill = start[:-1].copy()
    row, source = np.empty(start[n], np.int32), np.empty(start[n], np.int32)
    for r in range(n):
        for p in range(indptr[r], indptr[r + 1]):
            a, b = rank[r], rank[indices[p]]
            q = fill[min(a, b)]
            row[q], source[q] = max(a, b), p
            fill[min(a, b)] = q + 1
    return Entries(start, row, source)


@kernel
def transposed_rows(entries: Entries) -> tuple[IntArray, IntArray]:
    """Columns of each row of the lower triangle: where each row starts (n + 1,) and its columns (nnz,)."""
    n = len(entries.start) - 1
    start = np.zeros(n + 1, np.int64)
    for i in entries.row:
        start[i + 1] += 1
    add_up(start)
    fill = start[:-1].copy()
    column = np.empty(len(entries.row), np.int32)
    for j in range(n):
        for p in range(entries.start[j], entries.start[j + 1]):
            column[fill[entries.row[p]]] = j
            fill[entries.row[p]] += 1
    return start, column


@kernel
def elimination_tree(start: IntArray, column: IntArray) -> IntArray:
    """Parent (n,) of each column, -1 at roots, from the rows of the lower triangle (Liu's algorithm)."""
    n = len(start) - 1
    parent, ancestor = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    for j in range(n):
        for p in range(start[j], start[j + 1]):
            i = np.int64(column[p])
            while i != -1 and i < j:
                above = ancestor[i]
                ancestor[i] = j
                if above == -1:
                    parent[i] = j
                i = above
    return parent


@kernel
def children(parent: IntArray) -> tuple[IntArray, IntArray]:
    """First child (n,) of each node and next sibling (n,), -1 where there is none; siblings ascend."""
    first, following = np.full(len(parent), -1, np.int64), np.full(len(parent), -1, np.int64)
    for j in range(len(parent) - 1, -1, -1):
        if parent[j] >= 0:
            following[j] = first[parent[j]]
            first[parent[j]] = j
    return first, following


@kernel
def postorder(parent: IntArray) -> IntArray:
    """Nodes (n,) so that each tree's nodes are together and children stand before parents."""
    child, following = children(parent)
    post, stack, k = np.empty(len(parent), np.int64), np.empty(len(parent), np.int64), 0
    for root in range(len(parent)):
        if parent[root] != -1:
            continue
        top, stack[0] = 0, root
        while top >= 0:
            j = stack[top]
            if child[j] == -1:
                post[k] = j
                k, top = k + 1, top - 1
            else:
                top += 1
                stack[top] = child[j]
                child[j] = following[child[j]]
    return post


@kernel
def column_counts(entries: Entries, parent: IntArray) -> IntArray:
    """Entries (n,) of each column of the factor, diagonal included, for columns in postorder.

    Gilbert, Ng and Peyton's algorithm: row i of the factor is the subtree of those columns below i whose leaves are A's
    entries, and each leaf less the common ancestor with the leaf before it counts once.
    """
    n = len(parent)
    first = np.full(n, -1, np.int64)
    count = np.zeros(n, np.int64)
    for k in range(n):
        j = k
        count[j] = first[j] == -1
        while j != -1 and first[j] == -1:
            first[j] = k
            j = parent[j]
    last, leaf, ancestor = np.full(n, -1, np.int64), np.full(n, -1, np.int64), np.arange(n)
    for j in range(n):
        if parent[j] != -1:
            count[parent[j]] -= 1
        for p in range(entries.start[j], entries.start[j + 1]):
            i = entries.row[p]
            if i <= j or first[j] <= last[i]:
                continue
            if leaf[i] != -1:
                count[_common(leaf[i], ancestor)] -= 1
            count[j] += 1
            last[i], leaf[i] = first[j], j
        if parent[j] != -1:
            ancestor[j] = parent[j]
    for j in range(n):
        if parent[j] != -1:
            count[parent[j]] += count[j]
    return count


@inner_kernel
def _common(node: int, ancestor: IntArray) -> int:
    """The last ancestor known of ``node``; paths are shortened on the way."""
    root = node
    while root != ancestor[root]:
        root = ancestor[root]
    while node != root:
        node, ancestor[node] = ancestor[node], root
    return root


# Symbolic factorisation: unknowns eliminated together, and their couplings, from the pattern alone.

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
    """``order`` (n,): unknowns in the order of their elimination; the ``fronts`` in that order; ``parent``
    (n_supernode,), -1 at roots."""

    order: IntArray
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
    indptr, indices = upper.indptr.astype(np.int32, copy=False), upper.indices.astype(np.int32, copy=False)
    parent = elimination_tree(*transposed_rows(lower_entries(indptr, indices, np.argsort(order))))
    post = postorder(parent)
    above, rank = parent[post], np.argsort(post)
    parent = np.where(above >= 0, rank[above], -1)
    order = order[post]
    entries = lower_entries(indptr, indices, np.argsort(order))
    count = column_counts(entries, parent)
    chains, above = _fundamental(parent, count)
    kept, size = merged(np.diff(chains), count[chains[:-1]], above, np.array(_COLUMNS), np.array(_ZEROS))
    first = chains[np.append(kept, True)]
    below = np.concatenate([[0], np.cumsum(size[kept] - np.diff(first))])
    rows, above = rows_below(first, below, entries)
    rows = rows[np.lexsort((rows, np.repeat(np.arange(len(above)), np.diff(below))))]
    return Symbolic(order, Fronts(first, below, rows, *children(above)), above)


def _fundamental(parent: IntArray, count: IntArray) -> tuple[IntArray, IntArray]:
    """Starts of chains of columns with the same pattern (n_chain + 1,), and each chain's parent (n_chain,)."""
    n = len(parent)
    starts = (parent[:-1] != np.arange(1, n)) | (count[:-1] != count[1:] + 1)
    first = np.concatenate([[0], np.flatnonzero(starts) + 1, [n]])
    chain = np.repeat(np.arange(len(first) - 1), np.diff(first))
    above = parent[first[1:] - 1]
    return first, np.where(above >= 0, chain[above], -1)


@inner_kernel
def _worth_merging(columns: int, new: float, zeros: float, size: float, limits: IntArray, shares: FloatArray) -> bool:
    if new == 0 or columns <= limits[0]:
        return True
    share = zeros / size
    if (columns <= limits[1] and share < shares[0]) or (columns <= limits[2] and share < shares[1]):
        return True
    return bool(share < shares[2])


@kernel
def merged(
    columns: IntArray, size: IntArray, above: IntArray, limits: IntArray, shares: FloatArray
) -> tuple[BoolArray, IntArray]:
    """True where a chain starts a supernode (n_chain,), and the size of its front (n_chain,).

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
def rows_below(first: IntArray, below: IntArray, entries: Entries) -> tuple[NDArray[np.int32], IntArray]:
    """Rows below each supernode, in any order, and the supernode (n_supernode,) that the least of them belongs to."""
    n = len(first) - 1
    owner = np.empty(first[n], np.int64)
    for s in range(n):
        owner[first[s] : first[s + 1]] = s
    rows, mark = np.empty(below[n], np.int32), np.full(first[n], -1, np.int64)
    parent, child, following = np.full(n, -1, np.int64), np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    for s in range(n):
        end, q = first[s + 1], below[s]
        q = _noted(entries.row, entries.start[first[s]], entries.start[end], end, s, mark, rows, q)
        c = child[s]
        while c != -1:
            q = _noted(rows, below[c], below[c + 1], end, s, mark, rows, q)
            c = following[c]
        if q > below[s]:
            least = rows[below[s]]
            for k in range(below[s] + 1, q):
                least = min(least, rows[k])
            p = owner[least]
            parent[s], following[s], child[p] = p, child[p], s
    return rows, parent


@inner_kernel
def _noted(
    some: NDArray[np.int32], low: int, high: int, end: int, s: int, mark: IntArray, rows: NDArray[np.int32], q: int
) -> int:
    """Put what is new among the rows ``some[low:high]`` from ``end`` on at ``rows[q]`` and after; the next free
    place."""
    for p in range(low, high):
        i = some[p]
        if i >= end and mark[i] != s:
            mark[i], rows[q] = s, i
            q += 1
    return q
