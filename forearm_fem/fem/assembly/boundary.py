"""Matrices and loads on the skin and on cut ends: membrane, supports, contacts, points."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
from scipy.sparse import coo_array, csr_array, kron
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

from ...errors import GeometryError
from ...geometry.mesh.tissue_mesh import DOWN, keys
from ...ports import Port
from ...typing import BoolArray, FloatArray, IntArray
from ..space.numbering import CUBIC_EDGES, CUBIC_FACES, MixedSpace, facet_points, tabulate
from .tissues import scatter, scatter_blocks

# Real matrices of boundary terms: dashpots, foam, surface mass, membrane and pre-stress.

# True where points (k, q, 3) with outward normals (k, q, 3) belong to the surface of integration
Covered = Callable[[FloatArray, FloatArray], BoolArray]
_PIECES = 6  # along each side of a facet that is covered in part
_MORE = 2  # degrees of the rule beyond what is exact on plane facets: the measure of bent ones is no polynomial


def under_rectangle(length: float, width: float) -> Covered:
    """The part of a surface that a rectangle about the origin covers seen from above, sides [m] along x and y."""

    def covered(points: FloatArray, normals: FloatArray) -> BoolArray:
        """True where points of the volar side lie within it."""
        inside = np.abs(points[..., :2]) <= [length / 2, width / 2]
        return np.asarray(inside.all(axis=-1) & (normals[..., 2] > 0))

    return covered


def middles_covered(space: MixedSpace, facets: IntArray, covered: Covered) -> IntArray:
    """Those of boundary facets (k, 3) whose middle is ``covered``."""
    (tets, local), found = space.owners(facets), np.zeros(len(facets), dtype=bool)
    for f in range(4):
        middle = facet_points(f, np.full((2, 1), 1 / 3))
        found[local == f] = covered(*places_and_normals(space, tets[local == f], middle, f))[:, 0]
    return facets[found]


def rests(points: FloatArray, normals: FloatArray) -> BoolArray:
    """True where a skin's points rest on foam: their outward normals point down, n_z < -0.5."""
    return np.asarray(normals[..., 2] < DOWN)


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
    """Groups of facets with one rule, see :func:`_integrated`; facets that an edge of what is ``covered`` cuts through
    take a finer rule, and those outside are left out."""
    rule = get_quadrature(RefTri, 2 * space.pair.displacement.maxdeg + _MORE)
    tets, local = space.owners(facets)
    groups = []
    for f in range(4):
        mine = tets[local == f]
        if covered is None:
            groups.append(_integrated(space, mine, f, rule))
            continue
        inside = covered(*places_and_normals(space, mine, facet_points(f, rule[0]), f))
        whole, some = inside.all(axis=1), inside.any(axis=1)
        groups += [
            _integrated(space, mine[whole], f, rule),
            _integrated(space, mine[some & ~whole], f, in_pieces(*rule), covered),
        ]
    return [group for group in groups if len(group[0])]


def _integrated(
    space: MixedSpace, mine: IntArray, local: int, rule: tuple[FloatArray, FloatArray], covered: Covered | None = None
) -> _Group:
    """Of a ``local`` facet of tetrahedra ``mine`` (k,): these, values (nb, q), tangential gradients (k, nb, 3, q),
    measures (k, q) [m^2], zero at points that are not ``covered``, and unit normals (k, q, 3)."""
    points = facet_points(local, rule[0])
    values, slopes = tabulate(space.pair.displacement, points)
    jacobians = space.jacobians_at(mine, points)
    cross = _crossed(jacobians, local)
    length = np.linalg.norm(cross, axis=2)
    n = cross / length[..., None]
    full = np.einsum("eqki,bkq->ebiq", np.linalg.inv(jacobians), slopes, optimize=True)
    tangential = full - np.einsum("eqi,eqj,ebjq->ebiq", n, n, full, optimize=True)
    measure = length * rule[1]
    if covered is not None:
        measure = np.where(covered(*places_and_normals(space, mine, points, local)), measure, 0.0)
    return mine, values, tangential, measure, n


def in_pieces(points: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A rule of the reference triangle, points (2, q) and weights (q,), on each of its _PIECES squared parts."""
    corners = [(i, j, 1) for i in range(_PIECES) for j in range(_PIECES - i)]
    corners += [(i, j, -1) for i in range(1, _PIECES) for j in range(1, _PIECES - i + 1)]  # these point backwards
    parts = [(np.array([[i], [j]]) + side * points) / _PIECES for i, j, side in corners]
    return np.hstack(parts), np.tile(weights / _PIECES**2, len(parts))


def resting_nodes(space: MixedSpace, skin: IntArray) -> IntArray:
    """Displacement nodes of skin facets (k, 3) where the skin :func:`rests`, ascending and unique.

    Nodes of an edge go with its middle, so that they are held alike whatever order the edge has. Whole facets would
    err by half their size, and far from the device they are as long as the arm is wide.
    """
    tets, local = space.owners(skin)
    per_edge = {"P1": 0, "P2": 1, "P3": 2}[space.pair.name]
    found = []
    for f in range(4):
        mine, corners = tets[local == f], CUBIC_FACES[f]
        edges = [e for e, ends in enumerate(CUBIC_EDGES) if set(ends) <= set(corners)]
        ends = np.array([CUBIC_EDGES[e] for e in edges])
        vertex = np.eye(4)
        places = np.vstack([vertex[list(corners)], vertex[ends].mean(axis=1), vertex[list(corners)].mean(axis=0)])
        down = rests(*places_and_normals(space, mine, places[:, 1:].T, f))
        columns = [[c] for c in corners] + [[4 + per_edge * e + i for i in range(per_edge)] for e in edges]
        columns += [[16 + f] if space.pair.name == "P3" else []]
        found += [space.nodes[mine[down[:, i]]][:, each].ravel() for i, each in enumerate(columns) if each]
    return np.unique(np.concatenate(found))


def _crossed(jacobians: FloatArray, local: int) -> FloatArray:
    """Vectors (k, q, 3) [m^2] normal to a ``local`` facet of bent tetrahedra, twice as long as it is large."""
    sides = jacobians @ facet_points(local, np.eye(2)) - jacobians @ facet_points(local, np.zeros((2, 1)))
    return np.cross(sides[..., 0], sides[..., 1])


def places_and_normals(
    space: MixedSpace, mine: IntArray, points: FloatArray, local: int
) -> tuple[FloatArray, FloatArray]:
    """Places on straight facets (k, q, 3) [m] and outward unit normals (k, q, 3) of bent ones at reference ``points``
    (3, q) of a ``local`` facet of tetrahedra ``mine`` (k,)."""
    corners = space.mesh.points[space.vertices[mine]]
    places = corners[:, :1] + np.einsum("eki,iq->eqk", space.jacobians[mine], points)
    # which way is out the straight facet knows: at the corner of a thin tetrahedron a bent one points elsewhere
    flat = _crossed(space.jacobians[mine][:, None], local)[:, 0]
    outward = np.sign(np.einsum("ei,ei->e", flat, places[:, 0] - corners.mean(axis=1)))
    n = _crossed(space.jacobians_at(mine, points), local)
    return places, n * (outward[:, None] / np.linalg.norm(n, axis=2))[..., None]


# Port vectors: how a port's displacement is read from, and its force put on, the mesh.

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
