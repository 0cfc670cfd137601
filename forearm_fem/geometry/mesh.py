"""The mesh that everything after geometry works on: tetrahedra, named regions, named boundary facets."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..typing import FloatArray, IntArray


@dataclass(frozen=True)
class TissueMesh:
    """Conforming affine tetrahedra in metres; volar skin up (+z), x along the limb.

    ``points`` (n_point, 3) [m]; ``tetrahedra`` (n_tet, 4) positively oriented; ``region`` (n_tet,) indexes
    ``region_names`` (tissue names; a meshed bone is the region "bone").
    ``facets`` maps boundary names to (k, 3) vertex triples: always "skin" (whole free surface), and where they
    exist "bone" (surface of a bone left out of the mesh), "end" (cut ends; a slab's sides and bottom),
    "underside" (the part of "skin" that may rest on foam), "contact A1" ... (part of "skin" under a cone, exactly
    inside the disc's rim), "symmetry x" and "symmetry y".
    """

    points: FloatArray
    tetrahedra: IntArray
    region: IntArray
    region_names: tuple[str, ...]
    facets: Mapping[str, IntArray] = field(default_factory=dict)

    @cached_property
    def digest(self) -> str:
        """SHA-256 over coordinates, connectivity, regions and facets; goes into every result."""
        sha = hashlib.sha256()
        for array in (self.points, self.tetrahedra, self.region, *(self.facets[k] for k in sorted(self.facets))):
            sha.update(np.ascontiguousarray(array).tobytes())
        return sha.hexdigest()

    @cached_property
    def volumes(self) -> FloatArray:
        """Volume of each tetrahedron (n_tet,) [m^3], positive."""
        corner = self.points[self.tetrahedra]
        edges = corner[:, 1:] - corner[:, :1]
        return np.asarray(np.linalg.det(edges) / 6)
