"""Factorisations behind one protocol: choice, elimination order, refinement, fallback."""

from __future__ import annotations

import importlib.util
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, eye_array
from scipy.sparse.linalg import splu

from ...errors import SolverError
from ...typing import ComplexArray, FloatArray, IntArray
from ..assembly.operator import AffineOperator
from ..kernels.compiled import compiled, one_blas_thread
from . import cudss, pardiso

# Order in which unknowns are eliminated: nested dissection of the mesh's nodes, pressures after displacements.
# PARDISO orders by itself with METIS, one separator tried a level. Several tried, and parts of less equal size, leave a
# tenth less work to the factorisation; the nodes' graph is small enough that this costs no more. A pressure that is
# eliminated before the displacements it depends on has a pivot of the size of 1 / bulk modulus alone, and the factors
# lose three digits by it: it waits for a quarter of them (decision 0008).

_SEPARATORS = 4  # tried on each level
_UNEVEN = 300  # parts may differ by this many thousandths; 400 was as good, 600 worse, 1000 did not end
_SMALL = 3000  # unknowns below which there is nothing to gain


def nested_dissection(upper: csr_array, n_displacements: int) -> IntArray | None:
    """Unknowns (n,) in the order of their elimination; None where METIS is not installed or the matrix is small.

    ``upper`` is the upper triangle of a matrix with a symmetric pattern, every diagonal entry stored; its first
    ``n_displacements`` unknowns are displacements, the others pressures. Displacements with the same neighbours stay
    together, in their own order.
    """
    if upper.shape[0] < _SMALL or importlib.util.find_spec("pymetis") is None:
        return None
    import pymetis

    node = alike(upper)
    chosen = np.unique(node, return_index=True)[1]
    half = _pattern(upper)[chosen][:, chosen]
    graph = csr_array(half + half.T - 2 * eye_array(len(chosen), dtype=np.int8))
    graph.eliminate_zeros()
    shuffled = np.random.default_rng(2).permutation(len(chosen))  # METIS does worse on nodes numbered along a limb
    graph = csr_array(graph[shuffled][:, shuffled])
    adjacency = pymetis.CSRAdjacency(graph.indptr.astype(np.int32), graph.indices.astype(np.int32))
    options = pymetis.Options(nseps=_SEPARATORS, ufactor=_UNEVEN, seed=1)
    order = shuffled[np.asarray(pymetis.nested_dissection(adjacency, options=options)[0])]
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return _pressures_later(np.argsort(rank[node], kind="stable"), upper, n_displacements)


def _pressures_later(order: IntArray, upper: csr_array, n_displacements: int) -> IntArray:
    """``order`` with each pressure after a quarter of the displacements it is coupled to, if it was not."""
    place = np.empty(len(order), dtype=float)
    place[order] = np.arange(len(order))
    coupling = csc_array(_pattern(upper)[:n_displacements, n_displacements:])
    count = np.diff(coupling.indptr)
    coupled = place[coupling.indices]
    coupled = coupled[np.lexsort((coupled, np.repeat(np.arange(len(count)), count)))]
    some = np.flatnonzero(count)
    quarter = coupled[coupling.indptr[some] + count[some] // 4]
    place[n_displacements + some] = np.maximum(place[n_displacements + some], quarter + 0.5)
    return np.asarray(np.argsort(place, kind="stable"))


def alike(upper: csr_array) -> IntArray:
    """Number (n,) of each unknown's node, in order of appearance: unknowns with the same neighbours, themselves
    included, share one."""
    weight = np.random.default_rng(0).integers(1, 2**61, upper.shape[0])  # sums of sets that differ differ, to 2^-61
    half = _pattern(upper).astype(np.int64)
    _, first, node = np.unique(half @ weight + half.T @ weight - weight, return_index=True, return_inverse=True)
    number = np.empty_like(first)
    number[np.argsort(first)] = np.arange(len(first))
    return np.asarray(number[node])


def _pattern(upper: csr_array) -> csr_array:
    ones = np.ones(len(upper.indices), dtype=np.int8)
    return csr_array((ones, upper.indices, upper.indptr), shape=upper.shape)


# One small interface to direct solvers, with refinement to double precision and a checked residual.

Backend = Literal["auto", "multifrontal", "pardiso", "superlu", "cudss"]
Columns = NDArray[Any]  # complex, or real where the matrix is


class Multiplied(Protocol):
    """A matrix that residuals are worked out with."""

    def product(self, x: Columns) -> Columns:
        """The matrix times columns (n, k)."""
        ...


class Factor(Protocol):
    """Interface of direct solvers; the pattern is analysed once, values change with frequency."""

    @property
    def name(self) -> str:
        """The solver that is at work now, as ``solver.backend`` calls it."""
        ...

    @property
    def single(self) -> bool:
        """True if the factors are in single precision now."""
        ...

    def factorise(self, data: ComplexArray | FloatArray) -> None:
        """Numerical factorisation for upper-triangle values on the analysed pattern, complex or real."""
        ...

    def solve(self, right: Columns) -> Columns:
        """Solutions (n, k) for right-hand sides (n, k), all real where the matrix is."""
        ...

    def products(self, data: ComplexArray | FloatArray, right: Columns) -> ComplexArray | None:
        """B^T A^-1 B (k, k) for ``right`` B (n, k) and a matrix with values ``data``, unrefined, by elimination alone.

        Earlier factors go and none stay. None where this solver cannot but keep them.
        """
        ...

    def harden(self, data: ComplexArray | FloatArray) -> bool:
        """Factorise the same matrix, whose values are ``data``, more accurately; False where that cannot be done."""
        ...

    def release(self) -> None:
        """Give memory back."""
        ...


# Pivots of SuperLU: on the diagonal unless that is below a hundredth of its column, which keeps the order's fill (a
# thirtieth of the time at 6,786 unknowns, residuals no larger); hardened, the largest of each column.
_ON_DIAGONAL = MappingProxyType(
    {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.01, "options": {"SymmetricMode": True}}
)
_LARGEST = MappingProxyType({"permc_spec": "COLAMD", "diag_pivot_thresh": 1.0})


class SuperLUFactor:
    """SciPy's SuperLU: a fallback for small scenes (n below about 3e4); it stores both triangles.

    Its BLAS has one thread: its blocks are so small that two, beside other work, took eight times as long.
    """

    name = "superlu"
    single = False

    def __init__(self, upper: csr_array) -> None:
        self._indptr, self._indices, self._shape = upper.indptr, upper.indices, upper.shape
        self.n = int(upper.shape[0])
        self._how: Mapping[str, Any] = _ON_DIAGONAL

    def factorise(self, data: ComplexArray | FloatArray) -> None:
        """See :class:`Factor`."""
        self._real = not np.iscomplexobj(data)
        upper = csr_array((data.astype(complex), self._indices, self._indptr), shape=self._shape)
        full = csc_array(upper + upper.T)
        full.setdiag(upper.diagonal())
        try:
            with one_blas_thread():
                self._lu = splu(full, **self._how)
        except RuntimeError as problem:
            raise SolverError(f"SuperLU: {problem}: the system is singular at this frequency") from None

    def solve(self, right: Columns) -> Columns:
        """See :class:`Factor`."""
        with one_blas_thread():
            x = self._lu.solve(np.ascontiguousarray(right, dtype=complex))
        return np.asarray(x.real if self._real else x)

    def products(self, data: ComplexArray | FloatArray, right: Columns) -> ComplexArray | None:
        """See :class:`Factor`; this one cannot."""
        return None

    def harden(self, data: ComplexArray | FloatArray) -> bool:
        """See :class:`Factor`; False where the largest pivots were taken already."""
        if self._how is _LARGEST:
            return False
        self._how = _LARGEST
        self.factorise(data)
        return True

    def release(self) -> None:
        """See :class:`Factor`."""
        self._lu = None


class FallbackFactor:
    """The multifrontal factorisation, replaced by PARDISO with matching once it was not accurate enough."""

    def __init__(self, upper: csr_array, n_displacements: int, order: IntArray) -> None:
        from .multifrontal.factor import MultifrontalFactor

        self._indptr, self._indices, self._shape = upper.indptr, upper.indices, upper.shape
        self.now: Factor = MultifrontalFactor(upper, n_displacements, order)

    @property
    def name(self) -> str:
        """See :class:`Factor`."""
        return self.now.name

    @property
    def single(self) -> bool:
        """See :class:`Factor`."""
        return self.now.single

    def factorise(self, data: ComplexArray | FloatArray) -> None:
        """See :class:`Factor`."""
        self.now.factorise(data)

    def solve(self, right: Columns) -> Columns:
        """See :class:`Factor`."""
        return self.now.solve(right)

    def products(self, data: ComplexArray | FloatArray, right: Columns) -> ComplexArray | None:
        """See :class:`Factor`."""
        return self.now.products(data, right)

    def harden(self, data: ComplexArray | FloatArray) -> bool:
        """See :class:`Factor`; False where PARDISO is not installed or has done all it can."""
        if isinstance(self.now, pardiso.PardisoFactor):
            return self.now.harden(data)
        if pardiso.mkl_library() is None:
            return False
        self.now.release()
        upper = csr_array((data, self._indices, self._indptr), shape=self._shape)
        self.now = pardiso.PardisoFactor(upper, single=True)
        self.now.factorise(data)
        return True

    def release(self) -> None:
        """See :class:`Factor`."""
        self.now.release()


def _compiles() -> bool:
    """True if METIS and numba are there, and a place for what numba compiles."""
    return importlib.util.find_spec("pymetis") is not None and compiled("linear.multifrontal.factor") is not None


def available_backends() -> tuple[str, ...]:
    """Direct solvers found on this machine, the preferred one first; cuDSS serves only where it is asked for."""
    found = (
        ("multifrontal", _compiles()),
        ("pardiso", pardiso.mkl_library() is not None),
        ("superlu", True),
        ("cudss", cudss.available()),
    )
    return tuple(name for name, there in found if there)


SUPERLU_LIMIT = 40_000


def choose_backend(backend: Backend, n: int, *, single: bool = True) -> str:
    """The solver to use for ``n`` unknowns; refuses SuperLU where it would not finish.

    ``single`` says that factors in single precision and without matching will do, the only ones that the multifrontal
    solver makes.
    """
    if backend == "multifrontal" and not (single and _compiles()):
        raise SolverError(
            "solver.backend = 'multifrontal' needs numba and pymetis, and factorises in single precision what needs no "
            "matching (solver.precision = 'auto', no exactly incompressible tissue); set solver.backend = 'auto'"
        )
    if backend == "cudss":
        cudss.require()
    able = [name for name in available_backends() if single or name != "multifrontal"]
    chosen = able[0] if backend == "auto" else backend
    if chosen == "superlu" and n > SUPERLU_LIMIT:
        raise SolverError(
            f"SuperLU does not finish in reasonable time for {n} unknowns (limit {SUPERLU_LIMIT}); "
            f"{_faster(single)}coarsen the mesh (accuracy, mesh.size_grid) or set engine = 'layered'"
        )
    return chosen


def _faster(single: bool) -> str:
    """Sentence on how to get a faster solver on this machine, "" without one: MKL is made for x86 outside macOS
    alone."""
    if platform.machine().lower() in ("x86_64", "amd64") and sys.platform != "darwin":
        return "install MKL (python3 -m pip install mkl), "
    if not single:
        return "there is no MKL here, and the multifrontal solver needs solver.precision = 'auto' and K < inf; "
    return "" if _compiles() else "there is no MKL here; install pymetis and numba (python3 -m pip install pymetis), "


def make_factor(
    operator: AffineOperator, omega: float, backend: Backend, *, single: bool, matching: bool = True
) -> Factor:
    """Analysed, not yet factorised, solver for the operator's pattern; see :class:`.pardiso.PardisoFactor`."""
    upper = operator.upper(operator.data(omega))
    chosen = choose_backend(backend, operator.n, single=single and not matching)
    if chosen == "superlu":
        return SuperLUFactor(upper)
    if chosen == "cudss":
        return cudss.CudssFactor(upper, single=single and not matching)
    order = None if matching else nested_dissection(upper, operator.n_displacements)
    small = order is None and backend == "auto" and pardiso.mkl_library() is not None
    if chosen == "multifrontal" and not small:
        return FallbackFactor(upper, operator.n_displacements, np.arange(operator.n) if order is None else order)
    return pardiso.PardisoFactor(upper, order, single=single, matching=matching)


@dataclass(frozen=True)
class Solution:
    """Solutions (n, k), what is left of the right-hand sides (n, k), and the largest relative residual."""

    values: Columns
    rest: Columns
    residual: float


def refined_solve(
    factor: Factor, matrix: Multiplied, right: Columns, *, tolerance: float = 1e-12, rounds: int = 6
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
