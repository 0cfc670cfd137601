"""Order in which unknowns are eliminated: nested dissection of the mesh's nodes, pressures after displacements.

PARDISO orders by itself with METIS, one separator tried a level. Several tried, and parts of less equal size, leave a
tenth less work to the factorisation; the nodes' graph is small enough that this costs no more. A pressure that is
eliminated before the displacements it depends on has a pivot of the size of 1 / bulk modulus alone, and the factors
lose three digits by it: it waits for a quarter of them (docs/decisions/0008).
"""

from __future__ import annotations

import importlib.util

import numpy as np
from scipy.sparse import csc_array, csr_array, eye_array

from ...typing import IntArray

_SEPARATORS = 4  # tried on each level
_UNEVEN = 300  # parts may differ by this many thousandths; 400 was as good, 600 worse, 1000 did not end
_SMALL = 3000  # unknowns below which there is nothing to gain


def nested_dissection(upper: csr_array, n_displacements: int) -> IntArray | None:
    """Unknowns (n,) in the order of their elimination; None where METIS is not installed or the matrix is small.

    ``upper`` is the upper triangle of a matrix with a symmetric pattern, every diagonal entry stored; its first
    ``n_displacements`` unknowns are displacements, the others pressures. Displacements with the same neighbours stay
    together, in their own order.
    """
    if upper.shape[0] < _SMALL or importlib.util.find_spec("pymetis") is None:
        return None
    import pymetis

    node = alike(upper)
    chosen = np.unique(node, return_index=True)[1]
    half = _pattern(upper)[chosen][:, chosen]
    graph = csr_array(half + half.T - 2 * eye_array(len(chosen), dtype=np.int8))
    graph.eliminate_zeros()
    shuffled = np.random.default_rng(2).permutation(len(chosen))  # METIS does worse on nodes numbered along a limb
    graph = csr_array(graph[shuffled][:, shuffled])
    adjacency = pymetis.CSRAdjacency(graph.indptr.astype(np.int32), graph.indices.astype(np.int32))
    options = pymetis.Options(nseps=_SEPARATORS, ufactor=_UNEVEN, seed=1)
    order = shuffled[np.asarray(pymetis.nested_dissection(adjacency, options=options)[0])]
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return _pressures_later(np.argsort(rank[node], kind="stable"), upper, n_displacements)


def _pressures_later(order: IntArray, upper: csr_array, n_displacements: int) -> IntArray:
    """``order`` with each pressure after a quarter of the displacements it is coupled to, if it was not."""
    place = np.empty(len(order), dtype=float)
    place[order] = np.arange(len(order))
    coupling = csc_array(_pattern(upper)[:n_displacements, n_displacements:])
    count = np.diff(coupling.indptr)
    coupled = place[coupling.indices]
    coupled = coupled[np.lexsort((coupled, np.repeat(np.arange(len(count)), count)))]
    some = np.flatnonzero(count)
    quarter = coupled[coupling.indptr[some] + count[some] // 4]
    place[n_displacements + some] = np.maximum(place[n_displacements + some], quarter + 0.5)
    return np.asarray(np.argsort(place, kind="stable"))


def alike(upper: csr_array) -> IntArray:
    """Number (n,) of each unknown's node, in order of appearance: unknowns with the same neighbours, themselves
    included, share one."""
    weight = np.random.default_rng(0).integers(1, 2**61, upper.shape[0])  # sums of sets that differ differ, to 2^-61
    half = _pattern(upper).astype(np.int64)
    _, first, node = np.unique(half @ weight + half.T @ weight - weight, return_index=True, return_inverse=True)
    number = np.empty_like(first)
    number[np.argsort(first)] = np.arange(len(first))
    return np.asarray(number[node])


def _pattern(upper: csr_array) -> csr_array:
    ones = np.ones(len(upper.indices), dtype=np.int8)
    return csr_array((ones, upper.indices, upper.indptr), shape=upper.shape)
