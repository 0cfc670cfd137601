"""Shape functions of tetrahedra and numbers of their degrees of freedom."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import skfem
from skfem.element import ElementH1
from skfem.refdom import RefTet

from ...geometry.mesh.tissue_mesh import TissueMesh, bent_jacobians, bent_places, straight_jacobians
from ...typing import BoolArray, FloatArray, IntArray

# Element pairs: displacement order, pressure order, quadrature; third-order tetrahedra that scikit-fem lacks.


class ElementTetP3(ElementH1):  # type: ignore[misc]
    """Cubic Lagrange tetrahedron: 4 corner, 12 edge and 4 face nodes.

    Edge nodes are ordered by scikit-fem's ascending vertex numbering (``sort_t``), so that neighbours agree.
    Basis functions: Zienkiewicz, Taylor, Zhu, The Finite Element Method, 6th ed., section 4.8.
    """

    nodal_dofs = 1
    edge_dofs = 2
    facet_dofs = 1
    maxdeg = 3
    dofnames = ["u", "u", "u", "u"]  # noqa: RUF012  (scikit-fem's own interface)
    refdom = RefTet
    doflocs = np.zeros((20, 3))

    def lbasis(self, X: FloatArray, i: int) -> tuple[FloatArray, FloatArray]:
        """Value and gradient of basis function ``i`` at reference points ``X`` (3, n)."""
        bary = np.array([1 - X[0] - X[1] - X[2], X[0], X[1], X[2]])
        slope = np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        value, by_bary = _cubic(bary, i)
        return value, np.einsum("k...,kd->d...", by_bary, slope)


CUBIC_EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))  # scikit-fem's edge order, as a test sees
CUBIC_FACES = ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))  # scikit-fem's facet order


def _cubic(L: FloatArray, i: int) -> tuple[FloatArray, FloatArray]:
    """Cubic Lagrange function ``i`` in barycentric coordinates and its derivatives by them (4, n)."""
    d = np.zeros_like(L)
    if i < 4:
        a = L[i]
        d[i] = (27 * a**2 - 18 * a + 2) / 2
        return a * (3 * a - 1) * (3 * a - 2) / 2, d
    if i < 16:
        p, q = CUBIC_EDGES[(i - 4) // 2]
        near, far = (p, q) if (i - 4) % 2 == 0 else (q, p)
        a, b = L[near], L[far]
        d[near], d[far] = 4.5 * b * (6 * a - 1), 4.5 * a * (3 * a - 1)
        return 4.5 * a * b * (3 * a - 1), d
    p, q, r = CUBIC_FACES[i - 16]
    d[p], d[q], d[r] = 27 * L[q] * L[r], 27 * L[p] * L[r], 27 * L[p] * L[q]
    return 27 * L[p] * L[q] * L[r], d


@dataclass(frozen=True)
class ElementPair:
    """Displacement and pressure elements that are stable together, with a quadrature degree exact for affine cells."""

    name: str
    displacement: ElementH1
    pressure: ElementH1
    degree: int


def element_pair(name: str) -> ElementPair:
    """Pair by displacement order: "P2" Taylor-Hood P2/P1, "P3" P3/P2, "P1" the MINI element (P1 + bubble / P1).

    scikit-fem's tetrahedral rules asked for degree 5 and more are exact to one degree less (seen in 12.0.2: rule "6"
    misses x^6 by 5 %), so mass matrices of degree 6 and 8 ask for 7 and 9.
    """
    pairs = {
        "P1": (skfem.ElementTetMini(), skfem.ElementTetP1(), 9),
        "P2": (skfem.ElementTetP2(), skfem.ElementTetP1(), 4),
        "P3": (ElementTetP3(), skfem.ElementTetP2(), 7),
    }
    displacement, pressure, degree = pairs[name]
    return ElementPair(name, displacement, pressure, degree)


def tabulate(element: ElementH1, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values (n_basis, n_point) and reference gradients (n_basis, dim, n_point) at reference points (dim, n)."""
    domain = element.refdom
    count = element.nodal_dofs * domain.nnodes + element.edge_dofs * domain.nedges
    count += element.facet_dofs * domain.nfacets + element.interior_dofs
    pairs = [element.lbasis(points, i) for i in range(count)]
    values = np.array([np.broadcast_to(v, points.shape[1:]) for v, _ in pairs])
    return values, np.array([np.broadcast_to(g, points.shape) for _, g in pairs])


# Numbering of unknowns: scikit-fem's scalar numbering, three components per node, pressure per tissue.


@dataclass(frozen=True)
class MixedSpace:
    """Displacement nodes shared by all tissues and pressure nodes shared within one tissue only.

    The pressure of the exact solution jumps where the shear modulus jumps, so it is not tied across tissues.
    Displacement unknown ``3 * node + component``. ``nodes`` (n_tet, nb) and ``pressures`` (n_tet, npb) number the
    basis functions of each tetrahedron; ``vertices`` (n_tet, 4) are its corners, ascending as scikit-fem wants them.
    """

    mesh: TissueMesh
    pair: ElementPair
    vertices: IntArray
    nodes: IntArray
    pressures: IntArray
    n_nodes: int
    n_pressures: int

    @property
    def n_displacements(self) -> int:
        """Number of displacement unknowns before constraints."""
        return 3 * self.n_nodes

    @cached_property
    def jacobians(self) -> FloatArray:
        """d(position)/d(reference) of every tetrahedron (n_tet, 3, 3) [m], its edges taken as straight."""
        return straight_jacobians(self.mesh.points, self.vertices)

    @cached_property
    def offsets(self) -> FloatArray:
        """Offsets (n_tet, 6, 3) [m] of the middles of edges from their chords, as :meth:`.Bends.of` has them.

        First-order elements are left straight: what they can follow of a bent edge is less than it changes.
        """
        if self.pair.name == "P1":
            return np.zeros((len(self.vertices), 6, 3))
        return self.mesh.bends.of(self.vertices)

    @cached_property
    def is_bent(self) -> BoolArray:
        """True where a tetrahedron (n_tet,) has an edge that bends."""
        return np.asarray(self.offsets.any(axis=(1, 2)))

    def jacobians_at(self, tetrahedra: IntArray, points: FloatArray) -> FloatArray:
        """d(position)/d(reference) (k, q, 3, 3) [m] of some ``tetrahedra`` (k,) at reference ``points`` (3, q)."""
        return bent_jacobians(self.jacobians[tetrahedra], self.offsets[tetrahedra], points)

    @cached_property
    def facet_owners(self) -> dict[tuple[int, int, int], tuple[int, int]]:
        """Boundary facet (ascending vertices) -> (tetrahedron, local facet)."""
        facets = np.sort(self.vertices[:, _LOCAL_FACETS], axis=2).reshape(-1, 3)
        unique, first, count = np.unique(facets, axis=0, return_index=True, return_counts=True)
        single = count == 1
        return {
            (int(f[0]), int(f[1]), int(f[2])): (int(i) // 4, int(i) % 4)
            for f, i in zip(unique[single], first[single], strict=True)
        }

    def owners(self, facets: IntArray) -> tuple[IntArray, IntArray]:
        """Tetrahedron and local facet number of each boundary facet (k, 3)."""
        keys = np.sort(facets, axis=1)
        pairs = np.array([self.facet_owners[(int(a), int(b), int(c))] for a, b, c in keys]).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]

    def facet_nodes(self, facets: IntArray) -> IntArray:
        """Displacement nodes that lie on any of the boundary facets (k, 3), ascending and unique."""
        tets, local = self.owners(facets)
        found = []
        for f in range(4):
            points = facet_points(f, _PROBE)
            values = np.array([self.pair.displacement.lbasis(points, i)[0] for i in range(self.nodes.shape[1])])
            not_zero = np.flatnonzero(np.abs(values).max(axis=1) > 1e-12)  # functions that do not vanish on the facet
            found.append(self.nodes[tets[local == f]][:, not_zero].ravel())
        return np.unique(np.concatenate(found))

    @cached_property
    def node_points(self) -> FloatArray:
        """Position of each displacement node (n_nodes, 3) [m]; bubbles sit at the centroid."""
        places = np.array([_node_place(self.pair.name, i) for i in range(self.nodes.shape[1])])
        found = bent_places(self.mesh.points[self.vertices], self.offsets, places[:, 1:].T)
        result = np.zeros((self.n_nodes, 3))
        result[self.nodes.ravel()] = found.reshape(-1, 3)
        return result


_LOCAL_FACETS = np.array(CUBIC_FACES)
_PROBE = np.array([[0.21, 0.4, 0.31, 0.05, 0.7], [0.33, 0.1, 0.57, 0.6, 0.15]])
_REFERENCE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def facet_points(local: int, points: FloatArray) -> FloatArray:
    """Points (2, n) of the reference triangle placed on a local facet of the reference tetrahedron (3, n)."""
    a, b, c = _REFERENCE[_LOCAL_FACETS[local]]
    return np.asarray(a[:, None] + np.outer(b - a, points[0]) + np.outer(c - a, points[1]))


def _node_place(name: str, i: int) -> FloatArray:
    """Barycentric place (4,) of basis function ``i``."""
    place = np.zeros(4)
    if i < 4:
        place[i] = 1
    elif name == "P1":
        place[:] = 0.25
    elif name == "P2":
        place[list(CUBIC_EDGES[i - 4])] = 0.5
    elif i < 16:
        near, far = CUBIC_EDGES[(i - 4) // 2] if i % 2 == 0 else CUBIC_EDGES[(i - 4) // 2][::-1]
        place[near], place[far] = 2 / 3, 1 / 3
    else:
        place[_LOCAL_FACETS[i - 16]] = 1 / 3
    return place


def mixed_space(mesh: TissueMesh, element: str) -> MixedSpace:
    """Number the unknowns of ``mesh`` for the element pair named ``element`` ("P1", "P2" or "P3")."""
    pair = element_pair(element)
    ascending = np.sort(mesh.tetrahedra, axis=1)
    grid = skfem.MeshTet(np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(ascending.T), validate=False)
    nodes = np.asarray(skfem.Dofs(grid, pair.displacement).element_dofs.T)
    continuous = np.asarray(skfem.Dofs(grid, pair.pressure).element_dofs.T)
    keys = continuous * len(mesh.region_names) + mesh.region[:, None]
    unique, pressures = np.unique(keys, return_inverse=True)
    return MixedSpace(mesh, pair, ascending, nodes, pressures.reshape(keys.shape), int(nodes.max()) + 1, len(unique))
