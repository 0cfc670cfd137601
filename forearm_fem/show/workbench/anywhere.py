"""Compliance of discs anywhere on flat layers: a few channels a disc, tabulated over distance, for a page to work with.

On flat layers two discs meet in numbers that depend on their distance, and on their direction by a phase. Each disc has
a channel for its force and a few for what it scatters: the strongest of its answers to a neighbour, so that a page
solves for some ten unknowns a disc where the layered model has some fifty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...device import close_loop
from ...engines.layered import flat_ports, kept_tables, solve_layered
from ...errors import ForearmError
from ...geometry.device.layout import layout_of
from ...layered import Disc
from ...layered.discs import inner_tractions
from ...layered.response import chebyshev_between, terms_of
from ...layered.tables import CLEAR, Tabulated
from ...ports import Port, positions
from ...progress import Progress
from ...scenario import Scenario
from ...transfer import ErrorEstimate, TransferMatrix, finite
from ...typing import ComplexArray, FloatArray, IntArray
from .field import MARGIN, packed
from .places import moved

__all__ = ["CLOSEST", "Anywhere", "anywhere_of", "packed_anywhere"]

CLOSEST = 3.0  # radii between the middles of two discs: nearer, the tables' two azimuthal orders miss 3 % and more
_ROUND = 0.01  # [m] to which tables reach, so that one serves alike devices
_CHANNELS = (2, 2, 1)  # of azimuthal order 0, 1 and 2, besides the force: leaves out 1e-3 of G, twice as many 5e-4
_RADII = 64  # distances, even in the root of the distance from touching; 128 change G by less than 1e-5
_DEGREE = 5
_KNOWN = 0.02  # e(f) of the tables up to which a page takes them
_CHECKED, _SEED, _TRIES = 4, 0, 400  # arrangements drawn, on which the page's numbers are held against the engine's


@dataclass(frozen=True, eq=False)
class Anywhere:
    """Channels of equal discs on flat layers, at the ``nodes`` (n,) [rad/s] of a Chebyshev rule between two ends.

    - ``order`` (c,): azimuthal order of each channel, the first being the disc's force
    - ``own`` (n, c, c) [m/N]: a disc's channels with themselves
    - ``discs`` (r, n, c, c): two discs' channels at ``apart`` (r,) [m], the second in direction x from the first
    - ``points`` (r, n, c): normal motion of a point at ``away`` (r,) [m] from a disc's channels
    - ``half`` (2,) [m]: of the rectangle around ``middle`` (2,) in which discs can stand
    """

    radius: float
    contact: str
    ends: tuple[float, float]
    nodes: FloatArray
    order: IntArray
    own: ComplexArray
    discs: ComplexArray
    points: ComplexArray
    apart: FloatArray
    away: FloatArray
    middle: FloatArray
    half: FloatArray

    def compliance(self, omega: FloatArray, contacts: FloatArray, points: FloatArray) -> ComplexArray:
        """(n_freq, m + n_point, m) [m/N] of m discs at ``contacts`` (m, 2) and of ``points`` (p, 2), discs first."""
        m, c = len(contacts), len(self.order)
        whole = np.zeros((len(self.nodes), m * c, m * c), dtype=complex)
        for i in range(m):
            here = slice(i * c, (i + 1) * c)
            whole[:, here, here] = self.own
            for j in range(i):
                there, (distance, angle) = slice(j * c, (j + 1) * c), _polar(contacts[j] - contacts[i])
                turned = np.exp(1j * (self.order[:, None] + self.order) * angle)
                block = _between(self.apart, self.discs, distance, 2 * self.radius) * turned
                whole[:, here, there], whole[:, there, here] = block, block.swapaxes(1, 2)
        rows = np.zeros((len(self.nodes), len(points), m * c), dtype=complex)
        for p, place in enumerate(points):
            under = [i for i in range(m) if np.linalg.norm(place - contacts[i]) <= self.radius]
            for i in range(m):
                distance, angle = _polar(place - contacts[i])
                seen = _between(self.away, self.points, max(distance, self.radius + CLEAR), self.radius)
                rows[:, p, i * c : (i + 1) * c] = seen * np.exp(1j * self.order * angle)
            if under and self.contact != "pressure":  # a point under a rigid disc moves with it
                rows[:, p] = whole[:, under[0] * c]
        force = np.arange(m) * c
        inner = np.setdiff1d(np.arange(m * c), force)
        scattered = np.linalg.solve(whole[:, inner[:, None], inner], whole[:, inner[:, None], force])
        seen = np.concatenate([whole[:, force], rows], axis=1)
        return chebyshev_between(*self.ends, omega, seen[:, :, force] - seen[:, :, inner] @ scattered)[0]

    def refuses(self, contacts: FloatArray, points: FloatArray) -> bool:
        """True if discs cannot stand there: off the skin that is known, too close, or pressing on one of ``points``."""
        away = np.linalg.norm(contacts[:, None] - points[None], axis=2)
        if self.contact == "pressure" and away.min(initial=np.inf) < self.radius + CLEAR:
            return True
        gaps = np.linalg.norm(contacts[:, None] - contacts[None], axis=2)[np.triu_indices(len(contacts), 1)]
        off = np.abs(contacts - self.middle) + self.radius > self.half
        return bool(off.any()) or gaps.min(initial=np.inf) < CLOSEST * self.radius


def anywhere_of(
    scenario: Scenario, transfer: TransferMatrix, progress: Progress | None = None
) -> tuple[Anywhere, ErrorEstimate] | None:
    """Channels for the discs of a layered ``scenario``, and what they miss of the engine's G; None where the layered
    model has no tables (a single frequency, sharp resonances)."""
    ports = flat_ports(scenario)
    contacts = tuple(p for p in ports if p.kind == "contact")
    places = positions(ports)[:, :2]
    low, high = places.min(axis=0) - MARGIN, places.max(axis=0) + MARGIN
    reach = _ROUND * np.ceil(float(np.linalg.norm(high - low)) / _ROUND)
    if len(transfer.frequency) < 2 or not contacts:
        return None
    try:
        tables = kept_tables(scenario, float(reach), progress=progress)
    except ForearmError:
        return None
    if not tables.checked.max() < _KNOWN:
        return None
    middle = (low + high) / 2
    found = _channels(tables, middle, _room(scenario, middle, (high - low) / 2), float(reach))
    return found, _missed(found, scenario, transfer)


def _room(scenario: Scenario, middle: FloatArray, half: FloatArray) -> FloatArray:
    """The largest part of the rectangle, as wide along the limb, in whose corners the limb takes a disc."""
    radius, points = scenario.device.cone.radius, layout_of(scenario).points
    for part in np.linspace(1, 0.3, 15):
        corner = half * [1, part] - radius * (1 + 1e-9)
        try:
            flat_ports(moved(scenario, middle + corner * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]), points))
        except ForearmError:
            continue
        return np.asarray(half * [1, part])
    return np.asarray(half * [1, 0.3])


def packed_anywhere(found: Anywhere, missed: ErrorEstimate, ports: Sequence[Port]) -> dict[str, Any]:
    """Arrays that ``moves.js`` reads; of a symmetric pair of channels the upper half."""
    upper = np.triu_indices(len(found.order))
    return {
        "order": found.order.tolist(), "ends": list(found.ends), "nodes": len(found.nodes),
        "radius": found.radius, "pressed": found.contact == "pressure", "closest": CLOSEST, "clear": CLEAR,
        "own": packed(found.own, "c16"),
        "discs": packed(found.discs[:, :, upper[0], upper[1]], "c8"), "points": packed(found.points, "c8"),
        "apart": [float(found.apart[0]), float(found.apart[-1])], "away": [float(found.away[0]), float(found.away[-1])],
        "radii": len(found.apart), "middle": found.middle.tolist(), "half": found.half.tolist(),
        "home": [list(p.position[:2]) for p in ports if p.kind == "contact"], "error": missed.band,
    }  # fmt: skip


def _polar(step: FloatArray) -> tuple[float, float]:
    return float(np.hypot(*step)), float(np.arctan2(step[1], step[0]))


def _between(at: FloatArray, values: ComplexArray, distance: float, edge: float) -> ComplexArray:
    """``values`` (r, ...) at distances ``at`` (r,), even in the root of what lies beyond ``edge``, at another one."""
    root = np.sqrt(at[[0, -1]] - edge)
    step = (np.sqrt(max(distance - edge, 0.0)) - root[0]) / (root[1] - root[0]) * (len(at) - 1)
    first = int(np.clip(np.floor(step) - _DEGREE // 2, 0, len(at) - _DEGREE - 1))
    x = step - first
    weight = [np.prod([(x - k) / (j - k) for k in range(_DEGREE + 1) if k != j]) for j in range(_DEGREE + 1)]
    return np.asarray(np.tensordot(weight, values[first : first + _DEGREE + 1], axes=1))


def _channels(tables: Tabulated, middle: FloatArray, half: FloatArray, reach: float) -> Anywhere:
    r, contact = tables.radius, tables.contact
    alone = Disc(0.0, 0.0, r, contact)  # type: ignore[arg-type]
    terms = terms_of([alone], tables._medium, np.array([tables.low, tables.high]))
    inner = inner_tractions(alone, tables.surface, terms, tables.orders) if alone.rigid else []
    order = np.array([0, *(t.m - {"z": 0, "+": 1, "-": -1}[t.component] for t in inner)])
    m = len(order)
    here, there = np.array([0, *range(2, m + 1)]), np.array([1, *range(m + 1, 2 * m)])
    grids = [edge + np.linspace(np.sqrt(CLEAR), np.sqrt(reach - edge), _RADII) ** 2 for edge in (2 * r, r)]
    pairs = []
    own = np.zeros((0, 0, 0), dtype=complex)
    for distance in grids[0]:
        a = tables.matrix([alone, replace(alone, x=float(distance))])[1]
        pairs.append(a[:, here[:, None], there])
        own = a[:, here[:, None], here]
    points = [tables.matrix([alone, Disc(float(distance), 0.0)])[1][:, here, 1] for distance in grids[1]]
    discs, seen = np.array(pairs), np.array(points)
    basis, kept = _strongest(own, discs, seen, order)
    return Anywhere(
        r, contact, (tables.low, tables.high), tables.omega, kept,
        np.einsum("fai,fab,fbj->fij", basis, own, basis),
        np.einsum("fai,rfab,fbj->rfij", basis, discs, basis, optimize=True),
        np.einsum("fai,rfa->rfi", basis, seen), grids[0], grids[1], middle, half,
    )  # fmt: skip


def _strongest(
    own: ComplexArray, discs: ComplexArray, points: ComplexArray, order: IntArray
) -> tuple[ComplexArray, IntArray]:
    """Combinations (n, m, c) of a disc's tractions at each node, and their azimuthal orders (c,).

    The first is a unit force on the disc alone. The others span its strongest answers, order by order, to the force of
    a disc or a point at any distance.
    """
    counts = [(o, min(_CHANNELS[abs(o)], int(np.sum(order[1:] == o)))) for o in (0, 1, -1, 2, -2)]
    kept = np.array([0, *(o for o, count in counts for _ in range(count))])
    basis = np.zeros((len(own), len(order), len(kept)), dtype=complex)
    basis[:, 0, 0] = 1
    if len(order) == 1:
        return basis, kept
    for n, whole in enumerate(own):
        held, at = whole[1:, 1:], 1
        basis[n, 1:, 0] = -np.linalg.solve(held, whole[1:, 0])
        felt = np.concatenate([np.einsum("rij,j->ir", discs[:, n], basis[n, :, 0])[1:], points[:, n, 1:].T], axis=1)
        answer = np.linalg.solve(held, felt) / np.sqrt(np.linalg.norm(felt, axis=0))  # far ones count, too
        size = np.sqrt(np.abs(held).max(axis=1))
        for o, count in counts:
            rows = np.flatnonzero(order[1:] == o)
            left = np.linalg.svd(size[rows, None] * answer[rows], full_matrices=False)[0][:, :count]
            basis[n, 1 + rows, at : at + count] = left / size[rows, None]
            at += count
    return basis, kept


def _missed(found: Anywhere, scenario: Scenario, transfer: TransferMatrix) -> ErrorEstimate:
    """G of the channels against G of the layered engine, on the scenario's arrangement and drawn ones; the worst."""
    layout = layout_of(scenario)
    home, points = layout.contacts, layout.points
    worst, band = np.zeros(len(transfer.frequency)), 0.0
    arrangements = [home, *_drawn(found, home, points)]
    for contacts in arrangements:
        exact = solve_layered(moved(scenario, contacts, points), transfer.frequency)
        discs, rest = exact.indices("contact"), exact.indices("point")
        rows = np.array([*discs, *rest])
        answer = found.compliance(2 * np.pi * exact.frequency, contacts, points)
        values = exact.values.copy()
        values[:, rows[:, None], np.array(discs)] = answer
        values[:, np.array(discs)[:, None], rows] = answer.swapaxes(1, 2)
        said = finite(close_loop(replace(exact, values=values), scenario.device)).values
        true = finite(close_loop(exact, scenario.device)).values
        worst = np.maximum(worst, np.abs(said - true).max(axis=(1, 2)) / np.abs(true).max(axis=(1, 2)))
        band = max(band, float(np.linalg.norm(said - true) / np.linalg.norm(true)))
    return ErrorEstimate(
        "interpolation", band, "the page's tables for moved actuators against the layered engine's own G, the worst of "
        f"{len(arrangements)} arrangements", tuple(transfer.frequency.tolist()), tuple(worst.tolist()),
    )  # fmt: skip


def _drawn(found: Anywhere, home: FloatArray, points: FloatArray) -> list[FloatArray]:
    """Arrangements of as many discs: half of them each disc a little moved, the others anywhere."""
    rng, out = np.random.default_rng(_SEED), list[FloatArray]()
    for k in range(_TRIES):
        near = home + rng.uniform(-1, 1, size=home.shape) * 2 * found.radius
        contacts = near if k % 2 else found.middle + rng.uniform(-1, 1, size=home.shape) * (found.half - found.radius)
        if not found.refuses(contacts, points):
            out.append(contacts)
        if len(out) == _CHECKED:
            break
    return out
