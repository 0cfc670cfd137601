"""The part of a mesh that waves pass on their way from contacts to points, and the order of elements there."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from ..ports import Port
from ..typing import BoolArray, FloatArray, IntArray
from .mesh import TissueMesh

REACH, DEPTH = 0.03, 0.025  # [m] what third order gains beyond them on the forearm is in docs/decisions.md
_UNIFORM = {"P1": 1, "P2": 2, "P3": 3}


def tetrahedron_orders(mesh: TissueMesh, ports: tuple[Port, ...], element: str) -> IntArray:
    """Order of displacements (n_tet,) in each tetrahedron: with "P2/P3" third around the ports, second elsewhere."""
    if element in _UNIFORM:
        return np.full(len(mesh.region), _UNIFORM[element])
    return np.where(near_ports(mesh, ports, REACH, DEPTH), 3, 2)


def near_ports(mesh: TissueMesh, ports: tuple[Port, ...], reach: float, depth: float) -> BoolArray:
    """Tetrahedra (n_tet,) around the ports: seen along z at most about ``reach`` [m] outside the hull of all contacts
    and points, and at most ``depth`` [m] below the lowest of them."""
    centre = mesh.points[mesh.tetrahedra].mean(axis=1)
    if not ports:
        return np.zeros(len(centre), dtype=bool)
    places = np.array([p.position[:2] for p in ports])
    planes = half_planes(places, np.array([p.radius for p in ports]) + reach)
    around = (centre[:, :2] @ planes[:, :2].T + planes[:, 2] <= 0).all(axis=1)
    return np.asarray(around & (centre[:, 2] >= min(p.position[2] for p in ports) - depth))


def half_planes(places: FloatArray, radii: FloatArray) -> FloatArray:
    """Half planes (k, 3) a x + b y + c <= 0 around the hull of circles of ``radii`` (n,) about ``places`` (n, 2)."""
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    around = [p + r * circle for p, r in zip(places, radii, strict=True)]
    return np.asarray(ConvexHull(np.vstack(around)).equations) if around else np.zeros((0, 3))
