"""Order in which unknowns are eliminated: nested dissection of the mesh's nodes.

PARDISO orders by itself with METIS, one separator tried a level. Several tried, and parts of less equal size, leave a
seventh less work to the factorisation (docs/decisions.md); the nodes' graph is small enough that this costs no more.
"""

from __future__ import annotations

import importlib.util

import numpy as np
from scipy.sparse import csr_array, eye_array

from ..typing import IntArray

_SEPARATORS = 4  # tried on each level
_UNEVEN = 300  # parts may differ by this many thousandths; 400 was as good, 600 worse, 1000 did not end
_SMALL = 3000  # unknowns below which there is nothing to gain


def nested_dissection(upper: csr_array) -> IntArray | None:
    """Unknowns (n,) in the order of their elimination; None where METIS is not installed or the matrix is small.

    ``upper`` is the upper triangle of a matrix with a symmetric pattern, every diagonal entry stored. Unknowns with the
    same neighbours (a node's displacements and pressure) stay together, in their own order.
    """
    if upper.shape[0] < _SMALL or importlib.util.find_spec("pymetis") is None:
        return None
    import pymetis

    node = alike(upper)
    chosen = np.unique(node, return_index=True)[1]
    half = _pattern(upper)[chosen][:, chosen]
    graph = csr_array(half + half.T - 2 * eye_array(len(chosen), dtype=np.int8))
    graph.eliminate_zeros()
    adjacency = pymetis.CSRAdjacency(graph.indptr.astype(np.int32), graph.indices.astype(np.int32))
    options = pymetis.Options(nseps=_SEPARATORS, ufactor=_UNEVEN, seed=1)
    order = np.asarray(pymetis.nested_dissection(adjacency, options=options)[0])
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return np.asarray(np.argsort(rank[node], kind="stable"))


def alike(upper: csr_array) -> IntArray:
    """Number (n,) of each unknown's node: unknowns with the same neighbours, themselves included, share one."""
    weight = np.random.default_rng(0).integers(1, 2**61, upper.shape[0])  # sums of sets that differ differ, to 2^-61
    half = _pattern(upper).astype(np.int64)
    return np.asarray(np.unique(half @ weight + half.T @ weight - weight, return_inverse=True)[1])


def _pattern(upper: csr_array) -> csr_array:
    ones = np.ones(len(upper.indices), dtype=np.int8)
    return csr_array((ones, upper.indices, upper.indptr), shape=upper.shape)
