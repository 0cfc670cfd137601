"""One reduced space for many tissues: solutions for several coefficients of the same terms, taken where it errs most.

The terms' matrices do not depend on moduli or tension, so a space that holds solutions for several of these serves all
between them. It starts from derivatives about a real rate for the model's own ones. Then, over and over, the place
(draw and frequency) where the model changes most without its highest derivatives is solved directly. That gives a true
error there, and the solution with its derivatives extends the space. At the end each part of the band gets a model of
its own, on the principal directions of what the draws do there (docs/decisions/0038-parametric-model.md).
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
from .basis import Basis, Columns, orthonormal_extension, real_columns
from .expansion import expansion_rate
from .quick import quick_compliance, quick_state, with_and_without
from .rate_space import RateSpace
from .reduced_model import ReducedModel, empty_model, with_last_columns

Coefficients = tuple[Coefficient, ...]  # one of each term: what a draw is to the operator
_DERIVATIVES, _AT_ONCE = 20, 5  # about the rate, for the middle draw
_LOOKED_AT = 12  # places among which the next solve is chosen; each costs two small dense solves
_TURNS = 3  # parts of the band, equally many bins each, in which solves are placed in turn
_FEW = 8  # bins below which a band is not cut
_TESTED = 12  # states of each part that size its model and do not shape it
_POINTS = 0.1  # what a point's state counts beside a contact's: errors of G are products of the two
_CORE = 0.8  # of the whole model's directions
_STEP = 1.25  # ratio of the sizes tried
_LEAST = 40  # directions
_DROP = 1e-3  # of a solution's length: the error of C is the product of two of these


@dataclass(frozen=True)
class TrialSolve:
    """The model's ``estimated`` and ``true`` e(f) at a place that it had not seen: a draw's number and a frequency."""

    draw: int
    frequency: float
    estimated: float
    true: float


@dataclass(frozen=True)
class Piece:
    """The models of a part of the band, up to ``high`` [Hz]: the ``whole`` one, and the ``core``, of fewer directions,
    in which a third of the solves had no part. What an answer changes between them is the estimate of its error."""

    high: float
    whole: ReducedModel
    core: ReducedModel

    def change(self, draw: Coefficients, frequency: float) -> tuple[ComplexArray, ComplexArray]:
        """Compliances (n_port, n_port) of the whole and of the core for a draw."""
        one = np.array([frequency])
        both = (quick_compliance(replace(m, coefficients=draw), one)[0] for m in (self.whole, self.core))
        whole, core = both
        return whole, core


@dataclass(frozen=True)
class United:
    """A reduced model for many coefficients, in ``pieces`` from the low to the high end of the band.

    ``trials`` were compared while the space grew and then extended it; ``checks`` afterwards, and did not. ``solves``
    counts the factorisations.
    """

    pieces: tuple[Piece, ...]
    trials: tuple[TrialSolve, ...]
    checks: tuple[TrialSolve, ...]
    solves: int


@dataclass(frozen=True)
class Growth:
    """How much work is put into a model.

    Direct ``solves`` extend the space, each with so many ``derivatives`` by frequency; ``checks`` follow. The band is
    cut into ``parts``, equal in the root of the frequency, whose models are made from ``states`` (of draws at
    frequencies) each: as many directions as err by ``tolerance`` (rms over the draws) beside the space, but ``most``.
    """

    solves: int = 11
    checks: int = 6
    derivatives: int = 4
    parts: int = 4
    states: int = 90
    tolerance: float = 4e-3
    most: int = 700
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
    stage, total = "draws solved", growth.solves + growth.checks
    work.start(frequency, progress)
    tell(progress, stage, 0, total)
    turns = np.array_split(frequency, min(_TURNS, len(frequency)))
    trials = list[TrialSolve]()
    for i in range(growth.solves):  # each part of the band in turn, as errors are largest where waves are short
        early = i // _TURNS % 3 != 2
        fresh = work.unsolved()
        places = [(fresh[d], f) for d, f in _places(rng, len(fresh), turns[-1 - i % len(turns)], _LOOKED_AT)]
        trials.append(work.extended_where_worst(places, early, growth.derivatives))
        tell(progress, stage, i + 1, total)
    parts = cut(frequency, growth.parts)
    pieces = list[Piece]()
    tell(progress, "states gathered", 0, len(parts))
    for part in parts:
        pieces.append(work.piece(part, rng, growth))
        tell(progress, "states gathered", len(pieces), len(parts))
    checks = list[TrialSolve]()
    for i, place in enumerate(_places(rng, len(draws), frequency, growth.checks)):
        checks.append(work.checked(piece_at(pieces, place[1]), place))
        tell(progress, stage, growth.solves + i + 1, total)
    work.release()
    return United(tuple(pieces), tuple(trials), tuple(checks), total + 1)


def cut(frequency: FloatArray, parts: int) -> list[FloatArray]:
    """The band of ``frequency`` (n,) [Hz], rising, in so many parts, equal in the root of the frequency."""
    if len(frequency) < _FEW * parts:
        return [frequency]
    ends = np.linspace(np.sqrt(frequency[0]), np.sqrt(frequency[-1]), parts + 1)[1:-1] ** 2
    return [p for p in np.split(frequency, np.searchsorted(frequency, ends)) if len(p)]


def piece_at(pieces: Sequence[Piece], frequency: float) -> Piece:
    """The piece whose part of the band holds ``frequency`` [Hz]; the last one beyond."""
    return next((p for p in pieces if frequency <= p.high), pieces[-1])


Place = tuple[int, float]


def _places(rng: np.random.Generator, draws: int, frequency: FloatArray, count: int) -> list[Place]:
    """Random draws, each as often as the others, at bins that are dense in the square root of the frequency."""
    order = np.concatenate([rng.permutation(draws) for _ in range(-(-count // draws))])[:count]
    wanted = rng.uniform(np.sqrt(frequency[0]), np.sqrt(frequency[-1]), count) ** 2
    return [(int(d), float(frequency[np.argmin(np.abs(frequency - f))])) for d, f in zip(order, wanted, strict=True)]


class _Growing:
    """The space as it grows.

    ``strong`` marks columns but the highest derivatives, on which it is looked at to choose the next solve, ``early``
    those that the estimate's core is made from.
    """

    def __init__(self, model: ForearmModel, draws: Sequence[Coefficients], solver: DirectSolver) -> None:
        self._model, self._draws, self._solver = model, draws, solver
        self.reduced, self._strong, self._early = empty_model(model), np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)
        self._solved = set[int]()

    def start(self, frequency: FloatArray, progress: Progress | None = None) -> None:
        """Derivatives about a rate, where moduli that are no polynomials of it are replaced by Kelvin-Voigt ones."""
        rate = expansion_rate(frequency)
        own = [kelvin_voigt_like(t.coefficient, rate) for t in self._model.operator.terms]
        space = RateSpace(self._of(tuple(own)), self._model.functionals, rate)
        tell(progress, "derivatives", 0, _DERIVATIVES)
        for done in range(0, _DERIVATIVES, _AT_ONCE):
            self._added(space.more(_AT_ONCE).columns, done < _DERIVATIVES // 2, early=True)
            tell(progress, "derivatives", done + _AT_ONCE, _DERIVATIVES)

    def unsolved(self) -> list[int]:
        """Draws that have not been solved; all once there is no other."""
        return [d for d in range(len(self._draws)) if d not in self._solved] or list(range(len(self._draws)))

    def extended_where_worst(self, places: Sequence[Place], early: bool, derivatives: int) -> TrialSolve:
        """The trial at the place with the largest estimate, whose solution then belongs to the space."""
        found = [self._change_at(p) for p in places]
        draw, f = places[int(np.argmax([change for change, _ in found]))]
        estimated, whole = max(found, key=lambda pair: pair[0])
        solution = self._solution((draw, f))
        trial = TrialSolve(draw, f, estimated, self._difference(whole, self._compliance(solution)))
        orders = np.full(len(self._model.ports), derivatives)
        series = self._of(self._draws[draw]).taylor(f, solution, orders)
        for k, columns in enumerate(series):
            self._added(real_columns([columns]), k < derivatives or not derivatives, early)
        self._solved.add(draw)
        return trial

    def checked(self, piece: Piece, place: Place) -> TrialSolve:
        """What a finished ``piece`` says at a place, against a direct solution."""
        whole, core = piece.change(self._draws[place[0]], place[1])
        truth = self._compliance(self._solution(place))
        return TrialSolve(*place, self._difference(core, whole), self._difference(whole, truth))

    def piece(self, part: FloatArray, rng: np.random.Generator, growth: Growth) -> Piece:
        """The models of a ``part`` (n,) [Hz] of the band."""
        places = _places(rng, len(self._draws), part, growth.states + _TESTED)
        whole = self._compressed(self.reduced, places, growth)
        most = max(_LEAST // 2, round(_CORE * whole.size))
        start = part_of(self.reduced, self._early)
        shaping = self._states(start, places[_TESTED : _TESTED + growth.states // 2])
        return Piece(float(part[-1]), whole, on_directions(start, self._principal(shaping)[:, :most]))

    def release(self) -> None:
        """Give the factor's memory back."""
        self._solver.factor.release()

    def _compressed(self, reduced: ReducedModel, places: Sequence[Place], growth: Growth) -> ReducedModel:
        """``reduced`` on as few principal directions as serve the first of the ``places``, which had no part in
        them."""
        tested = [(p, reduced.functionals.T @ x) for p, x in self._states(reduced, places[:_TESTED])]
        directions = self._principal(self._states(reduced, places[_TESTED:]))
        largest = on_directions(reduced, directions[:, : growth.most])
        size = min(_LEAST, largest.size)
        while True:
            small = part_of(largest, np.arange(largest.size) < size)
            found = [self._difference(self._answer(small, p), c * self._model.shares) for p, c in tested]
            if size == largest.size or np.sqrt(np.mean(np.square(found))) <= growth.tolerance:
                return small
            size = min(largest.size, round(_STEP * size))

    def _states(self, reduced: ReducedModel, places: Sequence[Place]) -> list[tuple[Place, ComplexArray]]:
        return [(p, np.asarray(quick_state(replace(reduced, coefficients=self._draws[p[0]]), p[1]))) for p in places]

    def _principal(self, states: Sequence[tuple[Place, ComplexArray]]) -> FloatArray:
        """Directions (r, k), strongest first, of states of unit length; a point's count less than a contact's."""
        contact = np.array([p.kind == "contact" for p in self._model.ports])
        weights = np.where(contact | (not contact.any()), 1.0, _POINTS)
        scaled = [x * (weights / np.linalg.norm(x, axis=0)) for _, x in states]
        columns = np.hstack([part for x in scaled for part in (x.real, x.imag)])
        return np.asarray(np.linalg.eigh(columns @ columns.T)[1][:, ::-1])

    def _answer(self, reduced: ReducedModel, place: Place) -> ComplexArray:
        drawn = replace(reduced, coefficients=self._draws[place[0]])
        return np.asarray(quick_compliance(drawn, np.array([place[1]]))[0])

    def _change_at(self, place: Place) -> tuple[float, ComplexArray]:
        drawn = replace(self.reduced, coefficients=self._draws[place[0]])
        whole, less = with_and_without(drawn, self._strong, place[1])
        return self._difference(less, whole), whole

    def _solution(self, place: Place) -> ComplexArray:
        return np.asarray(self._of(self._draws[place[0]]).at(place[1]).values)

    def _compliance(self, solution: ComplexArray) -> ComplexArray:
        return np.asarray((self._model.functionals.T @ solution) * self._model.shares)

    def _difference(self, estimate: ComplexArray, truth: ComplexArray) -> float:
        """e(f) of the watched entries."""
        block = np.ix_(*watched(self._model))
        return float(relative_error(estimate[block][None], truth[block][None])[0])

    def _added(self, columns: Columns, strong: bool, early: bool) -> None:
        n_u, whole = self._model.operator.n_displacements, np.array(columns, dtype=float)
        new, _ = orthonormal_extension(self.reduced.basis, whole, [whole.shape[1]], n_u, drop=_DROP)
        self.reduced = with_last_columns(self.reduced, self._model, new.astype(np.float32))
        self._strong = np.append(self._strong, np.full(new.shape[1], strong))
        self._early = np.append(self._early, np.full(new.shape[1], early))

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


def on_directions(reduced: ReducedModel, directions: FloatArray) -> ReducedModel:
    """The model on orthonormal ``directions`` (r, s) of its space; it cannot be extended or drawn."""
    s = directions.shape[1]
    matrices = np.array([directions.T @ m @ directions for m in reduced.matrices])
    return replace(
        reduced,
        matrices=(matrices + matrices.swapaxes(1, 2)) / 2,
        functionals=directions.T @ reduced.functionals,
        basis=Basis(),
        low=np.zeros((s, 0)),
        coupling=np.zeros((0, 0)),
    )
