"""A flat piece of skin for what has no mesh: the layered model's own field, or what lies between measured points."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import Delaunay, QhullError

from ...engines.layered import flat_disc, flat_layers, flat_surface
from ...layered import Disc, layered_compliance
from ...ports import Port, positions
from ...scenario import Scenario
from ...typing import ComplexArray, FloatArray, IntArray
from .field import Field, Surface

MARGIN = 0.016  # [m] of skin around the run's ports, in which actuators can stand
_MM = 1e3
_SIDE = 61  # vertices along the longer side
_AT_ONCE = 12  # radii: motion from each to each is computed too, unasked
_TOLERANCE = 1e-3  # of the picture's field; G itself is as the run computed it


def flat_field(ports: tuple[Port, ...]) -> Field:
    """Flat skin around the ports of a layered run; the page knows its motion from one disc's, at growing distance."""
    surface = _rectangle(positions(ports)[:, :2], MARGIN)
    shapes = np.zeros((len(surface.rest), 1, 1))
    words = "flat skin of the layered model; waves that rigid cones scatter are in G, not in the picture"
    return Field((_with(surface, shapes),), None, 0.0, words)


def profile(scenario: Scenario, contact: Port, frequency: FloatArray, radii: FloatArray) -> ComplexArray:
    """Normal motion (n_frequency, n_radius) [m/N] at radii from 0 on; the cone's own mean at radius 0."""
    disc = flat_disc(contact)
    centred = Disc(0.0, 0.0, disc.radius, disc.contact)

    def seen(some: FloatArray) -> ComplexArray:
        """Compliance (n_frequency, 1 + n) of the disc itself and of points at the radii ``some``."""
        found = layered_compliance(
            flat_layers(scenario), 2 * np.pi * frequency, [centred], [centred, *(Disc(float(r), 0.0) for r in some)],
            surface=flat_surface(scenario.tissues), tolerance=_TOLERANCE,
        )  # fmt: skip
        return found.values[:, :, 0]

    groups = [seen(part) for part in np.split(radii[1:], range(_AT_ONCE, len(radii) - 1, _AT_ONCE))]
    return np.concatenate([groups[0][:, :1], *(g[:, 1:] for g in groups)], axis=1)


def between_points(ports: tuple[Port, ...]) -> Field:
    """A surface through measured points: thin plate between them, nothing beyond them; for the eye only.

    Points on a line carry a straight interpolation along it.
    """
    places = positions(ports)[:, :2]
    surface = _rectangle(places, 0.0)
    at = surface.rest[:, :2] / _MM
    try:
        net: Delaunay | None = Delaunay(places)
    except (QhullError, ValueError):  # the points span no area
        net = None
    if net is None:
        weights = RBFInterpolator(places, np.eye(len(places)), kernel="linear", degree=0)(at)
        inside = np.ones(len(at), dtype=bool)
    else:
        weights = RBFInterpolator(places, np.eye(len(places)), kernel="thin_plate_spline")(at)
        inside = net.find_simplex(at, tol=1e-6) >= 0
    faces = surface.faces[inside[surface.faces].all(axis=1)]
    words = "a surface drawn through the measured points: between them nothing was measured"
    return Field(
        (_with(Surface(surface.rest, surface.normals, faces, surface.shapes), weights[:, None, :]),), None, 0.0, words
    )


def _with(surface: Surface, shapes: FloatArray) -> Surface:
    return Surface(surface.rest, surface.normals, surface.faces, shapes)


def _rectangle(places: FloatArray, margin: float) -> Surface:
    """A regular net over ``places`` (n, 2) [m] and ``margin`` around them."""
    low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
    step = max(float((high - low).max()), 1e-3) / (_SIDE - 1)
    low, high = np.minimum(low, (low + high) / 2 - 2 * step), np.maximum(high, (low + high) / 2 + 2 * step)
    axes = [np.linspace(a, b, round((b - a) / step) + 1) for a, b in zip(low, high, strict=True)]
    x, y = (v.ravel() for v in np.meshgrid(*axes, indexing="ij"))
    rest = _MM * np.stack([x, y, np.zeros_like(x)], axis=1)
    return Surface(
        rest,
        np.tile([0.0, 0.0, 1.0], (len(rest), 1)),
        net_faces(len(axes[0]), len(axes[1])),
        np.zeros((len(rest), 1, 0)),
    )


def net_faces(rows: int, columns: int) -> IntArray:
    """Triangles of a regular net, counted row by row."""
    k = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    return np.concatenate(
        [np.stack([k, k + columns, k + columns + 1], axis=1), np.stack([k, k + columns + 1, k + 1], axis=1)]
    )
