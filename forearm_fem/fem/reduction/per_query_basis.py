"""Single-precision solves of a parametric reduced model, on a basis chosen for each query."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.linalg.lapack import csysv, csysv_lwork

from ...errors import SolverError
from ...typing import BoolArray, ComplexArray, FloatArray
from ..assembly.coefficients import Coefficient, grouped
from .affine import AffineReduced, combined
from .rational import chebyshev_frequencies

# Dense reduced systems solved in single precision, for answers that need three digits: a fifth of the time.
# Sums of terms are formed in double precision, so that what cancels between them (the coupling and the compression) is
# exact before it is rounded; what rounding leaves enters a compliance at 1e-4 of the largest entry at 700 directions.

Single = NDArray[np.complex64]


@dataclass(frozen=True, eq=False)
class Summed:
    """A reduced model for the coefficients of one draw: ``sums`` (k, r, r) of the terms that have one of its
    ``coefficients`` in common, rounded to single precision."""

    reduced: AffineReduced
    sums: NDArray[np.float32]
    coefficients: tuple[Coefficient, ...]

    @classmethod
    def of(cls, reduced: AffineReduced) -> Self:
        """The sums of a model, formed once for however many frequencies are asked."""
        sums = grouped(reduced.coefficients)
        weights, size = np.array([w for w, _ in sums]), reduced.size
        flat = (weights @ reduced.matrices.reshape(weights.shape[1], -1)).astype(np.float32)
        return cls(reduced, flat.reshape(-1, size, size), tuple(c for _, c in sums))

    def theta(self, frequency: FloatArray) -> ComplexArray:
        """Coefficients of the sums at ``frequency`` (n,) [Hz], (n, k)."""
        omega = 2 * np.pi * np.asarray(frequency, dtype=float)
        return np.array([np.broadcast_to(c.at(omega), omega.shape) for c in self.coefficients], dtype=complex).T

    def solution(self, frequency: float, right: Single | None = None) -> Single:
        """Reduced solution (r, m) at one frequency [Hz] for the loads ``right`` (r, m), of the ports where left out.

        Raises SolverError where the system is singular.
        """
        flat, size = self.sums.reshape(len(self.sums), -1), self.reduced.size
        matrix = combined(self.theta(np.array([frequency]))[0].astype(np.complex64), flat, np.complex64)
        return _solution(matrix.reshape(size, size).T, _right(self.reduced) if right is None else right)

    def compliance(self, frequency: FloatArray) -> ComplexArray:
        """Compliance by :func:`quick_compliance`."""
        reduced, right = self.reduced, _right(self.reduced)
        found = [reduced.functionals.T @ self.solution(f, right) for f in np.asarray(frequency, dtype=float).tolist()]
        return np.asarray(np.array(found, dtype=complex).reshape(-1, *reduced.shares.shape * 2) * reduced.shares)


def quick_compliance(reduced: AffineReduced, frequency: FloatArray) -> ComplexArray:
    """Compliance (n_frequency, n_port, n_port) [m/N] as :meth:`.AffineReduced.compliance`, to about 1e-4.

    Raises SolverError where a system is singular.
    """
    return Summed.of(reduced).compliance(frequency)


def quick_state(reduced: AffineReduced, frequency: float) -> Single:
    """Reduced solution (r, n_port) at one frequency [Hz] for a unit force on each port; raises as above."""
    return _solution(_matrix(reduced, frequency), _right(reduced))


def with_and_without(reduced: AffineReduced, kept: BoolArray, frequency: float) -> tuple[ComplexArray, ComplexArray]:
    """Compliances (n_port, n_port) at one frequency [Hz] of the model and of its ``kept`` (r,) directions alone."""
    matrix, right, chosen = _matrix(reduced, frequency), _right(reduced), np.flatnonzero(kept)
    part = np.asfortranarray(matrix[np.ix_(chosen, chosen)])
    less = reduced.functionals[chosen].T @ _solution(part, np.asfortranarray(right[chosen]))
    whole = reduced.functionals.T @ _solution(matrix, right)
    return np.asarray(whole * reduced.shares, dtype=complex), np.asarray(less * reduced.shares, dtype=complex)


def _right(reduced: AffineReduced) -> Single:
    return np.asfortranarray(reduced.functionals.astype(np.complex64))


def _matrix(reduced: AffineReduced, frequency: float) -> Single:
    """A (r, r) in columns, from the terms one by one: cheaper than their sums for one frequency."""
    theta = reduced.theta(frequency)
    matrix = combined(theta, reduced.matrices.reshape(len(theta), -1), np.complex64)
    return matrix.reshape(reduced.size, reduced.size).T  # symmetric


def _solution(matrix: Single, right: Single) -> Single:
    """Uses up the symmetric ``matrix``: 0.7 of the time of a general solve from 300 directions on."""
    if not len(right):
        return right
    work = int(csysv_lwork(len(right))[0].real)
    _, _, x, info = csysv(matrix, right, lwork=work, overwrite_a=1)
    if info:
        raise SolverError(f"a reduced system of {len(right)} directions is singular; make the model from other draws")
    return np.asarray(x)


# A draw at all frequencies of a band from its solutions at few: Galerkin's method on the span of these.
# A draw's system A(omega) = sum_j theta_j(omega) S_j is complex symmetric, so with the solutions as trial and as test
# functions C = F^T V (V^T A V)^-1 V^T F, which errs by the product of what the span lacks of two ports' states. V grows
# by one solution at a time, where the residual is largest. How much the last one changes C anywhere is what is stated.
# Between two solutions such a span may have a narrow resonance that the draw has not, as no energy bounds it.

FIRST = 3  # solutions that a span starts from: at the band's ends and in its middle
_LOOKED_AT = 17  # frequencies of the band where it may be solved, the first three among them
_MOST = 15  # solutions
_SAME = 1e-4  # of a state's length: what is new by less is rounding of single precision
_SKETCHED = 24  # random directions that the residual is seen in: its length to about a seventh


@dataclass(frozen=True, eq=False)
class Span:
    """An orthonormal ``basis`` (r, m) of solutions of a ``system``: ``images`` (k, r, m) of it under each of the sums,
    and these seen from it, ``inner`` (k, m, m)."""

    system: Summed
    basis: ComplexArray
    images: NDArray[np.complex64]
    inner: ComplexArray

    @classmethod
    def of(cls, system: Summed) -> Self:
        """An empty one."""
        k, r = system.sums.shape[:2]
        return cls(
            system, np.zeros((r, 0), dtype=complex), np.zeros((k, r, 0), dtype=np.complex64),
            np.zeros((k, 0, 0), dtype=complex),
        )  # fmt: skip

    def with_states(self, states: Single) -> Span:
        """The span of these solutions (r, n), too."""
        new = states.astype(complex)
        new /= np.linalg.norm(new, axis=0)
        for _ in range(2):  # once leaves what cancels
            new -= self.basis @ (self.basis.conj().T @ new)
        q, r, _ = qr(new, mode="economic", pivoting=True)
        fresh = q[:, np.abs(np.diag(r)) > _SAME]
        basis, m = np.hstack([self.basis, fresh]), self.basis.shape[1]
        single = fresh.astype(np.complex64)
        parts = self.system.sums @ np.hstack([single.real, single.imag])  # the sums are real
        images = np.concatenate([self.images, parts[..., : fresh.shape[1]] + 1j * parts[..., fresh.shape[1] :]], axis=2)
        inner = np.empty((len(images), basis.shape[1], basis.shape[1]), dtype=complex)
        inner[:, :m, :m] = self.inner
        inner[:, :, m:] = basis.astype(np.complex64).T @ images[:, :, m:]
        inner[:, m:] = inner[:, :, m:].swapaxes(1, 2)
        return replace(self, basis=basis, images=images, inner=inner)

    @property
    def loads(self) -> ComplexArray:
        """Loads of the ports (m, n_port) on the span."""
        return self.basis.T @ self.system.reduced.functionals

    def states(self, frequency: FloatArray) -> ComplexArray:
        """Coordinates (n_frequency, m, n_port) of the solutions."""
        loads, theta = self.loads, self.system.theta(frequency)
        matrices = np.tensordot(theta, self.inner, 1)
        return _solved(matrices, loads)

    def compliance(self, frequency: FloatArray) -> ComplexArray:
        """Compliance (n_frequency, n_port, n_port) [m/N]."""
        values = self.loads.T @ self.states(frequency)
        return np.asarray((values + values.swapaxes(1, 2)) / 2 * self.system.reduced.shares)

    def doubt(self, frequency: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Compliances as :meth:`compliance` without shares, in single precision, and squares of the residuals' length
        over the largest of them (n_frequency,), as far as random directions show it."""
        functionals, theta = self.system.reduced.functionals, self.system.theta(frequency).astype(np.complex64)
        loads = self.loads.astype(np.complex64)
        matrices = np.tensordot(theta, self.inner.astype(np.complex64), 1)
        states = _solved(matrices, loads)
        seen = np.random.default_rng(0).standard_normal((_SKETCHED, len(functionals))).astype(np.float32)
        left = np.abs(seen @ functionals - np.tensordot(theta, seen @ self.images, 1) @ states) ** 2
        values = loads.T @ states
        return values, np.asarray(left.sum(axis=(1, 2)) / np.abs(values).max(axis=(1, 2)))


def _solved(matrices: NDArray[Any], loads: NDArray[Any]) -> NDArray[Any]:
    """Solutions (n, m, k) of each of the ``matrices`` (n, m, m) for ``loads`` (m, k); SolverError where one is
    singular."""
    try:
        return np.asarray(np.linalg.solve(matrices, np.broadcast_to(loads, (len(matrices), *loads.shape))))
    except np.linalg.LinAlgError:
        raise SolverError("a draw's span of solutions is singular at a frequency of the band") from None


@dataclass(frozen=True, eq=False)
class Spanned:
    """A ``span`` that is good for a band, and ``missed`` (n_port, n_port): the largest change at any frequency by the
    last of the ``solved`` (n,) [Hz], in shares of the largest watched entry there.

    ``beside`` (3, n_other, n_other) is what other loads see of themselves at the ends and in the middle of the band.
    """

    span: Span
    missed: FloatArray
    solved: FloatArray
    beside: ComplexArray


def spanned(
    system: Summed,
    frequency: FloatArray,
    tolerance: float,
    watched: tuple[Any, ...],
    others: FloatArray | None = None,
) -> Spanned:
    """The span of solutions at few frequencies in the band of ``frequency`` (n,) [Hz]: as many as it takes for the last
    to change nothing by more than ``tolerance`` of the largest ``watched`` entry (an open mesh of ports), or 15.

    ``others`` (r, n_other) are further loads to be solved at the first three frequencies, for :attr:`Spanned.beside`.
    Raises SolverError where a system is singular.
    """
    reduced, ports = system.reduced, system.reduced.functionals.shape[1]
    others = np.zeros((reduced.size, 0)) if others is None else others
    nodes = chebyshev_frequencies(frequency, _LOOKED_AT)
    first = np.linspace(0, _LOOKED_AT - 1, FIRST).round().astype(int)
    right = np.asfortranarray(np.hstack([reduced.functionals, others]).astype(np.complex64))
    solutions = [system.solution(f, right) for f in nodes[first].tolist()]
    beside = np.array([others.T @ x[:, ports:] for x in solutions], dtype=complex)
    span, solved = Span.of(system).with_states(np.hstack([x[:, :ports] for x in solutions])), list(first)
    values, doubt = span.doubt(nodes)
    missed = np.full((ports, ports), np.inf)
    while len(solved) < _MOST and missed[watched].max() > tolerance:
        doubt[solved] = 0
        solved.append(int(np.argmax(doubt)))
        span = span.with_states(system.solution(float(nodes[solved[-1]])))
        before = values
        values, doubt = span.doubt(nodes)
        sizes = np.abs(values[(slice(None), *watched)]).max(axis=(1, 2), keepdims=True)
        missed = (np.abs(values - before) / sizes).max(axis=0)
    return Spanned(span, missed, nodes[solved], beside)
