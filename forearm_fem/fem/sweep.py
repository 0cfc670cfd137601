"""The sweep: a greedy reduced model certified on direct solves, or a direct solve per frequency."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..errors import SolverError
from ..scenario.sweep import SolverOptions
from ..transfer import relative_error
from ..typing import BoolArray, ComplexArray, FloatArray, IntArray
from .compress import PoleResidue, compressed, pole_residue
from .factor import Factor, Solution, make_factor, refined_solve
from .model import ForearmModel
from .reduce import ReducedModel, empty_model, extend

_log = logging.getLogger("forearm_fem.fem")
_ENOUGH = 1e-7  # relative residual: its error in G is stated as that of the linear solve
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Certificate:
    """Error of the reduced model at a frequency where it was compared with a direct solve it had not used.

    ``change`` is the largest change of the model by one derivative, over the band; it was largest at ``frequency``,
    or next to largest where the model, of so many ``expansions``, had been compared there before.
    """

    frequency: float
    error: float
    change: float = 0.0
    expansions: int = 0

    @property
    def bound(self) -> float:
        """The error, or the change where that says that one true error cannot speak for the band."""
        return self.error if self.change <= _DOUBTFUL else max(self.error, self.change)


@dataclass(frozen=True)
class SweepResult:
    """Compliance (n_frequency, n_port, n_port) [m/N] and what certifies it.

    ``residual`` is the largest relative residual of any solve, ``solve_error`` the error of the compliance that it
    causes, relative to the largest watched entry: x_i . r_j, exact to first order as A is symmetric.
    """

    values: ComplexArray
    residual: float
    solve_error: float = 0.0
    reduced: ReducedModel | None = None
    expansions: tuple[float, ...] = ()
    certificates: tuple[Certificate, ...] = ()
    poles: PoleResidue | None = None
    compression: float = 0.0
    least: float = 0.0

    @property
    def reduction_error(self) -> float:
        """Error stated for the reduced model: its largest certificate, or the largest ever where that is in doubt.

        Certificates are of the whole space; what the second stage changes (``compression``) comes on top. Where
        resonances were hard to resolve it is ``least``, the tolerance, at least: few frequencies speak for many peaks.
        """
        last = self.certificates[-1]
        sure = last.change <= _DOUBTFUL
        speaking = [c.bound for c in self.certificates if not sure or c.expansions == last.expansions]
        return max(*speaking, self.least) + self.compression

    def states(self, frequency: FloatArray, ports: Sequence[int]) -> ComplexArray:
        """Reduced solutions (n_frequency, r, n_chosen) for a unit force on the chosen ``ports``, shares undone."""
        if self.poles is not None:
            return self.poles.states(frequency, ports)
        assert self.reduced is not None
        return np.asarray(self.reduced.states(frequency)[:, :, ports] * self.reduced.shares[ports])


@dataclass(frozen=True)
class DirectSolver:
    """One analysed factorisation, reused for every frequency.

    ``tolerance`` is the relative residual to refine to; where factors leave more than 1e-7 and ``safe`` is set, the
    factorisation is repeated with matching, and then in double precision.
    """

    model: ForearmModel
    factor: Factor
    tolerance: float = 1e-11
    safe: bool = False

    def at(self, frequency: float) -> Solution:
        """Solutions (n, n_port) for a unit force on each port; the factor stays for more right-hand sides."""
        data = self.model.operator.data(2 * np.pi * frequency)
        self.factor.factorise(data)
        return self._solve(data, self.model.functionals.astype(complex))

    def taylor(self, frequency: float, start: ComplexArray, orders: IntArray) -> list[ComplexArray]:
        """Taylor coefficients in omega of the solutions about ``frequency``; column i to order ``orders[i]``.

        Coefficient k has the columns with order k or more. A_0 x_k = - sum_j A_j x_(k-j) with the Taylor matrices A_j.
        Refined once: what is left enters the reduced model squared (see :mod:`.reduce`), but unrefined single
        precision gave it unstable poles. The refinement of one coefficient is solved together with the next one,
        because reading the factors is what a solve costs.
        """
        operator, omega = self.model.operator, 2 * np.pi * frequency
        matrix, slopes = operator.matrix(operator.data(omega)), operator.slopes(omega, int(orders.max()))
        terms = {j: (omega**j, slope) for j, slope in enumerate(slopes, start=1) if slope is not None}
        series, pending = [start], np.zeros((len(start), 0), dtype=complex)
        for k in range(1, int(orders.max()) + 1):
            right = np.zeros((len(start), int((orders >= k).sum())), dtype=complex)
            for j, (power, slope) in terms.items():
                if j <= k:
                    right -= power * slope.product(series[k - j][:, _going_on(orders, k - j, k)])
            x, correction = np.split(self.factor.solve(np.hstack([right, pending])), [right.shape[1]], axis=1)
            if pending.shape[1]:
                series[-1] = series[-1] + correction
            if pending.shape[1] and 1 in terms:  # x lacks what this changes: left to its own refinement
                right -= terms[1][0] * terms[1][1].product(correction[:, _going_on(orders, k - 1, k)])
            if self.factor.single:
                pending = right - matrix.product(x)
            series.append(x)
        if pending.shape[1]:
            series[-1] = series[-1] + self.factor.solve(pending)
        return series

    def _solve(self, data: ComplexArray, right: ComplexArray) -> Solution:
        matrix = self.model.operator.matrix(data)
        while self.safe:
            try:
                solution = refined_solve(self.factor, matrix, right, tolerance=self.tolerance)
                if solution.residual <= _ENOUGH:
                    return solution
            except SolverError as problem:
                _log.info("%s", problem)
            if not self.factor.harden():
                break
            how = "single precision with matching" if self.factor.single else "double precision"
            _log.warning("the factors were not accurate enough at this frequency; %s from here on", how)
        return refined_solve(self.factor, matrix, right, tolerance=self.tolerance)

    def solve_error(self, solution: Solution) -> float:
        """Error of the watched compliances caused by the residual, relative to the largest of them."""
        block = np.ix_(*_watched(self.model))
        change = np.abs(solution.values.T @ solution.rest)[block]
        return float(change.max() / np.abs(self.model.functionals.T @ solution.values)[block].max())

    def compliance(self, solution: Solution) -> ComplexArray:
        """Compliance (n_port, n_port) [m/N] from solutions."""
        return np.asarray((self.model.functionals.T @ solution.values) * self.model.shares)


def _going_on(orders: IntArray, before: int, k: int) -> BoolArray:
    """Which columns of coefficient ``before`` coefficient ``k`` has as well."""
    return np.asarray(orders[orders >= before] >= k)


def make_solver(model: ForearmModel, options: SolverOptions, frequency: float) -> DirectSolver:
    """Analyse the pattern once for all frequencies."""
    single = options.precision != "double"
    safe, omega = options.precision == "auto", 2 * np.pi * frequency
    zeros = (model.operator.data(omega)[model.operator.diagonal_positions] == 0).any()  # incompressible tissue
    factor = make_factor(model.operator, omega, options.backend, single=single, matching=bool(zeros) or not safe)
    return DirectSolver(model, factor, 1e-9 if single else 1e-11, safe)


def direct_sweep(
    model: ForearmModel, frequency: FloatArray, options: SolverOptions, *, progress: Progress | None = None
) -> SweepResult:
    """Factorise and solve at every frequency (n,) [Hz]."""
    solver = make_solver(model, options, float(frequency[-1]))
    values, residual, error = [], 0.0, 0.0
    for i, f in enumerate(frequency):
        solution = solver.at(float(f))
        values.append(solver.compliance(solution))
        residual, error = max(residual, solution.residual), max(error, solver.solve_error(solution))
        _tell(progress, "direct solves", i + 1, len(frequency))
    solver.factor.release()
    return SweepResult(np.array(values), residual, error)


@dataclass(frozen=True)
class Expansion:
    """Direct solutions at ``frequency`` with Taylor coefficients: ``series[k]`` (n, n_port or fewer) for order k."""

    frequency: float
    series: tuple[ComplexArray, ...]
    residual: float
    solve_error: float


class Snapshots(Protocol):
    """Where expansions are kept between runs, so that an interrupted sweep loses none that was finished."""

    def get(self, frequency: float) -> Expansion | None:
        """What was stored for a frequency, or None."""
        ...

    def put(self, expansion: Expansion) -> None:
        """Store an expansion for good."""
        ...


def reduced_sweep(
    model: ForearmModel,
    frequency: FloatArray,
    options: SolverOptions,
    *,
    tolerance: float | None = 1e-4,
    progress: Progress | None = None,
    snapshots: Snapshots | None = None,
) -> SweepResult:
    """Sweep by a reduced model expanded about few frequencies and certified between them.

    Expansion starts at :func:`expansion_frequencies`. Then the most doubtful frequency (:func:`doubt`) is solved
    directly: that true error certifies the model, and where it exceeds ``tolerance`` the solution and its derivatives
    extend it (at most ``max_expansions`` times in all; the certificates say what was reached). Where resonances were
    seen to be unresolved, :data:`_WARY` such frequencies in turn must pass. With ``tolerance`` None
    nothing is certified and no factorisation is spent on it. Raises SolverError where the stated error is above 0.5.
    """
    work = _Expander(model, options, snapshots)
    planned = expansion_frequencies(frequency, options)
    reduced, used = empty_model(model), list[Expansion]()
    for i, f in enumerate(planned):
        reduced = work.extended(reduced, used, f)
        _tell(progress, "expansion frequencies", i + 1, len(planned) + 1)
    certificates = list[Certificate]()
    while tolerance is not None:
        worst = _most_doubtful(model, reduced, frequency, used, certificates)
        if worst is None:
            break
        truth = work.direct(worst.frequency)
        certificates.append(_certify(reduced, model, truth.series[0], worst, len(used)))
        _tell(progress, "expansion frequencies", len(used) + 1, len(used) + 1)
        if certificates[-1].bound > tolerance and len(used) < options.max_expansions:
            reduced = work.extended(reduced, used, worst.frequency, truth)
        elif _enough(certificates):
            break
    work.release()
    result = _swept(model, reduced, frequency, used, certificates, tolerance)
    return result if tolerance is None else _usable(result)


def _enough(certificates: Sequence[Certificate]) -> bool:
    """Whether the model as it is now was compared at enough frequencies."""
    wary = any(c.change > _DOUBTFUL for c in certificates)
    return sum(c.expansions == certificates[-1].expansions for c in certificates) >= (_WARY if wary else 1)


def _usable(result: SweepResult) -> SweepResult:
    if result.certificates and result.reduction_error > _USELESS:
        raise SolverError(
            f"the reduced model of {len(result.expansions)} expansion frequencies may be wrong by "
            f"{result.reduction_error:.2g} times G: it does not resolve the resonances of this band; raise "
            "solver.max_expansions, narrow the band, or set solver.sweep = 'direct'"
        )
    return result


def _most_doubtful(
    model: ForearmModel,
    reduced: ReducedModel,
    frequency: FloatArray,
    used: Sequence[Expansion],
    certificates: Sequence[Certificate],
) -> Doubt | None:
    """Where to certify next; probed at every bin once resonances were seen to be unresolved."""
    known = [*(c.frequency for c in certificates), *(e.frequency for e in used)]
    wary = any(c.change > _DOUBTFUL for c in certificates)
    worst = doubt(model, reduced, frequency, known, wary=wary)
    if worst is not None and worst.change > _DOUBTFUL and not wary:
        return doubt(model, reduced, frequency, known, wary=True)
    return worst


def _swept(
    model: ForearmModel,
    reduced: ReducedModel,
    frequency: FloatArray,
    used: list[Expansion],
    certificates: list[Certificate],
    tolerance: float | None,
) -> SweepResult:
    wary = any(c.change > _DOUBTFUL for c in certificates)
    small, change = (reduced, 0.0) if wary else _second_stage(model, reduced, frequency, tolerance or _UNCERTIFIED)
    fast = pole_residue(small)
    return SweepResult(
        small.compliance(frequency) if fast is None else fast.compliance(frequency),
        max(e.residual for e in used),
        max(e.solve_error for e in used),
        small,
        tuple(e.frequency for e in used),
        tuple(certificates),
        fast,
        change,
        (tolerance or 0.0) if wary else 0.0,
    )


def _second_stage(
    model: ForearmModel, reduced: ReducedModel, frequency: FloatArray, tolerance: float
) -> tuple[ReducedModel, float]:
    """The compressed model and what that changes at the watched ports over the band; as it was where that is much."""
    small = compressed(reduced, frequency, drop=max(0.1 * tolerance, 1e-9))  # directions cost about their own size
    probes = probe_frequencies(frequency, ())[::2]
    block = np.ix_(range(len(probes)), *_watched(model))
    change = float(relative_error(small.compliance(probes)[block], reduced.compliance(probes)[block]).max())
    return (small, change) if change <= tolerance else (reduced, 0.0)


class _Expander:
    """Makes expansions, or takes them from the store; factorises only when it must."""

    def __init__(self, model: ForearmModel, options: SolverOptions, store: Snapshots | None) -> None:
        self._model, self._options, self._store = model, options, store
        self.orders = derivative_orders(model, options)
        self._solver: DirectSolver | None = None

    def direct(self, frequency: float) -> Expansion:
        """Direct solutions without derivatives, taken from a stored expansion where there is one."""
        if self._store is not None and (stored := self._store.get(frequency)) is not None:
            return stored
        solution = self._ready(frequency).at(frequency)
        error = self._ready(frequency).solve_error(solution)
        return Expansion(frequency, (solution.values,), solution.residual, error)

    def expand(self, frequency: float, start: Expansion | None = None) -> Expansion:
        """Solutions and derivatives; ``start`` are direct solutions whose factorisation is still held."""
        start = start or self.direct(frequency)
        if len(start.series) > self.orders.max():
            return start
        solver = self._ready(frequency)
        series = solver.taylor(frequency, start.series[0], self.orders)
        result = Expansion(frequency, tuple(series), start.residual, start.solve_error)
        if self._store is not None:
            self._store.put(result)
        return result

    def extended(
        self, reduced: ReducedModel, used: list[Expansion], frequency: float, start: Expansion | None = None
    ) -> ReducedModel:
        """``reduced`` with an expansion about ``frequency``, which is noted in ``used`` without its vectors."""
        expansion = self.expand(frequency, start)
        used.append(replace(expansion, series=()))
        return extend(reduced, self._model, expansion.series, self.orders)

    def release(self) -> None:
        """Give the factor's memory back."""
        if self._solver is not None:
            self._solver.factor.release()

    def _ready(self, frequency: float) -> DirectSolver:
        if self._solver is None:
            self._solver = make_solver(self._model, self._options, frequency)
        return self._solver


def derivative_orders(model: ForearmModel, options: SolverOptions) -> IntArray:
    """How many derivatives (n_port,) are kept of each port's solution: the watched forces' more than the others'."""
    orders = np.full(len(model.ports), min(options.point_derivatives, options.derivatives))
    orders[_watched(model)[1]] = options.derivatives
    return orders


_SPACING = 0.1  # expansions are equally far apart in this power of the frequency (docs/decisions.md)


def expansion_frequencies(frequency: FloatArray, options: SolverOptions) -> tuple[float, ...]:
    """Middles of equal parts of the band in f^0.1: denser where damping is low (docs/decisions.md)."""
    count = min(options.expansions, len(frequency))
    low, high = frequency[0] ** _SPACING, frequency[-1] ** _SPACING
    wanted = (low + (high - low) * (np.arange(count) + 0.5) / count) ** (1 / _SPACING)
    return tuple(sorted({float(frequency[np.argmin(np.abs(frequency - f))]) for f in wanted}))


def _certify(reduced: ReducedModel, model: ForearmModel, solutions: ComplexArray, at: Doubt, used: int) -> Certificate:
    """Error at the watched ports against direct solutions (n, n_port)."""
    block = np.ix_([0], *_watched(model))
    truth = ((model.functionals.T @ solutions) * model.shares)[None]
    estimate = reduced.compliance(np.array([at.frequency]))
    return Certificate(at.frequency, float(relative_error(estimate[block], truth[block])[0]), at.change, used)


_DOUBTFUL = 0.1  # a change by one derivative above this, anywhere, says that resonances are not resolved
_UNCERTIFIED = 1e-5  # what the second stage may cost where nothing else is known
_WARY = 4  # one of dozens of resonances may be met by luck: 3e-8 was stated where the truth was 3e-3
_USELESS = 0.5  # a stated error above this says that the model tells nothing
_PROBES, _MANY = 40, 1000


@dataclass(frozen=True)
class Doubt:
    """Where one derivative fewer changes the reduced model most, and by how much (relative to the largest entry)."""

    frequency: float
    change: float


def doubt(
    model: ForearmModel, reduced: ReducedModel, frequency: FloatArray, known: Sequence[float], *, wary: bool = False
) -> Doubt | None:
    """The most doubtful of the probed frequencies that are not ``known``; None if none is left.

    The change is the error of the model with one derivative fewer: an upper bound that finds the place of the largest
    error, and says where a model is no approximation at all yet. ``wary`` probes nearly every bin: where resonances
    were not resolved before, they may hide between few probes.
    """
    probes = probe_frequencies(frequency, known, wary=wary)
    if not len(probes):
        return None
    block = np.ix_(range(len(probes)), *_watched(model))
    change = relative_error(reduced.lower().compliance(probes)[block], reduced.compliance(probes)[block])
    worst = int(np.argmax(change))
    return Doubt(float(probes[worst]), float(change[worst]))


def probe_frequencies(frequency: FloatArray, known: Sequence[float], *, wary: bool = False) -> FloatArray:
    """Bins equally far apart in f^0.1 (in f and many if ``wary``), without the known ones."""
    power, count = (1.0, _MANY) if wary else (_SPACING, _PROBES)
    low, high = frequency[0] ** power, frequency[-1] ** power
    wanted = np.linspace(low, high, min(count, len(frequency))) ** (1 / power)
    bins = {float(frequency[np.argmin(np.abs(frequency - f))]) for f in wanted}
    return np.array(sorted(bins - set(known)))


def _watched(model: ForearmModel) -> tuple[list[int], list[int]]:
    """Rows and columns whose error counts: grid points (else contacts) for forces on contacts (else points)."""
    contacts = [i for i, p in enumerate(model.ports) if p.kind == "contact"]
    points = [i for i, p in enumerate(model.ports) if p.kind == "point"]
    return points or contacts, contacts or points


def _tell(progress: Progress | None, stage: str, done: int, total: int) -> None:
    if progress is not None:
        progress(stage, done, total)
