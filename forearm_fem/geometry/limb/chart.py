"""A limb's skin or a bone's wall unrolled into a plane without distorting angles, and points spread evenly on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...errors import MeshError
from ...typing import FloatArray
from .planar import Rectangle, triangulate
from .tube import BoneAxis, Tube

Place = tuple[FloatArray, FloatArray]  # x [m] and angle [rad] (n,) of points on a tube
_STATIONS = 4001
_NONE = np.zeros((0, 2))


@dataclass(frozen=True)
class Chart:
    """Conformal map of a tube's surface to the rectangle 0 <= u <= end, -pi <= v <= pi; the seam is dorsal.

    With radius r(x), du = sqrt(1 + r'^2) dx / r and v the share of the section's arc: ds^2 = r^2 (du^2 + dv^2), exact
    for round sections. Even triangles of the plane are even on the surface. ``x``, ``u``, ``radius`` and ``angle``,
    ``v`` are tables, joined linearly.
    """

    x: FloatArray
    u: FloatArray
    radius: FloatArray
    angle: FloatArray
    v: FloatArray

    @classmethod
    def of_skin(cls, tube: Tube) -> Chart:
        """The skin; an elliptic section counts by its arc length."""
        x = np.linspace(-tube.length / 2, tube.length / 2, _STATIONS)
        angle = np.linspace(-np.pi, np.pi, _STATIONS)
        ring = tube.place(np.zeros(_STATIONS), angle, 0.0)
        arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))])
        radius = arc[-1] / (2 * np.pi) * tube.height(x) / tube.height(np.zeros(1))
        return cls(x, _stretched(x, radius), radius, angle, (2 * arc / arc[-1] - 1) * np.pi)

    @classmethod
    def of_bone(cls, tube: Tube, bone: BoneAxis) -> Chart:
        """A bone's wall, taken as a straight cylinder: its axis leans by a few degrees at most."""
        x = np.linspace(-tube.length / 2, tube.length / 2, _STATIONS)
        around = np.linspace(-np.pi, np.pi, _STATIONS)
        radius = np.full(_STATIONS, bone.radius)
        return cls(x, _stretched(x, radius), radius, around, around)

    def surface(self, uv: FloatArray) -> Place:
        """x and angle of points of the plane (n, 2)."""
        return np.interp(uv[:, 0], self.u, self.x), np.interp(uv[:, 1], self.v, self.angle)

    def plane(self, x: FloatArray, angle: FloatArray) -> FloatArray:
        """Points of the plane (n, 2) at ``x`` and ``angle`` (n,)."""
        return np.column_stack([np.interp(x, self.x, self.u), np.interp(angle, self.angle, self.v)])

    def scale(self, uv: FloatArray) -> FloatArray:
        """Metres on the surface per unit of the plane (n,)."""
        return np.interp(uv[:, 0], self.u, self.radius)


def _stretched(x: FloatArray, radius: FloatArray) -> FloatArray:
    middle = (radius[1:] + radius[:-1]) / 2
    return np.concatenate([[0], np.cumsum(np.hypot(np.diff(x), np.diff(radius)) / middle)])


def spread(
    chart: Chart,
    size: Callable[[FloatArray, FloatArray], FloatArray],
    *,
    circles: Place | None = None,
    radius: float = 0.0,
    fixed: Place | None = None,
) -> Place:
    """x and angle (n,) of points about ``size(x, angle)`` [m] apart that triangulate evenly, the same at every call.

    Rings of points follow the circles of ``radius`` [m] about ``circles``; ``fixed`` places become points too.
    """
    centres = chart.plane(*circles) if circles else _NONE
    wanted = chart.plane(*fixed) if fixed else _NONE
    rim = radius / float(chart.scale(centres).mean()) if len(centres) else 1.0
    box = Rectangle((0.0, -np.pi), (float(chart.u[-1]), np.pi))
    uv, _ = triangulate(box, lambda uv: size(*chart.surface(uv)) / chart.scale(uv), centres, rim, wanted)
    low, high = (np.sort(uv[np.abs(uv[:, 1] - seam) < 1e-9, 0]) for seam in (-np.pi, np.pi))
    if len(low) != len(high):
        raise MeshError("the limb's skin could not be unrolled, its seam has two sides; set mesh.size_far smaller")
    u, v = uv[uv[:, 1] < np.pi - 1e-9].T  # the seam's points at v = pi are those at -pi again
    u = np.where(u < 1e-9, 0.0, np.where(u > chart.u[-1] - 1e-9, chart.u[-1], u))
    return chart.surface(np.column_stack([u, v]))
