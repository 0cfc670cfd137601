"""The volar skin as a map: vertices and facets seen from above, normals, and points in between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import DataError
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..ports import Port, positions
from ..results.files import Wavefield
from ..typing import ComplexArray, FloatArray, IntArray

_STEEPEST = 0.35  # least n_z of a facet that still counts as volar


@dataclass(frozen=True, eq=False)
class VolarPatch:
    """Skin facets around the device that face upwards, so that (x, y) names one point of them.

    ``vertices`` (n,) are indices into the mesh, ``points`` (n, 3) [m], ``triangles`` (m, 3) index these, ``normals``
    (n, 3) point outwards.
    """

    vertices: IntArray
    points: FloatArray
    triangles: IntArray
    normals: FloatArray

    def weights(self, places: FloatArray) -> tuple[IntArray, FloatArray]:
        """Corners (k, 3), indices into the patch, and weights (k, 3) of points (k, 2) [m] seen from above.

        Raises DataError for a point off the patch.
        """
        flat = self.points[self.triangles][:, :, :2]
        edges = (flat[:, 1:] - flat[:, :1]).swapaxes(1, 2)
        inner = np.einsum("mab,kmb->kma", np.linalg.inv(edges), places[:, None] - flat[None, :, 0])
        shares = np.concatenate([1 - inner.sum(axis=2, keepdims=True), inner], axis=2)
        best = np.argmax(shares.min(axis=2), axis=1)
        weights = shares[np.arange(len(places)), best]
        if np.any(weights < -1e-6):
            x, y = places[(weights < -1e-6).any(axis=1)][0]
            raise DataError(f"the point ({x:g}, {y:g}) m is not on the volar skin of the mesh near the device")
        return self.triangles[best], weights

    def lift(self, places: FloatArray) -> FloatArray:
        """Points (k, 3) [m] of the skin under (x, y) (k, 2) [m]."""
        corners, weights = self.weights(places)
        return np.asarray(np.einsum("kcx,kc->kx", self.points[corners], weights))

    def normal_field(self, field: Wavefield) -> NormalField:
        """The field's modes on the patch, outward component only."""
        modes = np.einsum("pcr,pc->pr", field.modes[self.vertices], self.normals)
        return NormalField(field.frequency, modes, field.amplitudes)


@dataclass(frozen=True, eq=False)
class NormalField:
    """One scalar component of a wavefield: ``modes`` (n_point, r), ``amplitudes`` (n_frequency, r, n_input)."""

    frequency: FloatArray
    modes: FloatArray
    amplitudes: ComplexArray

    def response(self, source: int) -> ComplexArray:
        """Displacement per unit drive (n_frequency, n_point) of one input."""
        return np.asarray(self.amplitudes[:, :, source] @ self.modes.T)

    def in_time(self, spectrum: ComplexArray, times: FloatArray) -> FloatArray:
        """Normal motion over time (n_time, n_point) [m], as :meth:`Wavefield.in_time` has it."""
        as_field = Wavefield(self.frequency, self.modes[:, None, :], self.amplitudes)
        return as_field.in_time(spectrum, times)[:, :, 0]

    def between(self, corners: IntArray, weights: FloatArray) -> NormalField:
        """At points inside facets, interpolated from their corners."""
        return replace(self, modes=np.einsum("kcr,kc->kr", self.modes[corners], weights))


def volar_patch(mesh: TissueMesh, ports: Sequence[Port], margin: float = 0.014) -> VolarPatch:
    """The patch that reaches ``margin`` [m] beyond ``ports``; DataError if there are no facets."""
    facets = mesh.facets["skin"]
    corner = mesh.points[facets]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    away = mesh.points[facets].mean(axis=1) - mesh.points.mean(axis=0)
    away[:, 0] = 0
    normal *= np.sign(np.einsum("ij,ij->i", normal, away))[:, None]
    up = normal[:, 2] > _STEEPEST * np.linalg.norm(normal, axis=1)
    places = positions(tuple(ports))[:, :2]
    low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
    middle = corner.mean(axis=1)[:, :2]
    chosen = up & np.all((middle > low) & (middle < high), axis=1)
    if not chosen.any():
        raise DataError("the mesh has no skin facing upwards near the ports; are its axes x along, z out of the skin?")
    vertices, flat = np.unique(facets[chosen], return_inverse=True)
    triangles = flat.reshape(facets[chosen].shape)
    normals = np.zeros((len(vertices), 3))
    for k in range(3):  # area-weighted mean of the facets that meet
        np.add.at(normals, triangles[:, k], normal[chosen])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return VolarPatch(vertices, mesh.points[vertices], triangles, normals)
