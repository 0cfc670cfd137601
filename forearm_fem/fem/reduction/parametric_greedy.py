"""Greedy sampling of one reduced space for many tissues and frequencies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_array

from ...progress import Progress, tell
from ...scenario.sweep import SolverOptions
from ...store.shelf import Shelf
from ...transfer import relative_error
from ...typing import ComplexArray, FloatArray
from ..assembly.coefficients import Coefficient, kelvin_voigt_like
from ..assembly.model import ForearmModel
from ..linear.direct import DirectSolver, make_solver, watched
from .affine import AffineReduced, with_last_columns
from .basis import Basis, real_columns, rough_extension
from .expansion import expansion_rate
from .per_query_basis import quick_compliance, quick_state, with_and_without
from .rate_space import RateSpace

# The space as it grows, and what of it is kept between calls.

Coefficients = tuple[Coefficient, ...]  # one of each term: what a draw is to the operator
Sample = tuple[int, float]  # a draw's number and a frequency [Hz]
_POINTS = 0.1  # what a point's state counts beside a contact's: errors of G are products of the two
_DROP = 1e-2  # of a solution's length: the error of C is the product of two of these


@dataclass(frozen=True)
class TrialSolve:
    """The model's ``estimated`` and ``true`` e(f) at a place that it had not seen: a draw's number and a frequency."""

    kind: ClassVar[str] = "trial solve"
    version: ClassVar[int] = 1

    draw: int
    frequency: float
    estimated: float
    true: float


class Growing:
    """The space for ``model`` and ``draws`` of its coefficients as it grows.

    ``steps`` says how often it has grown. Blocks of its columns are ``strong`` (all but the highest derivatives), on
    which it is looked at to choose the next solve, and ``early`` where the estimate's core is made from them.
    ``readings`` (k, n_u) of places that are no ports are kept with the compressed models.
    """

    def __init__(
        self,
        model: ForearmModel,
        draws: Sequence[Coefficients],
        options: SolverOptions,
        highest: float,
        kept: Shelf,
        readings: csr_array | None = None,
    ) -> None:
        self._model, self._draws, self._options, self._highest = model, draws, options, highest
        self._readings = csr_array((0, model.operator.n_displacements)) if readings is None else readings
        self._kept, self._ready = kept, None
        self.reduced, self.trials, self.steps = AffineReduced.of(model), [], 0
        self._strong, self._early = np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)

    _ready: DirectSolver | None
    trials: list[TrialSolve]

    def restored(self) -> None:
        """Go on from what was kept; from nothing where some of it is missing or damaged."""
        if (found := self.reduced.restored(self._kept)) is None:
            return
        self.reduced, space = found
        self._strong, self._early, self.steps = space["strong"], space["early"], len(self.reduced.basis.blocks)
        self.trials = [TrialSolve(int(d), f, e, t) for d, f, e, t in space["trials"].tolist()]

    def start(self, frequency: FloatArray, derivatives: int) -> None:
        """Derivatives about a rate, where moduli that are no polynomials of it are replaced by Kelvin-Voigt ones."""
        rate = expansion_rate(frequency, upwards=0.5)  # some draws are softer
        own = [kelvin_voigt_like(t.coefficient, rate) for t in self._model.operator.terms]
        chunk = RateSpace(self._of(tuple(own)), self._model.functionals, rate).more(derivatives)
        half = chunk.columns.shape[1] // 2
        whole = chunk.columns.astype(float, copy=False)
        self._added([whole[:, :half], whole[:, half:]], [True, False], early=True)

    def unsolved(self) -> list[int]:
        """Draws that have not been solved; all once there is no other."""
        solved = {t.draw for t in self.trials}
        return [d for d in range(len(self._draws)) if d not in solved] or list(range(len(self._draws)))

    def greedy_step(self, places: Sequence[Sample], of_contacts: int, of_points: int, *, early: bool) -> None:
        """The trial at the place with the largest estimate, whose solution then belongs to the space, with so many
        derivatives by frequency."""
        found = []
        for number, f in places:
            drawn = replace(self.reduced, coefficients=self._draws[number])
            whole, less = with_and_without(drawn, self._strong, f)
            found.append((self._difference(less, whole), whole))
        draw, f = places[int(np.argmax([change for change, _ in found]))]
        estimated, whole = max(found, key=lambda pair: pair[0])
        solver, ports = self._of(self._draws[draw]), range(len(self._model.ports))
        solution = np.asarray(solver.at(f).values)
        truth = (self._model.functionals.T @ solution) * self._model.shares
        self.trials = [*self.trials, TrialSolve(draw, f, estimated, self._difference(whole, truth))]
        orders = np.where(np.isin(ports, watched(self._model)[1]), of_contacts, min(of_points, of_contacts))
        series = solver.taylor(f, solution, orders)
        strong = [k < of_contacts or not of_contacts for k in range(len(series))]
        self._added([real_columns([columns]) for columns in series], strong, early)

    def errors(self, whole: ComplexArray, core: ComplexArray, place: Sample) -> tuple[float, float]:
        """Estimated and true e(f) of compliances (n_port, n_port) that a model and its core have for a place."""
        rows, columns = watched(self._model)
        solution = self._of(self._draws[place[0]]).at(place[1], columns).values
        truth = (self._model.functionals[:, rows].T @ solution) * self._model.shares[columns]
        block = np.ix_(rows, columns)
        true = float(relative_error(whole[block][None], np.asarray(truth, dtype=complex)[None])[0])
        return self._difference(core, whole), true

    def states(self, places: Sequence[Sample]) -> list[ComplexArray]:
        """Reduced solutions (r, n_port) at each place."""
        drawn = (replace(self.reduced, coefficients=self._draws[draw]) for draw, _ in places)
        return [np.asarray(quick_state(reduced, f)) for reduced, (_, f) in zip(drawn, places, strict=True)]

    def compressed(self, shaping: Sequence[ComplexArray], most: int) -> AffineReduced:
        """The model on at most so many principal directions of the states ``shaping`` (r, n_port) it."""
        return self._read().bare().projected(self._principal(shaping)[:, :most])

    def core(self, shaping: Sequence[ComplexArray], most: int) -> AffineReduced:
        """The same from the early columns alone, in which the states are as far as these hold them."""
        chosen = np.flatnonzero(self._early)
        directions = self._principal([x[chosen] for x in shaping])[:, :most]
        return self._read().part(self._early).projected(directions)

    def misfit(self, small: AffineReduced, places: Sequence[Sample], states: Sequence[ComplexArray]) -> float:
        """Root of the mean square of e(f) of a smaller model at ``places``, against the ``states`` of this one."""
        drawn = [quick_compliance(replace(small, coefficients=self._draws[d]), np.array([f]))[0] for d, f in places]
        truth = [(self.reduced.functionals.T @ x) * self._model.shares for x in states]
        return float(np.sqrt(np.mean([self._difference(*pair) ** 2 for pair in zip(drawn, truth, strict=True)])))

    def release(self) -> None:
        """Give the factor's memory back."""
        if self._ready is not None:
            self._ready.factor.release()

    def _read(self) -> AffineReduced:
        """The model with what the readings see of its columns."""
        if len(self.reduced.places) < self.reduced.size:
            used = np.unique(self._readings.indices)
            few = csr_array(self._readings[:, used])
            seen = Basis(tuple(block[used] for block in self.reduced.basis.blocks)).seen_by(few)
            self.reduced = replace(self.reduced, places=np.asarray(seen.T, dtype=float))
        return self.reduced

    def _principal(self, states: Sequence[ComplexArray]) -> FloatArray:
        """Directions (r, k), strongest first, of states of unit length; a point's count less than a contact's."""
        contact = np.array([p.kind == "contact" for p in self._model.ports])
        weights = np.where(contact | (not contact.any()), 1.0, _POINTS)
        scaled = [x * (weights / np.linalg.norm(x, axis=0)) for x in states]
        columns = np.hstack([part for x in scaled for part in (x.real, x.imag)])
        return np.asarray(np.linalg.eigh(columns @ columns.T)[1][:, ::-1])

    def _difference(self, estimate: ComplexArray, truth: ComplexArray) -> float:
        """e(f) of the watched entries."""
        block = np.ix_(*watched(self._model))
        return float(relative_error(estimate[block][None], truth[block][None])[0])

    def _added(self, blocks: Sequence[FloatArray], strong: Sequence[bool], early: bool) -> None:
        """One step: what all ``blocks`` (n, k) add, which of them are ``strong``."""
        new = rough_extension(self.reduced.basis, blocks, self._model.operator.n_displacements, drop=_DROP)
        columns = np.hstack(new)
        self.reduced = with_last_columns(self.reduced, self._model, columns)
        marks = [np.full(block.shape[1], s) for block, s in zip(new, strong, strict=True)]
        self._strong = np.concatenate([self._strong, *marks])
        self._early = np.append(self._early, np.full(columns.shape[1], early))
        self.steps += 1
        trials = np.array([astuple(t) for t in self.trials], dtype=float).reshape(-1, 4)
        self.reduced.keep(self._kept, strong=self._strong, early=self._early, trials=trials)

    def _of(self, draw: Coefficients) -> DirectSolver:
        if self._ready is None:
            self._ready = make_solver(self._model, self._options, self._highest)
        operator = self._model.operator
        terms = tuple(replace(t, coefficient=c) for t, c in zip(operator.terms, draw, strict=True))
        return replace(self._ready, model=replace(self._model, operator=replace(operator, terms=terms)))


# One reduced space for many tissues: solutions for several coefficients of the same terms, taken where it errs most.
# The terms' matrices do not depend on moduli or tension, so a space that holds solutions for several of these serves
# all between them. It starts from derivatives about a real rate for the model's own ones. Then, over and over, the
# place (draw and frequency) where the model changes most without its highest derivatives is solved directly. That gives
# a true error there, and the solution with its derivatives extends the space. At the end each part of the band gets a
# model of its own, on the principal directions of what the draws do there (decision 0038).

_STAGE = "arms solved"
_LOOKED_AT = 24  # places among which the next solve is chosen; each costs two small dense solves
_THIRDS = 3  # of the band, equally many bins each
_LOW = 6  # the band's low end is this part of it, in the root of the frequency
_AT_LOW = 2  # solves there at most
_LOW_ORDER = 2  # derivatives of solves there, where solutions hardly change with frequency
_FEW = 8  # bins below which a band is not cut
_TESTED = 12  # states of each part that size its model and do not shape it
_CORE = 0.7  # of the whole model's directions
_STEP = 1.25  # ratio of the sizes tried
_LEAST = 40  # directions


@dataclass(frozen=True, eq=False)
class Piece:
    """The models of a part of the band, up to ``high`` [Hz]: the ``whole`` one, and the ``core``, of fewer directions,
    in which a third of the solves had no part. What an answer changes between them is the estimate of its error."""

    kind: ClassVar[str] = "piece of a parametric model"
    version: ClassVar[int] = 1

    high: float
    whole: AffineReduced
    core: AffineReduced

    def change(self, draw: Coefficients, frequency: float) -> tuple[ComplexArray, ComplexArray]:
        """Compliances (n_port, n_port) of the whole and of the core for a draw."""
        one = np.array([frequency])
        whole, core = (quick_compliance(replace(m, coefficients=draw), one)[0] for m in (self.whole, self.core))
        return whole, core


@dataclass(frozen=True)
class Growth:
    """Effort put into a model.

    It starts from so many derivatives about a ``rate``. Direct ``solves`` extend the space, each with derivatives by
    frequency, ``of_contacts`` and ``of_points``; ``checks`` follow. The band is cut into ``parts``, equal in the root
    of the frequency, whose models are made from ``states`` (of draws at frequencies) each: as many directions as err
    by ``tolerance`` (rms over the draws) beside the space, but ``most``.
    """

    rate: int = 20
    solves: int = 7
    checks: int = 3
    of_contacts: int = 4
    of_points: int = 3
    parts: int = 4
    states: int = 60
    tolerance: float = 4e-3
    most: int = 700
    seed: int = 1


def united_model(
    model: ForearmModel,
    draws: Sequence[Coefficients],
    frequency: FloatArray,
    options: SolverOptions,
    growth: Growth,
    kept: Shelf,
    progress: Progress | None = None,
    readings: csr_array | None = None,
) -> tuple[tuple[Piece, ...], tuple[TrialSolve, ...], tuple[TrialSolve, ...]]:
    """Pieces, from the low to the high end of the band of ``frequency`` (n,) [Hz], of a space for the model's own
    coefficients and those of the ``draws``; trials, which then extended it, and checks, which did not.

    All draws serve for choosing where to solve and for compression, random ones for checks. What is ``kept`` of an
    interrupted call of the same arguments is not made again. ``readings`` (k, n_u) of places that are no ports are
    worked out for each piece's models.
    """
    work = Growing(model, draws, options, float(frequency[-1]), kept, readings)
    work.restored()
    parts = cut(frequency, growth.parts)
    places = _places(np.random.default_rng([growth.seed, 2]), len(draws), frequency, growth.checks)
    pieces = [kept.record(f"piece-{k}", Piece) for k in range(len(parts))]
    checks = [kept.record(f"check-{i}", TrialSolve) for i in range(len(places))]
    done, total = 0, 1 + growth.solves - work.steps + sum(x is None for x in (*pieces, *checks))

    def step() -> None:
        """Tell that one more is done."""
        nonlocal done
        done += 1
        tell(progress, _STAGE, done, total)

    tell(progress, _STAGE, 0, total)  # of what is left, so that the time left is told from what was done now
    for i in range(work.steps, 1 + growth.solves):
        _grow(work, i, frequency, growth)
        step()
    whole = list[Piece]()
    for k, (part, piece) in enumerate(zip(parts, pieces, strict=True)):
        whole.append(piece or _made_piece(work, k, part, len(draws), growth))
        if piece is None:
            kept.keep(f"piece-{k}", whole[-1])
            step()
    compared = list[TrialSolve]()
    for i, (place, check) in enumerate(zip(places, checks, strict=True)):
        compared.append(check or _made_check(work, place, piece_at(whole, place[1]), draws))
        if check is None:
            kept.keep(f"check-{i}", compared[-1])
            step()
    work.release()
    return tuple(whole), tuple(work.trials), tuple(compared)


def _grow(work: Growing, step: int, frequency: FloatArray, growth: Growth) -> None:
    """Derivatives about a rate first. Then two solves in the upper two thirds of the band in turn, where waves are
    short, and one at its low end, where the ratios of moduli shape what moves and derivatives show none of it; two
    such are enough."""
    if step == 0:
        work.start(frequency, growth.rate)
        return
    place, early = step - 1, step <= growth.solves - max(1, growth.solves // 3)
    rng, fresh = np.random.default_rng([growth.seed, 0, place]), work.unsolved()
    low_ones = min(place // _THIRDS, _AT_LOW)
    if place % _THIRDS == _THIRDS - 1 and low_ones < _AT_LOW:
        end = np.sqrt(frequency[[0, -1]]) @ [1 - 1 / _LOW, 1 / _LOW]
        part, most = frequency[np.sqrt(frequency) <= end], _LOW_ORDER
    else:
        thirds, turn = np.array_split(frequency, min(_THIRDS, len(frequency))), place - low_ones
        part, most = thirds[-1 - turn % 2 % len(thirds)], growth.of_contacts
    places = [(fresh[d], f) for d, f in _places(rng, len(fresh), part, _LOOKED_AT)]
    work.greedy_step(places, min(most, growth.of_contacts), min(most, growth.of_points), early=early)


def _made_piece(work: Growing, number: int, part: FloatArray, draws: int, growth: Growth) -> Piece:
    """The models of a ``part`` (n,) [Hz] of the band, of as few directions as serve some of the states, which had no
    part in them."""
    rng = np.random.default_rng([growth.seed, 1, number])
    places = _places(rng, draws, part, growth.states + _TESTED)
    states = work.states(places)
    tested, shaping = states[:_TESTED], states[_TESTED:]
    largest = work.compressed(shaping, growth.most)
    size = min(_LEAST, largest.size)
    while size < largest.size:
        if work.misfit(largest.part(slice(size)), places[:_TESTED], tested) <= growth.tolerance:
            break
        size = min(largest.size, round(_STEP * size))
    core = work.core(shaping[: growth.states // 2], max(_LEAST // 2, round(_CORE * size)))
    return Piece(float(part[-1]), largest.part(slice(size)), core)


def _made_check(work: Growing, place: Sample, piece: Piece, draws: Sequence[Coefficients]) -> TrialSolve:
    """Answer of a finished ``piece`` at a place, against a direct solution."""
    whole, core = piece.change(draws[place[0]], place[1])
    return TrialSolve(*place, *work.errors(whole, core, place))


def cut(frequency: FloatArray, parts: int) -> list[FloatArray]:
    """The band of ``frequency`` (n,) [Hz], rising, in so many parts, equal in the root of the frequency."""
    if len(frequency) < _FEW * parts:
        return [frequency]
    ends = np.linspace(np.sqrt(frequency[0]), np.sqrt(frequency[-1]), parts + 1)[1:-1] ** 2
    return [p for p in np.split(frequency, np.searchsorted(frequency, ends)) if len(p)]


def piece_at(pieces: Sequence[Piece], frequency: float) -> Piece:
    """The piece whose part of the band holds ``frequency`` [Hz]; the last one beyond."""
    return next((p for p in pieces if frequency <= p.high), pieces[-1])


def _places(rng: np.random.Generator, draws: int, frequency: FloatArray, count: int) -> list[Sample]:
    """Random draws, each as often as the others, at bins that are dense in the square root of the frequency."""
    order = np.concatenate([rng.permutation(draws) for _ in range(1 + count // draws)])[:count]
    wanted = rng.uniform(np.sqrt(frequency[0]), np.sqrt(frequency[-1]), count) ** 2
    return [(int(d), float(frequency[np.argmin(np.abs(frequency - f))])) for d, f in zip(order, wanted, strict=True)]
