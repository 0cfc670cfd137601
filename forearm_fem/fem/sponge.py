"""Absorbing layer before cut ends: viscosity that grows towards the end swallows waves before they come back.

The dashpots behind it are exact for plane shear waves only; the guided waves of a limb at 20-80 Hz are reflected by
them (docs/decisions.md has the figures).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from ..tissue import Tissue
from ..typing import FloatArray, IntArray
from .assembly import ReferenceTensors, weighted_shear
from .coefficients import Polynomial
from .space import MixedSpace

_CORNER = 30.0  # Hz: where the added loss factor at the end reaches 1
SPONGE = Polynomial(rate=1 / (2 * np.pi * _CORNER))


def sponge_matrix(
    space: MixedSpace,
    tissues: Mapping[str, Tissue],
    ends: IntArray,
    thickness: float,
    reference: ReferenceTensors,
) -> csr_array:
    """Stiffness (n_u, n_u) that times :data:`SPONGE` is the added viscosity; it grows as the depth in the layer squared.

    ``ends`` (k, 3) are the cut facets, ``thickness`` [m] is that of the layer before them.
    """
    names = space.mesh.region_names
    modulus = np.array([abs(complex(tissues[n].modulus.at(np.array([0.0]))[0])) for n in names])
    return weighted_shear(space, modulus[space.mesh.region] * _depth(space, ends, thickness) ** 2, reference)


def _depth(space: MixedSpace, ends: IntArray, thickness: float) -> FloatArray:
    """0 where the layer begins to 1 at the end, for each tetrahedron (n_tet,)."""
    corner = space.mesh.points[ends]
    tree = cKDTree(np.vstack([corner.reshape(-1, 3), corner.mean(axis=1)]))
    away, _ = tree.query(space.mesh.points[space.vertices].mean(axis=1), distance_upper_bound=thickness)
    return np.asarray(np.clip(1 - away / thickness, 0.0, None))
