"""Orthonormal columns of a reduced space, kept in blocks as they came, and how new ones are made orthonormal to them.

Columns are long: fresh memory for them costs as much time as the arithmetic. So old blocks are never copied, and new
columns are changed where they lie, piece by piece (docs/decisions.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ..typing import ComplexArray, FloatArray, IntArray
from .threads import in_threads

_PIECE = 2000  # rows at a time: as many of all columns stay in the cache


@dataclass(frozen=True)
class Basis:
    """Columns (n, r): the ``blocks`` (n, k_i) side by side, times ``directions`` (sum of k_i, r) where given."""

    blocks: tuple[FloatArray, ...] = ()
    directions: FloatArray | None = None

    def with_block(self, block: FloatArray) -> Basis:
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

    def inner(self, columns: FloatArray, rows: slice | IntArray = slice(None)) -> FloatArray:
        """Products (r, k) of ``rows``, ascending, of the blocks with as many rows of ``columns`` (len(rows), k)."""
        if isinstance(rows, slice):
            parts = [block[rows].T @ columns for block in self.blocks]
        else:
            parts = [_inner(block, rows, columns) for block in self.blocks]
        return np.vstack([*parts, np.zeros((0, columns.shape[1]))])

    def subtract_in_place(self, columns: FloatArray, known: FloatArray) -> None:
        """``columns`` (n, k) less the combination ``known`` (r, k) of the blocks."""
        starts = np.cumsum([0, *(block.shape[1] for block in self.blocks)])

        def work(rows: slice) -> None:
            for block, start in zip(self.blocks, starts, strict=False):
                columns[rows] -= block[rows] @ known[start : start + block.shape[1]]

        in_threads(work, list(_pieces(len(columns))))

    def combination(self, known: FloatArray) -> FloatArray:
        """The combination ``known`` (r, k) of the blocks' columns, (n, k)."""
        total = np.zeros((len(self.blocks[0]), known.shape[1]))
        self.subtract_in_place(total, -known)
        return total


def _inner(block: FloatArray, rows: IntArray, columns: FloatArray) -> FloatArray:
    """block[rows].T @ columns; ``rows`` ascend, and long runs of them need no copy of the block."""
    ends = np.flatnonzero(np.diff(rows, append=-1) != 1) + 1
    starts = np.concatenate([[0], ends[:-1]])
    is_long = ends - starts > _PIECE
    runs = [slice(s, e) for s, e in zip(starts[is_long].tolist(), ends[is_long].tolist(), strict=True)]
    total = np.zeros((block.shape[1], columns.shape[1]))
    for run in runs:
        total += block[rows[run.start] : rows[run.stop - 1] + 1].T @ columns[run]
    short = np.flatnonzero(np.repeat(~is_long, ends - starts))
    for piece in _pieces(len(short)):
        total += block[rows[short[piece]]].T @ columns[short[piece]]
    return total


def _pieces(count: int) -> Iterator[slice]:
    return (slice(i, i + _PIECE) for i in range(0, count, _PIECE))


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
    _scale_in_place(columns, widths, n_u)
    known = basis.inner(columns[:n_u], slice(n_u))
    basis.subtract_in_place(columns, known)
    gram = columns[:n_u].T @ columns[:n_u]
    directions = _directions(gram, widths, drop)
    new = _combined_in_place(columns, directions)
    basis.subtract_in_place(new, basis.inner(new[:n_u], slice(n_u)))  # weak directions had rounding of known ones left
    half = np.linalg.inv(np.linalg.cholesky(new[:n_u].T @ new[:n_u])).T
    return new @ half, np.vstack([known, (directions @ half).T @ gram])


def _scale_in_place(columns: FloatArray, widths: Sequence[int], n_u: int) -> None:
    """Displacements of each column to unit length, negligible columns to zero."""
    norms = np.sqrt(np.einsum("ij,ij->j", columns[:n_u], columns[:n_u]))
    ends = np.cumsum(widths)
    longest = np.repeat([norms[e - w : e].max(initial=0.0) for e, w in zip(ends, widths, strict=True)], widths)
    kept = norms > 1e-14 * longest
    columns *= np.where(kept, 1 / np.where(kept, norms, 1.0), 0.0)


def _combined_in_place(columns: FloatArray, directions: FloatArray) -> FloatArray:
    """columns @ directions (n, m), standing where the first m columns stood."""
    new = columns[:, : directions.shape[1]]
    for rows in _pieces(len(columns)):
        new[rows] = columns[rows] @ directions
    return new


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
