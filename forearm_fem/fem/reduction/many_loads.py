"""A reduced space for hundreds of loads on one patch: the derivatives of each about a real rate, without what is known.

As in :mod:`.rate_space`, but loads come in batches, and a direction whose solution or derivative the space holds
already, to within a share ``drop`` of its length, is neither kept nor followed further: far from their loads fields of
neighbours are nearly the same. All loads are outputs, too, so the error of a compliance is that of both fields
multiplied. Columns are made orthonormal in single precision, as in :func:`.basis.rough_extension`.
"""

from __future__ import annotations

import numpy as np

from ...typing import FloatArray
from ..assembly.coefficients import rate_weights
from ..linear.direct import DirectSolver
from .basis import Basis, Columns
from .rate_space import Pairs


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
