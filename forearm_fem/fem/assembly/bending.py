"""Bending of a thin sheet on facets of the skin, by interior penalty: the elements' slopes jump between facets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from skfem.quadrature import get_quadrature
from skfem.refdom import RefLine, RefTri

from ...errors import ScenarioError
from ...typing import FloatArray, IntArray
from ..space.numbering import MixedSpace, facet_points, tabulate
from .boundary import Covered, in_pieces, places_and_normals
from .tissues import scatter_blocks

# The energy per D is the integral of H:AH with the Hessian H of the normal displacement in each flat facet and
# A H = (1 - nu) H + nu tr H, nu = 1/2 of an incompressible sheet. Elements are continuous, their slopes are not:
# over an edge the moments' mean works on the jump of slopes, and a penalty holds that (Engel et al. 2002, CMAME 191:
# 3669). The jump is the sum of both slopes along the outward conormals, which a rigid motion leaves zero whatever the
# angle between facets. Free edges carry nothing. A facet counts by the share of it that is covered.

_STEP = 0.25  # of central differences of gradients: exact for the quadratic ones of cubic elements
_PENALTY = 4.0  # times the trace inequality's constant; 9/4 is the least that is stable for nu = 1/2
_POISSON = 0.5


class _Side(NamedTuple):
    """Facets (k,) of the sheet on one local facet of their tetrahedra ``tets``.

    ``corners`` (k, 3) are vertices as reference places go, ``area`` (k,) [m^2], ``share`` (k,) covered, ``normal``
    (k, 3), and ``inverse`` (k, 2, 2) maps reference derivatives to those along two unit vectors in the plane,
    ``plane`` (k, 3, 2).
    """

    local: int
    tets: IntArray
    corners: IntArray
    area: FloatArray
    share: FloatArray
    normal: FloatArray
    inverse: FloatArray
    plane: FloatArray


def facet_bending(space: MixedSpace, facets: IntArray, covered: Covered) -> csr_array:
    """Matrix of the bending energy per D of what is ``covered`` of boundary facets (k, 3), a free plate.

    Raises ScenarioError for linear elements, whose facets do not bend.
    """
    if space.pair.name == "P1":
        raise ScenarioError("tissues.patch.bending: facets of P1 elements do not bend; set mesh.element = 'P2'")
    shape = (space.n_nodes, space.n_nodes)
    total = csr_array((3 * space.n_nodes, 3 * space.n_nodes))
    tets, local = space.owners(facets)
    sides = [side for f in range(4) if len((side := _side(space, tets[local == f], f, covered)).tets)]
    points, weights = get_quadrature(RefTri, 2)
    for side in sides:
        hessian = _hessians(space, side, points)
        moment = _moments(hessian)
        energy = np.einsum("eaqij,ebqij,q,e->eab", hessian, moment, 2 * weights, side.area * side.share, optimize=True)
        blocks = np.einsum("eab,ei,ej->ijeab", energy, side.normal, side.normal, optimize=True)
        total = total + scatter_blocks(space.nodes[side.tets], space.nodes[side.tets], blocks, shape)
    for nodes, blocks in _edges(space, sides):
        total = total + scatter_blocks(nodes, nodes, blocks, shape)
    return csr_array(total)


def _side(space: MixedSpace, mine: IntArray, local: int, covered: Covered) -> _Side:
    """The facets of tetrahedra ``mine`` that are covered at least in part."""
    points, weights = in_pieces(*get_quadrature(RefTri, 2))
    inside = covered(*places_and_normals(space, mine, facet_points(local, points), local))
    share = inside @ weights / weights.sum()
    mine, share = mine[share > 0], share[share > 0]
    corners = facet_points(local, np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    vertex = np.argmax(np.vstack([1 - corners.sum(axis=0), corners]), axis=0)
    along = space.jacobians[mine] @ (corners[:, 1:] - corners[:, :1])  # (k, 3, 2)
    plane, upper = np.linalg.qr(along)
    normal, place = np.cross(plane[..., 0], plane[..., 1]), space.mesh.points[space.vertices[mine]]
    inner = place.mean(axis=1) - place[:, vertex].mean(axis=1)
    normal = normal * -np.sign(np.einsum("ei,ei->e", normal, inner))[:, None]  # outward on both sides of an edge
    area = 0.5 * np.abs(np.linalg.det(upper))
    return _Side(local, mine, space.vertices[mine][:, vertex], area, share, normal, np.linalg.inv(upper), plane)


def _slopes(space: MixedSpace, local: int, points: FloatArray) -> FloatArray:
    """Derivatives (nb, 2, q) of the basis along both sides of the reference facet, at its ``points`` (2, q)."""
    ends = facet_points(local, np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    _, gradients = tabulate(space.pair.displacement, facet_points(local, points))
    return np.asarray(np.einsum("bkq,ks->bsq", gradients, ends[:, 1:] - ends[:, :1]))


def _hessians(space: MixedSpace, side: _Side, points: FloatArray) -> FloatArray:
    """Second derivatives (k, nb, q, 2, 2) [1/m^2] in the facets' planes at reference ``points`` (2, q)."""
    steps = _STEP * np.eye(2)[:, :, None]
    second = np.stack(
        [(_slopes(space, side.local, points + s) - _slopes(space, side.local, points - s)) / (2 * _STEP) for s in steps]
    )  # (2, nb, 2, q)
    return np.asarray(np.einsum("esi,sbtq,etj->ebqij", side.inverse, second, side.inverse, optimize=True))


def _moments(hessian: FloatArray) -> FloatArray:
    trace = np.trace(hessian, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray((1 - _POISSON) * hessian + _POISSON * trace * np.eye(2))


def _edges(space: MixedSpace, sides: list[_Side]) -> list[tuple[IntArray, FloatArray]]:
    """Nodes (k, 2 nb) and blocks (3, 3, k, 2 nb, 2 nb) of the edges between two facets of the sheet."""
    keys, owners = [], []
    for number, side in enumerate(sides):
        for first, second in ((0, 1), (1, 2), (2, 0)):
            ends = np.sort(side.corners[:, [first, second]], axis=1)
            keys.append(ends)
            owners.append(np.stack([np.full(len(ends), i) for i in (number, first, second)], axis=1))
    counts = [len(side.tets) for side in sides for _ in range(3)]
    rows = np.concatenate([np.arange(n) for n in counts])
    ends, owner = np.concatenate(keys), np.concatenate(owners)
    order = np.lexsort(ends.T)
    same = np.flatnonzero((ends[order[1:]] == ends[order[:-1]]).all(axis=1))
    pairs = np.stack([order[same], order[same + 1]], axis=1)
    kinds = np.concatenate([owner[pairs[:, 0]], owner[pairs[:, 1]]], axis=1)
    out = _mirrored(space, sides, rows, ends, owner)
    for kind in np.unique(kinds, axis=0):
        mine = pairs[(kinds == kind).all(axis=1)]
        both = [_at_edge(space, sides[n], rows[mine[:, i]], first, second)
                for i, (n, first, second) in enumerate((kind[:3], kind[3:]))]  # fmt: skip
        slope = np.concatenate([b.slope for b in both], axis=1)
        moment = 0.5 * np.concatenate([b.moment for b in both], axis=1)
        normal = np.concatenate([np.repeat(b.normal[:, None], b.slope.shape[1], axis=1) for b in both], axis=1)
        per_area = np.maximum(both[0].per_area, both[1].per_area)
        form = _form(space, slope, moment, both[0].weights, both[0].length * per_area)
        nodes = np.concatenate([b.nodes for b in both], axis=1)
        out.append((nodes, np.asarray(np.einsum("eab,eai,ebj->ijeab", form, normal, normal, optimize=True))))
    return out


def _mirrored(
    space: MixedSpace, sides: list[_Side], rows: IntArray, ends: IntArray, owner: IntArray
) -> list[tuple[IntArray, FloatArray]]:
    """As :func:`_edges`, of edges on planes of symmetry: half of what an edge to the mirror image has."""
    out = []
    for name in ("symmetry x", "symmetry y"):
        mine = np.isin(ends, space.mesh.facets.get(name, ())).all(axis=1)
        for kind in np.unique(owner[mine], axis=0):
            some = np.flatnonzero(mine & (owner == kind).all(axis=1))
            b = _at_edge(space, sides[kind[0]], rows[some], kind[1], kind[2])
            form = 0.5 * _form(space, 2 * b.slope, b.moment, b.weights, b.length * b.per_area)
            blocks = np.einsum("eab,ei,ej->ijeab", form, b.normal, b.normal, optimize=True)
            out.append((b.nodes, np.asarray(blocks)))
    return out


def _form(
    space: MixedSpace, slope: FloatArray, moment: FloatArray, weights: FloatArray, held: FloatArray
) -> FloatArray:
    """Penalty on the jump of slopes less the work of moments on it, (k, n, n)."""
    degree = space.pair.displacement.maxdeg
    held = _PENALTY * degree * (degree - 1) / 2 * held
    work = np.einsum("eaq,ebq,eq->eab", moment, slope, weights, optimize=True)
    jump = np.einsum("eaq,ebq,eq->eab", slope, slope, weights * held[:, None], optimize=True)
    return np.asarray(jump - work - work.swapaxes(1, 2))


class _Edge(NamedTuple):
    """One facet's part at its edges (k,): ``slope`` and ``moment`` (k, nb, q) along and about the outward conormal."""

    nodes: IntArray
    normal: FloatArray
    slope: FloatArray
    moment: FloatArray
    weights: FloatArray
    length: FloatArray
    per_area: FloatArray


def _at_edge(space: MixedSpace, side: _Side, rows: IntArray, first: int, second: int) -> _Edge:
    """Edges from corner ``first`` to ``second`` of the facets ``rows``; points go from the lower vertex on."""
    corner = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    line, weights = get_quadrature(RefLine, 2 * space.pair.displacement.maxdeg)
    side = side._replace(**{k: getattr(side, k)[rows] for k in side._fields[1:]})
    forward = side.corners[:, first] < side.corners[:, second]
    ends = space.mesh.points[side.corners[:, [first, second]]]
    third = space.mesh.points[side.corners[:, 3 - first - second]]
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    out = ends[:, 0] - third
    out = out - np.einsum("ei,ei->e", out, along)[:, None] * along
    conormal = np.einsum("eij,ei->ej", side.plane, out / np.linalg.norm(out, axis=1)[:, None])
    found = []
    for way in (line, 1 - line):
        points = corner[:, [first]] * (1 - way) + corner[:, [second]] * way
        slope = np.einsum("bsq,esi,ei->ebq", _slopes(space, side.local, points), side.inverse, conormal, optimize=True)
        moments = _moments(_hessians(space, side, points))
        found.append((slope, np.einsum("ebqij,ei,ej->ebq", moments, conormal, conormal, optimize=True)))
    slope, moment = (np.where(forward[:, None, None], a, b) for a, b in zip(*found, strict=True))
    moment = moment * side.share[:, None, None]
    return _Edge(
        space.nodes[side.tets], side.normal, slope, moment, np.multiply.outer(length, weights), length,
        side.share / side.area,
    )  # fmt: skip
