"""Sparse symmetric matrices of one pattern: upper triangles, sums, products with few vectors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, triu

from ...typing import ComplexArray, FloatArray, IntArray
from .compiled import compiled, in_threads, thread_count

# Symmetric sparse matrices kept as half of themselves, and their product with columns on all cores.


@dataclass(frozen=True)
class SymmetricMatrix:
    """A = H + H^T (not Hermitian), where ``half`` is the upper triangle with half of the diagonal."""

    half: csr_array

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


# Sums and congruences of sparse matrices, columns ascending and zeros kept, in compiled code or by scipy.
# Zeros matter: nodes whose three unknowns do not have the same neighbours make the ordering slower, and scipy drops
# what is zero in a sum.


def added(matrices: Sequence[csr_array]) -> csr_array:
    """Sum of matrices (n, m) with ascending columns; without compiled code zeros are dropped."""
    patterns: Any = compiled("kernels.scatter")
    if patterns is None:
        return csr_array(sum(matrices))
    indptr, indices, places = patterns.merged(*stacked(matrices))
    values = np.bincount(places, np.concatenate([m.data for m in matrices]), len(indices))
    return _matrix((indptr, indices, values), matrices[0].shape)


def stacked(matrices: Sequence[csr_array]) -> tuple[IntArray, IntArray]:
    """Row starts (n_matrix, n_row + 1) of all matrices in their columns, one matrix after the other."""
    ends = np.cumsum([0, *(m.nnz for m in matrices)])
    starts = np.array([m.indptr + end for m, end in zip(matrices, ends[:-1], strict=True)], dtype=np.int64)
    return starts, np.concatenate([m.indices.astype(np.int32, copy=False) for m in matrices])


def _rows(kind: Callable[..., Any], matrix: csr_array) -> Any:
    """Row starts, columns and values of one type each, so that kernels are compiled once."""
    return kind(matrix.indptr.astype(np.int64, copy=False), matrix.indices.astype(np.int32, copy=False), matrix.data)


def congruent(matrix: csr_array, transform: csr_array) -> csr_array:
    """T' A T (m, m) of a symmetric matrix (n, n) and ``transform`` (n, m)."""
    return _transposed_product(csr_array(transform.T), matrix, transform)


def projected(left: csr_array, matrix: csr_array, right: csr_array) -> csr_array:
    """L' A R of any matrix."""
    return _transposed_product(csr_array(right.T), csr_array(matrix.T), left)


def sorted_upper(matrix: csr_array) -> csr_array:
    """Upper triangle, columns ascending."""
    patterns: Any = compiled("kernels.scatter")
    if patterns is not None:
        return _matrix(patterns.sorted_upper(*_rows(patterns.Sparse, matrix)), matrix.shape)
    upper = csr_array(triu(matrix, format="csr"))
    upper.sort_indices()
    return upper


def _matrix(rows: Any, shape: tuple[int, int]) -> csr_array:
    """A matrix whose kernels gave row starts, columns and values; in 32 bits, or scipy copies columns to 64."""
    indptr, indices, data = rows
    return csr_array((data, indices, indptr.astype(np.int32)), shape=shape)


def _transposed_product(a: csr_array, b: csr_array, c: csr_array) -> csr_array:
    patterns: Any = compiled("kernels.scatter")
    if patterns is None:
        return csr_array((a @ b @ c).T)
    shape = (c.shape[1], a.shape[0])
    parts = [_rows(patterns.Sparse, m) for m in (a, b, c)]
    return _matrix(patterns.transposed_product(*parts, shape[0]), shape)


# Real symmetric matrices of one size that are multiplied with the same columns, all in one pass over the rows.

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
        entries = [2 * upper.nnz - int(np.count_nonzero(_rows_of(upper) == upper.indices)) for upper in uppers]
        starts, n = np.cumsum([0, *entries]), uppers[0].shape[0]
        indptr, indices = np.empty((len(uppers), n + 1), np.int64), np.empty(starts[-1], np.int32)
        data = np.empty(starts[-1])

        def put(t: int) -> None:
            """Matrix t in its place at once, so that nothing lies there twice."""
            place = slice(starts[t], starts[t + 1])
            indptr[t], indices[place], data[place] = _whole(uppers[t])
            indptr[t] += starts[t]

        in_threads(put, range(len(uppers)))
        return cls(indptr, indices, data)

    @property
    def n(self) -> int:
        """Rows and columns of each matrix."""
        return int(self.indptr.shape[1]) - 1

    def one(self, t: int) -> csr_array:
        """Matrix A_t for scipy."""
        start, end = self.indptr[t, 0], self.indptr[t, -1]
        return csr_array((self.data[start:end], self.indices[start:end], self.indptr[t] - start), shape=(self.n,) * 2)

    def upper_sum(self, weights: NDArray[Any], indptr: IntArray, indices: IntArray) -> NDArray[Any]:
        """Upper triangle of sum_t ``weights[t]`` A_t on a pattern that holds all of theirs, real where weights are."""
        kernels: Any = compiled("kernels.products")
        data = np.zeros(len(indices), dtype=np.result_type(weights, float))
        if kernels is None:
            row = np.repeat(np.arange(self.n), np.diff(indptr))
            for t in np.flatnonzero(weights).tolist():
                data += weights[t] * self.one(t)[row, indices]
            return data
        factors = weights.astype(data.dtype, copy=False)

        def work(piece: tuple[int, int]) -> None:
            """One piece of the rows."""
            kernels.add_uppers(piece, self.indptr, self.indices, self.data, factors, indptr, indices, data)

        self._in_pieces(work, self._work)
        return data

    def touching(self, rows: slice) -> list[int]:
        """Indices of the matrices with entries in ``rows``."""
        return np.flatnonzero(self.indptr[:, rows.stop] > self.indptr[:, rows.start]).tolist()

    def products(self, x: NDArray[Any]) -> Callable[[int, slice], FloatArray]:
        """Function that gives some rows (m, k) of A_t x, for t and these rows.

        ``x`` (n, k) are real columns, in single or double precision.

        Raises ValueError for another n, beyond which compiled code would read.
        """
        self._check(x)
        kernels, k = compiled("kernels.products"), x.shape[1]
        if kernels is None:
            return lambda t, rows: np.asarray(self.one(t)[rows] @ x)
        wide = _wide(x)

        def product(t: int, rows: slice) -> FloatArray:
            """``rows`` of A_t x."""
            y = np.empty((rows.stop - rows.start, wide.shape[1]))
            kernels.some_rows((rows.start, rows.stop), self.indptr[t], self.indices, self.data, wide, y)
            return y[:, :k]

        return product

    def real_sum(self, weights: FloatArray, columns: Sequence[NDArray[Any]]) -> FloatArray:
        """sum_j sum_t ``weights[j, t]`` A_t x_j (n, k) for real ``columns`` x_j (n, k), all of one width and precision.

        Raises ValueError for other shapes, beyond which compiled code would read.
        """
        self._check(columns[0], *(x for x in columns if x.shape != columns[0].shape))
        kernels, k = compiled("kernels.products"), columns[0].shape[1]
        if kernels is None:
            used = [(t, j) for j, t in np.argwhere(weights)]
            return np.asarray(sum((weights[j, t] * (self.one(t) @ columns[j]) for t, j in used), np.zeros((self.n, k))))
        sources = [_wide(x) for x in columns]
        if any(x.strides != sources[0].strides for x in sources):
            sources = [np.ascontiguousarray(x) for x in sources]
        total, addresses = np.empty((self.n, sources[0].shape[1])), np.array([x.ctypes.data for x in sources])
        like, apart = np.empty(0, sources[0].dtype), sources[0].strides[0]

        def work(piece: tuple[int, int]) -> None:
            """One piece of the rows."""
            kernels.weighted_rows(piece, self.indptr, self.indices, self.data, addresses, like, apart, weights, total)

        self._in_pieces(work, self._work)
        return total[:, :k]

    def add_products_in_place(self, totals: Sequence[ComplexArray], weights: ComplexArray, x: ComplexArray) -> None:
        """Add sum_t ``weights[o, t]`` A_t x to ``totals[o]`` (n, k), for complex columns ``x`` (n, k).

        Raises ValueError for other shapes, beyond which compiled code would read and write.
        """
        self._check(x, *(total for total in totals if total.shape != x.shape))
        kernels, k = compiled("kernels.products"), x.shape[1]
        if kernels is None or not all(total.flags.c_contiguous for total in totals):
            return self._added_by_scipy(totals, weights, x)
        pairs = _wide(np.ascontiguousarray(x).view(float))  # one behind the other
        narrow = pairs.shape[1] > 2 * k  # fewer columns than the kernel takes
        sums = [np.zeros((self.n, _LANES // 2), complex) for _ in totals] if narrow else totals
        addresses, weights = np.array([s.ctypes.data for s in sums]), np.ascontiguousarray(weights, dtype=complex)

        def work(piece: tuple[int, int]) -> None:
            """One piece of the rows."""
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


def _wide(x: NDArray[Any]) -> NDArray[Any]:
    """``x`` (n, k) by rows, wherever they lie, with columns of zeros where it has fewer than the kernels take."""
    missing = _LANES - x.shape[1]
    whole = np.pad(x, ((0, 0), (0, missing))) if missing > 0 else x
    return whole if whole.strides[1] == whole.itemsize else np.ascontiguousarray(whole)


def _rows_of(upper: csr_array) -> IntArray:
    """Row (nnz,) of each entry."""
    return np.repeat(np.arange(upper.shape[0], dtype=np.int32), np.diff(upper.indptr))


def _whole(upper: csr_array) -> tuple[IntArray, IntArray, FloatArray]:
    """Row starts, columns and values of the symmetric matrix with this upper triangle."""
    if (kernels := compiled("kernels.products")) is not None:
        start, columns, values = kernels.mirrored(*_rows(lambda *parts: parts, upper))
        return start, columns, values
    row, column = _rows_of(upper), upper.indices
    off = row != column
    places = np.concatenate([row, column[off]]), np.concatenate([column, row[off]])
    full = csr_array((np.concatenate([upper.data, upper.data[off]]), places), shape=upper.shape)  # zeros are kept
    full.sort_indices()
    return full.indptr, full.indices.astype(np.int32), full.data
