"""Actuators that form no rectangle: the line they lie on, or the triangles of nearest ones."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ..typing import BoolArray, FloatArray, IntArray

_ROUNDING = 1e-9
_ON_CIRCLE = 1e-6  # of a triangle's radius: as far inside its circle another actuator still counts as on it


def nearest_distance(place: FloatArray) -> float:
    """Distance [m] of the two nearest of ``place`` (n, 2) [m], n >= 2."""
    return float(min(np.hypot(*(a - b)) for a, b in combinations(place, 2)))


def line_through(place: FloatArray, slack: float) -> FloatArray | None:
    """Direction (2,) of the line that all of ``place`` (n, 2) [m] lie on, to ``slack`` [m]; None where they do not."""
    away = place - place.mean(axis=0)
    _, _, directions = np.linalg.svd(away, full_matrices=True)
    return np.asarray(directions[0]) if np.abs(away @ directions[1]).max() <= slack else None


def triangle_weights(place: FloatArray, at: FloatArray, slack: float) -> FloatArray | None:
    """Barycentric coordinates (n,) of the point ``at`` (2,) in its Delaunay triangle of ``place`` (n, 2) [m].

    No other place lies in that triangle's circle, so its corners are the nearest that surround the point (Delaunay
    1934). Where four or more lie on one circle, as on a square, the triangles are a matter of choice: their weights are
    then averaged, so that a symmetric layout has symmetric weights. A point outside all triangles, by ``slack`` [m] at
    most, counts as on the nearest edge; None for one further off.
    """
    corners = np.array(list(combinations(range(len(place)), 3)))
    share, height = _barycentric(place[corners], at)
    inside = (share * height).min(axis=1)
    good = inside >= -_ROUNDING * slack if inside.max() >= -_ROUNDING * slack else inside >= max(inside.max(), -slack)
    corners, share = corners[good], np.clip(share[good], 0, None)
    empty = _empty_circles(place, corners)
    corners, share = corners[empty], share[empty] / share[empty].sum(axis=1, keepdims=True)
    if not len(corners):
        return None
    weights = np.zeros(len(place))
    np.add.at(weights, corners.ravel(), share.ravel())
    return weights / len(corners)


def _barycentric(corner: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coordinates (m, 3) [-] of a point in the triangles ``corner`` (m, 3, 2) [m], and their heights (m, 3) [m]; flat
    ones have coordinates of minus infinity."""
    area = _cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    parts = np.stack([_cross(corner[:, (k + 1) % 3] - at, corner[:, (k + 2) % 3] - at) for k in range(3)], axis=1)
    sides = np.stack([np.hypot(*(corner[:, (k + 2) % 3] - corner[:, (k + 1) % 3]).T) for k in range(3)], axis=1)
    flat = np.abs(area) < 1e-9 * sides.max(axis=1) ** 2
    safe = np.where(flat, 1.0, area)[:, None]
    return np.where(flat[:, None], -np.inf, parts / safe), np.abs(np.where(flat[:, None], 1.0, area[:, None] / sides))


def _empty_circles(place: FloatArray, corners: IntArray) -> BoolArray:
    """Triangles (m, 3) with no other place inside their circle."""
    a, b, c = (place[corners[:, k]] for k in range(3))
    twice = 2 * _cross(b - a, c - a)[:, None]
    ab, ac = np.sum((b - a) ** 2, axis=1)[:, None], np.sum((c - a) ** 2, axis=1)[:, None]
    turned = np.array([[0.0, -1.0], [1.0, 0.0]])
    centre = a + (ab * ((c - a) @ turned.T) - ac * ((b - a) @ turned.T)) / -twice
    radius = np.hypot(*(centre - a).T)
    gaps = np.linalg.norm(centre[:, None] - place[None], axis=2)
    return np.asarray((gaps >= radius[:, None] * (1 - _ON_CIRCLE)).all(axis=1))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
