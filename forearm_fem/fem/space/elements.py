"""Element pairs: displacement order, pressure order, quadrature; third-order tetrahedra that scikit-fem lacks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import skfem
from skfem.element import ElementH1
from skfem.refdom import RefTet

from ...typing import FloatArray


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
