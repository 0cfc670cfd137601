"""Affine reduced model: a small real matrix a term, times coefficients of tissue and frequency.

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
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ...geometry.limb.thickness import stretches
from ...scenario import Scenario
from ...scenario.limb import Limb
from ...scenario.model import resolve_tissues
from ...store.record import UNKEPT, dims
from ...store.shelf import Shelf
from ...typing import ComplexArray, FloatArray, IntArray
from ..assembly.coefficients import (
    Coefficient,
    grouped,
    is_polynomial,
    polynomial_of,
    polynomial_weights,
    term_coefficient,
)
from ..assembly.model import ForearmModel
from ..assembly.operator import AffineOperator
from ..assembly.thickness import follows_thickness
from ..kernels.compiled import in_threads, one_blas_thread
from .basis import Basis, Columns, inverse_or_zero, orthonormal_extension, real_columns
from .rational import chebyshev_frequencies

_DROP = 1e-5  # of a snapshot's length: weaker directions carry what single-precision solves leave, and cost time
_SAME = 1e-10  # of the strongest pressures' energy, each of unit energy: weaker combinations of them are rounding
_COUPLING, _STORAGE = "incompressibility", "compression"  # terms that hold pressures
_NEGATIVE = 1e-12  # of the stiffest direction: what rounding leaves of one without stiffness
_TYPICAL = 2 * np.pi * 100.0  # [rad/s] where moduli that have no static value are looked at
_BAND = np.linspace(10.0, 500.0, 50)  # [Hz]
_PROBES = 5  # bins at which poles and residues are compared with the model they stand for
_AT_ONCE = 100  # frequencies: their weights, as many times all poles, stay in the cache (2000: a third longer)


@dataclass(frozen=True, eq=False)
class Modes:
    """Poles and residues: C(omega) = sum_k left_ik right_kj share_j / (i omega - pole_k), any number of frequencies.

    ``left`` (n_port, n_pole) are the modes seen through the ports, ``right`` (n_pole, n_port) their amplitudes, and
    ``shapes`` (r, n_pole) the modes in the reduced space, None where they were read from a file.
    """

    poles: ComplexArray = field(metadata=dims("mode", units="1/s"))
    left: ComplexArray = field(metadata=dims("port mode"))
    right: ComplexArray = field(metadata=dims("mode port"))
    shares: FloatArray = field(metadata=dims("port", name="share"))
    shapes: ComplexArray | None = field(default=None, repr=False, metadata=UNKEPT)

    def compliance(self, frequency: FloatArray) -> ComplexArray:
        """Compliance (n_frequency, n_port, n_port) [m/N]."""
        s = 2j * np.pi * np.asarray(frequency, dtype=float)
        if len(s) < len(self.left):  # pairs of hundreds of ports, times all poles, come to gigabytes
            products = np.array([(self.left / (one - self.poles)) @ self.right for one in s])
            return np.asarray((products + products.transpose(0, 2, 1)) / 2 * self.shares)
        i, j = np.triu_indices(len(self.left))
        pairs = (self.left[i] * self.right.T[j] + self.left[j] * self.right.T[i]) / 2  # reciprocal to the last digit
        values = np.empty((len(s), len(self.left), len(self.left)), dtype=complex)
        for piece in (slice(k, k + _AT_ONCE) for k in range(0, len(s), _AT_ONCE)):
            values[piece, i, j] = (1 / (s[piece, None] - self.poles)) @ pairs.T
        values[:, j, i] = values[:, i, j]
        return np.asarray(values * self.shares)

    def states(self, frequency: FloatArray, ports: Sequence[int]) -> ComplexArray:
        """Reduced solutions (n_frequency, r, n_chosen) for the force shares of the chosen ``ports``."""
        assert self.shapes is not None
        s = 2j * np.pi * np.asarray(frequency, dtype=float)
        amplitudes = (self.right * self.shares)[:, None, ports] / (s[None, :] - self.poles[:, None])[:, :, None]
        return np.moveaxis(np.tensordot(self.shapes, amplitudes, 1), 1, 0)

    @cached_property
    def half(self) -> tuple[ComplexArray, ComplexArray]:
        """Poles (m,) with imaginary parts of zero and above, and what ports see of them (n, m): its square is their
        residue, for left and right of a symmetric system are proportional."""
        kept = self.poles.imag >= 0
        left, right = self.left[:, kept], self.right[kept].T
        ratio = (right * left.conj()).sum(axis=0) / np.maximum((np.abs(left) ** 2).sum(axis=0), 1e-300)
        return self.poles[kept], np.ascontiguousarray(left * np.sqrt(ratio))


def _none() -> FloatArray:
    return np.zeros((0, 0))


@dataclass(frozen=True, eq=False)
class AffineReduced:
    """Compliance of all ports at any frequency, for any tissue, from small real matrices.

    ``matrices`` (n_term, r, r) of the operator's terms ``names``, symmetric; ``functionals`` (r, n_port) and ``shares``
    (n_port,) of the ports; ``places`` (r, k) read displacements where there are no ports. These are kept on file. The
    terms' ``coefficients`` follow from a scenario (:meth:`at`).

    A space that still grows has the ``basis`` of its columns (n, r), displacements and scaled pressures; ``low``
    (r, m), coordinates of all snapshots but the highest derivative of each port, for :meth:`lower`; and ``coupling``
    (r, r), products of each column's pressure with the divergence of each displacement.
    """

    kind: ClassVar[str] = "affine reduced model"
    version: ClassVar[int] = 1

    names: tuple[str, ...] = field(metadata=dims("term", name="term"))
    matrices: FloatArray = field(metadata=dims("term entry", name="upper", upper=True))
    functionals: FloatArray = field(metadata=dims("row port", name="functional"))
    shares: FloatArray = field(metadata=dims("port", name="share"))
    places: FloatArray = field(default_factory=_none, repr=False, metadata=dims("row place"))
    coefficients: tuple[Coefficient, ...] = field(default=(), metadata=UNKEPT)
    basis: Basis = field(default=Basis(), repr=False, metadata=UNKEPT)
    low: FloatArray = field(default_factory=_none, repr=False, metadata=UNKEPT)
    coupling: FloatArray = field(default_factory=_none, repr=False, metadata=UNKEPT)

    @classmethod
    def of(cls, model: ForearmModel) -> Self:
        """A reduced model of dimension zero, to be extended."""
        terms, ports = model.operator.terms, len(model.ports)
        empty = np.zeros((len(terms), 0, 0)), np.zeros((0, ports)), model.shares
        return cls(tuple(t.name for t in terms), *empty, coefficients=tuple(t.coefficient for t in terms))

    @property
    def size(self) -> int:
        """Dimension r of the reduced space."""
        return len(self.functionals)

    def at(self, scenario: Scenario, limb: Limb | None = None) -> Self:
        """The model with the coefficients that ``scenario`` gives its terms (:func:`coefficients_of`)."""
        return replace(self, coefficients=coefficients_of(self.names, scenario, limb))

    def changed(self, coefficients: Mapping[str, Coefficient]) -> Self:
        """The same space with other coefficients for some terms, such as "shear muscle".

        The error for them is not certified: it grows with the change. Raises KeyError for a name
        that is no term.
        """
        if unknown := set(coefficients) - set(self.names):
            raise KeyError(f"no term is called {sorted(unknown)[0]!r}; there are {', '.join(self.names)}")
        own = zip(self.names, self.coefficients, strict=True)
        return replace(self, coefficients=tuple(coefficients.get(name, c) for name, c in own))

    def response(self, frequency: FloatArray) -> ComplexArray:
        """Compliance (n_frequency, n_port, n_port) [m/N] by poles and residues, or by solves where there are none."""
        return (self.modes(frequency) or self).compliance(frequency)

    def compliance(self, frequency: FloatArray) -> ComplexArray:
        """The same by a solve at each frequency; columns of forces without a symmetric solution are NaN."""
        values = np.einsum("ri,frj->fij", self.functionals, self.states(frequency), optimize=True)
        return np.asarray(values * self.shares)

    def states(self, frequency: FloatArray) -> ComplexArray:
        """Reduced solutions (n_frequency, r, n_port) for a unit force on each port."""
        omega = 2 * np.pi * np.asarray(frequency, dtype=float)
        sums = grouped(self.coefficients)
        with one_blas_thread():
            flat = np.array([self.combined(weights).ravel() for weights, _ in sums])
        theta = np.array([np.broadcast_to(c.at(omega), omega.shape) for _, c in sums])
        right = self.functionals.astype(complex)

        def solved(weights: ComplexArray) -> ComplexArray:
            """Solutions (r, n_port) at one frequency."""
            return np.asarray(np.linalg.solve(combined(weights, flat).reshape(self.size, self.size), right))

        return np.array(in_threads(solved, list(theta.T)))

    def modes(self, frequency: FloatArray = _BAND) -> Modes | None:
        """Diagonalised pencil, or None where a modulus is not Kelvin-Voigt or the diagonalisation is inaccurate.

        Every coefficient must be a polynomial of second degree in omega (Kelvin-Voigt, springs, dashpots, masses). With
        s = i omega: (K + s C + s^2 M) q = f, first companion form s [q, s q]; the result is checked against solves at
        bins of ``frequency`` (n,) [Hz], where it will be used, and refused above 1e-8.
        """
        if not all(is_polynomial(c) for c in self.coefficients):
            return None
        result = self._diagonalised()
        probes = frequency[np.unique(np.linspace(0, len(frequency) - 1, _PROBES).astype(int))]
        exact, fast = self.compliance(probes), result.compliance(probes)
        off, scale = np.nanmax(np.abs(exact - fast), axis=(1, 2)), np.nanmax(np.abs(exact), axis=(1, 2))
        return result if np.all(off < 1e-8 * scale) else None

    @one_blas_thread()
    def _diagonalised(self) -> Modes:
        """Poles and residues, unchecked."""
        taylor = np.array([c.taylor(0.0, 2) for c in self.coefficients])
        stiffness, damping, mass = (self.combined(w) for w in polynomial_weights(taylor))
        r, functionals = self.size, self.functionals
        rate = np.sqrt(np.linalg.norm(stiffness) / np.linalg.norm(mass))  # a typical one, the unit of s
        inverse_k = np.linalg.solve(mass, stiffness) / rate**2
        inverse_c = np.linalg.solve(mass, damping) / rate
        companion = np.block([[np.zeros((r, r)), np.eye(r)], [-inverse_k, -inverse_c]])
        values, vectors = scipy.linalg.eig(companion)
        source = np.vstack([np.zeros_like(functionals), np.linalg.solve(mass, functionals) / rate**2])
        shapes, right = vectors[:r], np.linalg.solve(vectors, source) * rate
        return Modes(values * rate, functionals.T @ shapes, right, self.shares, shapes)

    def combined(self, weights: NDArray[Any]) -> NDArray[Any]:
        """Sum (r, r) of the terms' matrices by ``weights`` (n_term,)."""
        return np.tensordot(weights, self.matrices, 1)

    def theta(self, frequency: float) -> ComplexArray:
        """Coefficients (n_term,) at one frequency [Hz]."""
        return np.array([complex(c.at(np.array(2 * np.pi * frequency))) for c in self.coefficients])

    @one_blas_thread()
    def negative_directions(self) -> int:
        """Directions of negative stiffness, as many as there are unstable poles (Kelvin, Tait and Chetaev), any law.

        Moduli that are no polynomials are taken at 100 Hz, as a springpot has no static stiffness.
        """
        values = np.linalg.eigvalsh(self.combined(np.array([_static(c) for c in self.coefficients])))
        return int(np.sum(values < -_NEGATIVE * np.abs(values).max(initial=0.0)))

    def lower(self, drop: float = _DROP) -> Self:
        """The model that one derivative fewer per expansion would have given.

        Directions weaker than ``drop`` of the strongest are left out: much more than the derivatives alone where
        expansions lie close together or reach far.
        """
        kept = self.low.shape[1]
        if np.array_equal(self.low, np.eye(self.size, kept)):
            return self.part(slice(kept))
        values, vectors = np.linalg.eigh(self.low @ self.low.T)
        return self.projected(vectors[:, values > drop**2 * values[-1]])

    @one_blas_thread()
    def projected(self, directions: FloatArray) -> Self:
        """The model on the span of orthonormal ``directions`` (r, s) of this space."""
        return replace(
            self,
            matrices=np.array([_symmetric(directions.T @ m @ directions) for m in self.matrices]),
            functionals=directions.T @ self.functionals,
            places=directions.T @ self.places if len(self.places) else self.places,
            basis=self.basis.combined(directions) if self.basis.blocks else self.basis,
            low=directions.T @ self.low if len(self.low) else self.low,
            coupling=directions.T @ self.coupling @ directions if len(self.coupling) else self.coupling,
        )

    def compressed(self, frequency: FloatArray, *, samples: int = 48, drop: float = 1e-6) -> Self:
        """The model on the span of its own states at ``samples`` frequencies spread over the band.

        Singular directions below ``drop`` of the largest (states of unit length) are left out; projection keeps the
        structure. Costs ``samples`` small solves, and makes each later frequency several times cheaper.
        """
        states = self.states(chebyshev_frequencies(frequency, samples))
        columns = np.concatenate([states.real, states.imag], axis=2).transpose(1, 0, 2).reshape(self.size, -1)
        norms = np.linalg.norm(columns, axis=0)
        keep = norms > 1e-12 * norms.max()
        left, values, _ = np.linalg.svd(columns[:, keep] / norms[keep], full_matrices=False)
        return self.projected(left[:, values > drop * values[0]])

    def bare(self) -> Self:
        """The model that does not grow any more, without its columns: what is kept of it."""
        return replace(self, basis=Basis(), low=_none(), coupling=_none())

    def part(self, kept: NDArray[Any] | slice) -> Self:
        """:meth:`bare` on the ``kept`` directions alone, by their places or a mask (r,)."""
        chosen = np.arange(self.size)[kept]
        return replace(
            self.bare(),
            matrices=self.matrices[:, chosen[:, None], chosen],
            functionals=self.functionals[chosen],
            places=self.places[chosen] if len(self.places) else self.places,
        )

    def keep(self, shelf: Shelf, **facts: Any) -> None:
        """Keep the space as it grows, with ``facts`` on how far it got: its last block of columns is new."""
        blocks = self.basis.blocks
        if shelf.put(f"columns-{len(blocks) - 1}", {"columns": blocks[-1]}):
            grown = {name: getattr(self, name) for name in _GROWN}
            shelf.put("space", {**facts, **grown, "blocks": len(blocks)})

    def restored(self, shelf: Shelf) -> tuple[Self, dict[str, Any]] | None:
        """The space that this empty one had grown to, with its facts; None where some of it is missing or damaged."""
        if (space := shelf.get("space")) is None:
            return None
        parts = [shelf.get(f"columns-{k}") for k in range(space["blocks"])]
        blocks, size = tuple(p["columns"] for p in parts if p is not None), len(space["functionals"])
        if len(blocks) < len(parts) or sum(b.shape[1] for b in blocks) != size:
            return None
        grown = {name: space[name] for name in _GROWN}
        return replace(self, **grown, basis=Basis(blocks), low=np.zeros((size, 0))), space


_GROWN = ("matrices", "functionals", "coupling")


def coefficients_of(names: Sequence[str], scenario: Scenario, limb: Limb | None = None) -> tuple[Coefficient, ...]:
    """Coefficients of the terms ``names`` in ``scenario``, whose layers may be of other thicknesses than the ``limb``
    that the terms are of."""
    tissues, sheets = resolve_tissues(scenario), scenario.tissues
    found = (stretches(limb, scenario.limb) if limb is not None else None) or {}
    return tuple(term_coefficient(n, tissues, scenario.supports, sheets.membrane, sheets.patch, found) for n in names)


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


def extend(
    reduced: AffineReduced,
    model: ForearmModel,
    snapshots: Sequence[ComplexArray],
    orders: IntArray | None = None,
    *,
    drop: float = _DROP,
) -> AffineReduced:
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


def with_columns(
    reduced: AffineReduced, model: ForearmModel, added: Columns, low: FloatArray, loads: csr_array | None = None
) -> AffineReduced:
    """The space with orthonormal ``added`` columns (n, k); ``low`` (r + k, m) are the lower model's snapshots in it.

    ``loads`` (n, m) take the place of the model's functionals where these are many.
    """
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
    seen = Basis((added,)).inner(model.functionals) if loads is None else np.asarray(loads.T @ added).T.astype(float)
    return replace(
        reduced,
        matrices=matrices,
        functionals=np.vstack([reduced.functionals, seen]),
        basis=basis,
        low=np.hstack([np.pad(reduced.low, ((0, added.shape[1]), (0, 0))), low]),
        coupling=coupling,
    )


def with_last_columns(reduced: AffineReduced, model: ForearmModel, added: Columns) -> AffineReduced:
    """The space with orthonormal columns ``added`` (n, k), without which the lower model is all there was."""
    nothing = np.zeros((reduced.size + added.shape[1], 0))
    return with_columns(replace(reduced, low=np.eye(reduced.size)), model, added, nothing)


@one_blas_thread()
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
