"""Structure-preserving reduced model on the displacements of mixed solutions and their frequency derivatives.

Solutions of the mixed system satisfy B u = -S p exactly, so on their span the saddle system is the condensed one,
u^T K v + p^T S q: it is real symmetric term by term, needs no pressure unknowns, and keeps reciprocity and passivity.
The span of the real and the imaginary parts is used, which makes every projected matrix real.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..typing import BoolArray, ComplexArray, FloatArray
from .coefficients import Coefficient
from .model import ForearmModel
from .operator import AffineOperator, Term, symmetric_product

_DROPPED = {"incompressibility"}  # its energy is the one of "compression" on the span, with opposite sign


@dataclass(frozen=True)
class ReducedModel:
    """Compliance of all ports at any frequency from small real matrices.

    ``matrices`` (n_term, r, r) with ``coefficients``; ``functionals`` (r, n_port); ``last_order`` marks the columns that
    the highest derivatives added. ``basis`` (n, r) reconstructs displacements and scaled pressures.
    """

    coefficients: tuple[Coefficient, ...]
    matrices: FloatArray
    functionals: FloatArray
    shares: FloatArray
    last_order: BoolArray
    basis: FloatArray = field(repr=False)

    @property
    def size(self) -> int:
        """Dimension r of the reduced space."""
        return len(self.last_order)

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

    def without_last_order(self) -> ReducedModel:
        """The model on the smaller space without the highest derivatives: its distance estimates the error."""
        keep = np.flatnonzero(~self.last_order)
        matrices = self.matrices[:, keep[:, None], keep[None, :]]
        return ReducedModel(
            self.coefficients, matrices, self.functionals[keep], self.shares, self.last_order[keep], self.basis[:, keep]
        )

    def projected(self, directions: FloatArray) -> ReducedModel:
        """The model on the span of orthonormal ``directions`` (r, s) of this space."""
        return ReducedModel(
            self.coefficients,
            np.array([directions.T @ m @ directions for m in self.matrices]),
            directions.T @ self.functionals,
            self.shares,
            np.zeros(directions.shape[1], dtype=bool),
            self.basis @ directions,
        )

    def with_coefficients(self, coefficients: Sequence[Coefficient]) -> ReducedModel:
        """The same space for other moduli or densities; its error for them is not certified."""
        return ReducedModel(
            tuple(coefficients), self.matrices, self.functionals, self.shares, self.last_order, self.basis
        )


def empty_model(model: ForearmModel) -> ReducedModel:
    """A reduced model of dimension zero, to be extended."""
    kept = [t for t in model.operator.terms if t.name not in _DROPPED]
    return ReducedModel(
        tuple(_coefficient(t) for t in kept),
        np.zeros((len(kept), 0, 0)),
        np.zeros((0, len(model.ports))),
        model.shares,
        np.zeros(0, dtype=bool),
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
    basis, flags = reduced.basis, reduced.last_order
    for order, block in enumerate(snapshots):
        new = orthonormal_extension(basis, real_columns(block), operator.n_displacements, drop=drop)
        basis = np.hstack([basis, new])
        flags = np.concatenate([flags, np.full(new.shape[1], order == len(snapshots) - 1)])
    added = basis[:, reduced.size :]
    matrices = _extended_matrices(reduced, operator, basis, added)
    functionals = np.vstack([reduced.functionals, added.T @ model.functionals])
    return ReducedModel(reduced.coefficients, matrices, functionals, reduced.shares, flags, basis)


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


def save_reduced(reduced: ReducedModel, path: Path, *, with_basis: bool) -> None:
    """Store matrices and functionals (a few MB), and on request the basis in single precision."""
    basis = reduced.basis.astype(np.float32) if with_basis else np.zeros((0, reduced.size), dtype=np.float32)
    np.savez_compressed(
        path, matrices=reduced.matrices, functionals=reduced.functionals, shares=reduced.shares,
        last_order=reduced.last_order, basis=basis,
    )  # fmt: skip


def load_reduced(path: Path, coefficients: Sequence[Coefficient]) -> ReducedModel:
    """A stored reduced model; the coefficients come from the scenario (``ForearmModel`` order, see `empty_model`)."""
    with np.load(path) as store:
        return ReducedModel(
            tuple(coefficients), store["matrices"], store["functionals"], store["shares"],
            store["last_order"], store["basis"].astype(float),
        )  # fmt: skip
