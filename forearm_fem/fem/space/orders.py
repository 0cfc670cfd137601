"""Third order where the device is, second elsewhere: which unknowns are kept, and what the others follow from.

An edge is cubic (two nodes) or quadratic (one). What a tetrahedron has on an edge or a face follows from the unknowns
kept on that edge or face alone, so displacements are continuous between tetrahedra of different order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array, eye_array, kron

from ...geometry.device.sizing import tetrahedron_orders
from ...geometry.mesh.tissue_mesh import TissueMesh
from ...ports import Port
from ...typing import BoolArray, FloatArray, IntArray
from .numbering import CUBIC_EDGES, CUBIC_FACES, MixedSpace, element_pair, mixed_space

_ENDS, _CORNERS = np.array(CUBIC_EDGES), np.array(CUBIC_FACES)
_SIDES = np.array([[CUBIC_EDGES.index(e) for e in ((a, b), (b, c), (a, c))] for a, b, c in CUBIC_FACES])
_SIDE_ENDS = ((0, 1), (1, 2), (0, 2))  # which of a face's corners its sides join
_THIRD = (2 / 9, -1 / 9, 8 / 9)  # a parabola at a third of an edge: from its near end, far end and middle
_MIDDLE = (-1 / 16, 9 / 16)  # a cubic in the middle of an edge: from each end and each third
_CENTRE = (-1 / 9, 4 / 9)  # a quadratic function in the middle of a face: from its corners and its sides' middles


@dataclass(frozen=True)
class Orders:
    """Numbering of unknowns on a mesh whose tetrahedra are of one or of two orders.

    ``high`` numbers every tetrahedron as of the higher order; its coefficients are ``spread`` (high.n_nodes, n_kept)
    and ``spread_pressures`` (high.n_pressures, n_kept_pressures) times the unknowns kept. Tetrahedra ``raised``
    (n_tet,) are integrated in ``high``, the others in ``low``, which numbers the kept unknowns themselves and holds for
    those only.
    ``kept`` (high.n_nodes,) is each node's number among those kept, -1 where it follows from others.
    """

    low: MixedSpace
    high: MixedSpace
    raised: BoolArray
    spread: csr_array
    spread_pressures: csr_array
    kept: IntArray

    def kept_on(self, facets: IntArray) -> IntArray:
        """Numbers of the kept nodes on boundary facets (k, 3)."""
        return self.kept_of(self.high.facet_nodes(facets))

    def kept_of(self, nodes: IntArray) -> IntArray:
        """Numbers of the kept ones among ``nodes`` (k,) of ``high``."""
        found = self.kept[nodes]
        return np.asarray(found[found >= 0])

    def unused(self) -> IntArray:
        """Numbers of the kept nodes that no tetrahedron has: points of the mesh that belong to none."""
        is_used = np.zeros(self.spread.shape[1], dtype=bool)
        found = self.kept[self.high.nodes]
        is_used[found[found >= 0]] = True
        return np.flatnonzero(~is_used)

    def carried(self, transform: csr_array) -> csr_array:
        """``transform`` (3 n_kept, n_free) carried on to all displacement unknowns of ``high``."""
        return csr_array(csr_array(kron(self.spread, eye_array(3), format="csr")) @ transform)


def element_orders(mesh: TissueMesh, ports: tuple[Port, ...], element: str) -> Orders:
    """Numbering for the element pair "P1", "P2" or "P3", or "P2/P3": third order around ``ports``, second elsewhere."""
    if element != "P2/P3":
        return uniform_orders(mesh, element)
    return graded_orders(mesh, tetrahedron_orders(mesh, ports, element) == 3)


def uniform_orders(mesh: TissueMesh, element: str) -> Orders:
    """One element pair, "P1", "P2" or "P3", for all tetrahedra."""
    space = mixed_space(mesh, element)
    nodes, pressures = (csr_array(eye_array(n, format="csr")) for n in (space.n_nodes, space.n_pressures))
    return Orders(space, space, np.zeros(len(mesh.region), dtype=bool), nodes, pressures, np.arange(space.n_nodes))


def graded_orders(mesh: TissueMesh, chosen: BoolArray) -> Orders:
    """P3/P2 in the ``chosen`` (n_tet,) tetrahedra, P2/P1 away from them.

    Edges of chosen tetrahedra are cubic. Pressures are quadratic only along edges around which, in one tissue, all
    tetrahedra have six cubic edges: elsewhere displacements would not be rich enough for them.
    """
    high = mixed_space(mesh, "P3")
    _, first, number = np.unique(high.nodes[:, 4:16:2], return_index=True, return_inverse=True)
    tet, local, number = first // 6, first % 6, number.reshape(-1, 6)
    is_cubic = np.zeros(len(first), dtype=bool)
    is_cubic[number[chosen]] = True
    ends = high.nodes[tet[:, None], _ENDS[local]]
    thirds = np.column_stack([high.nodes[tet, 4 + 2 * local], high.nodes[tet, 5 + 2 * local]])
    edges = _Edges(ends, thirds, is_cubic, number)
    spread, kept = _spread(high, edges)
    cubic = is_cubic[number]
    spread_pressures, kept_pressures = _spread_pressures(high, np.asarray(cubic.all(axis=1)))
    nodes = kept[np.hstack([high.nodes[:, :4], high.nodes[:, 4:16:2]])]
    low = MixedSpace(
        mesh, element_pair("P2"), high.vertices, nodes, kept_pressures[high.pressures[:, :4]],
        spread.shape[1], spread_pressures.shape[1],
    )  # fmt: skip
    return Orders(low, high, np.asarray(cubic.any(axis=1)), spread, spread_pressures, kept)


@dataclass(frozen=True)
class _Edges:
    """Each edge's end nodes and the cubic nodes next to them (n, 2), whether it is ``cubic`` (n,), and the
    ``number`` (n_tet, 6) of each tetrahedron's edges. A quadratic edge keeps its middle in place of ``thirds[:, 0]``.
    """

    ends: IntArray
    thirds: IntArray
    cubic: BoolArray
    number: IntArray


@dataclass(frozen=True)
class _Faces:
    """Each face's node (n,), corner nodes and edges (n, 3)."""

    node: IntArray
    corners: IntArray
    sides: IntArray


class _Weights:
    """Entries of a sparse matrix, put down column by column of a table."""

    def __init__(self) -> None:
        self._parts: list[tuple[IntArray, IntArray, FloatArray]] = []

    def put(self, rows: IntArray, columns: IntArray, weight: float) -> None:
        """Note ``weight`` at each pair of ``rows`` and ``columns``."""
        self._parts.append((rows, columns, np.full(len(rows), weight)))

    def matrix(self, kept: IntArray) -> csr_array:
        """The matrix (len(kept), n_kept) over the columns with a number in ``kept``."""
        rows, columns, values = (np.concatenate(each) for each in zip(*self._parts, strict=True))
        shape = (len(kept), int(kept.max()) + 1)
        return csr_array(coo_array((values, (rows, kept[columns])), shape=shape))


def _spread(space: MixedSpace, edges: _Edges) -> tuple[csr_array, IntArray]:
    """Interpolation of displacement nodes from those kept, and the numbers of these."""
    node, first = np.unique(space.nodes[:, 16:20], return_index=True)
    tet, local = first[:, None] // 4, first % 4
    faces = _Faces(node, space.nodes[tet, _CORNERS[local]], edges.number[tet, _SIDES[local]])
    whole = edges.cubic[faces.sides].all(axis=1)
    own = np.ones(space.n_nodes, dtype=bool)  # nodes that are themselves unknowns
    own[edges.thirds[~edges.cubic]] = False
    own[faces.node[~whole]] = False
    is_kept = own.copy()
    is_kept[edges.thirds[~edges.cubic, 0]] = True
    kept = np.where(is_kept, np.cumsum(is_kept) - 1, -1)
    weights = _Weights()
    weights.put(np.flatnonzero(own), np.flatnonzero(own), 1.0)
    ends, thirds = edges.ends[~edges.cubic], edges.thirds[~edges.cubic]  # middles stand where first thirds would
    for near, far in ((0, 1), (1, 0)):
        for column, weight in zip((ends[:, near], ends[:, far], thirds[:, 0]), _THIRD, strict=True):
            weights.put(thirds[:, near], column, weight)
    _put_centres(weights, _Faces(faces.node[~whole], faces.corners[~whole], faces.sides[~whole]), edges)
    return weights.matrix(kept), kept


def _put_centres(weights: _Weights, faces: _Faces, edges: _Edges) -> None:
    """Centres of faces with a quadratic side; the middle of a cubic side follows from its ends and thirds."""
    corner, side = _CENTRE
    for i in range(3):
        weights.put(faces.node, faces.corners[:, i], corner)
        thirds, cubic = edges.thirds[faces.sides[:, i]], edges.cubic[faces.sides[:, i]]
        weights.put(faces.node[~cubic], thirds[~cubic, 0], side)
        for j in range(2):
            end = faces.corners[cubic, _SIDE_ENDS[i][j]]
            weights.put(faces.node[cubic], end, side * _MIDDLE[0])
            weights.put(faces.node[cubic], thirds[cubic, j], side * _MIDDLE[1])


def _spread_pressures(space: MixedSpace, cubic: BoolArray) -> tuple[csr_array, IntArray]:
    """Interpolation of pressure nodes from those kept, and the numbers of these; ``cubic`` (n_tet,) may have
    quadratic ones."""
    middle, first = np.unique(space.pressures[:, 4:], return_index=True)
    linear = np.zeros(space.n_pressures, dtype=bool)
    linear[space.pressures[~cubic, 4:]] = True
    kept = np.where(linear, -1, np.cumsum(~linear) - 1)
    weights = _Weights()
    weights.put(np.flatnonzero(~linear), np.flatnonzero(~linear), 1.0)
    follows = linear[middle]
    tet, local = first[follows] // 6, first[follows] % 6
    for end in _ENDS[local].T:
        weights.put(middle[follows], space.pressures[tet, end], 0.5)
    return weights.matrix(kept), kept
