"""One reduced space for many tissues: solutions for several coefficients of the same terms, taken where it errs most.

The terms' matrices do not depend on moduli or tension, so a space that holds solutions for several of these serves all
between them. It starts from derivatives about a real rate for the model's own ones. Then, over and over, the place
(draw and frequency) where the model changes most without its weaker half is solved directly. That gives a true error
there, and the solution with its derivative extends the space (docs/decisions/0038-parametric-model.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...progress import Progress, tell
from ...scenario.sweep import SolverOptions
from ...transfer import relative_error
from ...typing import BoolArray, ComplexArray, FloatArray
from ..assembly.coefficients import Coefficient, Polynomial, is_polynomial
from ..assembly.model import ForearmModel
from ..linear.direct import DirectSolver, make_solver, watched
from .basis import Columns, orthonormal_extension, real_columns
from .expansion import expansion_rate
from .rate_space import RateSpace
from .reduced_model import ReducedModel, empty_model, with_last_columns

Coefficients = tuple[Coefficient, ...]  # one of each term: what a draw is to the operator
_DERIVATIVES = 20  # about the rate, for the middle draw
_LOOKED_AT = 16  # places among which the next solve is chosen; each costs two small dense solves
_PARTS = 3  # of the band, equally many bins each
_DROP = 1e-3  # of a solution's length: the error of C is the product of two of these


@dataclass(frozen=True)
class TrialSolve:
    """The model's ``estimated`` and ``true`` e(f) at a place that it had not seen: a draw's number and a frequency."""

    draw: int
    frequency: float
    estimated: float
    true: float


@dataclass(frozen=True)
class United:
    """A reduced model for many coefficients. Its first ``core`` directions are the space that a third of the solves did
    not extend: what an answer changes without the others is the estimate of its error.

    ``trials`` were compared while it grew and then extended it; ``checks`` afterwards, and did not. ``solves`` counts
    the factorisations.
    """

    reduced: ReducedModel
    core: int
    trials: tuple[TrialSolve, ...]
    checks: tuple[TrialSolve, ...]
    solves: int


@dataclass(frozen=True)
class Growth:
    """How much work is put into a space: direct ``solves`` that extend it, ``checks`` after that, ``states`` (of draws
    at frequencies) that it is compressed to, and the share ``drop`` of the strongest direction that is left out."""

    solves: int = 16
    checks: int = 6
    states: int = 160
    drop: float = 5e-4
    seed: int = 1


def united_model(
    model: ForearmModel,
    draws: Sequence[Coefficients],
    frequency: FloatArray,
    options: SolverOptions,
    growth: Growth,
    progress: Progress | None = None,
) -> United:
    """A space for the model's own coefficients and those of the ``draws``, in the band of ``frequency`` (n,) [Hz].

    All draws serve for choosing where to solve and for compression, random ones for checks.
    """
    work = _Growing(model, draws, make_solver(model, options, float(frequency[-1])))
    rng = np.random.default_rng(growth.seed)
    stage = "draws solved"
    tell(progress, stage, 0, growth.solves + growth.checks)
    work.start(frequency)
    trials = list[TrialSolve]()
    for i in range(growth.solves):  # each part of the band in turn, as errors are largest where waves are short
        part = np.array_split(frequency, min(_PARTS, len(frequency)))[-1 - i % min(_PARTS, len(frequency))]
        early = i // _PARTS % 3 != 2
        trials.append(work.extended_where_worst(_places(rng, len(draws), part, _LOOKED_AT), early))
        tell(progress, stage, i + 1, growth.solves + growth.checks)
    places = _places(rng, len(draws), frequency, growth.states)
    small, core = _compressed(work.reduced, work.early, draws, places, growth.drop)
    checks = list[TrialSolve]()
    for i, place in enumerate(_places(rng, len(draws), frequency, growth.checks)):
        checks.append(work.tried(small, np.arange(small.size) < core, place)[0])
        tell(progress, stage, growth.solves + i + 1, growth.solves + growth.checks)
    work.release()
    return United(small, core, tuple(trials), tuple(checks), growth.solves + growth.checks + 1)


Place = tuple[int, float]


def _places(rng: np.random.Generator, draws: int, frequency: FloatArray, count: int) -> list[Place]:
    """Random draws, each as often as the others, at bins that are dense in the square root of the frequency."""
    order = np.concatenate([rng.permutation(draws) for _ in range(-(-count // draws))])[:count]
    wanted = rng.uniform(np.sqrt(frequency[0]), np.sqrt(frequency[-1]), count) ** 2
    return [(int(d), float(frequency[np.argmin(np.abs(frequency - f))])) for d, f in zip(order, wanted, strict=True)]


class _Growing:
    """The space as it grows.

    ``strong`` marks columns but derivatives, on which it is looked at to choose the next solve, ``early`` those that
    the estimate's smaller model has.
    """

    def __init__(self, model: ForearmModel, draws: Sequence[Coefficients], solver: DirectSolver) -> None:
        self._model, self._draws, self._solver = model, draws, solver
        self.reduced, self._strong, self.early = empty_model(model), np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)

    def start(self, frequency: FloatArray) -> None:
        """Derivatives about a rate, where moduli that are no polynomials of it are replaced by Kelvin-Voigt ones."""
        rate = expansion_rate(frequency)
        own = [kelvin_voigt_like(t.coefficient, rate) for t in self._model.operator.terms]
        space = RateSpace(self._of(tuple(own)), self._model.functionals, rate)
        for strong in (True, False):
            self._added(space.more(_DERIVATIVES // 2).columns, strong, early=True)

    def extended_where_worst(self, places: Sequence[Place], early: bool) -> TrialSolve:
        """The trial at the place with the largest estimate, whose solution then belongs to the space."""
        found = [_estimate(self.reduced, self._strong, self._draws[d], f, self._model) for d, f in places]
        draw, f = places[int(np.argmax(found))]
        trial, solution = self.tried(self.reduced, self._strong, (draw, f))
        series = self._of(self._draws[draw]).taylor(f, solution, np.ones(len(self._model.ports), dtype=int))
        for strong, columns in zip((True, False), series, strict=True):
            self._added(real_columns([columns]), strong, early)
        return trial

    def tried(self, reduced: ReducedModel, strong: BoolArray, place: Place) -> tuple[TrialSolve, ComplexArray]:
        """What ``reduced`` says at a place, against a direct solution (n, n_port), which comes along."""
        draw, f = place
        estimated = _estimate(reduced, strong, self._draws[draw], f, self._model)
        solution = self._of(self._draws[draw]).at(f).values
        truth = np.asarray((self._model.functionals.T @ solution) * self._model.shares, dtype=complex)[None]
        found = replace(reduced, coefficients=self._draws[draw]).compliance(np.array([f]))
        return TrialSolve(draw, f, estimated, _watched_change(found, truth, self._model)), solution

    def release(self) -> None:
        """Give the factor's memory back."""
        self._solver.factor.release()

    def _added(self, columns: Columns, strong: bool, early: bool) -> None:
        n_u, whole = self._model.operator.n_displacements, np.array(columns, dtype=float)
        new, _ = orthonormal_extension(self.reduced.basis, whole, [whole.shape[1]], n_u, drop=_DROP)
        self.reduced = with_last_columns(self.reduced, self._model, new.astype(np.float32))
        self._strong = np.append(self._strong, np.full(new.shape[1], strong))
        self.early = np.append(self.early, np.full(new.shape[1], early))

    def _of(self, draw: Coefficients) -> DirectSolver:
        return replace(self._solver, model=with_coefficients(self._model, draw))


def with_coefficients(model: ForearmModel, coefficients: Coefficients) -> ForearmModel:
    """The same matrices with other coefficients of the terms."""
    terms = tuple(replace(t, coefficient=c) for t, c in zip(model.operator.terms, coefficients, strict=True))
    return replace(model, operator=replace(model.operator, terms=terms))


def kelvin_voigt_like(coefficient: Coefficient, omega: float) -> Coefficient:
    """A spring and dashpot of the same size at ``omega`` [rad/s]; a polynomial as it is."""
    if is_polynomial(coefficient):
        return coefficient
    value = complex(coefficient.at(np.array(omega)))
    return Polynomial(max(value.real, 0.0), value.imag / omega)


def _estimate(reduced: ReducedModel, strong: BoolArray, draw: Coefficients, f: float, model: ForearmModel) -> float:
    """Change of the watched compliances at ``f`` [Hz] by the columns that are not ``strong``."""
    whole, one = replace(reduced, coefficients=draw), np.array([f])
    return _watched_change(part_of(whole, strong).compliance(one), whole.compliance(one), model)


def _watched_change(estimate: ComplexArray, truth: ComplexArray, model: ForearmModel) -> float:
    block = np.ix_([0], *watched(model))
    return float(relative_error(estimate[block], truth[block])[0])


def part_of(reduced: ReducedModel, kept: BoolArray) -> ReducedModel:
    """The model on some columns of its space alone; it cannot be extended or drawn, only asked for compliances."""
    chosen = np.flatnonzero(kept)
    return replace(
        reduced,
        matrices=reduced.matrices[:, chosen[:, None], chosen],
        functionals=reduced.functionals[chosen],
        low=np.zeros((len(chosen), 0)),
        coupling=np.zeros((0, 0)),
    )


def _compressed(
    reduced: ReducedModel, early: BoolArray, draws: Sequence[Coefficients], places: Sequence[Place], drop: float
) -> tuple[ReducedModel, int]:
    """The model on the principal directions of its states at the ``places``: first those of its ``early`` columns
    alone, whose number is the second result, then what the states of all columns add to these."""
    chosen, start = np.flatnonzero(early), part_of(reduced, early)
    first = np.zeros((reduced.size, 0))
    if len(chosen):
        inside = _principal(_states(start, draws, places), drop)
        first = np.zeros((reduced.size, inside.shape[1]))
        first[chosen] = inside
    states = _states(reduced, draws, places)
    second = _principal(states - first @ (first.T @ states), drop * float(np.linalg.norm(states, 2)), relative=False)
    return reduced.projected(np.linalg.qr(np.hstack([first, second]))[0]), first.shape[1]


def _states(reduced: ReducedModel, draws: Sequence[Coefficients], places: Sequence[Place]) -> FloatArray:
    """Real and imaginary parts of states (r, k), each state of unit length."""
    columns = list[FloatArray]()
    for draw, f in places:
        states = replace(reduced, coefficients=draws[draw]).states(np.array([f]))[0]
        states = states / np.linalg.norm(states, axis=0)
        columns += [states.real, states.imag]
    return np.hstack(columns)


def _principal(columns: FloatArray, drop: float, *, relative: bool = True) -> FloatArray:
    """Left singular vectors above ``drop``, of the largest value where ``relative``."""
    left, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, values > (drop * values[0] if relative else drop)])
