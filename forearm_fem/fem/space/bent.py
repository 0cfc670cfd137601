"""Element matrices of tetrahedra whose edges bend, by quadrature: their Jacobian changes from place to place."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from ...typing import FloatArray, IntArray
from .elements import tabulate
from .numbering import MixedSpace

_MORE = 2  # degrees of the rule beyond what is exact where edges are straight
_AT_ONCE = 250  # tetrahedra, whose matrices stay in the cache


@dataclass(frozen=True)
class BentMatrices:
    """Element matrices of k tetrahedra: ``shear`` (3, 3, k, nb, nb) as ``tissues.shear_blocks`` has them,
    ``mass`` (k, nb, nb), ``divergence`` (3, k, npb, nb) and ``pressure_mass`` (k, npb, npb)."""

    shear: FloatArray
    mass: FloatArray
    divergence: FloatArray
    pressure_mass: FloatArray


def bent_matrices(space: MixedSpace, tetrahedra: IntArray) -> Iterator[tuple[slice, BentMatrices]]:
    """Matrices of some ``tetrahedra`` (n,), piece by piece, and which of them each piece holds."""
    if not len(tetrahedra):
        return
    points, weights = get_quadrature(RefTet, space.pair.degree + _MORE)
    values, slopes = tabulate(space.pair.displacement, points)
    pressures, _ = tabulate(space.pair.pressure, points)
    for start in range(0, len(tetrahedra), _AT_ONCE):
        piece = slice(start, start + _AT_ONCE)
        jacobians = space.jacobians_at(tetrahedra[piece], points)
        measure = np.abs(np.linalg.det(jacobians)) * weights
        gradients = np.einsum("nqri,brq->nibq", np.linalg.inv(jacobians), slopes, optimize=True)
        yield piece, BentMatrices(
            _shear(gradients, measure),
            _mass(values, measure),
            np.einsum("pq,nibq->inpb", pressures, gradients * measure[:, None, None], optimize=True),
            _mass(pressures, measure),
        )


def _shear(gradients: FloatArray, measure: FloatArray) -> FloatArray:
    """Deviatoric stiffness (3, 3, n, nb, nb) from gradients (n, 3, nb, q) of basis functions."""
    n, _, nb, q = gradients.shape
    rows = gradients.reshape(n, 3 * nb, q)
    metric = (rows * measure[:, None]) @ rows.transpose(0, 2, 1)
    return deviatoric(metric.reshape(n, 3, nb, 3, nb).transpose(1, 3, 0, 2, 4))


def deviatoric(metric: FloatArray) -> FloatArray:
    """Blocks (3, 3, ...) of the stiffness that keeps volumes free, from products (3, 3, ...) of gradients."""
    blocks = np.swapaxes(metric, 0, 1) - (2 / 3) * metric
    trace = metric[0, 0] + metric[1, 1] + metric[2, 2]
    for i in range(3):
        blocks[i, i] += trace
    return np.asarray(blocks)


def _mass(values: FloatArray, measure: FloatArray) -> FloatArray:
    """Integrals (n, nb, nb) of products of functions with ``values`` (nb, q)."""
    products = (values[:, None] * values).reshape(-1, values.shape[1])
    return np.asarray((measure @ products.T).reshape(len(measure), len(values), len(values)))
