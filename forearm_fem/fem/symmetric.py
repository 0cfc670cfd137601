"""Symmetric sparse matrices kept as half of themselves, and their product with columns on all cores."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array

from .multiply import MklMatrix
from .pardiso import library

_FEW = 32  # real columns: with more of them the two halves are as fast and need no whole matrix
_LARGE = 300_000  # entries of a half below which nothing is gained


@dataclass(frozen=True)
class SymmetricMatrix:
    """A = H + H^T (not Hermitian), where ``half`` is the upper triangle with half of the diagonal."""

    half: csr_array

    @classmethod
    def from_upper(cls, upper: csr_array) -> SymmetricMatrix:
        """The symmetric matrix with this upper triangle, diagonal included."""
        row = np.repeat(np.arange(upper.shape[0]), np.diff(upper.indptr))
        data = np.where(upper.indices == row, upper.data / 2, upper.data)
        return cls(csr_array((data, upper.indices, upper.indptr), shape=upper.shape))

    @cached_property
    def _transposed(self) -> csc_array:
        return csc_array(self.half.T)

    @cached_property
    def _whole(self) -> MklMatrix:
        return MklMatrix(csr_array(self.half + self.half.T))

    def product(self, x: NDArray[Any]) -> NDArray[Any]:
        """A x for columns ``x`` (n, k): a large real matrix with few columns by MKL, else by :meth:`by_halves`."""
        if self.half.dtype.kind == "f" and np.iscomplexobj(x):  # half the work of complex times complex
            pairs = np.ascontiguousarray(x).view(np.float64).reshape(len(x), -1)
            return self.product(pairs).view(np.complex128).reshape(x.shape)
        few = x.ndim == 2 and x.shape[1] <= _FEW and self.half.dtype.kind == "f"
        if few and self.half.nnz > _LARGE and library() is not None:
            return self._whole.product(x)
        return self.by_halves(x)

    def by_halves(self, x: NDArray[Any]) -> NDArray[Any]:
        """A x with scipy, the two halves in a thread each, as the sums run without Python's lock."""
        with ThreadPoolExecutor(1) as pool:
            below = pool.submit(self._transposed.__matmul__, x)
            total = self.half @ x
            total += below.result()
        return np.asarray(total)
