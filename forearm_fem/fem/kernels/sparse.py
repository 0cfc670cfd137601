"""Sums and congruences of sparse matrices, columns ascending and zeros kept, in compiled code or by scipy.

Zeros matter: nodes whose three unknowns do not have the same neighbours make the ordering slower, and scipy drops what
is zero in a sum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from ...typing import IntArray
from .compiled import compiled


def added(matrices: Sequence[csr_array]) -> csr_array:
    """Sum of matrices (n, m) with ascending columns; without compiled code zeros are dropped."""
    patterns: Any = compiled("kernels.triple_products")
    if patterns is None:
        return csr_array(sum(matrices))
    indptr, indices, places = patterns.merged(*stacked(matrices))
    values = np.bincount(places, np.concatenate([m.data for m in matrices]), len(indices))
    return csr_array((values, indices, indptr), shape=matrices[0].shape)


def stacked(matrices: Sequence[csr_array]) -> tuple[IntArray, IntArray]:
    """Row starts (n_matrix, n_row + 1) of all matrices in their columns, one matrix after the other."""
    ends = np.cumsum([0, *(m.nnz for m in matrices)])
    starts = np.array([m.indptr + end for m, end in zip(matrices, ends[:-1], strict=True)], dtype=np.int64)
    return starts, np.concatenate([m.indices for m in matrices])


def _rows(kind: Callable[..., Any], matrix: csr_array) -> Any:
    """Row starts, columns and values of one type each, so that kernels are compiled once."""
    return kind(matrix.indptr.astype(np.int64, copy=False), matrix.indices.astype(np.int32, copy=False), matrix.data)


def congruent(matrix: csr_array, transform: csr_array) -> csr_array:
    """T' A T (m, m) of a symmetric matrix (n, n) and ``transform`` (n, m)."""
    return _transposed_product(csr_array(transform.T), matrix, transform)


def projected(left: csr_array, matrix: csr_array, right: csr_array) -> csr_array:
    """L' A R of any matrix."""
    return _transposed_product(csr_array(right.T), csr_array(matrix.T), left)


def _transposed_product(a: csr_array, b: csr_array, c: csr_array) -> csr_array:
    patterns: Any = compiled("kernels.triple_products")
    if patterns is None:
        return csr_array((a @ b @ c).T)
    shape = (c.shape[1], a.shape[0])
    parts = [_rows(patterns.Sparse, m) for m in (a, b, c)]
    found = patterns.transposed_product(*parts, shape[0])
    return csr_array((found.data, found.indices, found.indptr), shape=shape)
