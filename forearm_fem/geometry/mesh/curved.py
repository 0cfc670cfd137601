"""Tetrahedra whose edges are parabolas: places in them, what a step there is in space, and their volumes.

x(r) = sum_i L_i x_i + sum_ab 4 L_a L_b d_ab with barycentric coordinates L_i of the reference point r and the edges'
offsets d_ab (Zienkiewicz, Taylor, Zhu, The Finite Element Method, 6th ed., section 5.5).
"""

from __future__ import annotations

import numpy as np

from ...typing import FloatArray, IntArray
from .tissue_mesh import TissueMesh
from .topology import EDGES

_SLOPES = np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # of barycentric coordinates
# Determinants are cubic: Keast's rule of five points is exact for them.
_CUBIC = np.array([[1 / 4] * 3, [1 / 6] * 3, [1 / 2, 1 / 6, 1 / 6], [1 / 6, 1 / 2, 1 / 6], [1 / 6, 1 / 6, 1 / 2]]).T
_CUBIC_WEIGHTS = np.array([-2 / 15, *[3 / 40] * 4])


def barycentric(points: FloatArray) -> FloatArray:
    """Barycentric coordinates (4, q) of reference points (3, q)."""
    return np.vstack([1 - points.sum(axis=0), points])


def bent_places(corners: FloatArray, offsets: FloatArray, points: FloatArray) -> FloatArray:
    """Positions (n, q, 3) [m] of reference points (3, q) in tetrahedra with ``corners`` (n, 4, 3) and edges'
    ``offsets`` (n, 6, 3), in the order of :data:`.topology.EDGES`."""
    bary = barycentric(points)
    bumps = 4 * bary[EDGES[:, 0]] * bary[EDGES[:, 1]]
    return np.asarray(np.einsum("vq,nvi->nqi", bary, corners) + np.einsum("eq,nei->nqi", bumps, offsets))


def bent_jacobians(straight: FloatArray, offsets: FloatArray, points: FloatArray) -> FloatArray:
    """d(position)/d(reference) (n, q, 3, 3) [m] at reference points (3, q), from that of ``straight`` edges
    (n, 3, 3) and the edges' ``offsets`` (n, 6, 3)."""
    bary, (a, b) = barycentric(points), EDGES.T
    slopes = 4 * (bary[a, :, None] * _SLOPES[b, None] + bary[b, :, None] * _SLOPES[a, None])  # (6, q, 3)
    return np.asarray(straight[:, None] + np.einsum("nei,eqr->nqir", offsets, slopes, optimize=True))


def straight_jacobians(points: FloatArray, tetrahedra: IntArray) -> FloatArray:
    """d(position)/d(reference) (n_tet, 3, 3) [m] of tetrahedra (n_tet, 4) with straight edges."""
    corner = points[tetrahedra]
    return np.asarray(np.swapaxes(corner[:, 1:] - corner[:, :1], 1, 2))


def true_volumes(mesh: TissueMesh) -> FloatArray:
    """Volume of each tetrahedron (n_tet,) [m^3], its edges bent as they are."""
    jacobians = bent_jacobians(
        straight_jacobians(mesh.points, mesh.tetrahedra), mesh.bends.of(mesh.tetrahedra), _CUBIC
    )
    return np.asarray(np.linalg.det(jacobians) @ _CUBIC_WEIGHTS)
