"""Real matrices of boundary terms: dashpots, foam, surface mass, membrane and pre-stress."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array, kron
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

from ...geometry.mesh.topology import triangle_normals
from ...typing import BoolArray, FloatArray, IntArray
from ..space.elements import tabulate
from ..space.numbering import MixedSpace, facet_points
from .tissues import scatter, scatter_blocks

# Whether points (k, q, 3) with outward normals (k, q, 3) belong to what is integrated over
Covered = Callable[[FloatArray, FloatArray], BoolArray]
_MORE = 2  # degrees of the rule beyond what is exact on plane facets: the measure of bent ones is no polynomial


def facet_normals(points: FloatArray, facets: IntArray) -> tuple[FloatArray, FloatArray]:
    """Unit normals (k, 3), in the facets' own orientation, and areas (k,) [m^2]."""
    cross = triangle_normals(points, facets)
    length = np.linalg.norm(cross, axis=1)
    return cross / length[:, None], length / 2


def under_rectangle(length: float, width: float) -> Covered:
    """The part of a surface that a rectangle about the origin covers seen from above, sides [m] along x and y."""

    def covered(points: FloatArray, normals: FloatArray) -> BoolArray:
        """Which points of the volar side lie within it."""
        inside = np.abs(points[..., :2]) <= [length / 2, width / 2]
        return np.asarray(inside.all(axis=-1) & (normals[..., 2] > 0))

    return covered


def facet_mass(space: MixedSpace, facets: IntArray, covered: Covered | None = None) -> csr_array:
    r"""Matrix of :math:`\int_\Gamma u\cdot v` over boundary facets (k, 3), or what is ``covered`` of them."""
    shape = (space.n_nodes, space.n_nodes)
    total = csr_array(shape)
    for tets, values, _, measure, _ in _by_local_facet(space, facets, covered):
        block = np.einsum("aq,bq,eq->eab", values, values, measure, optimize=True)
        total = total + scatter(space.nodes[tets], space.nodes[tets], block, shape)
    return csr_array(kron(total, np.eye(3), format="csr"))


def facet_gradients(space: MixedSpace, facets: IntArray) -> csr_array:
    r"""Matrix of :math:`\int_\Gamma \nabla_s u : \nabla_s v`, the geometric stiffness per unit membrane tension."""
    shape = (space.n_nodes, space.n_nodes)
    total = csr_array(shape)
    for tets, _, slopes, measure, _ in _by_local_facet(space, facets):
        d = np.einsum("eaiq,ebiq,eq->eab", slopes, slopes, measure, optimize=True)
        total = total + scatter(space.nodes[tets], space.nodes[tets], d, shape)
    return csr_array(kron(total, np.eye(3), format="csr"))


def facet_membrane(space: MixedSpace, facets: IntArray, covered: Covered | None = None) -> csr_array:
    r"""Incompressible sheet per mu h: :math:`\int 2\epsilon_s:\epsilon_s + 2\,tr\epsilon_s\,tr\epsilon_s`.

    :math:`\epsilon_s` is the strain of the tangential displacement in the plane that touches the facet (curvature
    coupling left out).
    """
    shape = (space.n_nodes, space.n_nodes)
    total = csr_array((3 * space.n_nodes, 3 * space.n_nodes))
    for tets, _, slopes, measure, normal in _by_local_facet(space, facets, covered):
        d = np.einsum("eaiq,ebjq,eq->ijeab", slopes, slopes, measure, optimize=True)
        tangential = np.eye(3) - normal[..., None] * normal[..., None, :]
        trace = np.einsum("eqij,eaqk,ebqk,eq->ijeab", tangential, *[slopes.swapaxes(2, 3)] * 2, measure, optimize=True)
        blocks = np.swapaxes(d, 0, 1) + 2 * d + trace  # slopes are tangential themselves
        total = total + scatter_blocks(space.nodes[tets], space.nodes[tets], blocks, shape)
    return csr_array(total)


def facet_load(space: MixedSpace, facets: IntArray, direction: FloatArray) -> FloatArray:
    r"""Vector (n_u,) of :math:`\int_\Gamma d\cdot v` with one direction ``d`` (3,) for all facets."""
    scalar = np.zeros(space.n_nodes)
    for tets, values, _, measure, _ in _by_local_facet(space, facets):
        share = measure @ values.T
        scalar += np.bincount(space.nodes[tets].ravel(), weights=share.ravel(), minlength=space.n_nodes)
    return np.asarray(np.kron(scalar, direction), dtype=float)


def covered_area(space: MixedSpace, facets: IntArray, covered: Covered | None = None) -> float:
    """Area [m^2] of boundary facets (k, 3), bent as they are, or of what is ``covered`` of them."""
    return float(sum(measure.sum() for _, _, _, measure, _ in _by_local_facet(space, facets, covered)))


_Group = tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]


def _by_local_facet(space: MixedSpace, facets: IntArray, covered: Covered | None = None) -> list[_Group]:
    """Per local facet number: tetrahedra (k,), values (nb, q), tangential gradients (k, nb, 3, q), measures (k, q)
    [m^2], zero at points that are not ``covered``, and unit normals (k, q, 3)."""
    reference, weights = get_quadrature(RefTri, 2 * space.pair.displacement.maxdeg + _MORE)
    tets, local = space.owners(facets)
    groups = []
    for f in range(4):
        mine = tets[local == f]
        if len(mine):
            points = facet_points(f, reference)
            values, slopes = tabulate(space.pair.displacement, points)
            jacobians = space.jacobians_at(mine, points)
            sides = jacobians @ facet_points(f, np.eye(2)) - jacobians @ facet_points(f, np.zeros((2, 1)))
            cross = np.cross(sides[..., 0], sides[..., 1])
            length = np.linalg.norm(cross, axis=2)
            n = cross / length[..., None]
            full = np.einsum("eqki,bkq->ebiq", np.linalg.inv(jacobians), slopes, optimize=True)
            tangential = full - np.einsum("eqi,eqj,ebjq->ebiq", n, n, full, optimize=True)
            measure = length * weights
            if covered is not None:  # an edge that cuts through a facet takes the points of the rule on its side
                corners = space.mesh.points[space.vertices[mine]]
                places = corners[:, :1] + np.einsum("eki,iq->eqk", space.jacobians[mine], points)
                outward = np.sign(np.einsum("eqi,eqi->eq", n, places - corners.mean(axis=1)[:, None]))
                measure = np.where(covered(places, n * outward[..., None]), measure, 0.0)
            groups.append((mine, values, tangential, measure, n))
    return groups
