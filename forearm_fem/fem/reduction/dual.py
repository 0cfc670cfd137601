"""The error of a reduced model at a frequency from its residuals and a richer space, without a factorisation there.

The model's solutions x_i leave r_i = f_i - A x_i. As A is symmetric, its compliance is off by

    C_ij - f_i . x_j = x_i . r_j + r_i . A^-1 r_j

exactly. The first term is what solves left in the space, nothing else; for the second A^-1 r_j is looked for in the
space and the directions P^-1 r, with P = A at the expansion rate, whose factors are still there. What a space of
smooth solutions lacks is stiff, where P is much like A, so that these directions hold most of it: a dual-weighted
residual whose dual space is richer than the primal one (Becker and Rannacher, Acta Numerica 10, 2001). A mode that
resonates and that the space lacks would be missed; the energies r . P^-1 r bound what it could do (:mod:`.bounds`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...typing import ComplexArray, FloatArray
from ..assembly.operator import WeightedSum
from ..linear.direct import watched
from .bounds import ResidualBound, energy_norms
from .reduced_model import ReducedModel


@dataclass(frozen=True)
class DualEstimate:
    """Relative to the largest watched entry of the compliance: the ``error``, what solves left of it (``rounding``),
    and a ``bound`` that holds for modes, too, of which the richer space knows nothing."""

    error: float
    rounding: float
    bound: float


def dual_estimate(
    bound: ResidualBound, reduced: ReducedModel, frequency: float, solve: Callable[[FloatArray], FloatArray]
) -> DualEstimate:
    """Error of the ``reduced`` model at ``frequency`` [Hz]; ``solve`` gives P^-1 b for real b (n, k), with P at the
    rate of the ``bound``.

    On damped scenes it is 0.7 to 2.3 times the true error (docs/decisions/0045). Not covered: resonances that the
    space lacks, which only the bound sees.
    """
    model, basis = bound.solver.model, reduced.basis
    rows, columns = watched(model)
    states = reduced.states(np.array([frequency]))[0]
    stiffness = model.operator.at(2 * np.pi * frequency)
    solutions = _complex(basis.combination(_real(states)))
    rest = model.functionals - stiffness.product(solutions)
    directions = solve(_real(rest))
    eta = energy_norms(_real(rest), directions, model.operator.n_displacements)
    left = solutions.T @ rest
    off = left + _found_in(reduced, frequency, stiffness, rest, directions)
    largest = np.abs((reduced.functionals.T @ states) * model.shares)[np.ix_(rows, columns)].max()
    error, rounding = (np.abs(x * model.shares)[np.ix_(rows, columns)].max() for x in (off, left))
    most = eta[rows].max() * (eta * model.shares)[columns].max() / bound.stability(reduced, np.array([frequency]))[0]
    return DualEstimate(float(error / largest), float(rounding / largest), float(most / largest))


def _found_in(
    reduced: ReducedModel, frequency: float, stiffness: WeightedSum, rest: ComplexArray, directions: FloatArray
) -> ComplexArray:
    """r_i . z_j (n_port, n_port); z_j solves for r_j, the ``rest``, in the space and the ``directions`` (n, k)."""
    basis, unit = reduced.basis, directions / np.linalg.norm(directions, axis=0)
    moved = stiffness.product(unit.astype(complex))
    coupled, seen = (_complex(basis.inner(_real(x))) for x in (moved, rest))
    theta = np.array([complex(c.at(np.array(2 * np.pi * frequency))) for c in reduced.coefficients])
    matrix = np.block([[np.tensordot(theta, reduced.matrices, 1), coupled], [coupled.T, unit.T @ moved]])
    right = np.vstack([seen, unit.T @ rest])
    return np.asarray(right.T @ np.linalg.solve(matrix, right))


def _real(x: ComplexArray) -> FloatArray:
    """Real parts of columns (n, k), then imaginary ones."""
    return np.hstack([x.real, x.imag])


def _complex(x: FloatArray) -> ComplexArray:
    real, imaginary = np.hsplit(x, 2)
    return np.asarray(real + 1j * imaginary)
