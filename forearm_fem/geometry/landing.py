"""Landing points on the skin of a limb known only by its facets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..typing import FloatArray, IntArray
from .mesh import TissueMesh

_SLACK = 1e-9


@dataclass(frozen=True)
class FacetSkin:
    """Skin facets (k, 3) of ``points`` (n, 3); calling it with (x, y) (m, 2) gives the uppermost place
    there."""

    points: FloatArray
    facets: IntArray

    @classmethod
    def of(cls, mesh: TissueMesh) -> FacetSkin:
        """The skin of ``mesh``."""
        return cls(mesh.points, mesh.facets["skin"])

    @cached_property
    def normals(self) -> FloatArray:
        """Area-weighted outward unit normals (n, 3) of the vertices; zero away from the skin."""
        a, b, c = self.points[self.facets].transpose(1, 0, 2)
        total = np.zeros_like(self.points)
        for corner in self.facets.T:
            np.add.at(total, corner, np.cross(b - a, c - a))
        return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None])

    def __call__(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (m, 3) and interpolated outward unit normals (m, 3); NaN where there is no skin."""
        found = [self._land(p) for p in xy]
        return np.array([p for p, _ in found]), np.array([n for _, n in found])

    def _land(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        weight = self._weights(xy)
        hit = np.flatnonzero((weight > -_SLACK).all(axis=1))
        if not len(hit):
            return np.full(3, np.nan), np.full(3, np.nan)
        places = np.einsum("ij,ijk->ik", weight[hit], self.points[self.facets[hit]])
        top = int(places[:, 2].argmax())
        normal = weight[hit[top]] @ self.normals[self.facets[hit[top]]]
        return places[top], np.asarray(normal / np.linalg.norm(normal))

    def _weights(self, xy: FloatArray) -> FloatArray:
        """Barycentric coordinates (k, 3) of ``xy`` (2,) in every facet seen from above; NaN for upright
        ones."""
        a, b, c = self.points[self.facets][:, :, :2].transpose(1, 0, 2)
        u, v, w = b - a, c - a, xy - a
        twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        twice = np.where(np.abs(twice) < 1e-30, np.nan, twice)
        s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / twice
        r = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / twice
        return np.column_stack([1 - s - r, s, r])

    def lift(self, points: FloatArray) -> FloatArray:
        """Points (n, 3) set to the height of the skin above or below them where there is one."""
        landed, _ = self(points[:, :2])
        missing = np.asarray(np.isnan(landed).any(axis=1))
        return np.where(np.reshape(missing, (-1, 1)), points, landed)
