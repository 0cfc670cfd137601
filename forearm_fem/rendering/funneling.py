"""Funneling: all actuators play the wavelet, the nearer ones louder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Literal

import numpy as np

from ..errors import DataError, GeometryError
from ..ports import Port, positions
from ..typing import BoolArray, ComplexArray, FloatArray, IntArray
from .drives import Aim
from .signals import BinnedTransfer

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


# Funneling: all actuators send the same signal, the nearer ones more of it.

Weights = Mapping[str, FloatArray]  # A_q / A (n_in,) by target
Distance = Literal["spacing", "diagonal"] | float  # D of eq. 6 [m]


def funneling_weights(inputs: tuple[Port, ...], target: Port, distance: Distance = "spacing") -> FloatArray:
    """A_q / A (n_in,) [-]; they sum to 1 where ``distance`` is the spacing.

    On a rectangle of N x M actuators eq. 6 of de Vlam 2022, (1 - d_x / D_x)(1 - d_y / D_y): the four around the target
    share its weight, so that eq. 6 holds within each cell. D, "the maximum distances between the actuators", is the
    cell's side along each axis; or its diagonal; or a length [m], which may not be shorter than a side.

    On a line, the one-dimensional form of eq. 6 between the two neighbours. Any other layout: the target's barycentric
    coordinates in the triangle of nearest actuators (:mod:`.triangles`), the linear law of three-actuator phantoms
    (US 10867526 B2, eq. 5).

    Raises GeometryError for a single actuator, and where the target lies outside the actuators. The logarithmic law is
    not covered (the thesis took the linear one).
    """
    if len(inputs) < 2:
        raise GeometryError("funneling, actuators: expected two or more, got one")
    try:
        grid = lattice_of(inputs, "funneling, actuators")
    except GeometryError:  # no rectangle
        grid = None
    if grid is not None:
        shares = [
            _shares(at, lines, grid.slack, target.name)
            for at, lines in zip(grid.coordinates(target), (grid.rows, grid.columns), strict=True)
        ]
        if distance != "spacing":
            shares = _farther(grid, shares, target, distance)
        return np.asarray(shares[0][grid.place[:, 0]] * shares[1][grid.place[:, 1]])
    if distance != "spacing":
        raise GeometryError("rendering.funneling_distance: the actuators form no rectangle; leave it at 'spacing'")
    place, at = positions(inputs)[:, :2], positions((target,))[0, :2]
    if not (nearest := nearest_distance(place)) > 0:
        raise GeometryError("funneling, actuators: two of them lie at one place; give each its own")
    slack = SLACK * nearest
    line = line_through(place, slack)
    if line is None:
        weights = triangle_weights(place, at, slack)
        if weights is None:
            raise GeometryError(f"funneling: target '{target.name}' lies outside the actuators")
        return weights
    along, aside = place @ line, abs(float((at - place.mean(axis=0)) @ np.array([-line[1], line[0]])))
    if aside > slack:
        raise GeometryError(f"funneling: target '{target.name}' lies {aside:.3g} m outside the actuators' line")
    order, weights = np.argsort(along), np.empty(len(inputs))
    weights[order] = _shares(float(at @ line), along[order], slack, target.name, "line")
    return weights


def _farther(grid: PortLattice, shares: list[FloatArray], target: Port, distance: Distance) -> list[FloatArray]:
    """Shares 1 - d / D of the lines of the target's cell along both axes, D one length for both."""
    cell = [_cell(at, lines) for at, lines in zip(grid.coordinates(target), (grid.rows, grid.columns), strict=True)]
    sides = [float(np.ptp(lines[inside])) for lines, inside in zip((grid.rows, grid.columns), cell, strict=True)]
    length = math.hypot(*sides) if distance == "diagonal" else float(distance)
    if length < max(sides):
        raise GeometryError(
            f"rendering.funneling_distance: {length:g} m is shorter than the {max(sides):g} m between actuators, and "
            "shares would be negative; lengthen it"
        )
    return [
        np.where(inside, 1 - np.abs(lines - at) / length, 0.0)
        for at, lines, inside in zip(grid.coordinates(target), (grid.rows, grid.columns), cell, strict=True)
    ]


def _cell(at: float, lines: FloatArray) -> BoolArray:
    """The two lines (n,) around a coordinate."""
    first = int(np.clip(np.searchsorted(lines, at, side="right") - 1, 0, len(lines) - 2))
    return np.isin(np.arange(len(lines)), (first, first + 1))


def _shares(at: float, lines: FloatArray, slack: float, name: str, what: str = "rectangle") -> FloatArray:
    """Linear share of each line: 1 on it, 0 on its neighbours."""
    if not lines[0] - slack <= at <= lines[-1] + slack:
        outside = max(lines[0] - at, at - lines[-1])
        raise GeometryError(f"funneling: target '{name}' lies {outside:.3g} m outside the actuators' {what}")
    return np.array([np.interp(at, lines, unit) for unit in np.eye(len(lines))])


@dataclass(frozen=True)
class Funneling:
    """Funneling renderer, eq. 5, 6 and 8 of de Vlam 2022: s_q(t) = A_q w(t).

    ``amplitude`` [V, or G's drive unit] is A. The drive is cut to the bins where the target's row of G is known, as in
    the other renderers, so that their displacements compare; an actuator never measured there stays silent. ``weights``
    are A_q / A by target where they were found before (:meth:`precomputed_for_targets`). ``distance`` is D of
    eq. 6.
    """

    amplitude: float = 1.0
    distance: Distance = "spacing"
    weights: Weights | None = field(default=None, repr=False, compare=False)
    name: str = "funneling"

    def aim(self, placed: BinnedTransfer, target: str, wavelet: ComplexArray) -> Aim:
        """Drive spectra towards output ``target``; ``wavelet`` (n_bins,) [1/Hz]."""
        row = placed.row(target)
        found = (self.weights or {}).get(target)
        weights = funneling_weights(placed.inputs, placed.outputs[row], self.distance) if found is None else found
        used = known_bins(placed, [row])
        weights = np.where(absent_inputs(placed, [row]), 0, weights)
        spectrum = self.amplitude * weights * np.where(used, wavelet, 0)[:, None]
        return Aim(np.asarray(spectrum, dtype=complex), used)

    def precomputed_for_targets(self, placed: BinnedTransfer, targets: Sequence[str]) -> Funneling:
        """The same renderer with the weights of ``targets``, for any G of the same ports."""
        return replace(self, weights=settled_weights(self.weights, placed, targets, self.distance))


def settled_weights(
    weights: Weights | None, placed: BinnedTransfer, targets: Sequence[str], distance: Distance = "spacing"
) -> Weights:
    """Weights of ``targets`` that are not among ``weights`` yet, and those; raises as :func:`funneling_weights`."""
    known = weights or {}
    new = [t for t in targets if t not in known]
    found = {t: funneling_weights(placed.inputs, placed.outputs[placed.row(t)], distance) for t in new}
    return {**known, **found}


def known_bins(placed: BinnedTransfer, rows: list[int]) -> BoolArray:
    """Bins (n_bins,) on which G is valid between ``rows`` and every input that is known there at all.

    Raises DataError if there is none.
    """
    valid = placed.bins.valid[:, rows]
    used = valid[:, :, ~absent_inputs(placed, rows)].all(axis=(1, 2))
    if not used.any() or absent_inputs(placed, rows).all():
        raise DataError(f"{_never_together(placed, rows)}; choose others or measure again")
    return np.asarray(used)


def _never_together(placed: BinnedTransfer, rows: list[int]) -> str:
    """Reason that no bin serves ``rows``: outputs or single entries that are never known, or never all at once."""
    ever = np.asarray(placed.bins.valid[:, rows].any(axis=0))
    names = [placed.outputs[r].name for r in rows]
    if lost := [n for n, row in zip(names, ever, strict=True) if not row.any()]:
        return f"G is marked invalid on every bin for output(s) {', '.join(lost)}"
    columns = np.flatnonzero(ever.any(axis=0))
    single = [f"{names[r]} <- {placed.inputs[i].name}" for r, i in np.argwhere(~ever) if i in columns]
    if single:
        return f"G is marked invalid on every bin for {', '.join(single[:6])}"
    return f"G is nowhere known for outputs {', '.join(names)} at once"


def absent_inputs(placed: BinnedTransfer, rows: list[int]) -> BoolArray:
    """Inputs (n_in,) whose column of G is never valid in ``rows``: they cannot be aimed and stay silent."""
    return np.asarray(~placed.bins.valid[:, rows].any(axis=(0, 1)))
