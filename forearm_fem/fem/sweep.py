"""The sweep: a greedy reduced model certified on direct solves, or a direct solve per frequency."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..scenario.sweep import SolverOptions
from ..transfer import relative_error
from ..typing import ComplexArray, FloatArray
from .factor import Factor, Solution, make_factor, refined_solve
from .model import ForearmModel
from .reduce import ReducedModel, empty_model, extend

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Certificate:
    """Error of the reduced model at a frequency where it was compared with a direct solve it had not used."""

    frequency: float
    error: float


@dataclass(frozen=True)
class SweepResult:
    """Compliance (n_frequency, n_port, n_port) [m/N] with its linear residual and what certifies the reduction."""

    values: ComplexArray
    residual: float
    reduced: ReducedModel | None = None
    expansions: tuple[float, ...] = ()
    certificates: tuple[Certificate, ...] = ()


@dataclass(frozen=True)
class DirectSolver:
    """One analysed factorisation, reused for every frequency."""

    model: ForearmModel
    factor: Factor
    tolerance: float = 1e-11

    def at(self, frequency: float) -> Solution:
        """Solutions (n, n_port) for a unit force on each port; the factor stays for more right-hand sides."""
        data = self.model.operator.data(2 * np.pi * frequency)
        self.factor.factorise(data)
        return self._solve(data, self.model.functionals.astype(complex))

    def taylor(self, frequency: float, start: Solution, order: int) -> list[ComplexArray]:
        """Taylor coefficients 0 ... ``order`` in omega of the solutions about ``frequency``, unit-free columns.

        A_0 x_k = - sum_j A_j x_(k-j) with the Taylor matrices A_j; each order is scaled by its own norm.
        """
        operator, omega = self.model.operator, 2 * np.pi * frequency
        data, slopes = operator.data(omega), operator.taylor_data(omega, order)
        series = [start.values]
        for k in range(1, order + 1):
            right = np.zeros_like(series[0])
            for j in range(1, k + 1):
                if (slope := slopes[j - 1]) is not None:
                    right -= omega**j * operator.multiply(slope, series[k - j])
            series.append(self._solve(data, right).values)
        return series

    def _solve(self, data: ComplexArray, right: ComplexArray) -> Solution:
        return refined_solve(self.factor, self.model.operator.upper(data), right, tolerance=self.tolerance)

    def compliance(self, solution: Solution) -> ComplexArray:
        """Compliance (n_port, n_port) [m/N] from solutions."""
        return np.asarray((self.model.functionals.T @ solution.values) * self.model.shares)


def make_solver(model: ForearmModel, options: SolverOptions, frequency: float) -> DirectSolver:
    """Analyse the pattern once for all frequencies."""
    single = options.precision == "single"
    factor = make_factor(model.operator, 2 * np.pi * frequency, options.backend, single=single)
    return DirectSolver(model, factor, 1e-9 if single else 1e-11)


def direct_sweep(
    model: ForearmModel, frequency: FloatArray, options: SolverOptions, *, progress: Progress | None = None
) -> SweepResult:
    """Factorise and solve at every frequency (n,) [Hz]."""
    solver = make_solver(model, options, float(frequency[-1]))
    values, residual = [], 0.0
    for i, f in enumerate(frequency):
        solution = solver.at(float(f))
        values.append(solver.compliance(solution))
        residual = max(residual, solution.residual)
        _tell(progress, "direct solves", i + 1, len(frequency))
    solver.factor.release()
    return SweepResult(np.array(values), residual)


def reduced_sweep(
    model: ForearmModel,
    frequency: FloatArray,
    options: SolverOptions,
    *,
    tolerance: float = 1e-4,
    progress: Progress | None = None,
) -> SweepResult:
    """Sweep by a reduced model whose expansion frequencies are chosen where it is least certain.

    Each new expansion frequency is first a test: the model built so far is compared there with the direct solve. The
    sweep ends when that true error is below ``tolerance`` (or ``max_expansions`` is reached: the certificates say so).
    """
    solver = make_solver(model, options, float(frequency[-1]))
    reduced, residual = empty_model(model), 0.0
    expansions: list[float] = []
    certificates: list[Certificate] = []
    chosen: float | None = _first(frequency)
    while chosen is not None:
        solution = solver.at(chosen)
        residual = max(residual, solution.residual)
        if reduced.size:
            certificates.append(_certify(reduced, solver, solution, chosen))
        reduced = extend(reduced, model, solver.taylor(chosen, solution, options.derivatives))
        expansions.append(chosen)
        _tell(progress, "expansion frequencies", len(expansions), options.max_expansions)
        chosen = _next(reduced, frequency, expansions, certificates, options, tolerance)
    solver.factor.release()
    values = reduced.compliance(frequency)
    return SweepResult(values, residual, reduced, tuple(expansions), tuple(certificates))


def _certify(reduced: ReducedModel, solver: DirectSolver, solution: Solution, frequency: float) -> Certificate:
    truth = solver.compliance(solution)[None]
    estimate = reduced.compliance(np.array([frequency]))
    rows, columns = _points_by_contacts(reduced, solver.model)
    error = relative_error(estimate[:, rows][:, :, columns], truth[:, rows][:, :, columns])
    return Certificate(frequency, float(error[0]))


def _points_by_contacts(reduced: ReducedModel, model: ForearmModel) -> tuple[list[int], list[int]]:
    """Rows and columns of the compliance whose error counts: grid points (else all ports) by contacts."""
    contacts = [i for i, p in enumerate(model.ports) if p.kind == "contact"]
    points = [i for i, p in enumerate(model.ports) if p.kind == "point"]
    del reduced
    return points or contacts, contacts or points


def _first(frequency: FloatArray) -> float:
    return float(frequency[len(frequency) // 2])


def _next(
    reduced: ReducedModel,
    frequency: FloatArray,
    expansions: list[float],
    certificates: list[Certificate],
    options: SolverOptions,
    tolerance: float,
) -> float | None:
    """Where to expand next, or None when certified or at the limit of expansions."""
    certified = bool(certificates) and certificates[-1].error <= tolerance
    if certified or len(expansions) >= min(options.max_expansions, len(frequency)):
        return None
    return most_uncertain(reduced, frequency, expansions)


def most_uncertain(reduced: ReducedModel, frequency: FloatArray, expansions: list[float]) -> float:
    """The frequency at which leaving out the highest derivatives changes the compliance most."""
    probes = frequency[np.unique(np.linspace(0, len(frequency) - 1, 61).astype(int))]
    probes = np.array([f for f in probes if f not in expansions])
    if not len(probes):
        probes = np.array([f for f in frequency if f not in expansions])
    change = relative_error(_finite(reduced.without_last_order().compliance(probes)), _finite(reduced.compliance(probes)))
    return float(probes[int(np.argmax(change))])


def _finite(values: ComplexArray) -> ComplexArray:
    columns = np.isfinite(values).all(axis=(0, 1))
    return np.asarray(values[:, :, columns])


def _tell(progress: Progress | None, stage: str, done: int, total: int) -> None:
    if progress is not None:
        progress(stage, done, total)
