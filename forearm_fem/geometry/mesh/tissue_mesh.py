"""The mesh that everything after geometry works on: tetrahedra, named regions, named boundary facets."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ...typing import BoolArray, FloatArray, IntArray
from .topology import EDGES, keys

DOWN = -0.5  # z of a unit outward normal below which skin belongs to the underside: a sixth of the way round each side


@dataclass(frozen=True)
class Bends:
    """Edges that are parabolas: ``edges`` (k, 2) of vertices, and how far [m] the middle of each lies off its chord,
    ``offsets`` (k, 3)."""

    edges: IntArray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    offsets: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    def on(self, edges: IntArray) -> FloatArray:
        """Offsets (m, 3) [m] of ``edges`` (m, 2), zero where they are straight."""
        offsets = np.zeros((len(edges), 3))
        if len(self.edges):
            n = 1 + max(int(edges.max(initial=0)), int(self.edges.max()))
            known, wanted = keys(self.edges, n), keys(edges, n)
            order = np.argsort(known)
            at = order[np.minimum(np.searchsorted(known, wanted, sorter=order), len(known) - 1)]
            found = known[at] == wanted
            offsets[found] = self.offsets[at[found]]
        return offsets

    def of(self, tetrahedra: IntArray) -> FloatArray:
        """Offsets (n_tet, 6, 3) [m] of the edges, in the order of :data:`.topology.EDGES`, of ``tetrahedra``
        (n_tet, 4)."""
        return self.on(tetrahedra[:, EDGES].reshape(-1, 2)).reshape(-1, len(EDGES), 3)

    def chosen(self, which: BoolArray) -> Bends:
        """Those of the edges that are marked in ``which`` (k,)."""
        return Bends(self.edges[which], self.offsets[which])


@dataclass(frozen=True)
class TissueMesh:
    """Conforming tetrahedra in metres, affine but for edges that bend; volar skin up (+z), x along the limb.

    ``points`` (n_point, 3) [m]; ``tetrahedra`` (n_tet, 4) positively oriented; ``region`` (n_tet,) indexes
    ``region_names`` (tissue names; a meshed bone is the region "bone"). ``facets`` maps boundary names to (k, 3) vertex
    triples: always "skin" (whole free surface), and where they exist "bone" (surface of a bone left out of the mesh),
    "end" (cut ends; a slab's sides and bottom), "underside" (the part of "skin" that may be held), "contact A1"
    ... (part of "skin" under a cone, exactly inside the disc's rim), "symmetry x" and "symmetry y". ``bends`` follow
    from these and the scenario's limb (:mod:`forearm_fem.geometry.limb.bending`): files do not hold them.
    """

    points: FloatArray
    tetrahedra: IntArray
    region: IntArray
    region_names: tuple[str, ...]
    facets: Mapping[str, IntArray] = field(default_factory=dict)
    bends: Bends = field(default_factory=Bends)

    @cached_property
    def digest(self) -> str:
        """SHA-256 over coordinates, connectivity, regions and facets; goes into every result."""
        sha = hashlib.sha256()
        for array in (self.points, self.tetrahedra, self.region, *(self.facets[k] for k in sorted(self.facets))):
            sha.update(np.ascontiguousarray(array).tobytes())
        return sha.hexdigest()

    @cached_property
    def volumes(self) -> FloatArray:
        """Volume of each tetrahedron (n_tet,) [m^3] with straight edges, positive."""
        corner = self.points[self.tetrahedra]
        edges = corner[:, 1:] - corner[:, :1]
        return np.asarray(np.linalg.det(edges) / 6)
