"""Real symmetric matrices of one size that are multiplied with the same columns, all in one pass over the rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..typing import ComplexArray, FloatArray, IntArray
from .compiled import compiled
from .threads import in_threads, thread_count

_LANES = 8  # doubles that a row needs at least
_PIECES = 4  # for each thread, of as much work
_LARGE = 100_000  # entries below which threads gain nothing


@dataclass(frozen=True)
class SymmetricMatrices:
    """Matrices A_t, whole, one behind the other.

    ``indptr`` (n_matrix, n + 1) point into the ``indices`` and ``data`` (nnz of all).
    """

    indptr: IntArray
    indices: IntArray
    data: FloatArray

    @classmethod
    def from_uppers(cls, uppers: Sequence[csr_array]) -> SymmetricMatrices:
        """The symmetric matrices with these upper triangles, columns ascending in each row."""
        parts = in_threads(_whole, uppers)
        starts = np.cumsum([0, *(len(indices) for _, indices, _ in parts)])
        indptr = np.array([own + start for (own, _, _), start in zip(parts, starts, strict=False)], dtype=np.int64)
        return cls(indptr, *(np.concatenate([part[k] for part in parts]) for k in (1, 2)))

    @property
    def n(self) -> int:
        """Rows and columns of each matrix."""
        return int(self.indptr.shape[1]) - 1

    def one(self, t: int) -> csr_array:
        """Matrix A_t for scipy."""
        start, end = self.indptr[t, 0], self.indptr[t, -1]
        return csr_array((self.data[start:end], self.indices[start:end], self.indptr[t] - start), shape=(self.n,) * 2)

    @cached_property
    def touched(self) -> tuple[IntArray, ...]:
        """Rows of each matrix that are not empty."""
        return tuple(np.flatnonzero(np.diff(own)) for own in self.indptr)

    def product(self, t: int, x: FloatArray) -> FloatArray:
        """The rows ``touched[t]`` of A_t x (len(touched[t]), k) for real columns ``x`` (n, k).

        Raises ValueError for another n, beyond which compiled code would read.
        """
        self._check(x)
        kernels, rows, k = compiled("rows"), self.touched[t], x.shape[1]
        if kernels is None:
            return np.asarray((self.one(t) @ x)[rows])
        x = _wide(x)
        y = np.empty((len(rows), x.shape[1]))

        def work(piece: tuple[int, int]) -> None:
            some = rows[slice(*piece)]
            to = y.ctypes.data + y.strides[0] * piece[0]
            kernels.chosen_rows(some, self.indptr[t], self.indices, self.data, x.ctypes.data, x.shape[1], to)

        self._in_pieces(work, np.cumsum(np.diff(self.indptr[t])[rows]))
        return y[:, :k]

    def add_products_in_place(self, totals: Sequence[ComplexArray], weights: ComplexArray, x: ComplexArray) -> None:
        """Add sum_t ``weights[o, t]`` A_t x to ``totals[o]`` (n, k), for complex columns ``x`` (n, k).

        Raises ValueError for other shapes, beyond which compiled code would read and write.
        """
        self._check(x, *(total for total in totals if total.shape != x.shape))
        kernels, k = compiled("rows"), x.shape[1]
        if kernels is None or not all(total.flags.c_contiguous for total in totals):
            return self._added_by_scipy(totals, weights, x)
        pairs = _wide(np.ascontiguousarray(x).view(float))
        narrow = pairs.shape[1] > 2 * k  # fewer columns than the kernel takes
        sums = [np.zeros((self.n, _LANES // 2), complex) for _ in totals] if narrow else totals
        addresses, weights = np.array([s.ctypes.data for s in sums]), np.ascontiguousarray(weights, dtype=complex)

        def work(piece: tuple[int, int]) -> None:
            kernels.add_weighted_rows(
                piece, self.indptr, self.indices, self.data, pairs.ctypes.data, pairs.shape[1], weights, addresses
            )

        self._in_pieces(work, self._work)
        if narrow:
            for total, found in zip(totals, sums, strict=True):
                total += found[:, :k]
        return None

    def _check(self, x: NDArray[Any], *others: NDArray[Any]) -> None:
        if len(x) != self.n or others:
            shapes = " and ".join(str(each.shape) for each in (x, *others))
            raise ValueError(f"matrices of {self.n} columns were given arrays of {shapes}")

    def _added_by_scipy(self, totals: Sequence[ComplexArray], weights: ComplexArray, x: ComplexArray) -> None:
        for t in range(len(self.indptr)):
            y = self.one(t) @ x
            for total, weight in zip(totals, weights[:, t], strict=True):
                total += weight * y

    @cached_property
    def _work(self) -> IntArray:
        """Entries (n,) in all rows up to each."""
        return np.asarray((self.indptr[:, 1:] - self.indptr[:, :1]).sum(axis=0))

    def _in_pieces(self, work: Callable[[tuple[int, int]], None], done: IntArray) -> None:
        """``work`` on ranges of rows in threads; ``done`` (m,) says how much there is to do up to each row."""
        if not len(done) or done[-1] < _LARGE:
            return work((0, len(done)))
        count = _PIECES * thread_count()
        cuts = np.searchsorted(done, done[-1] * np.arange(1, count) / count).tolist()
        in_threads(work, list(zip([0, *cuts], [*cuts, len(done)], strict=True)))
        return None


def _wide(x: NDArray[Any]) -> FloatArray:
    """``x`` (n, k) by rows, with columns of zeros where it has fewer than the kernels take."""
    missing = _LANES - x.shape[1]
    return np.ascontiguousarray(np.pad(x, ((0, 0), (0, missing))) if missing > 0 else x, dtype=float)


def _whole(upper: csr_array) -> tuple[IntArray, IntArray, FloatArray]:
    """Row starts, columns and values of the symmetric matrix with this upper triangle."""
    if (kernels := compiled("rows")) is not None:
        start, columns, values = kernels.mirrored(upper.indptr, upper.indices, upper.data)
        return start, columns, values
    diagonal = csr_array((upper.diagonal(), (np.arange(len(upper.indptr) - 1),) * 2), shape=upper.shape)
    full = csr_array(upper + upper.T - diagonal)
    full.sort_indices()
    return full.indptr, full.indices.astype(np.int32), full.data
