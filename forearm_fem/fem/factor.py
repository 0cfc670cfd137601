"""One small interface to direct solvers, with refinement to double precision and a checked residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from ..errors import SolverError
from ..typing import ComplexArray
from . import pardiso
from .operator import AffineOperator

Backend = Literal["auto", "pardiso", "superlu"]


class Multiplied(Protocol):
    """A matrix that residuals are worked out with."""

    def product(self, x: ComplexArray) -> ComplexArray:
        """The matrix times columns (n, k)."""
        ...


class Factor(Protocol):
    """What every direct solver offers; the pattern is analysed once, values change with frequency."""

    @property
    def single(self) -> bool:
        """Whether the factors are in single precision now."""
        ...

    def factorise(self, data: ComplexArray) -> None:
        """Numerical factorisation for upper-triangle values on the analysed pattern."""
        ...

    def solve(self, right: ComplexArray) -> ComplexArray:
        """Solutions (n, k) for right-hand sides (n, k)."""
        ...

    def harden(self) -> bool:
        """Factorise the same matrix more accurately; False where that cannot be done."""
        ...

    def release(self) -> None:
        """Give memory back."""
        ...


class SuperLUFactor:
    """SciPy's SuperLU: a fallback for small scenes (n below about 3e4); it stores both triangles."""

    single = False

    def __init__(self, upper: csr_array) -> None:
        self._indptr, self._indices, self._shape = upper.indptr, upper.indices, upper.shape
        self.n = int(upper.shape[0])

    def factorise(self, data: ComplexArray) -> None:
        """See :class:`Factor`."""
        upper = csr_array((data, self._indices, self._indptr), shape=self._shape)
        full = csc_array(upper + upper.T)
        full.setdiag(upper.diagonal())
        try:
            self._lu = splu(full, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": False})
        except RuntimeError as problem:
            raise SolverError(f"SuperLU: {problem}: the system is singular at this frequency") from None

    def solve(self, right: ComplexArray) -> ComplexArray:
        """See :class:`Factor`."""
        return np.asarray(self._lu.solve(np.ascontiguousarray(right)))

    def harden(self) -> bool:
        """See :class:`Factor`; this one is in double precision."""
        return False

    def release(self) -> None:
        """See :class:`Factor`."""
        self._lu = None


def available_backends() -> tuple[str, ...]:
    """Direct solvers found on this machine, the preferred one first."""
    return ("pardiso", "superlu") if pardiso.library() is not None else ("superlu",)


SUPERLU_LIMIT = 40_000


def choose_backend(backend: Backend, n: int) -> str:
    """The solver to use for ``n`` unknowns; refuses SuperLU where it would not finish."""
    chosen = available_backends()[0] if backend == "auto" else backend
    if chosen == "superlu" and n > SUPERLU_LIMIT:
        raise SolverError(
            f"SuperLU does not finish in reasonable time for {n} unknowns (limit {SUPERLU_LIMIT}); "
            "install MKL (python3 -m pip install mkl) or coarsen the mesh (accuracy, mesh.size_grid)"
        )
    return chosen


def make_factor(
    operator: AffineOperator, omega: float, backend: Backend, *, single: bool, matching: bool = True
) -> Factor:
    """Analysed, not yet factorised, solver for the operator's pattern; see :class:`.pardiso.PardisoFactor`."""
    upper = operator.upper(operator.data(omega))
    chosen = choose_backend(backend, operator.n)
    if chosen == "pardiso":
        return pardiso.PardisoFactor(upper, operator.n_displacements, single=single, matching=matching)
    return SuperLUFactor(upper)


@dataclass(frozen=True)
class Solution:
    """Solutions (n, k), what is left of the right-hand sides (n, k), and the largest relative residual."""

    values: ComplexArray
    rest: ComplexArray
    residual: float


def refined_solve(
    factor: Factor, matrix: Multiplied, right: ComplexArray, *, tolerance: float = 1e-12, rounds: int = 6
) -> Solution:
    """Solve with iterative refinement in double precision until the relative residual is below ``tolerance``.

    The residual is measured column by column against the right-hand side. Stops early when a round gains less than a
    factor two; raises :class:`SolverError` where the residual stays above 1e-6 (a number that cannot be trusted).
    """
    scale = np.linalg.norm(right, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    x = factor.solve(right)
    rest = right - matrix.product(x)
    residual = float((np.linalg.norm(rest, axis=0) / scale).max())
    for _ in range(rounds):
        if residual <= tolerance:
            break
        candidate = x + factor.solve(rest)
        rest_new = right - matrix.product(candidate)
        residual_new = float((np.linalg.norm(rest_new, axis=0) / scale).max())
        if not residual_new < residual:
            break
        gained = residual_new < residual / 2
        x, rest, residual = candidate, rest_new, residual_new
        if not gained:
            break
    if not residual < 1e-6:
        raise SolverError(
            f"linear solve left a relative residual of {residual:.1e}; the system is singular or badly scaled here: "
            "hold the limb (supports), leave out the frequency of an undamped resonance, or mend slivers in the mesh"
        )
    return Solution(x, rest, residual)
