"""Landing points on the skin of a limb known only by its facets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...typing import FloatArray, IntArray
from ..mesh.nearby import meeting
from ..mesh.tissue_mesh import TissueMesh
from ..mesh.topology import triangle_normals

_SLACK = 1e-9


@dataclass(frozen=True)
class FacetSkin:
    """Skin facets (k, 3) of ``points`` (n, 3); calling it with (x, y) (m, 2) gives the uppermost place there."""

    points: FloatArray
    facets: IntArray

    @classmethod
    def of(cls, mesh: TissueMesh) -> FacetSkin:
        """The skin of ``mesh``."""
        return cls(mesh.points, mesh.facets["skin"])

    @cached_property
    def normals(self) -> FloatArray:
        """Area-weighted outward unit normals (n, 3) of the vertices; zero away from the skin."""
        normals, total = triangle_normals(self.points, self.facets), np.zeros_like(self.points)
        for corner in self.facets.T:
            np.add.at(total, corner, normals)
        return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None])

    def __call__(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (m, 3) and interpolated outward unit normals (m, 3); NaN where there is no skin."""
        at, facet = meeting(xy, np.zeros(len(xy)), *self._discs)
        weight = self._weights(xy[at], facet)
        hit = np.asarray((weight > -_SLACK).all(axis=1))
        at, facet, weight = at[hit], facet[hit], weight[hit]
        places = np.einsum("ij,ijk->ik", weight, self.points[self.facets[facet]])
        top = np.lexsort((-places[:, 2], at))
        where, first = np.unique(at[top], return_index=True)
        chosen = top[first]
        points, normals = np.full((len(xy), 3), np.nan), np.full((len(xy), 3), np.nan)
        normal = np.einsum("ij,ijk->ik", weight[chosen], self.normals[self.facets[facet[chosen]]])
        points[where] = places[chosen]
        normals[where] = normal / np.linalg.norm(normal, axis=1)[:, None]
        return points, normals

    @cached_property
    def _discs(self) -> tuple[FloatArray, FloatArray]:
        """Centres (k, 2) and radii (k,) of circles around the facets seen from above, slack included."""
        corner = self.points[self.facets][:, :, :2]
        centre = corner.mean(axis=1)
        radius = np.linalg.norm(corner - centre[:, None], axis=2).max(axis=1)
        return centre, np.asarray((1 + 1e-6) * radius)

    def _weights(self, xy: FloatArray, facet: IntArray) -> FloatArray:
        """Barycentric coordinates (m, 3) of ``xy`` (m, 2) in facets (m,) seen from above; NaN for upright ones."""
        a, b, c = self.points[self.facets[facet]][:, :, :2].transpose(1, 0, 2)
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
