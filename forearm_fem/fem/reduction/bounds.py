"""A bound of the reduced model's error at every bin, from residuals: no sharp resonance hides between what is compared.

With r_j = f_j - A V q_j the error is C_ij - f_i . V q_j = r_i . A^-1 r_j, as A is symmetric and V . r_j = 0. Let P be
A at a real rate, real and positive on displacements, and eta_j^2 = r_j . P^-1 r_j. Undamped modes phi diagonalise A
and P where damping is modal, so

    |C_ij - f_i . V q_j| <= eta_i eta_j / alpha,    alpha = min over modes of |phi . A phi| / (phi . P phi),

whatever modes V lacks, as long as alpha is theirs, too. So modes close to omega are taken to resonate exactly there,
whether they do or not, and alpha is halved once more: a mode that V lacks may lose half as much as the least damped of
its neighbours, and damping that couples modes changes alpha by less than that (docs/decisions/0028).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from ...typing import ComplexArray, FloatArray
from ..assembly.coefficients import Coefficient, polynomial_of
from ..linear.direct import DirectSolver, watched
from .poles import Modes
from .reduced_model import ReducedModel

_LESS_LOSS = 0.5  # of a mode that the space lacks, in terms of the least damped of those near it that it has
_NEAR = 1.5  # ratio of frequencies up to which a mode tells what its neighbours lose


@dataclass(frozen=True)
class ResidualBound:
    """Bounds with the factors of P, which are made at the first use; ``rate`` [1/s] says where.

    For moduli that are no polynomials of the rate P has their real part at omega = ``rate``. Not covered: modes that
    lose less than half of what their neighbours do, such as those of a skin membrane alone.
    """

    solver: DirectSolver
    rate: float

    def errors(self, reduced: ReducedModel, frequency: FloatArray, poles: Modes | None) -> FloatArray:
        """Bounds (n_frequency,) of max |dC| / max |C| over the watched entries; states from ``poles`` where given."""
        model, rows, columns = self.solver.model, *watched(self.solver.model)
        self.solver.factor.factorise(model.operator.combine(self._weights(reduced).tolist()))
        ports = list(range(len(model.ports)))
        bounds = np.empty(len(frequency))
        for i, stable in enumerate(self.stability(reduced, frequency)):
            one = frequency[i : i + 1]
            states = (reduced.states(one) if poles is None else poles.states(one, ports) / reduced.shares)[0]
            eta = self._residuals(reduced, float(one[0]), states)
            largest = np.nanmax(np.abs((reduced.functionals.T @ states) * reduced.shares)[np.ix_(rows, columns)])
            bounds[i] = eta[rows].max() * np.nanmax((eta * reduced.shares)[columns]) / (stable * largest)
        return bounds

    def stability(self, reduced: ReducedModel, frequency: FloatArray) -> FloatArray:
        """alpha (n_frequency,) from the undamped modes of the reduced model."""
        modes = undamped_modes(reduced, frequency)
        scale = self._weights(reduced) @ modes.energy
        kept, lost, moved = (x[:, scale > 0] / scale[scale > 0] for x in (modes.kept, modes.lost, modes.moved))
        near = (kept < _NEAR**2 * moved) & (kept * _NEAR**2 > moved)
        least = np.where(near, lost, np.abs(kept - moved + 1j * lost)).min(axis=1)
        return np.asarray(_LESS_LOSS * np.maximum(least, 0.0))

    def _weights(self, reduced: ReducedModel) -> FloatArray:
        """Weights (n_term,) of P."""
        return np.array([_at_rate(c, self.rate) for c in reduced.coefficients])

    def _residuals(self, reduced: ReducedModel, frequency: float, states: ComplexArray) -> FloatArray:
        """eta (n_port,) of the reduced ``states`` (r, n_port) for unit forces."""
        operator, basis = self.solver.model.operator, reduced.basis
        known = np.hstack([states.real, states.imag])
        known = known if basis.directions is None else basis.directions @ known
        real, imaginary = np.hsplit(basis.combination(known), 2)
        rest = self.solver.model.functionals - operator.at(2 * np.pi * frequency).product(real + 1j * imaginary)
        both = np.hstack([rest.real, rest.imag])
        return energy_norms(both, self.solver.factor.solve(both), operator.n_displacements)


def energy_norms(rest: FloatArray, moved: FloatArray, n_displacements: int) -> FloatArray:
    """eta (k,) of residuals whose real parts, then imaginary ones, are ``rest`` (n, 2k), ``moved`` by P^-1.

    Pressures count with the other sign: with it both halves of the saddle form are energies.
    """
    energy = rest * moved
    total = energy[:n_displacements].sum(axis=0) - energy[n_displacements:].sum(axis=0)
    return np.asarray(np.sqrt(np.maximum(total.reshape(2, -1).sum(axis=0), 0.0)))


@dataclass(frozen=True)
class UndampedModes:
    """Energies (n_term, n_mode) of modes in each term's matrix; what they keep, lose and move (n_frequency, n_mode).

    phi . A(omega) phi = kept + i lost - moved.
    """

    energy: FloatArray
    kept: FloatArray
    lost: FloatArray
    moved: FloatArray


def undamped_modes(reduced: ReducedModel, frequency: FloatArray) -> UndampedModes:
    """Modes of the reduced model with the moduli that it keeps in the middle of the band."""
    omega = 2 * np.pi * frequency
    theta = np.array([np.broadcast_to(c.at(omega), omega.shape) for c in reduced.coefficients])
    inertia = np.array([(polynomial_of(c) or (0.0, 0.0, 0.0))[2] for c in reduced.coefficients])
    held = theta.real + np.outer(inertia, omega**2)
    stiffness, mass = (np.tensordot(w, reduced.matrices, 1) for w in (held[:, len(omega) // 2], inertia))
    _, shapes = scipy.linalg.eigh(stiffness, mass)
    energy = np.array([np.einsum("rn,rn->n", shapes, m @ shapes) for m in reduced.matrices])
    return UndampedModes(energy, held.T @ energy, theta.imag.T @ energy, np.outer(omega**2, inertia @ energy))


def sharp_modes(reduced: ReducedModel, frequency: FloatArray, loss: float) -> int:
    """How many modes of the reduced model resonate in the band with a loss factor below ``loss``.

    That is a Rayleigh quotient: right long before the mode is.
    """
    modes = undamped_modes(reduced, frequency)
    above = modes.moved > modes.kept
    crossed = above[1:] & ~above[:-1]
    return int(np.sum(modes.lost[1:][crossed] < loss * modes.kept[1:][crossed]))


def _at_rate(coefficient: Coefficient, rate: float) -> float:
    if (known := polynomial_of(coefficient)) is None:
        return float(complex(coefficient.at(np.array(rate))).real)
    constant, slope, inertia = known
    return constant + rate * slope + rate**2 * inertia
