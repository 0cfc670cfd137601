"""Orthonormal columns of a reduced space, kept in blocks as they came, and how new ones are made orthonormal to them.

Columns are long: fresh memory for them costs as much time as the arithmetic. So old blocks are never copied, and new
columns are changed where they lie, piece by piece. Blocks may be kept in single precision; all
that is worked out with them is in double.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ...typing import ComplexArray, FloatArray, IntArray
from ..kernels.compiled import compiled, in_threads, one_blas_thread, thread_count

Columns = NDArray[np.floating[Any]]  # in single or double precision
_PIECE = 512  # rows at a time: what is worked out with them stays in the cache
_LONG = 4096  # rows at a time of few columns in single precision, the same
_VECTOR = 16  # numbers in single precision that compiled code takes together
_FEW = 32  # columns up to which compiled code is faster than BLAS, on processors with short registers too


@dataclass(frozen=True)
class Basis:
    """Columns (n, r): the ``blocks`` (n, k_i) side by side, times ``directions`` (sum of k_i, r) where given."""

    blocks: tuple[Columns, ...] = ()
    directions: FloatArray | None = None

    def with_block(self, block: Columns) -> Basis:
        """These columns and those of ``block`` (n, k) behind them."""
        assert self.directions is None, "a space that was compressed is not extended"
        return Basis((*self.blocks, block))

    def combined(self, directions: FloatArray) -> Basis:
        """Combinations of the columns by ``directions`` (r, s), which are not worked out."""
        return Basis(self.blocks, directions if self.directions is None else self.directions @ directions)

    def seen_by(self, matrix: csr_array) -> FloatArray:
        """Product (m, r) of a sparse matrix (m, k) with the first k rows."""
        whole = np.hstack([matrix @ block[: matrix.shape[1]] for block in self.blocks])
        return whole if self.directions is None else np.asarray(whole @ self.directions)

    def inner(self, columns: FloatArray) -> FloatArray:
        """Products (r, k) of the blocks' first m rows with ``columns`` (m, k)."""
        products = self.inner_of(lambda rows: [(0, columns[rows])], (len(columns), 1, columns.shape[1]))
        return np.asarray(products[0])

    def inner_of(
        self, given: Callable[[slice], Iterable[tuple[int, FloatArray]]], shape: tuple[int, int, int]
    ) -> FloatArray:
        """Products (t, r, k) of the blocks' first m rows with t times columns (m, k) that are ``given`` by rows.

        ``shape`` is (m, t, k). Which of them are not zero there, and these rows of them, is asked for once for each
        piece of rows, so that they need not be kept.
        """
        count, several, width = shape

        def work(pieces: Sequence[slice]) -> FloatArray:
            """One thread's sums over its pieces of rows."""
            totals = np.zeros((several, int(self._starts[-1]), _padded(width)))
            for rows in pieces:
                found = list(given(rows))
                for block, (start, end) in zip(self.blocks, pairwise(self._starts), strict=True):
                    _add_inner(block[rows], found, totals[:, start:end])
            return totals

        totals = in_threads(work, _shared(count))
        return np.asarray(sum(totals[1:], totals[0])[:, :, :width])

    def subtract_in_place(self, columns: FloatArray, known: FloatArray) -> None:
        """``columns`` (n, k) less the combination ``known`` (r, k) of the blocks."""
        factors = -np.pad(known, ((0, 0), (0, _padded(known.shape[1]) - known.shape[1])))

        def work(pieces: Sequence[slice]) -> None:
            """One thread's pieces of rows."""
            for rows in pieces:
                for block, (start, end) in zip(self.blocks, pairwise(self._starts), strict=True):
                    _add_combination(block[rows], factors[start:end], columns[rows])

        in_threads(work, _shared(len(columns)))

    def combination(self, known: FloatArray) -> FloatArray:
        """The combination ``known`` (r, k) of the blocks' columns, (n, k)."""
        total = np.zeros((len(self.blocks[0]), known.shape[1]))
        self.subtract_in_place(total, -known)
        return total

    def subtracted_in_place(self, columns: NDArray[np.float32], n_u: int) -> FloatArray:
        """Coefficients (r, k) of ``columns`` (n, k) in the blocks' first ``n_u`` rows, in single precision, taken
        from all rows. Block by block, so that the rest that blocks leave, which are not quite orthogonal, is taken
        too."""
        known = [np.zeros((0, columns.shape[1]), np.float32)]
        for block in self.blocks:
            known.append(_rough_inner(block[:n_u], columns[:n_u]))
            _subtract_rough(block, known[-1], columns)
        return np.vstack(known)

    def rough_combination(self, known: FloatArray) -> NDArray[np.float32]:
        """:meth:`combination` in single precision, of blocks in single precision."""
        total, factors = np.zeros((len(self.blocks[0]), known.shape[1]), dtype=np.float32), -known.astype(np.float32)
        for block, (start, end) in zip(self.blocks, pairwise(self._starts), strict=True):
            _subtract_rough(block, factors[start:end], total)
        return total

    @cached_property
    def _starts(self) -> IntArray:
        """Columns before each block, and in all of them."""
        return np.cumsum([0, *(block.shape[1] for block in self.blocks)])


def _padded(width: int) -> int:
    """Columns (of sums) that compiled code takes for so many, all zero beyond."""
    kernels = compiled("kernels.products")
    return width if kernels is None or width > _FEW else -(-width // kernels.PAIR) * kernels.PAIR


def _add_inner(block: Columns, found: Sequence[tuple[int, FloatArray]], totals: FloatArray) -> None:
    """Add block^T y to ``totals[t]`` for each (t, y) that was ``found``."""
    kernels = compiled("kernels.products") if totals.shape[2] <= _FEW else None
    whole = np.ascontiguousarray(block) if kernels is not None else block.astype(float, copy=False)
    for t, y in found:
        if kernels is not None:
            kernels.add_inner(whole, y, totals[t])
        else:
            totals[t] += whole.T @ y


def _add_combination(block: Columns, factors: FloatArray, total: FloatArray) -> None:
    """Add block factors to ``total`` (m, k); ``factors`` may have more columns, which are zero."""
    kernels = compiled("kernels.products") if factors.shape[1] <= _FEW else None
    if kernels is not None:
        kernels.add_combination(np.ascontiguousarray(block), factors, total)
    else:
        total += block.astype(float, copy=False) @ factors


def _rough_inner(block: Columns, columns: NDArray[np.float32]) -> NDArray[np.float32]:
    """block^T columns, in single precision but for the sum over pieces of rows."""
    kernels, count, width, wide = _kernels_for(block, columns), block.shape[1], columns.shape[1], columns.strides[0]

    def work(pieces: Sequence[slice]) -> FloatArray:
        """One thread's pieces; the kernel subtracts."""
        total = np.zeros((count, width))
        for rows in pieces:
            if kernels is None:
                total += block[rows].T @ columns[rows]
                continue
            part, some, own = np.zeros((count, width), np.float32), block[rows], columns[rows]
            at = some.ctypes.data, some.strides[0], own.ctypes.data, part.ctypes.data
            kernels.subtract_real_product(count, len(some), *at, wide, wide)
            total -= part
        return total

    return np.asarray(sum(in_threads(work, _shared(len(columns), _LONG))), dtype=np.float32)


def _subtract_rough(block: Columns, known: NDArray[np.float32], columns: NDArray[np.float32]) -> None:
    """``columns`` less block known, in single precision."""
    kernels, factors, wide = _kernels_for(block, columns), np.ascontiguousarray(known), columns.strides[0]

    def work(pieces: Sequence[slice]) -> None:
        """One thread's pieces."""
        for rows in pieces:
            some, own = block[rows], columns[rows]
            if kernels is None:
                own -= some @ factors
                continue
            at = some.ctypes.data, some.strides[0], factors.ctypes.data, own.ctypes.data
            kernels.subtract_real_transposed(block.shape[1], len(some), *at, wide, wide)

    in_threads(work, _shared(len(columns), _LONG))


def _kernels_for(block: Columns, columns: NDArray[np.float32]) -> Any:
    """Kernels that are faster than BLAS on so few columns, whole vectors of them side by side; None for others."""
    few = columns.shape[1] <= _FEW and columns.shape[1] % _VECTOR == 0 and columns.flags.c_contiguous
    by_rows = block.dtype == np.float32 and block.strides[1] == block.itemsize
    return compiled("linear.multifrontal.panels_real") if few and by_rows else None


def in_vectors(columns: Columns) -> NDArray[np.float32]:
    """``columns`` (n, k) in single precision with as many columns of zeros behind them as :class:`Basis` likes."""
    missing = -columns.shape[1] % _VECTOR
    return np.pad(columns.astype(np.float32), ((0, 0), (0, missing)))


def _pieces(count: int, rows: int = _PIECE) -> Iterator[slice]:
    return (slice(i, min(i + rows, count)) for i in range(0, count, rows))


def _shared(count: int, rows: int = _PIECE) -> list[list[slice]]:
    """Pieces of so many rows, shared by the threads in turn."""
    pieces, threads = list(_pieces(count, rows)), thread_count()
    return [pieces[k::threads] for k in range(threads)]


def inverse_or_zero(lengths: FloatArray) -> FloatArray:
    """1 / ``lengths``, zero where they are zero."""
    return np.where(lengths > 0, 1 / np.where(lengths > 0, lengths, 1.0), 0.0)


def real_columns(blocks: Sequence[ComplexArray]) -> FloatArray:
    """Real and imaginary parts (n, 2 sum of k) of complex ``blocks`` (n, k), one block after the other."""
    columns = np.empty((len(blocks[0]), 2 * sum(block.shape[1] for block in blocks)))
    start = 0
    for block in blocks:
        for part in (block.real, block.imag):
            columns[:, start : start + block.shape[1]] = part
            start += block.shape[1]
    return columns


def orthonormal_extension(
    basis: Basis, columns: FloatArray, widths: Sequence[int], n_u: int, *, drop: float
) -> tuple[FloatArray, FloatArray]:
    """New columns, orthonormal in their displacements to ``basis`` and each other, pressures following along.

    ``columns`` (n, k) are used up; they are taken in turn, as many at a time as ``widths`` say. Directions whose
    independent part is below ``drop`` of a column's length are left out: what rounding leaves of them would only add
    noise, and columns shorter than 1e-14 of their block's longest are rounding alone. The second result are the
    coordinates of all columns, scaled to unit length, in the basis and the new directions together.
    """
    norms, ends = np.sqrt(np.einsum("ij,ij->j", columns[:n_u], columns[:n_u])), np.cumsum(widths)
    longest = np.repeat([norms[e - w : e].max(initial=0.0) for e, w in zip(ends, widths, strict=True)], widths)
    kept = norms > 1e-14 * longest
    columns *= np.where(kept, 1 / np.where(kept, norms, 1.0), 0.0)
    known = basis.inner(columns[:n_u])
    basis.subtract_in_place(columns, known)
    gram = columns[:n_u].T @ columns[:n_u]
    directions = _directions(gram, widths, drop)
    new = columns[:, : directions.shape[1]]  # they stand where the first columns stood
    for rows in _pieces(len(columns)):
        new[rows] = columns[rows] @ directions
    basis.subtract_in_place(new, basis.inner(new[:n_u]))  # weak directions had rounding of known ones left
    half = np.linalg.inv(np.linalg.cholesky(new[:n_u].T @ new[:n_u])).T
    return new @ half, np.vstack([known, (directions @ half).T @ gram])


def rough_extension(basis: Basis, blocks: Sequence[Columns], n_u: int, *, drop: float) -> list[NDArray[np.float32]]:
    """New columns of ``blocks`` (n, k), in turn and in single precision (:func:`orthonormal_extension`).

    Seven times as fast on hundreds of columns. What is added is orthonormal to the basis to 1e-6 / ``drop``: enough
    where solutions are asked to 1e-4, as products of the columns are formed of what they are.
    """
    widths = [block.shape[1] for block in blocks]
    lengths = np.concatenate([np.linalg.norm(block[:n_u], axis=0) for block in blocks])
    scale = inverse_or_zero(lengths)
    starts = np.cumsum([0, *widths])
    columns = np.hstack(
        [(b * scale[i:j]).astype(np.float32) for b, (i, j) in zip(blocks, pairwise(starts), strict=True)]
    )
    basis.subtracted_in_place(columns, n_u)
    directions = _directions((columns[:n_u].T @ columns[:n_u]).astype(float), widths, drop)
    new = columns @ directions.astype(np.float32)
    last = len(directions) - 1 - (directions[::-1] != 0).argmax(axis=0)  # of a block's columns, none behind them
    counts = np.histogram(last, starts)[0]
    return np.split(new, np.cumsum(counts)[:-1], axis=1)


@one_blas_thread()
def _directions(gram: FloatArray, widths: Sequence[int], drop: float) -> FloatArray:
    """Combinations (k, m) of columns, none longer than 1, that are orthonormal by their products ``gram`` (k, k).

    Column blocks of the given ``widths`` in turn, directions weaker than ``drop`` left out. Their products are known
    to 1e-16, so the weakest directions kept come out orthonormal to 1e-16 / drop^2 only: see the caller.
    """
    chosen, starts = np.zeros((len(gram), 0)), np.cumsum([0, *widths[:-1]])
    for start, width in zip(starts, widths, strict=True):
        rest = np.eye(len(gram))[:, start : start + width]
        for _ in range(2):
            rest = rest - chosen @ (chosen.T @ (gram @ rest))
            values, vectors = np.linalg.eigh(rest.T @ gram @ rest)
            keep = values > drop**2
            rest = rest @ (vectors[:, keep] / np.sqrt(values[keep]))
        chosen = np.hstack([chosen, rest])
    return chosen
