"""Gaussian loads on the skin, and those of a flat layered body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

from ...errors import MeshError
from ...fem.assembly.model import ForearmModel
from ...fem.space.numbering import MixedSpace, facet_points, tabulate
from ...geometry.mesh.tissue_mesh import bent_places
from ...layered.hankel import HankelTable, Radial
from ...layered.integrals import Integrals, Medium
from ...typing import ComplexArray, FloatArray, IntArray
from .skin import FlatSkin

# Gaussian loads on the limb's layered model, along its normal and along it.
# Two bells at a distance d meet in four integrals :math:`K_q=\frac1{2\pi}\int_0^\infty k\,U\,e^{-k^2w^2}J_q(kd)\,dk`
# over the surface compliance: U is zz, zx, and half the sum and half the difference of the compliances along and across
# a wave (:mod:`forearm_fem.layered.discs`). With the unit vector e from the one that pushes to the one that reads,
# .. math:: T_{zz}=K_0^{zz},\quad T_{zt}=K_1^{zx}e,\quad T_{tt}=K_0^+I-K_2^-(2ee^T-I).

_TOLERANCE = 1e-6
_AT_ONCE = 64  # distances of one quadrature
_ORDERS = (0, 1, 0, 2)  # q of the four integrals


def between_flat_bells(
    medium: Medium, frequency: FloatArray, width: float, distances: FloatArray, *, sideways: bool = False
) -> ComplexArray:
    """Integrals (n_frequency, 1, n_distance) [m/N] of two bells of ``width`` [m] at increasing ``distances``; all four
    of them with ``sideways``."""
    omega, kinds, parts = 2 * np.pi * frequency, len(_ORDERS) if sideways else 1, []
    for piece in np.array_split(distances, max(1, len(distances) // _AT_ONCE)):
        kernel, place = (a.ravel() for a in np.indices((kinds, len(piece))))
        order = np.array(_ORDERS)[kernel]
        sure = (order > 0) & (piece[place] == 0)  # J_q(0) = 0
        kernel, place, order = kernel[~sure], place[~sure], order[~sure]
        zero = np.zeros(len(kernel), dtype=int)
        table = HankelTable((Radial("bell", width),), kernel, zero, zero, order, piece[place])
        integrals, out = Integrals(medium, table, _TOLERANCE), np.zeros((len(omega), kinds, len(piece)), dtype=complex)
        for chunk in integrals.chunks(omega):
            out[chunk[:, None], kernel, place] = integrals.solve(omega[chunk]).values
        parts.append(out)
    return np.concatenate(parts, axis=2)


def flat_compliance(
    integrals: ComplexArray, distances: FloatArray, centres: FloatArray, sideways: FloatArray
) -> ComplexArray:
    """Compliance (..., n + 2 s, n + 2 s) between bells along the normal at ``centres`` (n, 2), then along u and along v
    at ``sideways`` (s, 2), from ``integrals`` (..., 1 or 4, n_distance) at the ``distances`` of them all."""
    n, s = len(centres), len(sideways)
    out = np.empty((*integrals.shape[:-2], n + 2 * s, n + 2 * s), dtype=complex)
    out[..., :n, :n] = integrals[..., 0, :][..., _number(distances, centres, centres)]
    if s:
        number, e = _number(distances, centres, sideways), _directions(centres, sideways)
        coupling = np.concatenate([integrals[..., 1, :][..., number] * along for along in e], axis=-1)
        out[..., :n, n:], out[..., n:, :n] = coupling, coupling.swapaxes(-1, -2)
        number, e = _number(distances, sideways, sideways), _directions(sideways, sideways)
        even, odd = integrals[..., 2, :][..., number], integrals[..., 3, :][..., number]
        for i in range(2):
            for j in range(2):
                block = even * (i == j) - odd * (2 * e[i] * e[j] - (i == j))
                out[..., n + i * s : n + (i + 1) * s, n + j * s : n + (j + 1) * s] = block
    return out


def pair_distances(centres: FloatArray) -> FloatArray:
    """The distinct distances (m,) [m] between any two of ``centres`` (n, 2), rising."""
    return np.unique(_distances(centres, centres))


def _distances(some: FloatArray, others: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(some[:, None] - others[None], axis=2).round(9))


def _number(distances: FloatArray, some: FloatArray, others: FloatArray) -> IntArray:
    """Indices into ``distances`` for each pair (n, m)."""
    return np.searchsorted(distances, _distances(some, others))


def _directions(some: FloatArray, others: FloatArray) -> FloatArray:
    """Unit vectors (2, n, m) from ``others`` (m, 2) to ``some`` (n, 2); zero between a place and itself."""
    way = np.moveaxis(some[:, None] - others[None], 2, 0)
    length = np.linalg.norm(way, axis=0)
    return np.asarray(way / np.where(length > 0, length, 1.0))


# Smooth loads on the skin: bells of force, narrow beside waves, wide beside elements, that need no rim in a mesh.

_REACH = 4.5  # widths beyond which a bell is nothing: 4e-5 of its middle
_DEGREE = 19  # of the rule on a facet: exact enough for bells a quarter of a facet wide
_LEAST = 20  # points of the rule under a bell


@dataclass(frozen=True)
class GaussianLoads:
    """Loads exp(-r^2 / 2 width^2) about ``centres`` (n, 2), flat coordinates, along ``axes`` (n, 3); ``width`` [m]."""

    centres: FloatArray
    axes: FloatArray
    width: float


def bell_functionals(model: ForearmModel, skin: FlatSkin, bells: GaussianLoads) -> csr_array:
    """Functionals (n, n_bell): the mean of the displacement along each bell's axis, weighted with it.

    A unit force on a bell loads the system with the same vector, so what is found is reciprocal.
    """
    space = model.space
    places, values = _skin_rule(space, skin, bells)
    weights = _weights(places, bells)
    scalar = csr_array(weights @ values)
    scalar = coo_array(csr_array((1 / scalar.sum(axis=1))[:, None] * scalar))  # the basis adds up to one
    rows = (3 * scalar.col[:, None] + np.arange(3)).ravel()
    entries = (scalar.data[:, None] * bells.axes[scalar.row]).ravel()
    shape = (3 * space.n_nodes, len(bells.centres))
    full = csr_array(coo_array((entries, (rows, np.repeat(scalar.row, 3))), shape=shape))
    free = csr_array(model.constraints.transform.T @ full)
    n = model.operator.n
    return csr_array((free.data, free.indices, np.pad(free.indptr, (0, n - free.shape[0]), "edge")), (n, shape[1]))


def _skin_rule(space: MixedSpace, skin: FlatSkin, bells: GaussianLoads) -> tuple[FloatArray, csr_array]:
    """Flat places (m, 2) of a rule on the skin under the bells; matrix (m, n_nodes) of its weights times the basis."""
    reference, weights = get_quadrature(RefTri, _DEGREE)
    tets, local = space.owners(_facets_under(space, skin, bells))
    places, rows, columns, entries, count = [], [], [], [], 0
    for f in np.unique(local):
        mine, points = tets[local == f], facet_points(int(f), reference)
        values, _ = tabulate(space.pair.displacement, points)
        jacobians = space.jacobians_at(mine, points)
        sides = jacobians @ facet_points(int(f), np.eye(2)) - jacobians @ facet_points(int(f), np.zeros((2, 1)))
        measure = np.linalg.norm(np.cross(sides[..., 0], sides[..., 1]), axis=2) * weights
        where = bent_places(space.mesh.points[space.vertices[mine]], space.offsets[mine], points)
        places.append(skin.flat(where.reshape(-1, 3)))
        number = count + np.arange(measure.size).reshape(measure.shape)
        block = measure[:, None, :] * values[None]
        rows.append(np.broadcast_to(number[:, None], block.shape).ravel())
        columns.append(np.broadcast_to(space.nodes[mine][:, :, None], block.shape).ravel())
        entries.append(block.ravel())
        count += measure.size
    matrix = coo_array((np.hstack(entries), (np.hstack(rows), np.hstack(columns))), shape=(count, space.n_nodes))
    return np.vstack(places), csr_array(matrix)


def _facets_under(space: MixedSpace, skin: FlatSkin, bells: GaussianLoads) -> IntArray:
    """Facets (k, 3) of the skin with a corner near a bell, or wide enough to have one inside."""
    facets = space.mesh.facets["skin"]
    corners = skin.flat(space.mesh.points[facets.ravel()]).reshape(-1, 3, 2)
    size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    reach = _REACH * bells.width + np.where(np.isfinite(size), size, 0.0)[:, None]
    low, high = bells.centres.min(axis=0), bells.centres.max(axis=0)
    inside = ((corners > low - reach[..., None]) & (corners < high + reach[..., None])).all(axis=2)
    return np.asarray(facets[inside.any(axis=1)])


def _weights(places: FloatArray, bells: GaussianLoads) -> csr_array:
    """Gaussian loads (n, m) at flat ``places`` (m, 2); those off the volar skin have none."""
    known = np.flatnonzero(np.isfinite(places).all(axis=1))
    near = cKDTree(places[known]).query_ball_point(bells.centres, _REACH * bells.width)
    counts = np.array([len(found) for found in near])
    if counts.min() < _LEAST:
        raise MeshError("the skin under the library's patch has gaps; use smaller elements (accuracy, mesh.size_grid)")
    rows, columns = np.repeat(np.arange(len(near)), counts), known[np.concatenate(near).astype(int)]
    away = np.linalg.norm(places[columns] - bells.centres[rows], axis=1)
    return csr_array(
        coo_array((np.exp(-0.5 * (away / bells.width) ** 2), (rows, columns)), shape=(len(near), len(places)))
    )
