"""The part of a mesh that waves pass on their way from contacts to points, and the order of elements there."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from ...ports import Port
from ...typing import BoolArray, FloatArray, IntArray
from ..mesh.tissue_mesh import TissueMesh
from ..mesh.topology import EDGES, SIDES, edge_lengths, edges_of
from .layout import RIGID

REACH, DEPTH = 0.03, 0.025  # [m] what third order gains beyond them on the forearm is in docs/decisions/0002
_UNIFORM = {"P1": 1, "P2": 2, "P3": 3}
# Longest edge, relative to the usual edge between ports, up to which second order is enough: in the outermost tissue,
# the one beneath, all deeper ones. Second order needs edges half as long as third; fat's waves are 1.4 times shorter.
# At 0.95 and 1.42 points beside a rigid disc on a slab were 10 % off at 500 Hz, whatever the accuracy asked for, and
# the second mesh was off by nearly the same (docs/decisions/0026-rims.md).
_SMALL = (0.0, 0.5, 0.7)


def tetrahedron_orders(mesh: TissueMesh, ports: tuple[Port, ...], element: str) -> IntArray:
    """Order of displacements (n_tet,) in each tetrahedron: with "P2/P3" third around the ports, second elsewhere."""
    if element in _UNIFORM:
        return np.full(len(mesh.region), _UNIFORM[element])
    third = near_ports(mesh, ports, REACH, DEPTH)
    if any(p.contact in RIGID for p in ports):  # their rims made tetrahedra beneath smaller than waves ask
        corners = mesh.points[mesh.tetrahedra]
        longest = np.max([np.linalg.norm(corners[:, a] - corners[:, b], axis=1) for a, b in EDGES], axis=0)
        depth = np.minimum(tissue_depths(mesh), len(_SMALL) - 1)[mesh.region]
        third &= ~(longest < usual_edge(mesh, ports) * np.array(_SMALL)[depth])
    return np.where(third, 3, 2)


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


def tissue_depths(mesh: TissueMesh) -> IntArray:
    """How many tissues (n_region,) lie between each tissue and the skin's surface."""
    depth = np.full(len(mesh.region_names), len(mesh.region_names))
    touched, here = np.isin(mesh.tetrahedra, mesh.facets["skin"]).sum(axis=1) >= 3, 0
    while touched.any():
        depth[np.unique(mesh.region[touched])] = here
        reached = np.isin(mesh.tetrahedra, mesh.tetrahedra[depth[mesh.region] <= here]).any(axis=1)
        touched, here = reached & (depth[mesh.region] > here), here + 1
    return depth


def usual_edge(mesh: TissueMesh, ports: tuple[Port, ...]) -> float:
    """Median edge [m] of the skin between the ports, away from contacts; zero where nothing is."""
    edges = edges_of(mesh.facets["skin"], SIDES)
    middle = mesh.points[edges].mean(axis=1)
    xy, volar = middle[:, :2], middle[:, 2] > min(p.position[2] for p in ports) - DEPTH
    planes = half_planes(np.array([p.position[:2] for p in ports]), np.array([p.radius for p in ports]))
    chosen = volar & (xy @ planes[:, :2].T + planes[:, 2] <= 0).all(axis=1)
    for port in (p for p in ports if p.kind == "contact"):
        chosen &= np.linalg.norm(xy - port.position[:2], axis=1) > 2 * port.radius
    lengths = edge_lengths(mesh.points, edges[chosen])
    return float(np.median(lengths)) if len(lengths) else 0.0


def half_planes(places: FloatArray, radii: FloatArray) -> FloatArray:
    """Half planes (k, 3) a x + b y + c <= 0 around the hull of circles of ``radii`` (n,) about ``places`` (n, 2)."""
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    around = [p + r * circle for p, r in zip(places, radii, strict=True)]
    return np.asarray(ConvexHull(np.vstack(around)).equations) if around else np.zeros((0, 3))
