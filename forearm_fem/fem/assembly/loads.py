"""Port vectors: how a port's displacement is read from, and its force put on, the mesh."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.sparse import coo_array, csr_array

from ...errors import GeometryError
from ...geometry.mesh.topology import keys
from ...ports import Port
from ...typing import FloatArray, IntArray
from ..space.elements import tabulate
from ..space.numbering import MixedSpace
from .boundary import covered_area, facet_load

_SYMMETRY_AXIS = {"symmetry x": 0, "symmetry y": 1}


def port_functional(space: MixedSpace, port: Port) -> FloatArray:
    """Vector f (n_u,) with displacement = f . u: a point value along the axis, or the mean over a contact."""
    if port.kind == "point":
        return _point_value(space, np.array(port.position), np.array(port.axis))
    facets = space.mesh.facets.get(f"contact {port.name}")
    if facets is None or len(facets) == 0:
        raise GeometryError(f"the mesh has no facets named 'contact {port.name}'; mesh the scenario again")
    return np.asarray(facet_load(space, facets, np.array(port.axis)) / covered_area(space, facets))


def force_share(space: MixedSpace, port: Port) -> float:
    """Share of a port's unit force that the modelled part carries: 1, or 1/2, 1/4 on symmetry planes.

    NaN where the port lies off a symmetry plane: a force there has no symmetric solution.
    """
    share = 1.0
    extent = float(np.ptp(space.mesh.points[:, 0]))
    for name, axis in _SYMMETRY_AXIS.items():
        if name in space.mesh.facets:
            share *= 0.5 if abs(port.position[axis]) < 1e-9 * extent else np.nan
    return share


def _point_value(space: MixedSpace, position: FloatArray, axis: FloatArray) -> FloatArray:
    """Interpolation of the axial displacement at the point of the skin nearest to ``position``.

    That point is sought on facets taken as flat: off a vertex a bent one lies aside by a part of its offset squared.
    """
    facets = space.mesh.facets["skin"]
    facet, bary = _nearest_facet(space.mesh.points, facets, position)
    tet = int(space.owners(facets[facet : facet + 1])[0][0])
    place = bary @ space.mesh.points[facets[facet]]
    corner = space.mesh.points[space.vertices[tet, 0]]
    reference = np.linalg.solve(space.jacobians[tet], place - corner)
    values, _ = tabulate(space.pair.displacement, reference[:, None])
    result = np.zeros((space.n_nodes, 3))
    result[space.nodes[tet]] = values * axis
    return result.ravel()


def edge_middles(space: MixedSpace, edges: IntArray) -> csr_array:
    """Matrix (n_edge, n_nodes) that interpolates displacements in the middles of edges (n_edge, 2) of the mesh."""
    wanted, n = keys(edges, len(space.mesh.points)), len(space.mesh.points)
    rows, columns, weights = [], [], []
    left = np.arange(len(edges))
    for ends in combinations(range(4), 2):
        here = keys(space.vertices[:, ends], n)
        order = np.argsort(here)
        place = order[np.minimum(np.searchsorted(here, wanted[left], sorter=order), len(order) - 1)]
        found = here[place] == wanted[left]
        middle = np.eye(4)[list(ends)].mean(axis=0)[1:, None]  # reference coordinates are those of corners 1 to 3
        values, _ = tabulate(space.pair.displacement, middle)
        rows.append(np.repeat(left[found], len(values)))
        columns.append(space.nodes[place[found]].ravel())
        weights.append(np.tile(values[:, 0], int(found.sum())))
        left = left[~found]
    entries = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
    return csr_array(coo_array(entries, shape=(len(edges), space.n_nodes)))


def _nearest_facet(points: FloatArray, facets: IntArray, position: FloatArray) -> tuple[int, FloatArray]:
    """Facet nearest to ``position`` among those around it, and the barycentric place of the foot point (3,)."""
    a, b, c = (points[facets[:, i]] for i in range(3))
    candidates = np.argsort(np.linalg.norm((a + b + c) / 3 - position, axis=1))[:60]
    feet = [_foot(points[facets[f]], position) for f in candidates]
    gaps = [
        float(np.linalg.norm(bary @ points[facets[f]] - position)) for f, bary in zip(candidates, feet, strict=True)
    ]
    best = int(np.argmin(gaps))
    return int(candidates[best]), feet[best]


def _foot(triangle: FloatArray, position: FloatArray) -> FloatArray:
    """Barycentric coordinates of the plane projection, clipped into the triangle."""
    edges = (triangle[1:] - triangle[0]).T
    (s, t), *_ = np.linalg.lstsq(edges, position - triangle[0], rcond=None)
    bary = np.clip([1 - s - t, s, t], 0.0, None)
    return np.asarray(bary / bary.sum())
