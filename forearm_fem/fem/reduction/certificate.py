"""Error of a reduced model: residual bounds, the dual estimate in a richer space, direct solves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.linalg

from ...transfer import relative_error
from ...typing import ComplexArray, FloatArray
from ..assembly.coefficients import Coefficient, polynomial_of
from ..assembly.model import ForearmModel
from ..assembly.operator import WeightedSum
from ..kernels.compiled import one_blas_thread
from ..linear.direct import DirectSolver, watched
from .affine import AffineReduced, Modes

# A bound of the reduced model's error at every bin, from residuals: no sharp resonance hides between what is compared.
# With r_j = f_j - A V q_j the error is C_ij - f_i . V q_j = r_i . A^-1 r_j, as A is symmetric and V . r_j = 0. Let P be
# A at a real rate, real and positive on displacements, and eta_j^2 = r_j . P^-1 r_j. Undamped modes phi diagonalise A
# and P where damping is modal, so
# |C_ij - f_i . V q_j| <= eta_i eta_j / alpha,    alpha = min over modes of |phi . A phi| / (phi . P phi),
# whatever modes V lacks, as long as alpha is theirs, too. So modes close to omega are taken to resonate exactly there,
# whether they do or not, and alpha is halved once more: a mode that V lacks may lose half as much as the least damped
# of its neighbours, and damping that couples modes changes alpha by less than that.

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

    def errors(self, reduced: AffineReduced, frequency: FloatArray, poles: Modes | None) -> FloatArray:
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

    def stability(self, reduced: AffineReduced, frequency: FloatArray) -> FloatArray:
        """alpha (n_frequency,) from the undamped modes of the reduced model."""
        modes = undamped_modes(reduced, frequency)
        scale = self._weights(reduced) @ modes.energy
        kept, lost, moved = (x[:, scale > 0] / scale[scale > 0] for x in (modes.kept, modes.lost, modes.moved))
        near = (kept < _NEAR**2 * moved) & (kept * _NEAR**2 > moved)
        least = np.where(near, lost, np.abs(kept - moved + 1j * lost)).min(axis=1)
        return np.asarray(_LESS_LOSS * np.maximum(least, 0.0))

    def _weights(self, reduced: AffineReduced) -> FloatArray:
        """Weights (n_term,) of P."""
        return np.array([_at_rate(c, self.rate) for c in reduced.coefficients])

    def _residuals(self, reduced: AffineReduced, frequency: float, states: ComplexArray) -> FloatArray:
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


@one_blas_thread()
def undamped_modes(reduced: AffineReduced, frequency: FloatArray) -> UndampedModes:
    """Modes of the reduced model with the moduli that it keeps in the middle of the band."""
    omega = 2 * np.pi * frequency
    theta = np.array([np.broadcast_to(c.at(omega), omega.shape) for c in reduced.coefficients])
    inertia = np.array([(polynomial_of(c) or (0.0, 0.0, 0.0))[2] for c in reduced.coefficients])
    held = theta.real + np.outer(inertia, omega**2)
    stiffness, mass = (reduced.combined(w) for w in (held[:, len(omega) // 2], inertia))
    _, shapes = scipy.linalg.eigh(stiffness, mass)
    energy = np.array([np.einsum("rn,rn->n", shapes, m @ shapes) for m in reduced.matrices])
    return UndampedModes(energy, held.T @ energy, theta.imag.T @ energy, np.outer(omega**2, inertia @ energy))


def sharp_modes(reduced: AffineReduced, frequency: FloatArray, loss: float) -> int:
    """Number of modes of the reduced model that resonate in the band with a loss factor below ``loss``.

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


# The error of a reduced model at a frequency from its residuals and a richer space, without a factorisation there.
# The model's solutions x_i leave r_i = f_i - A x_i. As A is symmetric, its compliance is off by
# C_ij - f_i . x_j = x_i . r_j + r_i . A^-1 r_j
# exactly. The first term is what solves left in the space, nothing else; for the second A^-1 r_j is looked for in the
# space and the directions P^-1 r, with P = A at the expansion rate, whose factors are still there. What a space of
# smooth solutions lacks is stiff, where P is much like A, so that these directions hold most of it: a dual-weighted
# residual whose dual space is richer than the primal one (Becker and Rannacher, Acta Numerica 10, 2001). A mode that
# resonates and that the space lacks would be missed; the energies r . P^-1 r bound what it could do (:mod:`.bounds`).


@dataclass(frozen=True)
class DualEstimate:
    """Relative to the largest watched entry of the compliance: the ``error``, what solves left of it (``rounding``),
    and a ``bound`` that holds for modes, too, of which the richer space knows nothing."""

    error: float
    rounding: float
    bound: float


def dual_estimate(
    bound: ResidualBound, reduced: AffineReduced, frequency: float, solve: Callable[[FloatArray], FloatArray]
) -> DualEstimate:
    """Error of the ``reduced`` model at ``frequency`` [Hz]; ``solve`` gives P^-1 b for real b (n, k), with P at the
    rate of the ``bound``.

    On damped scenes it is 0.7 to 2.3 times the true error (decision 0045). Not covered: resonances that the
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
    model: ForearmModel, reduced: AffineReduced, stiffness: WeightedSum, states: ComplexArray
) -> tuple[FloatArray, ComplexArray]:
    """Residuals r (n, 2 n_port), real parts, then imaginary ones, and x_i . r_j (n_port, n_port)."""
    solutions = _complex(reduced.basis.combination(_real(states)))
    rest = model.functionals - stiffness.product(solutions)
    return _real(rest), solutions.T @ rest


def _found_in(
    reduced: AffineReduced, frequency: float, stiffness: WeightedSum, rest: FloatArray, directions: FloatArray
) -> ComplexArray:
    """r_i . z_j (n_port, n_port); z_j solves for r_j, the ``rest``, in the space and the ``directions`` (n, k)."""
    basis, lengths = reduced.basis, np.linalg.norm(directions, axis=0)
    coupled, own = np.zeros((reduced.size, len(lengths)), complex), np.zeros((len(lengths),) * 2, complex)
    weights = np.array([stiffness.weights.real, stiffness.weights.imag])
    for part, turn in zip(weights, (1, 1j), strict=True):  # complex columns would take more room
        moved = stiffness.matrices.real_sum(part[None], (directions,))
        coupled = coupled + turn * basis.inner(moved)
        with one_blas_thread():
            own = own + turn * (directions.T @ moved)
    with one_blas_thread():
        by_own = _complex(directions.T @ rest)
    right = np.vstack([_complex(basis.inner(rest)), by_own])
    kept = np.concatenate([np.ones(reduced.size, bool), lengths > 0])
    unit = np.concatenate([np.ones(reduced.size), lengths])[kept]
    matrix = np.block([[reduced.combined(reduced.theta(frequency)), coupled], [coupled.T, own]])[np.ix_(kept, kept)]
    matrix, right = matrix / np.outer(unit, unit), right[kept] / unit[:, None]
    with one_blas_thread():
        return np.asarray(right.T @ np.linalg.solve(matrix, right))


def _real(x: ComplexArray) -> FloatArray:
    """Real parts of columns (n, k), then imaginary ones."""
    return np.hstack([x.real, x.imag])


def _complex(x: FloatArray) -> ComplexArray:
    real, imaginary = np.hsplit(x, 2)
    return np.asarray(real + 1j * imaginary)


# Where a reduced model is doubted, and what it is certified with.

DOUBTFUL = 0.1  # a change by one derivative above this, anywhere, says that resonances are not resolved
_PROBES = 40
_ROUNDING = 1e-10  # weaker directions are none
_SPACING = 0.1  # probes are equally far apart in this power of the frequency


@dataclass(frozen=True)
class Certificate:
    """Error of the reduced model at a frequency where it was compared with a direct solve it had not used, or, ``by``
    its residual, twice what a richer space finds of it (:mod:`.dual`).

    ``change`` is the largest change of the model, of so many ``expansions``, by one derivative and its weak directions,
    over the band; ``frequency`` is where the model was doubted most (:func:`doubt`). Where resonances are sharp
    ``change`` is a bound of the error at every bin instead (:mod:`.bounds`), largest at ``frequency``. ``wary`` says
    that resonances are sharp, or that the change is, or was before, too large for one true error to speak for the band.
    ``rounding`` is what may be wrong with the direct solution itself, where it is not refined, or what solves left in
    the space. ``elsewhere`` is the
    largest error at frequencies that were compared before: the model was extended by these solutions and should
    reproduce them; where it does not, as with pressures of incompressible tissue, it is no better between them.
    """

    frequency: float
    error: float
    change: float = 0.0
    expansions: int = 0
    wary: bool = False
    rounding: float = 0.0
    elsewhere: float = 0.0
    by: Literal["direct solve", "elimination", "residual"] = "direct solve"

    @property
    def bound(self) -> float:
        """The error and the rounding; the change, too, where one true error cannot speak for the band."""
        here = max(self.error, self.change) if self.wary else self.error + self.rounding
        return max(here, self.elsewhere)


@dataclass(frozen=True)
class Doubt:
    """Frequency at which the reduced model is doubted most.

    ``change``: largest anywhere, relative to the largest entry; where resonances are sharp, the largest error
    bound.
    ``wary``: True where the bound is stated, too.
    """

    frequency: float
    change: float
    wary: bool = False


def doubt(
    model: ForearmModel, reduced: AffineReduced, frequency: FloatArray, known: Sequence[float], *, wary: bool = False
) -> Doubt | None:
    """The most doubtful of the probed frequencies that are not ``known``; None if none is left.

    The change is the error of the model with one derivative fewer, and without its weak directions: it says where a
    model is no approximation at all yet. Where the change is small everywhere, the largest error is where the
    derivatives alone change most.
    """
    probes = probe_frequencies(frequency, known)
    if not len(probes):
        return None
    values = _watched(model, reduced, probes)
    lower = reduced.lower()
    change = place = relative_error(_watched(model, lower, probes), values)
    if not wary and change.max() <= DOUBTFUL and (rounding := reduced.lower(_ROUNDING)).size != lower.size:
        place = relative_error(_watched(model, rounding, probes), values)
    largest = float(change.max())
    return Doubt(float(probes[int(np.argmax(place))]), largest, wary or largest > DOUBTFUL)


def most_doubtful_bin(bounds: FloatArray, frequency: FloatArray, known: Sequence[float]) -> Doubt | None:
    """The bin that is not ``known`` with the largest of the ``bounds`` (n_frequency,), which are all stated."""
    open_bins = np.flatnonzero(~np.isin(frequency, known))
    if not len(open_bins):
        return None
    worst = open_bins[int(np.argmax(bounds[open_bins]))]
    return Doubt(float(frequency[worst]), float(bounds.max()), wary=True)


def largest_change(model: ForearmModel, reduced: AffineReduced, smaller: AffineReduced, frequency: FloatArray) -> float:
    """Largest change of G over the band by what the ``smaller`` model lacks."""
    return float(changes(model, reduced, smaller, probe_frequencies(frequency, ())[::2]).max())


def changes(model: ForearmModel, reduced: AffineReduced, smaller: AffineReduced, probes: FloatArray) -> FloatArray:
    """Change (n_probe,) of G at each of the ``probes`` [Hz] by what the ``smaller`` model lacks."""
    return relative_error(_watched(model, smaller, probes), _watched(model, reduced, probes))


def _watched(model: ForearmModel, reduced: AffineReduced, probes: FloatArray) -> ComplexArray:
    """Compliances (n_probe, n_output, n_input) whose error counts."""
    return reduced.compliance(probes)[np.ix_(range(len(probes)), *watched(model))]


def probe_frequencies(frequency: FloatArray, known: Sequence[float]) -> FloatArray:
    """Bins equally far apart in f^0.1, without the known ones."""
    low, high = frequency[0] ** _SPACING, frequency[-1] ** _SPACING
    wanted = np.linspace(low, high, min(_PROBES, len(frequency))) ** (1 / _SPACING)
    bins = {float(frequency[np.argmin(np.abs(frequency - f))]) for f in wanted}
    return np.array(sorted(bins - set(known)))


def certified(reduced: AffineReduced, model: ForearmModel, truth: ComplexArray, at: Doubt, used: int) -> Certificate:
    """Error at the watched ports against a direct solution's compliance (n_port, n_port) [m/N]."""
    return Certificate(at.frequency, error_at(reduced, model, at.frequency, truth), at.change, used, at.wary)


def error_at(reduced: AffineReduced, model: ForearmModel, frequency: float, truth: ComplexArray) -> float:
    """Of the reduced compliance at the watched ports, relative to the largest entry of the ``truth`` there."""
    known = truth[None][np.ix_([0], *watched(model))]
    return float(relative_error(_watched(model, reduced, np.array([frequency])), known)[0])
