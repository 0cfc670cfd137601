"""Structure-preserving reduced model on the displacements of mixed solutions and their frequency derivatives.

Solutions of the mixed system satisfy B u = -S p exactly, so on their span the saddle system is the condensed one,
u^T K v + p^T S q: it is real symmetric term by term, needs no pressure unknowns, and keeps reciprocity and passivity.
The span of the real and the imaginary parts is used, which makes every projected matrix real.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..typing import ComplexArray, FloatArray
from .coefficients import Coefficient
from .model import ForearmModel
from .operator import AffineOperator, Term, symmetric_product

_DROPPED = {"incompressibility"}  # its energy is the one of "compression" on the span, with opposite sign


@dataclass(frozen=True)
class ReducedModel:
    """Compliance of all ports at any frequency from small real matrices.

    ``matrices`` (n_term, r, r) with ``coefficients``; ``functionals`` (r, n_port).
    ``basis`` (n, r) reconstructs displacements and scaled pressures.
    """

    coefficients: tuple[Coefficient, ...]
    matrices: FloatArray
    functionals: FloatArray
    shares: FloatArray
    basis: FloatArray = field(repr=False)

    @property
    def size(self) -> int:
        """Dimension r of the reduced space."""
        return len(self.functionals)

    def states(self, frequency: FloatArray) -> ComplexArray:
        """Reduced solutions (n_frequency, r, n_port) for a unit force on each port."""
        omega = 2 * np.pi * np.asarray(frequency, dtype=float)
        weights = np.array([np.broadcast_to(c.at(omega), omega.shape) for c in self.coefficients])
        flat = self.matrices.reshape(len(self.matrices), -1)
        right = self.functionals.astype(complex)
        rows = [np.linalg.solve((w @ flat).reshape(self.size, self.size), right) for w in weights.T]
        return np.array(rows)

    def compliance(self, frequency: FloatArray) -> ComplexArray:
        """Compliance (n_frequency, n_port, n_port) [m/N]; columns of forces without a symmetric solution are NaN."""
        values = np.einsum("ri,frj->fij", self.functionals, self.states(frequency), optimize=True)
        return np.asarray(values * self.shares)

    def projected(self, directions: FloatArray) -> ReducedModel:
        """The model on the span of orthonormal ``directions`` (r, s) of this space."""
        return ReducedModel(
            self.coefficients,
            np.array([directions.T @ m @ directions for m in self.matrices]),
            directions.T @ self.functionals,
            self.shares,
            self.basis @ directions,
        )

    def with_coefficients(self, coefficients: Sequence[Coefficient]) -> ReducedModel:
        """The same space for other moduli or densities; its error for them is not certified."""
        return ReducedModel(tuple(coefficients), self.matrices, self.functionals, self.shares, self.basis)


def empty_model(model: ForearmModel) -> ReducedModel:
    """A reduced model of dimension zero, to be extended."""
    kept = [t for t in model.operator.terms if t.name not in _DROPPED]
    return ReducedModel(
        tuple(_coefficient(t) for t in kept),
        np.zeros((len(kept), 0, 0)),
        np.zeros((0, len(model.ports))),
        model.shares,
        np.zeros((model.operator.n, 0)),
    )


@dataclass(frozen=True)
class _Negated:
    """-theta: the sign change that turns the saddle's pressure block into stored energy."""

    inner: Coefficient

    def at(self, omega: FloatArray) -> ComplexArray:
        return np.asarray(-self.inner.at(omega))

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        return np.asarray(-self.inner.taylor(omega0, n))


def _coefficient(term: Term) -> Coefficient:
    return _Negated(term.coefficient) if term.name == "compression" else term.coefficient


def extend(
    reduced: ReducedModel, model: ForearmModel, snapshots: Sequence[ComplexArray], *, drop: float = 1e-7
) -> ReducedModel:
    """Add solutions and derivatives (a list over derivative orders of (n, k) arrays) to the space."""
    operator = model.operator
    basis = reduced.basis
    for block in snapshots:
        new = orthonormal_extension(basis, real_columns(block), operator.n_displacements, drop=drop)
        basis = np.hstack([basis, new])
    added = basis[:, reduced.size :]
    matrices = _extended_matrices(reduced, operator, basis, added)
    functionals = np.vstack([reduced.functionals, added.T @ model.functionals])
    return ReducedModel(reduced.coefficients, matrices, functionals, reduced.shares, basis)


def real_columns(block: ComplexArray) -> FloatArray:
    """Real and imaginary parts side by side, columns of unit length (zero columns left out)."""
    columns = np.hstack([block.real, block.imag])
    norms = np.linalg.norm(columns, axis=0)
    keep = norms > 1e-14 * norms.max()
    return np.asarray(columns[:, keep] / norms[keep])


def orthonormal_extension(basis: FloatArray, columns: FloatArray, n_u: int, *, drop: float) -> FloatArray:
    """Columns made orthonormal, in their displacements, to ``basis`` and each other; pressures follow along.

    Directions whose independent part is below ``drop`` of a column's length are left out: what rounding leaves of them
    would only add noise.
    """
    norms = np.linalg.norm(columns[:n_u], axis=0)
    rest = columns / norms
    for _ in range(2):
        if basis.shape[1]:
            rest = rest - basis @ (basis[:n_u].T @ rest[:n_u])
        values, vectors = np.linalg.eigh(rest[:n_u].T @ rest[:n_u])
        keep = values > drop**2
        rest = rest @ (vectors[:, keep] / np.sqrt(values[keep]))
    return np.asarray(rest)


def _extended_matrices(
    reduced: ReducedModel, operator: AffineOperator, basis: FloatArray, added: FloatArray
) -> FloatArray:
    """Projected matrices of all kept terms; only products with the added columns are new."""
    old, total = reduced.size, basis.shape[1]
    kept = [t for t in operator.terms if t.name not in _DROPPED]
    matrices = np.zeros((len(kept), total, total))
    matrices[:, :old, :old] = reduced.matrices
    for matrix, term in zip(matrices, kept, strict=True):
        columns = basis.T @ symmetric_product(operator.term_matrix(term), added).real
        matrix[:, old:] = columns
        matrix[old:, :old] = columns[:old].T
        matrix[old:, old:] = (columns[old:] + columns[old:].T) / 2
    return matrices
