"""Rows and columns of ports seen from above: the rectangle that funneling and the corner rule need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import GeometryError
from ..ports import Port, positions
from ..typing import FloatArray, IntArray

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
