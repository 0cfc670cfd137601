"""Direct solves at single frequencies, and their derivatives there, from one factorisation each."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SolverError
from ...scenario.sweep import SolverOptions
from ...typing import BoolArray, ComplexArray, FloatArray, IntArray
from ..assembly.model import ForearmModel
from ..assembly.operator import AffineOperator, WeightedSum
from .factor import Factor, Solution, make_factor, refined_solve

_log = logging.getLogger("forearm_fem.fem")
ENOUGH = 1e-7  # relative residual: its error in G is stated as that of the linear solve
_ROUGHER = 8.0  # what G may be off by, in what known solutions are: they are no waves of that frequency


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

    def at(self, frequency: float, ports: Sequence[int] | None = None) -> Solution:
        """Solutions (n, n_port) for a unit force on each of the ``ports``, all where None; the factor stays for more
        right-hand sides."""
        omega, forces = 2 * np.pi * frequency, self.model.functionals
        chosen = forces if ports is None else forces[:, ports]
        operator = self.model.operator
        return self._solved(lambda: operator.data(omega), operator.at(omega), chosen.astype(complex))

    def about_rate(self, weights: FloatArray, forces: FloatArray) -> Solution:
        """Real solutions (n, b) for ``forces`` (n, b) where the terms have real ``weights``; the factor stays."""
        operator = self.model.operator
        matrix = WeightedSum(operator.matrices, weights)
        return self._solved(lambda: operator.combine(weights.tolist()), matrix, forces)

    def taylor(self, frequency: float, start: ComplexArray, orders: IntArray) -> list[ComplexArray]:
        """Taylor coefficients in omega of the solutions about ``frequency``; column i to order ``orders[i]``.

        Coefficient k has the columns with order k or more (:class:`TaylorRecursion`). Refined once: what is left enters
        the reduced model squared (see ``reduction.affine``), but unrefined single precision gave it unstable poles. The
        refinement of one coefficient is solved together with the next one, because reading the factors is what a
        solve costs; the next one lacks what this changes, which is left to its own refinement.
        """
        recursion = TaylorRecursion(self.model.operator, 2 * np.pi * frequency, orders)
        recursion.add(start, 0)
        series, pending = [start], np.zeros((len(start), 0), dtype=complex)
        for k in range(1, int(orders.max()) + 1):
            right = recursion.right(k)
            both = self.factor.solve(np.hstack([right, pending]))
            x, correction = (np.ascontiguousarray(part) for part in np.split(both, [right.shape[1]], axis=1))
            if correction.shape[1]:
                series[-1] = series[-1] + correction
                recursion.add(correction, k - 1)
            product = recursion.add(x, k, product=self.factor.single)
            if product is not None:
                pending = recursion.right(k) - product
            series.append(x)
        if pending.shape[1]:
            series[-1] = series[-1] + self.factor.solve(pending)
        return series

    def _solved(
        self, values: Callable[[], ComplexArray | FloatArray], matrix: WeightedSum, right: NDArray[Any]
    ) -> Solution:
        """Solutions with a matrix whose upper triangle has these ``values``."""
        self.factor.factorise(values())
        while self.safe:
            try:
                solution = refined_solve(self.factor, matrix, right, tolerance=self.tolerance)
                if solution.residual <= ENOUGH:
                    return solution
            except SolverError as problem:
                _log.info("%s", problem)
            if not self.factor.harden(values()):
                break
            how = "single precision with matching" if self.factor.single else "double precision"
            how = "the largest pivots" if self.factor.name == "superlu" else how
            _log.warning("the factors were not accurate enough at this frequency; %s from here on", how)
        return refined_solve(self.factor, matrix, right, tolerance=self.tolerance)

    def by_elimination(self, frequency: float, known: FloatArray) -> tuple[ComplexArray, float] | None:
        """Compliance (n_port, n_port) [m/N] without factors that stay, and what rounding may have changed in it.

        That is relative to the largest watched entry. It is seen on ``known`` solutions (n, k), real: A times them is
        carried along with the loads, and their values at the ports must come back. None where the solver at work
        cannot, or met a singular block.
        """
        omega, count = 2 * np.pi * frequency, len(self.model.ports)
        carried = np.hstack([self.model.functionals, self.model.operator.at(omega).product(known)])
        try:
            products = self.factor.products(self.model.operator.data(omega), carried)
        except SolverError as problem:
            _log.info("%s", problem)
            return None
        if products is None:
            return None
        rows, truth = watched(self.model)[0], self.model.functionals.T @ known
        size = np.abs(truth[rows]).max(axis=0)
        off = np.abs(products[:count, count:] - truth)[rows].max(axis=0) / np.where(size > 0, size, 1.0)
        return np.asarray(products[:count, :count] * self.model.shares), _ROUGHER * float(off.max())

    def solve_error(self, solution: Solution) -> float:
        """Error of the watched compliances caused by the residual, relative to the largest of them."""
        block = np.ix_(*watched(self.model))
        change = np.abs(solution.values.T @ solution.rest)[block]
        return float(change.max() / np.abs(self.model.functionals.T @ solution.values)[block].max())

    def compliance(self, solution: Solution) -> ComplexArray:
        """Compliance (n_port, n_port) [m/N] from solutions."""
        return np.asarray((self.model.functionals.T @ solution.values) * self.model.shares)


class TaylorRecursion:
    """Right-hand sides of A_0 x_k = - sum_j A_j x_(k-j) for Taylor coefficients of solutions about ``omega`` [rad/s],
    in units of omega^k, summed up as coefficients become known.

    The Taylor matrices A_j are weighted sums of the operator's terms, so each of those is multiplied once with each
    x_k, and what it gives is handed on to all later right-hand sides it belongs to.
    ``orders`` (n_port,) are the highest orders wanted of each column; coefficient k has the columns with order k or
    more. A coefficient may be added in pieces, as what is added enters linearly.
    """

    def __init__(self, operator: AffineOperator, omega: float, orders: IntArray) -> None:
        self._matrices, self._orders = operator.matrices, orders
        powers = omega ** np.arange(int(orders.max()) + 1)
        self._weights = np.array([t.coefficient.taylor(omega, len(powers) - 1) * powers for t in operator.terms])
        self._sums: dict[int, ComplexArray] = {}

    def right(self, k: int) -> ComplexArray:
        """Right-hand sides (n, columns with order k or more) from what was added so far."""
        return self._sums[k]

    def add(self, x: ComplexArray, k: int, *, product: bool = False) -> ComplexArray | None:
        """Note ``x`` (n, columns with order k or more) as a piece of coefficient k; A_0 x where ``product`` is set."""
        later = [j for j in range(1, self._weights.shape[1] - k) if self._weights[:, j].any()]
        totals = [self._total(k, k + j, x) for j in later]
        weights = [-self._weights[:, j] for j in later]
        whole = np.zeros(x.shape, dtype=complex) if product else None
        if whole is not None:
            totals, weights = [*totals, whole], [*weights, self._weights[:, 0]]
        if totals:
            self._matrices.add_products_in_place(totals, np.array(weights), x)
        for j, total in zip(later, totals, strict=False):
            if k + j not in self._sums:
                self._sums[k + j] = np.ascontiguousarray(total[:, self._going_on(k, k + j)])
            elif total is not self._sums[k + j]:
                self._sums[k + j] += total[:, self._going_on(k, k + j)]
        return whole

    def _total(self, k: int, later: int, x: ComplexArray) -> ComplexArray:
        """Array that coefficient k's part of a later right-hand side is added to: itself where their columns are the
        same."""
        if later in self._sums and self._going_on(k, later).all():
            return self._sums[later]
        return np.zeros(x.shape, dtype=complex)

    def _going_on(self, before: int, k: int) -> BoolArray:
        """True where columns of coefficient ``before`` go on in coefficient ``k``."""
        return np.asarray(self._orders[self._orders >= before] >= k)


def make_solver(model: ForearmModel, options: SolverOptions, frequency: float) -> DirectSolver:
    """Analyse the pattern once for all frequencies."""
    single = options.precision != "double"
    safe, omega = options.precision == "auto", 2 * np.pi * frequency
    zeros = (model.operator.data(omega)[model.operator.diagonal_positions] == 0).any()  # incompressible tissue
    factor = make_factor(model.operator, omega, options.backend, single=single, matching=bool(zeros) or not safe)
    return DirectSolver(model, factor, 1e-9 if single else 1e-11, safe)


def watched(model: ForearmModel) -> tuple[list[int], list[int]]:
    """Rows and columns whose error counts: grid points (else contacts) for forces on contacts (else points)."""
    contacts = [i for i, p in enumerate(model.ports) if p.kind == "contact"]
    points = [i for i, p in enumerate(model.ports) if p.kind == "point"]
    return points or contacts, contacts or points
