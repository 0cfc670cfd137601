"""Structure-preserving reduced model on displacements with their pressures, and their frequency derivatives.

Each basis vector is a displacement together with its own pressure, made orthonormal in the displacements: the saddle
system projected on such pairs is as good as the condensed one, because solutions obey B u = -S p. Kept in saddle form
it is stationary, so that what solves leave of B u + S p enters squared: single-precision factors are enough
(decision 0004). Where tissue is compressible the pressures are then those that suit best within the span of all
of them, which keeps the stiffness positive whatever solves leave. Every term
stays real symmetric, which keeps reciprocity and passivity; the span of the real and the imaginary parts is used.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...typing import ComplexArray, FloatArray, IntArray
from ..assembly.coefficients import Coefficient, grouped, polynomial_of
from ..assembly.model import ForearmModel
from ..assembly.operator import AffineOperator
from ..assembly.thickness import follows_thickness
from .basis import Basis, Columns, inverse_or_zero, orthonormal_extension, real_columns

_DROP = 1e-5  # of a snapshot's length: weaker directions carry what single-precision solves leave, and cost time
_SAME = 1e-10  # of the strongest pressures' energy, each of unit energy: weaker combinations of them are rounding
_COUPLING, _STORAGE = "incompressibility", "compression"  # terms that hold pressures
_NEGATIVE = 1e-12  # of the stiffest direction: what rounding leaves of one without stiffness
_TYPICAL = 2 * np.pi * 100.0  # [rad/s] where moduli that have no static value are looked at


@dataclass(frozen=True)
class ReducedModel:
    """Compliance of all ports at any frequency from small real matrices.

    ``matrices`` (n_term, r, r) of the operator's terms ``names`` with ``coefficients``; ``functionals`` (r, n_port).
    ``basis`` holds the columns (n, r) that give displacements and scaled pressures. ``low`` (r, m) are coordinates of
    all snapshots but the highest derivative of each port: :meth:`lower` is the model without these. ``coupling`` (r, r)
    are products of each column's pressure with the divergence of each displacement, which only :func:`with_columns`
    needs. ``places`` (r, k) read displacements where there are no ports, worked out for a space that
    does not grow any more.
    """

    names: tuple[str, ...]
    coefficients: tuple[Coefficient, ...]
    matrices: FloatArray
    functionals: FloatArray
    shares: FloatArray
    basis: Basis = field(repr=False)
    low: FloatArray = field(repr=False)
    coupling: FloatArray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    places: FloatArray = field(default_factory=lambda: np.zeros((0, 0)), repr=False)

    @property
    def size(self) -> int:
        """Dimension r of the reduced space."""
        return len(self.functionals)

    def states(self, frequency: FloatArray) -> ComplexArray:
        """Reduced solutions (n_frequency, r, n_port) for a unit force on each port."""
        omega = 2 * np.pi * np.asarray(frequency, dtype=float)
        sums = grouped(self.coefficients)
        flat = np.array([np.tensordot(weights, self.matrices, 1).ravel() for weights, _ in sums])
        theta = np.array([np.broadcast_to(c.at(omega), omega.shape) for _, c in sums])
        right = self.functionals.astype(complex)
        rows = [np.linalg.solve(combined(w, flat).reshape(self.size, self.size), right) for w in theta.T]
        return np.array(rows)

    def compliance(self, frequency: FloatArray) -> ComplexArray:
        """Compliance (n_frequency, n_port, n_port) [m/N]; columns of forces without a symmetric solution are NaN."""
        values = np.einsum("ri,frj->fij", self.functionals, self.states(frequency), optimize=True)
        return np.asarray(values * self.shares)

    def negative_directions(self) -> int:
        """Directions of negative stiffness, as many as there are unstable poles (Kelvin, Tait and Chetaev), any law.

        Moduli that are no polynomials are taken at 100 Hz, as a springpot has no static stiffness.
        """
        held = np.array([_static(c) for c in self.coefficients])
        values = np.linalg.eigvalsh(np.tensordot(held, self.matrices, 1))
        return int(np.sum(values < -_NEGATIVE * np.abs(values).max(initial=0.0)))

    def lower(self, drop: float = _DROP) -> ReducedModel:
        """The model that one derivative fewer per expansion would have given.

        Directions weaker than ``drop`` of the strongest are left out: much more than the derivatives alone where
        expansions lie close together or reach far.
        """
        values, vectors = np.linalg.eigh(self.low @ self.low.T)
        return self.projected(vectors[:, values > drop**2 * values[-1]])

    def projected(self, directions: FloatArray) -> ReducedModel:
        """The model on the span of orthonormal ``directions`` (r, s) of this space."""
        return replace(
            self,
            matrices=np.array([_symmetric(directions.T @ m @ directions) for m in self.matrices]),
            functionals=directions.T @ self.functionals,
            basis=self.basis.combined(directions),
            low=directions.T @ self.low,
            coupling=directions.T @ self.coupling @ directions,
        )

    def changed(self, coefficients: Mapping[str, Coefficient]) -> ReducedModel:
        """The same space with other coefficients for some terms, such as "shear muscle".

        The error for them is not certified: it grows with the change. Raises KeyError for a name
        that is no term.
        """
        if unknown := set(coefficients) - set(self.names):
            raise KeyError(f"no term is called {sorted(unknown)[0]!r}; there are {', '.join(self.names)}")
        own = zip(self.names, self.coefficients, strict=True)
        return replace(self, coefficients=tuple(coefficients.get(name, c) for name, c in own))


def _static(coefficient: Coefficient) -> float:
    """Static value of a term, without inertia."""
    known = polynomial_of(coefficient)
    return float(complex(coefficient.at(np.array(_TYPICAL))).real) if known is None else known[0]


def combined(weights: NDArray[Any], parts: NDArray[Any], number: type = complex) -> NDArray[Any]:
    """weights @ parts as complex numbers of a kind, without a complex copy of the real ``parts`` (k, m)."""
    total: NDArray[Any] = np.empty(parts.shape[1], dtype=number)
    total.real, total.imag = weights.real @ parts, weights.imag @ parts
    return total


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
        Basis(),
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
    widths = [2 * block.shape[1] for block in snapshots]
    highest = [np.tile(orders[orders >= k] == k, 2) for k in range(len(snapshots))]
    added, coordinates = orthonormal_extension(
        reduced.basis, real_columns(snapshots), widths, operator.n_displacements, drop=drop
    )
    return with_columns(reduced, model, added, coordinates[:, ~np.concatenate(highest)])


def with_columns(reduced: ReducedModel, model: ForearmModel, added: Columns, low: FloatArray) -> ReducedModel:
    """The space with orthonormal ``added`` columns (n, k); ``low`` (r + k, m) are the lower model's snapshots in it."""
    operator, old, basis = model.operator, reduced.size, reduced.basis.with_block(added)
    total, place = old + added.shape[1], reduced.names.index(_COUPLING)
    matrices, coupling = np.zeros((len(operator.terms), total, total)), np.zeros((total, total))
    columns = _projected(basis, operator, added)  # only products with the added columns are new
    coupling[:old, :old] = reduced.coupling
    coupling[old:], coupling[:, old:] = columns[place].T, columns[-1]
    matrices[:, :old, :old] = reduced.matrices
    for matrix, new in zip(matrices, columns[:-1], strict=True):
        matrix[:, old:] = new
        matrix[old:, :old] = new[:old].T
        matrix[old:, old:] = _symmetric(new[old:])
    matrices[place] = coupling + coupling.T
    if compressible(model.operator):
        matrices[place] = condensed(coupling, -matrices[reduced.names.index(_STORAGE)])
    return replace(
        reduced,
        matrices=matrices,
        functionals=np.vstack([reduced.functionals, Basis((added,)).inner(model.functionals)]),
        basis=basis,
        low=np.hstack([np.pad(reduced.low, ((0, added.shape[1]), (0, 0))), low]),
        coupling=coupling,
    )


def with_last_columns(reduced: ReducedModel, model: ForearmModel, added: Columns) -> ReducedModel:
    """The space with orthonormal columns ``added`` (n, k), without which the lower model is all there was."""
    nothing = np.zeros((reduced.size + added.shape[1], 0))
    return with_columns(replace(reduced, low=np.eye(reduced.size)), model, added, nothing)


def condensed(coupling: FloatArray, storage: FloatArray) -> FloatArray:
    """The coupling's matrix (r, r) with which pressures are the best in their span: S + G^T S^+ G.

    ``coupling`` G and ``storage`` S (r, r) are products of all pressures with divergences and, by what they compress,
    with each other. With each displacement's own pressure it were G + G^T, less than this by (G - S)^T S^+ (G - S):
    nothing for exact solutions, squares of what solves leave, and in weak directions, of which single precision leaves
    noise only, what had made the stiffness negative. Here S cancels against the compression's term, -S, and
    G^T S^+ G is an energy.
    """
    unit = inverse_or_zero(np.sqrt(np.maximum(storage.diagonal(), 0.0)))
    values, vectors = np.linalg.eigh(unit[:, None] * storage * unit)
    keep = values > _SAME * values.max(initial=0.0)
    seen = ((unit[:, None] * vectors[:, keep]) / np.sqrt(values[keep])).T @ coupling
    return np.asarray(_symmetric(storage) + seen.T @ seen)


def compressible(operator: AffineOperator) -> bool:
    """True if all pressures compress something: where tissue is incompressible their energy says nothing of them.

    Nor does it where layers change their thickness, and pressures their divergences.
    """
    if follows_thickness([t.name for t in operator.terms]):
        return False
    storage = next(t for t in operator.terms if t.name == _STORAGE)
    return bool((operator.term_matrix(storage).diagonal()[operator.n_displacements :] < 0).all())


def _projected(basis: Basis, operator: AffineOperator, added: Columns) -> FloatArray:
    """Products (n_term + 1, r, k) of the basis with A_t times the ``added`` columns (n, k), in one pass over the rows.

    The coupling's stand in two parts: that of the displacements' rows in its place, that of the pressures' last.
    """
    matrices, product, first = operator.matrices, operator.matrices.products(added), operator.n_displacements
    coupling, pressures = [t.name for t in operator.terms].index(_COUPLING), len(operator.terms)

    def given(rows: slice) -> Iterator[tuple[int, FloatArray]]:
        """Term and rows of its product with the added columns, where these are not zero."""
        for t in matrices.touching(rows):
            y = product(t, rows)
            if t != coupling or rows.stop <= first:
                yield t, y
            elif rows.start >= first:
                yield pressures, y
            else:
                upper = np.arange(rows.start, rows.stop)[:, None] < first
                yield coupling, np.where(upper, y, 0.0)
                yield pressures, np.where(upper, 0.0, y)

    return basis.inner_of(given, (matrices.n, pressures + 1, added.shape[1]))
