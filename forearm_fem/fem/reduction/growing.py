"""The space of :mod:`.united` as it grows, and what of it is kept between calls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any, Protocol

import numpy as np
from scipy.sparse import csr_array

from ...scenario.sweep import SolverOptions
from ...transfer import relative_error
from ...typing import BoolArray, ComplexArray, FloatArray
from ..assembly.coefficients import Coefficient, Polynomial, is_polynomial
from ..assembly.model import ForearmModel
from ..linear.direct import DirectSolver, make_solver, watched
from .basis import Basis, real_columns, rough_extension
from .expansion import expansion_rate
from .quick import quick_compliance, quick_state, with_and_without
from .rate_space import RateSpace
from .reduced_model import ReducedModel, empty_model, with_last_columns

Coefficients = tuple[Coefficient, ...]  # one of each term: what a draw is to the operator
Place = tuple[int, float]  # a draw's number and a frequency [Hz]
_POINTS = 0.1  # what a point's state counts beside a contact's: errors of G are products of the two
_DROP = 1e-2  # of a solution's length: the error of C is the product of two of these
_SPACE = "space"


class PartStore(Protocol):
    """Where finished parts are kept by name, so that an interrupted call loses at most the one under way."""

    def get(self, name: str, /) -> Mapping[str, Any] | None:
        """The arrays of a part, or None where it is missing or damaged."""
        ...

    def put(self, name: str, parts: Mapping[str, Any], /) -> object:
        """Keep the arrays of a part."""
        ...


@dataclass(frozen=True)
class TrialSolve:
    """The model's ``estimated`` and ``true`` e(f) at a place that it had not seen: a draw's number and a frequency."""

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
        kept: PartStore,
        readings: csr_array | None = None,
    ) -> None:
        self._model, self._draws, self._options, self._highest = model, draws, options, highest
        self._readings = csr_array((0, model.operator.n_displacements)) if readings is None else readings
        self._kept, self._ready = kept, None
        self.reduced, self.trials, self.steps = empty_model(model), [], 0
        self._strong, self._early = np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)

    _ready: DirectSolver | None
    trials: list[TrialSolve]

    def restored(self) -> None:
        """Go on from what was kept; from nothing where some of it is missing or damaged."""
        space = self._kept.get(_SPACE)
        if space is None:
            return
        blocks = [self._kept.get(f"columns-{k}") for k in range(int(space["steps"]))]
        columns = [b["columns"] for b in blocks if b is not None]
        if len(columns) < len(blocks) or sum(c.shape[1] for c in columns) != len(space["functionals"]):
            return
        nothing = np.zeros((len(space["functionals"]), 0))
        self.reduced = replace(
            self.reduced, matrices=space["matrices"], functionals=space["functionals"], coupling=space["coupling"],
            basis=Basis(tuple(columns)), low=nothing,
        )  # fmt: skip
        self._strong, self._early, self.steps = space["strong"], space["early"], len(columns)
        self.trials = [TrialSolve(int(d), f, e, t) for d, f, e, t in space["trials"].tolist()]

    def start(self, frequency: FloatArray, derivatives: int) -> None:
        """Derivatives about a rate, where moduli that are no polynomials of it are replaced by Kelvin-Voigt ones."""
        rate = expansion_rate(frequency)
        own = [kelvin_voigt_like(t.coefficient, rate) for t in self._model.operator.terms]
        chunk = RateSpace(self._of(tuple(own)), self._model.functionals, rate).more(derivatives)
        half = chunk.columns.shape[1] // 2
        whole = chunk.columns.astype(float, copy=False)
        self._added([whole[:, :half], whole[:, half:]], [True, False], early=True)

    def unsolved(self) -> list[int]:
        """Draws that have not been solved; all once there is no other."""
        solved = {t.draw for t in self.trials}
        return [d for d in range(len(self._draws)) if d not in solved] or list(range(len(self._draws)))

    def extended_where_worst(self, places: Sequence[Place], of_contacts: int, of_points: int, *, early: bool) -> None:
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

    def errors(self, whole: ComplexArray, core: ComplexArray, place: Place) -> tuple[float, float]:
        """Estimated and true e(f) of compliances (n_port, n_port) that a model and its core have for a place."""
        rows, columns = watched(self._model)
        solution = self._of(self._draws[place[0]]).at(place[1], columns).values
        truth = (self._model.functionals[:, rows].T @ solution) * self._model.shares[columns]
        block = np.ix_(rows, columns)
        true = float(relative_error(whole[block][None], np.asarray(truth, dtype=complex)[None])[0])
        return self._difference(core, whole), true

    def states(self, places: Sequence[Place]) -> list[ComplexArray]:
        """Reduced solutions (r, n_port) at each place."""
        drawn = (replace(self.reduced, coefficients=self._draws[draw]) for draw, _ in places)
        return [np.asarray(quick_state(reduced, f)) for reduced, (_, f) in zip(drawn, places, strict=True)]

    def compressed(self, shaping: Sequence[ComplexArray], most: int) -> ReducedModel:
        """The model on at most so many principal directions of the states ``shaping`` (r, n_port) it."""
        return on_directions(self._read(), self._principal(shaping)[:, :most])

    def core(self, shaping: Sequence[ComplexArray], most: int) -> ReducedModel:
        """The same from the early columns alone, in which the states are as far as these hold them."""
        chosen = np.flatnonzero(self._early)
        directions = self._principal([x[chosen] for x in shaping])[:, :most]
        return on_directions(part_of(self._read(), self._early), directions)

    def misfit(self, small: ReducedModel, places: Sequence[Place], states: Sequence[ComplexArray]) -> float:
        """Root of the mean square of e(f) of a smaller model at ``places``, against the ``states`` of this one."""
        drawn = [quick_compliance(replace(small, coefficients=self._draws[d]), np.array([f]))[0] for d, f in places]
        truth = [(self.reduced.functionals.T @ x) * self._model.shares for x in states]
        return float(np.sqrt(np.mean([self._difference(*pair) ** 2 for pair in zip(drawn, truth, strict=True)])))

    def release(self) -> None:
        """Give the factor's memory back."""
        if self._ready is not None:
            self._ready.factor.release()

    def _read(self) -> ReducedModel:
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
        self._kept.put(f"columns-{self.steps}", {"columns": columns})
        self.steps += 1
        trials = np.array([astuple(t) for t in self.trials], dtype=float).reshape(-1, 4)
        self._kept.put(_SPACE, {
            "steps": self.steps, "strong": self._strong, "early": self._early, "trials": trials,
            **{name: getattr(self.reduced, name) for name in ("matrices", "functionals", "coupling")},
        })  # fmt: skip

    def _of(self, draw: Coefficients) -> DirectSolver:
        if self._ready is None:
            self._ready = make_solver(self._model, self._options, self._highest)
        operator = self._model.operator
        terms = tuple(replace(t, coefficient=c) for t, c in zip(operator.terms, draw, strict=True))
        return replace(self._ready, model=replace(self._model, operator=replace(operator, terms=terms)))


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
        places=reduced.places[chosen],
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
        places=directions.T @ reduced.places,
        basis=Basis(),
        low=np.zeros((s, 0)),
        coupling=np.zeros((0, 0)),
    )
