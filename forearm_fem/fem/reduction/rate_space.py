"""Block Krylov spaces about one real rate, for a few loads or many."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...typing import FloatArray
from ..assembly.coefficients import rate_weights
from ..kernels.compiled import give_back, one_blas_thread
from ..linear.direct import ENOUGH, DirectSolver
from .affine import compressible
from .basis import Basis, Columns, in_vectors, inverse_or_zero

# Second-order Krylov space about a real rate: from one factorisation, all that solutions over a wide band consist of.
# With s = s_0 (1 + d) and real s_0 the dynamic stiffness is A_0 + A_1 d + A_2 d^2, all real, and the derivatives of
# solutions are x_k = -A_0^-1 (A_1 x_(k-1) + A_2 x_(k-2)). These soon are nearly parallel, so pairs (x_k, x_(k-1)) are
# made orthonormal to all pairs before them and go on from there. Both halves are combinations of the same columns, so
# pairs are kept as coordinates in these (two-level orthogonal Arnoldi: Lu, Su and Bai, SIAM J. Matrix Anal. Appl. 37,
# 2016).

_REFINED = 8  # first derivatives, which are refined once: what solves leave in them reaches all others
_CAREFUL = 1e-5  # of a solution: all are refined where refinement changes more
_EXACT = 1e-9  # of a solution: none is where refinement changes less
_BEFORE = 1e-3  # what x_(k-1) counts in a pair; 1 leaves columns that are errors of solves, 0 breaks down without loss
_NOTHING = 1e-7  # of a derivative's length: a remainder below is what solves leave
# the same where pressures compress nothing: they balance forces then and are no function of the column's displacements,
# so that a column of small ones has huge pressures, of which what is left of any divergence makes stiffness
_NOTHING_FREE = 1e-4
_ROUNDING = 1e-12  # of a pair's length: a remainder below is rounding
_AGAIN = 0.3  # of a derivative's length: known columns are subtracted twice from remainders below


@dataclass(frozen=True)
class Pairs:
    """Orthonormal pairs of combinations of columns: the ``upper`` halves (r, m), and what came before these."""

    upper: FloatArray
    lower: FloatArray

    @property
    def count(self) -> int:
        """Number m of pairs."""
        return int(self.upper.shape[1])

    def padded(self, rows: int) -> Pairs:
        """The same pairs where there are more columns, ``rows`` in all."""
        more = ((0, rows - len(self.upper)), (0, 0))
        return Pairs(np.pad(self.upper, more), np.pad(self.lower, more))

    def and_then(self, others: Pairs) -> Pairs:
        """These pairs, then others of as many or more columns."""
        own = self.padded(len(others.upper))
        return Pairs(np.hstack([own.upper, others.upper]), np.hstack([own.lower, others.lower]))

    def last(self, count: int) -> Pairs:
        """The last ``count`` pairs."""
        first = self.count - count
        return Pairs(self.upper[:, first:], self.lower[:, first:])

    @one_blas_thread()
    def remainder(self, others: Pairs) -> Pairs:
        """Orthonormal pairs that ``others``, of as many or more columns, add to these."""
        own, new = self.padded(len(others.upper)), others
        lengths = np.sqrt(_products_of(others, others).diagonal())
        for _ in range(2):
            known = _products_of(own, new)
            new = Pairs(new.upper - own.upper @ known, new.lower - own.lower @ known)
        directions = _directions(_products_of(new, new), lengths, _ROUNDING)
        return Pairs(new.upper @ directions, new.lower @ directions)


def _products_of(some: Pairs, others: Pairs) -> FloatArray:
    """Products (m, k) of pairs with others."""
    return np.asarray(some.upper.T @ others.upper + _BEFORE**2 * (some.lower.T @ others.lower))


@dataclass(frozen=True)
class Chunk:
    """New ``columns`` (n, m) of the space, orthonormal in their displacements, each with its own pressure.

    ``pairs`` are the new ones in all columns so far, ``last`` is how many of them the last of all ``derivatives`` gave,
    ``residual`` what was left of the forces, ``correction`` what refinement changed, by which more is refined or not.
    """

    columns: Columns
    pairs: Pairs
    last: int
    derivatives: int
    residual: float
    correction: float


class RateSpace:
    """Grows the space of ``forces`` (n, b) about ``rate`` [1/s], some derivatives at a time.

    ``chunks`` of an interrupted sweep are continued. So many first derivatives are ``refined``. Moduli must be
    Kelvin-Voigt. Columns are orthonormal to 1e-4, as far as single-precision solves need it.
    """

    def __init__(
        self, solver: DirectSolver, forces: FloatArray, rate: float, chunks: tuple[Chunk, ...] = (),
        refined: int = _REFINED,
    ) -> None:  # fmt: skip
        self._solver, self._forces, self._refined = solver, forces, refined
        operator = solver.model.operator
        self._weights = rate_weights([t.coefficient for t in operator.terms], rate)
        self._nothing = _NOTHING if compressible(operator) else _NOTHING_FREE
        self._basis = Basis(tuple(c.columns.astype(self._number, copy=False) for c in chunks))
        self._pairs = Pairs(np.zeros((0, 0)), np.zeros((0, 0)))
        self._last, self.derivatives, self.residual, self._correction = 0, 0, 0.0, np.inf
        for chunk in chunks:
            self._pairs = self._pairs.and_then(chunk.pairs)
            self._last, self.derivatives, self.residual = chunk.last, chunk.derivatives, chunk.residual
            self._correction = chunk.correction
        self._start: FloatArray | None = None

    def more(self, count: int) -> Chunk:
        """The next ``count`` derivatives; fewer columns, or none, once what the forces can reach is exhausted."""
        start, known, old = self._begun(), self._basis, self._pairs
        columns, end = np.empty((len(self._forces), count * self._forces.shape[1]), self._number), 0
        for _ in range(count):
            if self.derivatives and not self._last:
                break
            new = self._extended(self._derivative() if self.derivatives else start)
            columns[:, end : end + new.shape[1]] = new
            end += new.shape[1]
            self._basis = known.with_block(columns[:, :end])
        pairs = self._pairs.last(self._pairs.count - old.count)
        return Chunk(columns[:, :end], pairs, self._last, self.derivatives, self.residual, self._correction)

    def solved(self, right: FloatArray) -> FloatArray:
        """P^-1 ``right`` (n, k), unrefined, with P the stiffness at the rate."""
        self._begun()
        return np.asarray(self._solver.factor.solve(right))

    def _begun(self) -> FloatArray:
        """Solutions for the forces; factorised at the first call, for derivatives and others that follow."""
        if self._start is None:
            solution = self._solver.about_rate(self._weights[0], self._forces)
            self._start, self.residual = solution.values, solution.residual
            give_back()  # what factorisation and matrices needed: a third of all that is kept
        return self._start

    @property
    def _number(self) -> type[np.float32] | type[np.float64]:
        """Number type of columns: rounding to single precision is a tenth of what single-precision solves leave."""
        rough = self._solver.factor.single and self._solver.tolerance >= ENOUGH
        return np.float32 if rough else np.float64

    @property
    def _careful(self) -> bool:
        """True where columns are worked with in double precision: all, or the first that all others come from."""
        return self.derivatives <= self._refined or self._number is not np.float32

    def _derivative(self) -> FloatArray:
        """The next derivative (n, last) of the solutions that the last pairs stand for."""
        latest, one, two = self._pairs.last(self._last), self._weights[1], self._weights[2]
        known = latest.upper, 2 * latest.upper + latest.lower
        both: Columns
        if self._careful:
            both = self._basis.combination(np.hstack(known))
        else:  # whole vectors, each row of them in one line of the cache
            both = self._basis.rough_combination(np.hstack([in_vectors(part) for part in known]))
        # A_1 x_(k-1) + A_2 x_(k-2) so that masses, whose part of A_1 is twice that of A_2, take one product and not two
        matrices, solve = self._solver.model.operator.matrices, self._solver.factor.solve
        right = matrices.real_sum(np.array([2 * two - one, -two]), np.hsplit(both, 2))
        x = solve(right)
        # the first derivatives are refined; all where much is asked or factors are poor, none in double precision
        early = self.derivatives < self._refined or self._solver.tolerance < ENOUGH
        if self._correction > _CAREFUL or (early and self._correction > _EXACT):
            change = solve(right - matrices.real_sum(self._weights[:1], (x,)))
            x = x + change
            n_u = self._solver.model.operator.n_displacements
            self._correction = float(np.linalg.norm(change[:n_u]) / np.linalg.norm(x[:n_u]))
        return np.asarray(x[:, : self._last])

    def _extended(self, x: FloatArray) -> FloatArray:
        """Columns that the derivative ``x`` (n, b) of the last pairs adds to the space; its pairs are noted."""
        n_u = self._solver.model.operator.n_displacements
        lengths = np.linalg.norm(x[:n_u], axis=0)
        rest, coordinates = self._taken_apart(x, lengths, n_u)
        gram = rest[:n_u].T @ rest[:n_u]
        directions = _directions(gram, lengths, self._nothing)
        new_u = rest[:n_u] @ directions
        directions = directions @ np.linalg.inv(np.linalg.cholesky(new_u.T @ new_u)).T
        upper = np.vstack([coordinates, directions.T @ gram])
        before = self._pairs.last(self._last).upper if self.derivatives else np.zeros((0, x.shape[1]))
        lower = np.pad(before, ((0, len(upper) - len(before)), (0, 0)))
        new = self._pairs.remainder(Pairs(upper, lower))
        self._pairs, self._last, self.derivatives = self._pairs.and_then(new), new.count, self.derivatives + 1
        return np.asarray(rest @ directions)

    def _taken_apart(self, x: FloatArray, lengths: FloatArray, n_u: int) -> tuple[FloatArray, FloatArray]:
        """What the space lacks of columns ``x`` (n, b), and their coordinates (r, b) in it."""
        coordinates, width = np.zeros((len(self._pairs.upper), x.shape[1])), x.shape[1]
        rest, rough = (x.copy(), None) if self._careful else (x, in_vectors(x))
        for _ in range(2):
            if rough is None:
                known = self._basis.inner(rest[:n_u])
                self._basis.subtract_in_place(rest, known)
            else:
                known = self._basis.subtracted_in_place(rough, n_u)[:, :width]
                rest = rough[:, :width].astype(float)
            coordinates += known
            if (np.linalg.norm(rest[:n_u], axis=0) >= _AGAIN * lengths).all():
                break
        return rest, coordinates


def _directions(gram: FloatArray, lengths: FloatArray, nothing: float) -> FloatArray:
    """Combinations (b, k) of columns with these products that are orthonormal, without those that are ``nothing``.

    Columns are compared with the ``lengths`` (b,) that they had.
    """
    scale = inverse_or_zero(lengths)
    values, vectors = np.linalg.eigh(scale[:, None] * gram * scale)
    keep = values > nothing**2
    return np.asarray(scale[:, None] * vectors[:, keep] / np.sqrt(values[keep]))


# A reduced space for hundreds of loads on one patch: the derivatives of each about a real rate, without what is known.
# As in :mod:`.rate_space`, but loads come in batches, and a direction whose solution or derivative the space holds
# already, to within a share ``drop`` of its length, is neither kept nor followed further: far from their loads fields
# of neighbours are nearly the same. All loads are outputs, too, so the error of a compliance is that of both fields
# multiplied. Columns are made orthonormal in single precision, as in :func:`.basis.rough_extension`.


class LoadSpace:
    """Grows one space of displacements and pressures for batches of loads about ``rate`` [1/s]; moduli must be
    Kelvin-Voigt.

    ``derivatives`` is the highest order, ``basis`` are the columns that earlier loads gave. ``solves`` counts
    right-hand sides.
    """

    def __init__(self, solver: DirectSolver, rate: float, *, derivatives: int, basis: Basis | None = None) -> None:
        self._solver, self._derivatives = solver, derivatives
        self._weights = rate_weights([t.coefficient for t in solver.model.operator.terms], rate)
        self.basis, self.solves = basis or Basis(), 0
        solver.factor.factorise(solver.model.operator.combine(self._weights[0].tolist()))

    @property
    def size(self) -> int:
        """Columns so far."""
        return sum(block.shape[1] for block in self.basis.blocks)

    def add(self, forces: FloatArray, drop: float) -> Columns:
        """New columns (n, k) that ``forces`` (n, b) call for, orthonormal in their displacements, as one block.

        ``drop`` is the share of a direction's length below which it is taken as known.
        """
        known, found = self.basis, [np.zeros((len(forces), 0), dtype=np.float32)]
        pairs, last = Pairs(np.zeros((self.size, 0)), np.zeros((self.size, 0))), 0
        for order in range(self._derivatives + 1):
            x = self._solved(forces) if order == 0 else self._derivative(pairs.last(last))
            before = pairs.last(last).upper if order else np.zeros((0, x.shape[1]))
            new, columns = self._extended(x, before, drop)
            if not columns.shape[1]:
                break
            new = pairs.remainder(new)
            pairs, last = pairs.and_then(new), new.count
            found.append(columns)
            if not last:
                break
        block = np.hstack(found)
        self.basis = known.with_block(block) if block.shape[1] else known
        return block

    def _derivative(self, latest: Pairs) -> FloatArray:
        """The next derivative (n, k) of the solutions that the ``latest`` pairs stand for."""
        one, two = self._weights[1], self._weights[2]
        padded = latest.padded(self.size)
        both = self.basis.rough_combination(np.hstack([padded.upper, 2 * padded.upper + padded.lower])).astype(float)
        halves = [np.ascontiguousarray(half) for half in np.hsplit(both, 2)]
        matrices = self._solver.model.operator.matrices
        return self._solved(-matrices.real_sum(np.array([one - 2 * two, two]), halves))

    def _extended(self, x: FloatArray, before: FloatArray, drop: float) -> tuple[Pairs, Columns]:
        """Pairs and columns of the directions of ``x`` (n, b) that the space lacks."""
        n_u = self._solver.model.operator.n_displacements
        lengths = np.linalg.norm(x[:n_u], axis=0)
        scale = 1 / np.where(lengths > 0, lengths, 1.0)
        rest = (x * scale).astype(np.float32)
        coordinates = self.basis.subtracted_in_place(rest, n_u)
        values, vectors = np.linalg.eigh((rest[:n_u].T @ rest[:n_u]).astype(float))
        keep = values > drop**2
        chosen, sizes = vectors[:, keep], np.sqrt(values[keep])
        made = rest @ (chosen / sizes).astype(np.float32)
        upper = np.vstack([coordinates @ chosen, np.diag(sizes)])
        lower = np.pad(before @ (scale[:, None] * chosen), ((0, len(upper) - len(before)), (0, 0)))
        if made.shape[1]:
            self.basis = self.basis.with_block(made)
        return Pairs(upper, lower), made

    def _solved(self, right: FloatArray) -> FloatArray:
        self.solves += right.shape[1]
        return np.asarray(self._solver.factor.solve(right))
