"""Symmetric sparse matrices kept as half of themselves, and their product with columns on all cores."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array


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

    def product(self, x: NDArray[Any]) -> NDArray[Any]:
        """A x for columns ``x`` (n, k), the two halves in a thread each, as scipy's sums run without Python's lock."""
        with ThreadPoolExecutor(1) as pool:
            below = pool.submit(self._transposed.__matmul__, x)
            total = self.half @ x
            total += below.result()
        return np.asarray(total)
