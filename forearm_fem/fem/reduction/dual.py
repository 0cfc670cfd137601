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
from ..assembly.model import ForearmModel
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
    space lacks, which only the bound sees; it is infinite beside a mode that loses nothing. LinAlgError where the
    residuals of two ports are alike to the last digit.
    """
    model, states = bound.solver.model, reduced.states(np.array([frequency]))[0]
    rows, columns = watched(model)
    stiffness = model.operator.at(2 * np.pi * frequency)
    rest, left = _rest(model, reduced, stiffness, states)
    directions = solve(rest)
    eta = energy_norms(rest, directions, model.operator.n_displacements)
    off = left + _found_in(reduced, frequency, stiffness, rest, directions)
    sizes = (np.abs(x * model.shares)[np.ix_(rows, columns)] for x in (reduced.functionals.T @ states, off, left))
    largest, error, rounding = (float(np.nanmax(size)) for size in sizes)  # NaN: no symmetric solution
    most = eta[rows].max() * np.nanmax((eta * model.shares)[columns])
    stable = float(bound.stability(reduced, np.array([frequency]))[0])
    return DualEstimate(error / largest, rounding / largest, float(most) / (stable * largest) if stable else np.inf)


def _rest(
    model: ForearmModel, reduced: ReducedModel, stiffness: WeightedSum, states: ComplexArray
) -> tuple[FloatArray, ComplexArray]:
    """Residuals r (n, 2 n_port), real parts, then imaginary ones, and x_i . r_j (n_port, n_port)."""
    solutions = _complex(reduced.basis.combination(_real(states)))
    rest = model.functionals - stiffness.product(solutions)
    return _real(rest), solutions.T @ rest


def _found_in(
    reduced: ReducedModel, frequency: float, stiffness: WeightedSum, rest: FloatArray, directions: FloatArray
) -> ComplexArray:
    """r_i . z_j (n_port, n_port); z_j solves for r_j, the ``rest``, in the space and the ``directions`` (n, k)."""
    basis, lengths = reduced.basis, np.linalg.norm(directions, axis=0)
    coupled, own = np.zeros((reduced.size, len(lengths)), complex), np.zeros((len(lengths),) * 2, complex)
    weights = np.array([stiffness.weights.real, stiffness.weights.imag])
    for part, turn in zip(weights, (1, 1j), strict=True):  # complex columns would take more room
        moved = stiffness.matrices.real_sum(part[None], (directions,))
        coupled, own = coupled + turn * basis.inner(moved), own + turn * (directions.T @ moved)
    theta = np.array([complex(c.at(np.array(2 * np.pi * frequency))) for c in reduced.coefficients])
    right = np.vstack([_complex(basis.inner(rest)), _complex(directions.T @ rest)])
    kept = np.concatenate([np.ones(reduced.size, bool), lengths > 0])
    unit = np.concatenate([np.ones(reduced.size), lengths])[kept]
    matrix = np.block([[np.tensordot(theta, reduced.matrices, 1), coupled], [coupled.T, own]])[np.ix_(kept, kept)]
    matrix, right = matrix / np.outer(unit, unit), right[kept] / unit[:, None]
    return np.asarray(right.T @ np.linalg.solve(matrix, right))


def _real(x: ComplexArray) -> FloatArray:
    """Real parts of columns (n, k), then imaginary ones."""
    return np.hstack([x.real, x.imag])


def _complex(x: FloatArray) -> ComplexArray:
    real, imaginary = np.hsplit(x, 2)
    return np.asarray(real + 1j * imaginary)
