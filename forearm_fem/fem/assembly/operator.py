"""A(omega) = sum_k theta_k(omega) A_k: constant real symmetric matrices on one pattern, frequency in scalars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, eye_array, triu

from ...typing import ComplexArray, FloatArray, IntArray
from ..kernels.compiled import compiled, in_threads
from ..kernels.matrices import SymmetricMatrices, SymmetricMatrix, sorted_upper, stacked
from .coefficients import Coefficient


@dataclass(frozen=True)
class Term:
    """What one of the matrices is, and its coefficient."""

    name: str
    coefficient: Coefficient


@dataclass(frozen=True)
class AffineOperator:
    """Dynamic stiffness of displacements (first ``n_displacements``) and scaled pressures.

    ``indptr`` and ``indices`` describe the upper triangle of the common pattern, diagonal always included. The
    ``matrices`` of the ``terms`` are whole and without the zeros of that pattern. Their sum is complex symmetric, not
    Hermitian. Pressures are in units of ``pressure_scale`` [Pa].
    """

    indptr: IntArray
    indices: IntArray
    terms: tuple[Term, ...]
    matrices: SymmetricMatrices
    n_displacements: int
    pressure_scale: float

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.indptr) - 1

    def data(self, omega: float) -> ComplexArray:
        """Upper-triangle values (nnz,) of A(omega)."""
        return self.combine([complex(t.coefficient.at(np.array(omega))) for t in self.terms])

    def at(self, omega: float) -> WeightedSum:
        """A(omega) for products with few columns."""
        return WeightedSum(self.matrices, np.array([complex(t.coefficient.at(np.array(omega))) for t in self.terms]))

    def combine(self, weights: Sequence[complex]) -> NDArray[Any]:
        """Upper-triangle values of a weighted sum of the terms, real where all weights are."""
        return self.matrices.upper_sum(np.array(weights), self.indptr, self.indices)

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
        return csr_array(triu(self.matrices.one([t.name for t in self.terms].index(term.name)), format="csr"))


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
    uppers = in_threads(sorted_upper, [matrix for _, matrix, _ in matrices])
    eye = csr_array(eye_array(uppers[0].shape[0], format="csr"))
    if (patterns := compiled("kernels.scatter")) is None:
        pattern = eye
        for upper in uppers:
            ones = csr_array((np.ones(upper.nnz), upper.indices, upper.indptr), shape=upper.shape)
            pattern = csr_array(pattern + ones)
        pattern.sort_indices()
        indptr, indices = pattern.indptr, pattern.indices
    else:
        indptr, indices, _ = patterns.merged(*stacked([*uppers, eye]))
    terms = tuple(Term(name, coefficient) for name, _, coefficient in matrices)
    whole = SymmetricMatrices.from_uppers(uppers)
    return AffineOperator(
        indptr.astype(np.int32, copy=False), indices.astype(np.int32, copy=False), terms, whole, n_displacements,
        pressure_scale,
    )  # fmt: skip
