"""Dense reduced systems solved in single precision, for answers that need three digits: a fifth of the time.

Sums of terms are formed in double precision, so that what cancels between them (the coupling and the compression) is
exact before it is rounded; what rounding leaves enters a compliance at 1e-4 of the largest entry at 700 directions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import csysv, csysv_lwork

from ...errors import SolverError
from ...typing import BoolArray, ComplexArray, FloatArray
from ..assembly.coefficients import Coefficient, grouped
from .reduced_model import ReducedModel, combined

Single = NDArray[np.complex64]


@dataclass(frozen=True, eq=False)
class Summed:
    """A reduced model for the coefficients of one draw: ``sums`` (k, r, r) of the terms that have one of its
    ``coefficients`` in common, rounded to single precision."""

    reduced: ReducedModel
    sums: NDArray[np.float32]
    coefficients: tuple[Coefficient, ...]

    @classmethod
    def of(cls, reduced: ReducedModel) -> Self:
        """The sums of a model, formed once for however many frequencies are asked."""
        sums = grouped(reduced.coefficients)
        weights, size = np.array([w for w, _ in sums]), reduced.size
        flat = (weights @ reduced.matrices.reshape(weights.shape[1], -1)).astype(np.float32)
        return cls(reduced, flat.reshape(-1, size, size), tuple(c for _, c in sums))

    def theta(self, frequency: FloatArray) -> ComplexArray:
        """What the sums are multiplied with at ``frequency`` (n,) [Hz], (n, k)."""
        omega = 2 * np.pi * np.asarray(frequency, dtype=float)
        return np.array([np.broadcast_to(c.at(omega), omega.shape) for c in self.coefficients], dtype=complex).T

    def solution(self, frequency: float, right: Single | None = None) -> Single:
        """Reduced solution (r, m) at one frequency [Hz] for the loads ``right`` (r, m), of the ports where left out.

        Raises SolverError where the system is singular.
        """
        flat, size = self.sums.reshape(len(self.sums), -1), self.reduced.size
        matrix = combined(self.theta(np.array([frequency]))[0].astype(np.complex64), flat, np.complex64)
        return _solution(matrix.reshape(size, size).T, _right(self.reduced) if right is None else right)

    def compliance(self, frequency: FloatArray) -> ComplexArray:
        """As :func:`quick_compliance`."""
        reduced, right = self.reduced, _right(self.reduced)
        found = [reduced.functionals.T @ self.solution(f, right) for f in np.asarray(frequency, dtype=float).tolist()]
        return np.asarray(np.array(found, dtype=complex).reshape(-1, *reduced.shares.shape * 2) * reduced.shares)


def quick_compliance(reduced: ReducedModel, frequency: FloatArray) -> ComplexArray:
    """Compliance (n_frequency, n_port, n_port) [m/N] as :meth:`.ReducedModel.compliance`, to about 1e-4.

    Raises SolverError where a system is singular.
    """
    return Summed.of(reduced).compliance(frequency)


def quick_state(reduced: ReducedModel, frequency: float) -> Single:
    """Reduced solution (r, n_port) at one frequency [Hz] for a unit force on each port; raises as above."""
    return _solution(_matrix(reduced, frequency), _right(reduced))


def with_and_without(reduced: ReducedModel, kept: BoolArray, frequency: float) -> tuple[ComplexArray, ComplexArray]:
    """Compliances (n_port, n_port) at one frequency [Hz] of the model and of its ``kept`` (r,) directions alone."""
    matrix, right, chosen = _matrix(reduced, frequency), _right(reduced), np.flatnonzero(kept)
    part = np.asfortranarray(matrix[np.ix_(chosen, chosen)])
    less = reduced.functionals[chosen].T @ _solution(part, np.asfortranarray(right[chosen]))
    whole = reduced.functionals.T @ _solution(matrix, right)
    return np.asarray(whole * reduced.shares, dtype=complex), np.asarray(less * reduced.shares, dtype=complex)


def _right(reduced: ReducedModel) -> Single:
    return np.asfortranarray(reduced.functionals.astype(np.complex64))


def _matrix(reduced: ReducedModel, frequency: float) -> Single:
    """A (r, r) in columns, from the terms one by one: cheaper than their sums for one frequency."""
    theta = np.array([complex(c.at(np.array(2 * np.pi * frequency))) for c in reduced.coefficients])
    matrix = combined(theta, reduced.matrices.reshape(len(theta), -1), np.complex64)
    return matrix.reshape(reduced.size, reduced.size).T  # symmetric


def _solution(matrix: Single, right: Single) -> Single:
    """Uses up the symmetric ``matrix``: 0.7 of the time of a general solve from 300 directions on."""
    if not len(right):
        return right
    work = int(csysv_lwork(len(right))[0].real)
    _, _, x, info = csysv(matrix, right, lwork=work, overwrite_a=1)
    if info:
        raise SolverError(f"a reduced system of {len(right)} directions is singular; make the model from other draws")
    return np.asarray(x)
