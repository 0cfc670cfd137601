"""Real matrices of boundary terms: dashpots, foam, surface mass, membrane and pre-stress."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array, kron
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

from ..typing import FloatArray, IntArray
from .assembly import _scatter, _scatter_blocks
from .elements import tabulate
from .space import MixedSpace, facet_points


def facet_normals(points: FloatArray, facets: IntArray) -> tuple[FloatArray, FloatArray]:
    """Unit normals (k, 3), in the facets' own orientation, and areas (k,) [m^2]."""
    a, b, c = (points[facets[:, i]] for i in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / length[:, None], length / 2


def facet_mass(space: MixedSpace, facets: IntArray) -> csr_array:
    r"""Matrix of :math:`\int_\Gamma u\cdot v` over boundary facets (k, 3)."""
    shape = (space.n_nodes, space.n_nodes)
    total = csr_array(shape)
    for tets, values, _, weights in _by_local_facet(space, facets):
        block = np.einsum("aq,bq,q->ab", values, values, weights[0]) * (weights[1][:, None, None])
        total = total + _scatter(space.nodes[tets], space.nodes[tets], block, shape)
    return csr_array(kron(total, np.eye(3), format="csr"))


def facet_gradients(space: MixedSpace, facets: IntArray) -> csr_array:
    r"""Matrix of :math:`\int_\Gamma \nabla_s u : \nabla_s v`, the geometric stiffness per unit membrane tension."""
    shape = (space.n_nodes, space.n_nodes)
    total = csr_array(shape)
    for tets, _, slopes, weights in _by_local_facet(space, facets):
        d = np.einsum("eaiq,ebiq,q,e->eab", slopes, slopes, weights[0], weights[1], optimize=True)
        total = total + _scatter(space.nodes[tets], space.nodes[tets], d, shape)
    return csr_array(kron(total, np.eye(3), format="csr"))


def facet_membrane(space: MixedSpace, facets: IntArray) -> csr_array:
    r"""Incompressible sheet per mu h: :math:`\int 2\epsilon_s:\epsilon_s + 2\,tr\epsilon_s\,tr\epsilon_s`.

    :math:`\epsilon_s` is the strain of the tangential displacement in the facet's plane (curvature coupling left out).
    """
    shape = (space.n_nodes, space.n_nodes)
    total = csr_array((3 * space.n_nodes, 3 * space.n_nodes))
    for tets, _, slopes, weights in _by_local_facet(space, facets):
        d = np.einsum("eaiq,ebjq,q,e->ijeab", slopes, slopes, weights[0], weights[1], optimize=True)
        blocks = np.swapaxes(d, 0, 1) + 2 * d
        for i in range(3):
            blocks[i, i] += d[0, 0] + d[1, 1] + d[2, 2]
        tangential = np.eye(3) - weights[2][:, :, None] * weights[2][:, None, :]
        blocks = np.einsum("eki,ijeab,ejl->kleab", tangential, blocks, tangential, optimize=True)
        total = total + _scatter_blocks(space.nodes[tets], space.nodes[tets], blocks, shape)
    return csr_array(total)


def facet_load(space: MixedSpace, facets: IntArray, direction: FloatArray) -> FloatArray:
    r"""Vector (n_u,) of :math:`\int_\Gamma d\cdot v` with one direction ``d`` (3,) for all facets."""
    scalar = np.zeros(space.n_nodes)
    for tets, values, _, weights in _by_local_facet(space, facets):
        share = np.outer(weights[1], values @ weights[0])
        scalar += np.bincount(space.nodes[tets].ravel(), weights=share.ravel(), minlength=space.n_nodes)
    return np.asarray(np.kron(scalar, direction), dtype=float)


_Weights = tuple[FloatArray, FloatArray, FloatArray]


def _by_local_facet(space: MixedSpace, facets: IntArray) -> list[tuple[IntArray, FloatArray, FloatArray, _Weights]]:
    """Per local facet number: tetrahedra, values (nb, q), tangential gradients (k, nb, 3, q) and
    (reference weights (q,), Jacobians (k,), unit normals (k, 3))."""
    points, weights = get_quadrature(RefTri, 2 * space.pair.displacement.maxdeg)
    tets, local = space.owners(facets)
    normals, areas = facet_normals(space.mesh.points, facets)
    groups = []
    for f in range(4):
        mine = local == f
        if mine.any():
            values, slopes = tabulate(space.pair.displacement, facet_points(f, points))
            inverse = np.linalg.inv(space.jacobians[tets[mine]])
            full = np.einsum("eki,bkq->ebiq", inverse, slopes, optimize=True)
            n = normals[mine]
            tangential = full - np.einsum("ei,ej,ebjq->ebiq", n, n, full, optimize=True)
            groups.append((tets[mine], values, tangential, (weights, 2 * areas[mine], n)))
    return groups
