"""Structure-preserving reduced model on displacements with their pressures, and their frequency derivatives.

Each basis vector is a displacement together with its own pressure, made orthonormal in the displacements: the saddle
system projected on such pairs is as good as the condensed one, because solutions obey B u = -S p. Kept in saddle form
it is stationary, so that what solves leave of B u + S p enters squared: single-precision factors are enough
(docs/decisions.md). Every term stays real symmetric, which keeps reciprocity and passivity; the span of the real and
the imaginary parts is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..typing import ComplexArray, FloatArray, IntArray
from .coefficients import Coefficient
from .model import ForearmModel
from .operator import AffineOperator

_DROP = 1e-5  # of a snapshot's length: weaker directions carry what single-precision solves leave, and cost time


@dataclass(frozen=True)
class ReducedModel:
    """Compliance of all ports at any frequency from small real matrices.

    ``matrices`` (n_term, r, r) of the operator's terms ``names`` with ``coefficients``; ``functionals`` (r, n_port).
    ``basis`` (n, r) reconstructs displacements and scaled pressures. ``low`` (r, m) are coordinates of all snapshots
    but the highest derivative of each port: :meth:`lower` is the model without these.
    """

    names: tuple[str, ...]
    coefficients: tuple[Coefficient, ...]
    matrices: FloatArray
    functionals: FloatArray
    shares: FloatArray
    basis: FloatArray = field(repr=False)
    low: FloatArray = field(repr=False)

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

    def lower(self, drop: float = _DROP) -> ReducedModel:
        """The model that one derivative fewer per expansion would have given, without its basis.

        Directions weaker than ``drop`` of the strongest are left out: much more than the derivatives alone where
        expansions lie close together or reach far.
        """
        values, vectors = np.linalg.eigh(self.low @ self.low.T)
        return replace(self, basis=np.zeros((0, self.size))).projected(vectors[:, values > drop**2 * values[-1]])

    def projected(self, directions: FloatArray) -> ReducedModel:
        """The model on the span of orthonormal ``directions`` (r, s) of this space."""
        return replace(
            self,
            matrices=np.array([_symmetric(directions.T @ m @ directions) for m in self.matrices]),
            functionals=directions.T @ self.functionals,
            basis=self.basis @ directions,
            low=directions.T @ self.low,
        )

    def changed(self, coefficients: Mapping[str, Coefficient]) -> ReducedModel:
        """The same space with other coefficients for some terms, such as "shear muscle".

        The error for them is not certified: it grows with the change (docs/decisions.md). Raises KeyError for a name
        that is no term.
        """
        if unknown := set(coefficients) - set(self.names):
            raise KeyError(f"no term is called {sorted(unknown)[0]!r}; there are {', '.join(self.names)}")
        own = zip(self.names, self.coefficients, strict=True)
        return replace(self, coefficients=tuple(coefficients.get(name, c) for name, c in own))


def _projected(basis: FloatArray, rows: IntArray, product: FloatArray, *, chunk: int = 30_000) -> FloatArray:
    """basis[rows].T @ product, piece by piece: the rows' copy would be as large as the basis."""
    pieces = (slice(i, i + chunk) for i in range(0, len(rows), chunk))
    start = np.zeros((basis.shape[1], product.shape[1]))
    return np.asarray(sum((basis[rows[p]].T @ product[p] for p in pieces), start))


def _symmetric(matrix: FloatArray) -> FloatArray:
    return (matrix + matrix.T) / 2


def empty_model(model: ForearmModel) -> ReducedModel:
    """A reduced model of dimension zero, to be extended."""
    terms = model.operator.terms
    return ReducedModel(
        tuple(t.name for t in terms),
        tuple(t.coefficient for t in terms),
        np.zeros((len(terms), 0, 0)),
        np.zeros((0, len(model.ports))),
        model.shares,
        np.zeros((model.operator.n, 0)),
        np.zeros((0, 0)),
    )


def extend(
    reduced: ReducedModel,
    model: ForearmModel,
    snapshots: Sequence[ComplexArray],
    orders: IntArray | None = None,
    *,
    drop: float = _DROP,
) -> ReducedModel:
    """Add solutions and derivatives to the space: ``snapshots[k]`` (n, k_column) of derivative order k.

    ``orders`` (n_port,) are the highest orders of each port's solution, the same for all where left out.
    """
    operator = model.operator
    orders = np.full(snapshots[0].shape[1], len(snapshots) - 1) if orders is None else orders
    blocks = [real_columns(block) for block in snapshots]
    highest = [np.tile(orders[orders >= k] == k, 2) for k in range(len(blocks))]
    added, coordinates = orthonormal_extension(reduced.basis, blocks, operator.n_displacements, drop=drop)
    low = coordinates[:, ~np.concatenate(highest)]
    old = np.vstack([reduced.low, np.zeros((added.shape[1], reduced.low.shape[1]))])
    basis = np.hstack([reduced.basis, added])
    matrices = _extended_matrices(reduced, operator, basis, added)
    functionals = np.vstack([reduced.functionals, added.T @ model.functionals])
    return replace(reduced, matrices=matrices, functionals=functionals, basis=basis, low=np.hstack([old, low]))


def real_columns(block: ComplexArray) -> FloatArray:
    """Real and imaginary parts (n, 2 k) side by side, columns of unit length, negligible ones zero."""
    columns = np.hstack([block.real, block.imag])
    norms = np.linalg.norm(columns, axis=0)
    kept = norms > 1e-14 * norms.max()
    return np.asarray(columns * np.where(kept, 1 / np.where(kept, norms, 1.0), 0.0))


def orthonormal_extension(
    basis: FloatArray, blocks: Sequence[FloatArray], n_u: int, *, drop: float = _DROP
) -> tuple[FloatArray, FloatArray]:
    """Columns made orthonormal, in their displacements, to ``basis`` and each other; pressures follow along.

    ``blocks`` are taken in turn, derivative order by order. Directions whose independent part is below ``drop`` of a
    column's length are left out: what rounding leaves of them would only add noise. The second result are the
    coordinates of all columns, scaled to unit length, in the basis and the new directions together.
    """
    columns = np.hstack(blocks)
    norms = np.linalg.norm(columns[:n_u], axis=0)
    columns /= np.where(norms > 0, norms, 1.0)
    known = basis[:n_u].T @ columns[:n_u]
    columns -= basis @ known
    gram = columns[:n_u].T @ columns[:n_u]
    directions = _directions(gram, [b.shape[1] for b in blocks], drop)
    added = without(basis, columns @ directions, n_u)  # weak directions had rounding of the known ones left in them
    half = np.linalg.inv(np.linalg.cholesky(added[:n_u].T @ added[:n_u])).T
    return added @ half, np.vstack([known, (directions @ half).T @ gram])


def without(basis: FloatArray, columns: FloatArray, n_u: int) -> FloatArray:
    """Columns less their part in the span of an orthonormal ``basis``."""
    return np.asarray(columns - basis @ (basis[:n_u].T @ columns[:n_u])) if basis.shape[1] else columns


def _directions(gram: FloatArray, widths: Sequence[int], drop: float) -> FloatArray:
    """Combinations (k, m) of columns, none longer than 1, that are orthonormal by their products ``gram`` (k, k).

    Column blocks of the given ``widths`` in turn, directions weaker than ``drop`` left out. Their products are known
    to 1e-16, so the weakest directions kept come out orthonormal to 1e-16 / drop^2 only: see the caller.
    """
    chosen, starts = np.zeros((len(gram), 0)), np.cumsum([0, *widths[:-1]])
    for start, width in zip(starts, widths, strict=True):
        rest = np.eye(len(gram))[:, start : start + width]
        for _ in range(2):
            rest = rest - chosen @ (chosen.T @ (gram @ rest))
            values, vectors = np.linalg.eigh(rest.T @ gram @ rest)
            keep = values > drop**2
            rest = rest @ (vectors[:, keep] / np.sqrt(values[keep]))
        chosen = np.hstack([chosen, rest])
    return chosen


def _extended_matrices(
    reduced: ReducedModel, operator: AffineOperator, basis: FloatArray, added: FloatArray
) -> FloatArray:
    """Projected matrices of all terms; only products with the added columns are new."""
    old, total = reduced.size, basis.shape[1]
    matrices = np.zeros((len(operator.terms), total, total))
    matrices[:, :old, :old] = reduced.matrices
    for matrix, term in zip(matrices, operator.terms, strict=True):
        rows, matrix_there = operator.compact[term.name]
        columns = _projected(basis, rows, matrix_there.product(added[rows]))
        matrix[:, old:] = columns
        matrix[old:, :old] = columns[:old].T
        matrix[old:, old:] = (columns[old:] + columns[old:].T) / 2
    return matrices
