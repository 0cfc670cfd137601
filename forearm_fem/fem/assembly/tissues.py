"""Real matrices of each tissue from per-element reference tensors: the work of scikit-fem's forms at memory speed.

On an affine tetrahedron every integral is a fixed tensor of the reference element contracted with the Jacobian,
D_ij = |J| sum_ab (J^-1)_ai (J^-1)_bj R_ab, so no quadrature loop is left (design.md: 125 s -> seconds). Where edges
bend there is one (:func:`bent_matrices`). Equality with scikit-fem's own forms is tested to 1e-13.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.sparse import bsr_array, csr_array, eye_array, kron
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from ...typing import BoolArray, FloatArray, IntArray
from ..kernels.compiled import compiled
from ..kernels.matrices import added, congruent, projected
from ..space.numbering import MixedSpace, tabulate
from ..space.orders import Orders

_MORE = 2  # degrees of the rule for bent tetrahedra beyond what is exact where edges are straight
_BENT_AT_ONCE = 250  # of them, whose matrices stay in the cache
_FIBRES_AT_ONCE = 1000  # tetrahedra, whose matrices take some ten megabytes


_Blocks = Iterator[tuple[IntArray, FloatArray]]  # some tetrahedra by number, and 3x3 blocks of their matrices


@dataclass(frozen=True)
class ReferenceTensors:
    """Integrals over the reference tetrahedron: gradients (3, 3, nb, nb), masses and divergence (3, npb, nb)."""

    gradient: FloatArray
    mass: FloatArray
    pressure_mass: FloatArray
    divergence: FloatArray


def reference_tensors(space: MixedSpace) -> ReferenceTensors:
    """Integrals of the pair's basis functions by a quadrature that is exact for them."""
    points, weights = get_quadrature(RefTet, space.pair.degree)
    value, slope = tabulate(space.pair.displacement, points)
    pressure, _ = tabulate(space.pair.pressure, points)
    return ReferenceTensors(
        np.einsum("aiq,bjq,q->ijab", slope, slope, weights),
        np.einsum("aq,bq,q->ab", value, value, weights),
        np.einsum("aq,bq,q->ab", pressure, pressure, weights),
        np.einsum("pq,biq,q->ipb", pressure, slope, weights),
    )


@dataclass(frozen=True)
class TissueMatrices:
    """Real matrices of one tissue, over all unknowns of a space before constraints, or over those solved for.

    ``shear`` per unit shear modulus, ``mass`` per unit density (both n_u x n_u), ``divergence`` (n_p x n_u) and
    ``pressure_mass`` (n_p x n_p); ``fibres`` as ``shear``, where they are asked for.
    """

    shear: csr_array
    mass: csr_array
    divergence: csr_array
    pressure_mass: csr_array
    fibres: csr_array | None = None


def tissue_matrices(
    space: MixedSpace, region: int, reference: ReferenceTensors, *, only: BoolArray | None = None, fibres: bool = False
) -> TissueMatrices:
    r"""Matrices of one tissue, from its tetrahedra among ``only`` (n_tet,).

    shear: :math:`\int 2\,\epsilon(u):\epsilon(v) - \tfrac23 \nabla\cdot u\,\nabla\cdot v`; mass: :math:`\int u\cdot v`;
    divergence: :math:`\int q\,\nabla\cdot u`; pressure mass: :math:`\int p q` (scaled by -1/bulk in the operator);
    fibres: :math:`\int \gamma_{xy}(u)\gamma_{xy}(v) + \gamma_{xz}(u)\gamma_{xz}(v)`, shear's part that holds x.
    """
    chosen = np.flatnonzero(space.mesh.region == region if only is None else only & (space.mesh.region == region))
    jacobian = space.jacobians[chosen]
    inverse = np.asarray(np.linalg.inv(jacobian), dtype=float)
    volume = np.abs(np.asarray(np.linalg.det(jacobian), dtype=float))
    volume[space.is_bent[chosen]] = 0.0  # these are added piece by piece
    build = _by_sorting if compiled("kernels.scatter") is None else _by_kernels
    along = _fibre_blocks(space, chosen, inverse, volume, reference.gradient) if fibres else None
    return build(space, chosen, inverse, volume, reference, along)


def _by_kernels(
    space: MixedSpace,
    chosen: IntArray,
    inverse: FloatArray,
    volume: FloatArray,
    reference: ReferenceTensors,
    along: _Blocks | None,
) -> TissueMatrices:
    """With the compiled kernels of :mod:`forearm_fem.fem.kernels.scatter`."""
    kernels: Any = compiled("kernels.scatter")
    nodes, pressures = (n[chosen].astype(np.int32) for n in (space.nodes, space.pressures))
    n, n_u, n_p = space.n_nodes, space.n_displacements, space.n_pressures
    pairs, mixed = kernels.pattern(nodes, nodes, n, n), kernels.pattern(pressures, nodes, n_p, n)
    paired = kernels.pattern(pressures, pressures, n_p, n_p)
    gradient = np.ascontiguousarray(reference.gradient).reshape(9, -1)
    shear = kernels.shear(nodes, pairs, inverse, volume, gradient)
    masses = kernels.scalars(pairs, volume, reference.mass)
    divergence = kernels.gradients(mixed, inverse, volume, reference.divergence)
    storage = kernels.scalars(paired, volume, reference.pressure_mass)
    bent = np.flatnonzero(space.is_bent[chosen])
    for piece, part in bent_matrices(space, chosen[bent]):
        kernels.add_blocks_in_place(shear, pairs, nodes, bent[piece], part.shear)
        kernels.add_scalars_in_place(masses, pairs, bent[piece], part.mass)
        kernels.add_gradients_in_place(divergence, mixed, bent[piece], part.divergence)
        kernels.add_scalars_in_place(storage, paired, bent[piece], part.pressure_mass)
    stiff = None if along is None else np.zeros_like(shear)
    for some, blocks in along or ():
        kernels.add_blocks_in_place(stiff, pairs, nodes, some, blocks)
    starts, columns = kernels.blocks_of(pairs.indptr, pairs.indices, 3)
    scalar_starts, scalar_columns, masses = kernels.diagonals_of(pairs.indptr, pairs.indices, masses)
    mixed_starts, mixed_columns = kernels.blocks_of(mixed.indptr, mixed.indices, 1)
    return TissueMatrices(
        csr_array((shear, columns, starts), shape=(n_u, n_u)),
        csr_array((masses, scalar_columns, scalar_starts), shape=(n_u, n_u)),
        csr_array((divergence, mixed_columns, mixed_starts), shape=(n_p, n_u)),
        csr_array((storage, paired.indices, paired.indptr), shape=(n_p, n_p)),
        None if stiff is None else csr_array((stiff, columns, starts), shape=(n_u, n_u)),
    )


def _by_sorting(
    space: MixedSpace,
    chosen: IntArray,
    inverse: FloatArray,
    volume: FloatArray,
    reference: ReferenceTensors,
    along: _Blocks | None,
) -> TissueMatrices:
    """With NumPy alone, element pairs sorted."""
    nodes, pressures = space.nodes[chosen], space.pressures[chosen]
    blocks = shear_blocks(inverse, volume, reference.gradient)
    mass, storage = (volume[:, None, None] * r for r in (reference.mass, reference.pressure_mass))
    divergence = np.einsum("e,eai,apb->iepb", volume, inverse, reference.divergence, optimize=True)
    bent = np.flatnonzero(space.is_bent[chosen])
    for piece, part in bent_matrices(space, chosen[bent]):
        blocks[:, :, bent[piece]], divergence[:, bent[piece]] = part.shear, part.divergence
        mass[bent[piece]], storage[bent[piece]] = part.mass, part.pressure_mass
    stiff: FloatArray | None = None
    if along is not None:
        stiff = np.zeros_like(blocks)
        for some, stiffer in along:
            stiff[:, :, some] = stiffer
    n, n_u, n_p = space.n_nodes, space.n_displacements, space.n_pressures
    parts = [scatter(pressures, 3 * nodes + i, divergence[i], (n_p, n_u)) for i in range(3)]
    return TissueMatrices(
        scatter_blocks(nodes, nodes, blocks, (n, n)),
        csr_array(kron(scatter(nodes, nodes, mass, (n, n)), np.eye(3), format="csr")),
        csr_array(parts[0] + parts[1] + parts[2]),
        scatter(pressures, pressures, storage, (n_p, n_p)),
        None if stiff is None else scatter_blocks(nodes, nodes, stiff, (n, n)),
    )


def _fibre_blocks(
    space: MixedSpace, chosen: IntArray, inverse: FloatArray, volume: FloatArray, reference: FloatArray
) -> _Blocks:
    """Blocks (3, 3, k, nb, nb) of the energy of both shears with x, of some of the ``chosen`` tetrahedra at a time."""
    straight, bent = (np.flatnonzero(space.is_bent[chosen] == which) for which in (False, True))
    for some in np.split(straight, range(_FIBRES_AT_ONCE, len(straight), _FIBRES_AT_ONCE)):
        yield some, shear_blocks(inverse[some], volume[some], reference, _along_fibres)
    for piece, part in bent_matrices(space, chosen[bent], _along_fibres):
        yield bent[piece], part.shear


def constrained_matrices(orders: Orders, region: int, transform: csr_array, *, fibres: bool = False) -> TissueMatrices:
    """Matrices of one tissue over the unknowns that are solved for: ``transform`` (3 n_kept, n_free) of those kept."""
    pressures = csr_array(eye_array(orders.spread_pressures.shape[1], format="csr"))
    plain = _projected(orders.low, region, ~orders.raised, transform, pressures, fibres)
    if not orders.raised.any():
        return plain
    raised = _projected(orders.high, region, orders.raised, orders.carried(transform), orders.spread_pressures, fibres)
    pairs = ((getattr(plain, f.name), getattr(raised, f.name)) for f in fields(plain))
    return TissueMatrices(*(None if one is None else added([one, other]) for one, other in pairs))


def _projected(
    space: MixedSpace, region: int, only: BoolArray, u: csr_array, p: csr_array, fibres: bool
) -> TissueMatrices:
    """Matrices of a tissue's tetrahedra among ``only``; ``u`` and ``p`` give this space's unknowns from those kept."""
    part = tissue_matrices(space, region, reference_tensors(space), only=only, fibres=fibres)
    return TissueMatrices(
        congruent(part.shear, u),
        congruent(part.mass, u),
        projected(p, part.divergence, u),
        congruent(part.pressure_mass, p),
        None if part.fibres is None else congruent(part.fibres, u),
    )


def _deviatoric(metric: FloatArray) -> FloatArray:
    """Blocks (3, 3, ...) of the stiffness that keeps volumes free, from products (3, 3, ...) of gradients."""
    blocks = np.swapaxes(metric, 0, 1) - (2 / 3) * metric
    trace = metric[0, 0] + metric[1, 1] + metric[2, 2]
    for i in range(3):
        blocks[i, i] += trace
    return np.asarray(blocks)


def _along_fibres(metric: FloatArray) -> FloatArray:
    """The same of both shears with x, in which fibres along x are stiff."""
    blocks = np.zeros_like(metric)
    for i in (1, 2):
        blocks[0, 0] += metric[i, i]
        blocks[i, i] += metric[0, 0]
        blocks[0, i], blocks[i, 0] = metric[i, 0], metric[0, i]
    return blocks


def shear_blocks(
    inverse: FloatArray,
    volume: FloatArray,
    reference: FloatArray,
    energy: Callable[[FloatArray], FloatArray] = _deviatoric,
) -> FloatArray:
    """3x3 blocks (3, 3, n_tet, nb, nb) of the ``energy``, the deviatoric one or another, from gradients' reference
    tensor.

    The blocks are combined as 3x3 tensors of the Jacobian, before the contraction makes them nb^2 / 9 times larger.
    """
    metric = np.einsum("e,eai,ebj->ijeab", volume, inverse, inverse, optimize=True)
    nb = reference.shape[2]
    whole = energy(metric).reshape(9 * len(volume), 9) @ reference.reshape(9, nb * nb)
    return np.asarray(whole.reshape(3, 3, len(volume), nb, nb))


@dataclass(frozen=True)
class BentMatrices:
    """Element matrices of k tetrahedra: ``shear`` (3, 3, k, nb, nb) as :func:`shear_blocks` has them,
    ``mass`` (k, nb, nb), ``divergence`` (3, k, npb, nb) and ``pressure_mass`` (k, npb, npb)."""

    shear: FloatArray
    mass: FloatArray
    divergence: FloatArray
    pressure_mass: FloatArray


def bent_matrices(
    space: MixedSpace, tetrahedra: IntArray, energy: Callable[[FloatArray], FloatArray] = _deviatoric
) -> Iterator[tuple[slice, BentMatrices]]:
    """Matrices of some ``tetrahedra`` (n,), piece by piece, and which of them each piece holds; ``shear`` is that of
    the ``energy``."""
    if not len(tetrahedra):
        return
    points, weights = get_quadrature(RefTet, space.pair.degree + _MORE)
    values, slopes = tabulate(space.pair.displacement, points)
    pressures, _ = tabulate(space.pair.pressure, points)
    for start in range(0, len(tetrahedra), _BENT_AT_ONCE):
        piece = slice(start, start + _BENT_AT_ONCE)
        jacobians = space.jacobians_at(tetrahedra[piece], points)
        measure = np.abs(np.linalg.det(jacobians)) * weights
        gradients = np.einsum("nqri,brq->nibq", np.linalg.inv(jacobians), slopes, optimize=True)
        n, _, nb, q = gradients.shape
        rows = gradients.reshape(n, 3 * nb, q)
        metric = (rows * measure[:, None]) @ rows.transpose(0, 2, 1)
        part = BentMatrices(
            energy(metric.reshape(n, 3, nb, 3, nb).transpose(1, 3, 0, 2, 4)),
            _mass(values, measure),
            np.einsum("pq,nibq->inpb", pressures, gradients * measure[:, None, None], optimize=True),
            _mass(pressures, measure),
        )
        yield piece, part


def _mass(values: FloatArray, measure: FloatArray) -> FloatArray:
    """Integrals (n, nb, nb) of products of functions with ``values`` (nb, q)."""
    products = (values[:, None] * values).reshape(-1, values.shape[1])
    return np.asarray((measure @ products.T).reshape(len(measure), len(values), len(values)))


def scatter(rows: IntArray, columns: IntArray, values: FloatArray, shape: tuple[int, int]) -> csr_array:
    """Sum element matrices (n_tet, nr, nc) into a CSR matrix."""
    order, start, row, column = element_pattern(rows, columns, shape[1])
    data = np.add.reduceat(values.reshape(-1)[order], start)
    return csr_array((data, column, _row_pointer(row, shape[0])), shape=shape)


def scatter_blocks(rows: IntArray, columns: IntArray, blocks: FloatArray, shape: tuple[int, int]) -> csr_array:
    """Sum 3x3 element blocks (3, 3, n_tet, nr, nc) into a CSR matrix of three times the shape."""
    order, start, row, column = element_pattern(rows, columns, shape[1])
    data = np.empty((len(row), 3, 3))
    for i in range(3):
        for j in range(3):
            data[:, i, j] = np.add.reduceat(blocks[i, j].reshape(-1)[order], start)
    matrix = bsr_array((data, column, _row_pointer(row, shape[0])), shape=(3 * shape[0], 3 * shape[1]))
    return csr_array(matrix.tocsr())


def element_pattern(rows: IntArray, columns: IntArray, width: int) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Order that sorts all element pairs by (row, column), starts of equal pairs, and their rows and columns."""
    keys = (rows[:, :, None].astype(np.int64) * width + columns[:, None, :]).reshape(-1)
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    start = np.flatnonzero(np.diff(ordered, prepend=-1))
    return order, start, ordered[start] // width, ordered[start] % width


def _row_pointer(row: IntArray, n_rows: int) -> IntArray:
    return np.concatenate(([0], np.cumsum(np.bincount(row, minlength=n_rows))))
