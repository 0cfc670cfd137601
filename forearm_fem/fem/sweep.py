"""The sweep: a greedy reduced model certified on direct solves, or a direct solve per frequency."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..errors import SolverError
from ..scenario.sweep import SolverOptions
from ..transfer import relative_error
from ..typing import ComplexArray, FloatArray, IntArray
from .certify import DOUBTFUL, Certificate, certified, enough, most_doubtful, probe_frequencies
from .compress import PoleResidue, compressed, pole_residue
from .direct import ENOUGH, DirectSolver, make_solver, watched
from .model import ForearmModel
from .reduce import ReducedModel, empty_model, extend

Progress = Callable[[str, int, int], None]
_SHARE = 1e-3  # of what is asked of the reduced model: the residual that its solves are refined to
_UNCERTIFIED = 1e-5  # what the second stage may cost where nothing else is known
_USELESS = 0.5  # a stated error above this says that the model tells nothing
_QUIET, _SPREAD = 30.0, -0.2  # [Hz] flesh on bone hardly resonates below; expansions are even in f^-0.2 above it


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
    solver: str = ""

    @property
    def reduction_error(self) -> float:
        """Error stated for the reduced model: its largest certificate, or the largest ever where that is in doubt.

        Certificates are of the whole space; what the second stage changes (``compression``) comes on top. Where
        resonances were hard to resolve it is ``least``, the tolerance, at least: few frequencies speak for many peaks.
        """
        last = self.certificates[-1]
        sure = last.change <= DOUBTFUL
        speaking = [c.bound for c in self.certificates if not sure or c.expansions == last.expansions]
        return max(*speaking, self.least) + self.compression

    def states(self, frequency: FloatArray, ports: Sequence[int]) -> ComplexArray:
        """Reduced solutions (n_frequency, r, n_chosen) for a unit force on the chosen ``ports``, shares undone."""
        if self.poles is not None:
            return self.poles.states(frequency, ports)
        assert self.reduced is not None
        return np.asarray(self.reduced.states(frequency)[:, :, ports] * self.reduced.shares[ports])


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
    return SweepResult(np.array(values), residual, error, solver=solver.factor.name)


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

    Expansion starts at :func:`expansion_frequencies`. Then the most doubtful frequency (:mod:`.certify`) is solved
    directly: that true error certifies the model, and where it exceeds ``tolerance`` the solution and its derivatives
    extend it (at most ``max_expansions`` times in all; the certificates say what was reached). Solves are refined to a
    thousandth of ``tolerance``, to 1e-7 at least. Where resonances were
    seen to be unresolved several frequencies in turn must pass. With ``tolerance`` None nothing is certified and no
    factorisation is spent on it. Raises SolverError where the stated error is above 0.5.
    """
    work = _Expander(model, options, snapshots, min(ENOUGH, _SHARE * (tolerance or _UNCERTIFIED)))
    planned = expansion_frequencies(frequency, options)
    reduced, used = empty_model(model), list[Expansion]()
    for i, f in enumerate(planned):
        reduced = work.extended(reduced, used, f)
        _tell(progress, "expansion frequencies", i + 1, len(planned) + 1)
    certificates = list[Certificate]()
    while tolerance is not None:
        worst = most_doubtful(model, reduced, frequency, [e.frequency for e in used], certificates)
        if worst is None:
            break
        truth = work.direct(worst.frequency)
        certificates.append(certified(reduced, model, truth.series[0], worst, len(used)))
        _tell(progress, "expansion frequencies", len(used) + 1, len(used) + 1)
        if certificates[-1].bound > tolerance and len(used) < options.max_expansions:
            reduced = work.extended(reduced, used, worst.frequency, truth)
        elif enough(certificates):
            break
    work.release()
    result = replace(_swept(model, reduced, frequency, used, certificates, tolerance), solver=work.solver)
    return result if tolerance is None else _usable(result)


def _usable(result: SweepResult) -> SweepResult:
    if result.certificates and result.reduction_error > _USELESS:
        raise SolverError(
            f"the reduced model of {len(result.expansions)} expansion frequencies may be wrong by "
            f"{result.reduction_error:.2g} times G: it does not resolve the resonances of this band; raise "
            "solver.max_expansions, narrow the band, or set solver.sweep = 'direct'"
        )
    return result


def _swept(
    model: ForearmModel,
    reduced: ReducedModel,
    frequency: FloatArray,
    used: list[Expansion],
    certificates: list[Certificate],
    tolerance: float | None,
) -> SweepResult:
    wary = any(c.change > DOUBTFUL for c in certificates)
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
    block = np.ix_(range(len(probes)), *watched(model))
    change = float(relative_error(small.compliance(probes)[block], reduced.compliance(probes)[block]).max())
    return (small, change) if change <= tolerance else (reduced, 0.0)


class _Expander:
    """Makes expansions, or takes them from the store; factorises only when it must."""

    def __init__(self, model: ForearmModel, options: SolverOptions, store: Snapshots | None, residual: float) -> None:
        self._model, self._options, self._store, self._residual = model, options, store, residual
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

    @property
    def solver(self) -> str:
        """The direct solver at work, empty where none was needed."""
        return "" if self._solver is None else self._solver.factor.name

    def release(self) -> None:
        """Give the factor's memory back."""
        if self._solver is not None:
            self._solver.factor.release()

    def _ready(self, frequency: float) -> DirectSolver:
        if self._solver is None:
            made = make_solver(self._model, self._options, frequency)
            self._solver = replace(made, tolerance=max(made.tolerance, self._residual))
        return self._solver


def derivative_orders(model: ForearmModel, options: SolverOptions) -> IntArray:
    """How many derivatives (n_port,) are kept of each port's solution: the watched forces' more than the others'."""
    orders = np.full(len(model.ports), min(options.point_derivatives, options.derivatives))
    orders[watched(model)[1]] = options.derivatives
    return orders


def expansion_frequencies(frequency: FloatArray, options: SolverOptions) -> tuple[float, ...]:
    """Middles of equal parts of the band in f^-0.2, from 30 Hz on where the band goes well beyond.

    Below, an expansion from above holds; far above, resonances are damped and one expansion reaches far
    (docs/decisions.md).
    """
    count = min(options.expansions, len(frequency))
    low = max(frequency[0], min(_QUIET, frequency[-1] / 8)) ** _SPREAD
    high = frequency[-1] ** _SPREAD
    wanted = (low + (high - low) * (np.arange(count) + 0.5) / count) ** (1 / _SPREAD)
    return tuple(sorted({float(frequency[np.argmin(np.abs(frequency - f))]) for f in wanted}))


def _tell(progress: Progress | None, stage: str, done: int, total: int) -> None:
    if progress is not None:
        progress(stage, done, total)
