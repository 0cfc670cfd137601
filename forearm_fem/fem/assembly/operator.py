"""A(omega) = sum_k theta_k(omega) A_k: constant real symmetric matrices on one pattern, frequency in scalars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array, triu

from ...typing import ComplexArray, FloatArray, IntArray
from ..kernels.compiled import compiled, in_threads
from ..kernels.matrices import SymmetricMatrices, SymmetricMatrix, stacked
from .coefficients import Coefficient


@dataclass(frozen=True)
class Term:
    """One real symmetric matrix: ``values`` (m,) at ``positions`` (m,) of the operator's upper-triangle data."""

    name: str
    positions: IntArray
    values: FloatArray
    coefficient: Coefficient


@dataclass(frozen=True)
class AffineOperator:
    """Dynamic stiffness of displacements (first ``n_displacements``) and scaled pressures.

    ``indptr`` and ``indices`` describe the upper triangle of the common pattern, diagonal always included. The
    matrix is complex symmetric, not Hermitian. Pressures are in units of ``pressure_scale`` [Pa].
    """

    indptr: IntArray
    indices: IntArray
    terms: tuple[Term, ...]
    n_displacements: int
    pressure_scale: float

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.indptr) - 1

    def data(self, omega: float) -> ComplexArray:
        """Upper-triangle values (nnz,) of A(omega)."""
        return self.combine([complex(t.coefficient.at(np.array(omega))) for t in self.terms])

    @cached_property
    def matrices(self) -> SymmetricMatrices:
        """The terms' matrices, whole and without the zeros of the common pattern, for products."""
        return SymmetricMatrices.from_uppers([self.term_matrix(t) for t in self.terms])

    def forget_products(self) -> None:
        """Give up the whole :attr:`matrices`, twice the size of the terms; they are made again when asked for."""
        self.__dict__.pop("matrices", None)

    def at(self, omega: float) -> WeightedSum:
        """A(omega) for products with few columns."""
        return WeightedSum(self.matrices, np.array([complex(t.coefficient.at(np.array(omega))) for t in self.terms]))

    def combine(self, weights: Sequence[complex]) -> NDArray[Any]:
        """Upper-triangle values of a weighted sum of the terms, real where all weights are."""
        factors = np.array(weights)
        data, patterns = np.zeros(len(self.indices), dtype=factors.dtype), compiled("kernels.scatter")
        for term, weight in zip(self.terms, factors, strict=True):
            if patterns is None:
                data[term.positions] += weight * term.values
            else:
                patterns.add_at(data, term.positions, weight, term.values)
        return data

    def upper(self, data: ComplexArray | FloatArray) -> csr_array:
        """Upper triangle with given values as a sparse matrix."""
        return csr_array((data, self.indices, self.indptr), shape=(self.n, self.n))

    def matrix(self, data: ComplexArray) -> SymmetricMatrix:
        """The whole matrix with these upper-triangle values, for products."""
        halved = data.copy()
        halved[self.diagonal_positions] /= 2
        return SymmetricMatrix(self.upper(halved))

    @cached_property
    def diagonal_positions(self) -> IntArray:
        """Positions of the diagonal in the data: the first entry of each row."""
        return self.indptr[:-1]

    def multiply(self, data: ComplexArray, x: ComplexArray | FloatArray) -> ComplexArray:
        """Product of the symmetric matrix with upper-triangle ``data`` and columns ``x`` (n, k)."""
        return np.asarray(self.matrix(data).product(x))

    def term_matrix(self, term: Term) -> csr_array:
        """Upper triangle of one term, without the zeros of the common pattern."""
        indptr = np.searchsorted(term.positions, self.indptr)  # positions ascend, row by row
        return csr_array((term.values, self.indices[term.positions], indptr), shape=(self.n, self.n))


@dataclass(frozen=True)
class WeightedSum:
    """A sum of real symmetric matrices with ``weights`` (n_matrix,)."""

    matrices: SymmetricMatrices
    weights: ComplexArray | FloatArray

    def product(self, x: NDArray[Any]) -> NDArray[Any]:
        """The sum times columns ``x`` (n, k), real where both are."""
        total = np.zeros(x.shape, dtype=complex)
        self.matrices.add_products_in_place([total], self.weights[None].astype(complex), x.astype(complex, copy=False))
        return total if np.iscomplexobj(x) or np.iscomplexobj(self.weights) else total.real


def affine_operator(
    matrices: Sequence[tuple[str, csr_array, Coefficient]], n_displacements: int, pressure_scale: float
) -> AffineOperator:
    """Put real symmetric matrices (full, equal shape) on one upper-triangle pattern, the diagonal included."""
    uppers = in_threads(_sorted_upper, [matrix for _, matrix, _ in matrices])
    eye = csr_array(eye_array(uppers[0].shape[0], format="csr"))
    if (patterns := compiled("kernels.scatter")) is None:
        pattern = eye
        for upper in uppers:
            ones = csr_array((np.ones(upper.nnz), upper.indices, upper.indptr), shape=upper.shape)
            pattern = csr_array(pattern + ones)
        pattern.sort_indices()
        places = [_positions(upper, pattern) for upper in uppers]
    else:
        indptr, indices, entries = patterns.merged(*stacked([*uppers, eye]))
        pattern = csr_array((np.empty(len(indices), np.int8), indices, indptr), shape=eye.shape)
        ends = np.cumsum([0, *(m.nnz for m in uppers)])
        places = [entries[a:b] for a, b in pairwise(ends)]
    terms = tuple(
        Term(name, position, upper.data, coefficient)
        for (name, _, coefficient), upper, position in zip(matrices, uppers, places, strict=True)
    )
    return AffineOperator(pattern.indptr, pattern.indices, terms, n_displacements, pressure_scale)


def _sorted_upper(matrix: csr_array) -> csr_array:
    if (patterns := compiled("kernels.scatter")) is not None:
        start, columns, values = patterns.sorted_upper(matrix.indptr, matrix.indices, matrix.data)
        return csr_array((values, columns, start), shape=matrix.shape)
    upper = csr_array(triu(matrix, format="csr"))
    upper.sort_indices()
    return upper


def _positions(upper: csr_array, pattern: csr_array) -> IntArray:
    places = csr_array((np.arange(1, pattern.nnz + 1, dtype=float), pattern.indices, pattern.indptr), pattern.shape)
    ones = csr_array((np.ones(upper.nnz), upper.indices, upper.indptr), shape=upper.shape)
    index = places.multiply(ones).tocsr()
    index.sort_indices()
    return np.asarray(index.data.astype(np.int64) - 1)
