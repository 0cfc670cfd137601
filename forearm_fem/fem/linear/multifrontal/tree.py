"""Elimination tree of a symmetric pattern and the number of entries in each column of its factor.

Davis, Direct Methods for Sparse Linear Systems (2006), chapter 4. Patterns come as the upper triangle in CSR in the old
numbering; ``rank`` gives each unknown's place in the new one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....typing import IntArray
from ...kernels.jit import kernel


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
    start = np.cumsum(start)
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
    start = np.cumsum(start)
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


@kernel
def _common(node: int, ancestor: IntArray) -> int:
    """The last ancestor known of ``node``; paths are shortened on the way."""
    root = node
    while root != ancestor[root]:
        root = ancestor[root]
    while node != root:
        node, ancestor[node] = ancestor[node], root
    return root
