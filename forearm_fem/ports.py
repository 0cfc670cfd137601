"""Ports: all that a model of the limb ever has to answer for; and the lattices, lines and triangles that they form."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from .errors import GeometryError
from .typing import BoolArray, FloatArray, IntArray

__all__ = ["Port", "distances", "positions"]

PortKind = Literal["contact", "point"]
ContactKind = Literal["pressure", "bonded", "frictionless"]


@dataclass(frozen=True)
class Port:
    """One scalar displacement and the force conjugate to it.

    A *contact* port is a disc of ``radius`` [m] under a cone: its displacement is that of the rigid disc
    along ``axis`` (``bonded`` or ``frictionless``), or the mean normal displacement under a uniform
    pressure. A *point* port is the skin's displacement along ``axis`` at ``position``.
    ``axis`` is the outward unit normal of the skin; displacement and force are positive along it.
    """

    name: str
    kind: PortKind
    position: tuple[float, float, float]
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    radius: float = 0.0
    contact: ContactKind = "pressure"


def positions(ports: tuple[Port, ...]) -> FloatArray:
    """Positions of ``ports`` as an (n, 3) array [m]."""
    return np.array([p.position for p in ports], dtype=float).reshape(-1, 3)


def distances(outputs: tuple[Port, ...], inputs: tuple[Port, ...]) -> FloatArray:
    """Straight distances (n_out, n_in) [m] between two sets of ports."""
    return np.asarray(np.linalg.norm(positions(outputs)[:, None] - positions(inputs)[None], axis=2))

# Rows and columns of ports seen from above: the rectangle that funneling and the corner rule need.

SLACK = 0.05  # of the nearest-neighbour distance that a port may lie off its row or column


@dataclass(frozen=True, eq=False)
class PortLattice:
    """A rectangular array turned by ``angle`` [rad] about z.

    ``rows`` (n,) and ``columns`` (m,) [m] are increasing coordinates along the turned x and y; ``place``
    (n_port, 2) is the row and column of each port. ``slack`` [m] is how far a point may lie outside.
    """

    angle: float
    rows: FloatArray
    columns: FloatArray
    place: IntArray
    slack: float

    def coordinates(self, port: Port) -> tuple[float, float]:
        """The port's planform position (x, y) [m] in the turned frame."""
        x, y = _turn(positions((port,))[:, :2], -self.angle)[0]
        return float(x), float(y)


def lattice_of(ports: tuple[Port, ...], what: str) -> PortLattice:
    """The N x M rectangular array (N, M >= 2) formed by the planform x, y of ``ports``, at any rotation about z.

    Each port may lie 5 % of the nearest-neighbour distance off its row and column. Raises GeometryError, naming the
    ports as ``what``, if they form no such array. Curvature of the skin is ignored: distances are seen from above.
    """
    xy = positions(ports)[:, :2]
    if len(ports) < 4:
        raise GeometryError(f"{what}: expected a rectangle of at least 2 x 2 ports, got {len(ports)}")
    step = xy - xy[0]
    nearest = 1 + int(np.argmin(np.linalg.norm(step[1:], axis=1)))
    reach = float(np.linalg.norm(step[nearest]))
    angle = float(np.arctan2(step[nearest, 1], step[nearest, 0]))
    angle -= np.pi / 2 * round(angle / (np.pi / 2))
    turned = _turn(xy, -angle)
    rows, r = _lines(turned[:, 0], SLACK * reach)
    columns, c = _lines(turned[:, 1], SLACK * reach)
    place = np.stack([r, c], axis=1)
    filled = (
        len(rows) >= 2 and len(columns) >= 2 and len(rows) * len(columns) == len(ports) == len(np.unique(place, axis=0))
    )
    if not filled:
        raise GeometryError(
            f"{what}: expected a rectangular array of rows and columns, got {len(ports)} ports "
            f"on {len(rows)} rows and {len(columns)} columns"
        )
    return PortLattice(angle, rows, columns, place, SLACK * reach)


def is_thesis_grid(outputs: tuple[Port, ...]) -> bool:
    """True if ``outputs`` are the thesis' 3 x 3 points "1" to "9", row by row; by their names where places are unknown.

    Groups of Table I (middle, edges, corners) mean something on such a grid only.
    """
    by_name = {p.name: p for p in outputs}
    if set(by_name) != {str(k) for k in range(1, 10)}:
        return False
    ordered = tuple(by_name[str(k)] for k in range(1, 10))
    if not np.isfinite(positions(ordered)).all():
        return True
    try:
        middle = lattice_of(ordered, "grid")
    except GeometryError:
        return False
    return middle.place[4].tolist() == [1, 1] and {tuple(middle.place[k]) for k in (0, 2, 6, 8)} == _CORNERS


_CORNERS = {(0, 0), (0, 2), (2, 0), (2, 2)}


def _turn(xy: FloatArray, angle: float) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray(xy @ np.array([[c, s], [-s, c]]))


def _lines(coordinate: FloatArray, slack: float) -> tuple[FloatArray, IntArray]:
    """Mean coordinate of each line and the line of each port; ports within 2 ``slack`` share a line."""
    order = np.argsort(coordinate)
    line = np.empty(len(order), dtype=int)
    line[order] = np.concatenate([[0], np.cumsum(np.diff(coordinate[order]) > 2 * slack)])
    means = np.bincount(line, coordinate) / np.bincount(line)
    return means, line


# Actuators that form no rectangle: the line they lie on, or the triangles of nearest ones.

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
