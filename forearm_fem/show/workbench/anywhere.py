"""Compliance of discs anywhere, on flat layers or on a library's patch, in few enough numbers for a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...device import close_loop
from ...engines.layered import flat_ports, kept_tables, solve_layered
from ...engines.library import ArmLibrary
from ...errors import ForearmError, GeometryError
from ...geometry.device.layout import layout_of
from ...layered import Disc
from ...layered.discs import inner_tractions
from ...layered.response import chebyshev_between, terms_of
from ...layered.tables import CLEAR, Tabulated
from ...ports import Port, positions
from ...progress import Progress, tell
from ...scenario import Scenario
from ...scenario.sweep import frequencies
from ...transfer import Compliance, ErrorEstimate, TransferMatrix, finite
from ...typing import ComplexArray, FloatArray, IntArray
from .field import MARGIN, Field, Surface, net_faces, packed, profile

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

_FINE, _AT_ONCE = 300, 100  # places for what the grid's points feel, and how many are read at once
_MOST = 60  # places that the library is asked for, seconds each; the page holds a number for each two of them
_SCALES = 1e3 / np.array([6.0, 9.0, 13.0, 20.0, 30.0, 45.0])  # [1/m] tried for the length over which fields change
_NOISE = 1e-6  # of the variance: no two places are alike to rounding
_PROFILE, _FARTHEST = 64, 1.05  # of the layered model's profile, and how far it reaches in diagonals of the patch
_RANK = 1e-4  # of the largest combination of places: far below the error of interpolating between them
_HELD_AGAINST, _DRAWN = 4, 0  # arrangements besides the scenario's own on which all of it is held against the library
_MOST_TRIES = 400
_RIM = 3e-4  # [m] from a rim to what is asked for: the layered model's tables end there
_SIDE = 48  # stretches of the picture's longer side


@dataclass(frozen=True, eq=False)
class Places:
    """Compliance of discs anywhere: C(P, Q) = T(r) + w_P^T D w_Q between discs, T(r) + k(P)^T E to the grid's points.

    ``xy`` (n, 2) are places seen from above, ``flat`` (n, 2) along the skin, ``position`` and ``axis`` (n, 3) on it,
    all [m]. ``layered`` (n_frequency, n_radius) is the layered model of one disc at ``radii`` [m], its own motion
    first. D = ``left`` (n_frequency, r) ``right`` (r, n, n) is the difference to it. Weights are those of a Gaussian
    process: w_P = ``inverse`` k(P), k = (1 + s + 2 s^2/5 + s^3/15) exp(-s), s = ``scale`` |P - place|. E, the
    difference to the grid's ``points`` (in flat coordinates), stands on a finer net as ``near``, its K^-1 included.

    Left out: what other discs scatter, and that a cone feels the mean over its foot of what another sends, not the
    middle. :func:`places_of` measures what both and the interpolation cost.
    """

    frequency: FloatArray
    xy: FloatArray
    flat: FloatArray
    position: FloatArray
    axis: FloatArray
    points: FloatArray
    radius: float
    radii: FloatArray
    layered: ComplexArray
    left: ComplexArray
    right: ComplexArray
    inverse: FloatArray
    scale: float
    near: Near | None = None

    def weights(self, xy: FloatArray) -> FloatArray:
        """(n, p) of places (p, 2)."""
        return np.asarray(self.inverse @ kernel(self.scale, self.xy, xy))

    def between(self, values: FloatArray, weights: FloatArray) -> FloatArray:
        """``values`` (n, c) of the places at those of ``weights`` (n, p): the mean, and what differs from it."""
        mean = values.mean(axis=0)
        return np.asarray(mean + weights.T @ (values - mean))

    def compliance(self, xy: FloatArray) -> ComplexArray:
        """(n_frequency, m + n_point, m) [m/N] of m discs at ``xy`` (m, 2), discs first."""
        m, weights = len(xy), self.weights(xy)
        flat = xy + self.between(self.flat - self.xy, weights)
        away = np.linalg.norm(np.concatenate([flat, self.points])[:, None] - flat[None], axis=2)
        share = np.einsum("np,rnq->rpq", weights, self.right) @ weights
        found = self.layered_at(away.ravel()).reshape(-1, *away.shape)
        found[:, :m] += np.einsum("fr,rpq->fqp", self.left, share)
        if self.near is not None:
            found[:, m:] += self.near.at(xy)
        found[:, :m] = (found[:, :m] + found[:, :m].swapaxes(1, 2)) / 2
        return np.asarray(found)

    def layered_at(self, away: FloatArray) -> ComplexArray:
        """(n_frequency, k) at distances (k,): a cubic through four radii, in the root of the distance from the rim."""
        beyond = np.sqrt(np.maximum(away - self.radius, 0.0))
        step = np.sqrt(self.radii[-1] - self.radius) / (len(self.radii) - 2)
        at = np.clip(beyond / step, 0, len(self.radii) - 2)
        first = np.clip(np.floor(at).astype(int) - 1, 0, len(self.radii) - 5)
        x = at - first
        found = np.zeros((len(self.frequency), len(away)), dtype=complex)
        for j in range(4):
            others = [k for k in range(4) if k != j]
            weight = np.prod([(x - k) / (j - k) for k in others], axis=0)
            found += weight * self.layered[:, 1 + first + j]
        found[:, away < self.radius] = self.layered[:, :1]
        return found


@dataclass(frozen=True, eq=False)
class Near:
    """The difference to the grid's points: ``left`` (n_frequency, r) times ``alpha`` (r, n, n_point), which is K^-1
    times what it is at ``xy`` (n, 2) [m]; ``scale`` [1/m] is that of the process."""

    xy: FloatArray
    left: ComplexArray
    alpha: ComplexArray
    scale: float

    def at(self, xy: FloatArray) -> ComplexArray:
        """(n_frequency, n_point, p) for discs at ``xy`` (p, 2)."""
        share = np.einsum("np,rnq->rqp", kernel(self.scale, self.xy, xy), self.alpha)
        return np.asarray(np.einsum("fr,rqp->fqp", self.left, share))


def kernel(scale: float, a: FloatArray, b: FloatArray) -> FloatArray:
    """(n, m) between places (n, 2) and (m, 2): Matern's of 7/2."""
    s = scale * np.linalg.norm(a[:, None] - b[None], axis=2)
    return np.asarray((1 + s + 0.4 * s**2 + s**3 / 15) * np.exp(-s))


def places_of(arm: ArmLibrary, scenario: Scenario, progress: Progress | None = None) -> tuple[Places, ErrorEstimate]:
    """Places on the patch of ``arm`` for the contacts and points of ``scenario``, and what they miss of the library.

    Asks the library for one disc at each of up to 60 places, and at each of the grid's points. The error is the worst
    of the scenario's arrangement and four drawn ones, of G by the library itself.
    """
    layout = layout_of(scenario)
    plain = moved(scenario, layout.contacts, layout.points)
    xy = _lattice(arm, plain, _MOST)
    ports = [_alone(arm, plain, place) for place in xy]
    given = tuple(p for p in arm.ports(plain) if p.kind == "point")
    flat, points = arm.skin.flat(positions(tuple(ports))), np.asarray(arm.skin.flat(positions(given)))
    frequency, radius = frequencies(plain.sweep), scenario.device.cone.radius
    reach = max(_FARTHEST * float(np.linalg.norm(np.ptp(np.concatenate([flat, points]), axis=0))), 4 * radius)
    steps = np.arange(_PROFILE) * np.sqrt(reach - radius) / (_PROFILE - 1)
    radii = np.concatenate([[0.0], radius + steps**2])
    layered = profile(plain, ports[0], frequency, radii)
    bare = Places(
        frequency, xy, flat, positions(tuple(ports)), np.array([p.axis for p in ports]), points, radius, radii, layered,
        np.zeros((len(frequency), 0), dtype=complex), np.zeros((0, len(xy), len(xy)), dtype=complex),
        np.eye(len(xy)), 1.0,
    )  # fmt: skip
    left, right = _few(_difference(arm, plain, bare, progress))
    scale, inverse = _process(xy, right, left)
    near = _near(arm, plain, bare, layout.points, progress)
    found = replace(bare, left=left, right=right, inverse=inverse, scale=scale, near=near)
    return found, _missed_by_library(arm, plain, found)


def patch_field(arm: ArmLibrary, places: Places) -> Field:
    """The skin of a library's patch, drawn between the places that the page knows; its amplitudes are found there."""
    patch = arm.scenario.library
    sides = np.array([patch.length, patch.width]) * (1 - 1e-6)
    counts = [max(round(s / sides.max() * _SIDE), 8) + 1 for s in sides]
    axes = [np.linspace(-0.5, 0.5, n) * side for n, side in zip(counts, sides, strict=True)]
    net = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    rest, normals = arm.skin.places(net)
    weights = places.weights(rest[:, :2]).T  # of a mean too: the layered model's part has one
    words = (
        f"the library's patch of skin, drawn between {len(places.xy)} places: blurred beside the cones, exact at none"
    )
    surface = Surface(1e3 * rest, normals, net_faces(*counts), weights[:, None, :])
    return Field((surface,), np.zeros((len(places.frequency), len(places.xy), 0), dtype=complex), 0.0, words)


def moved(scenario: Scenario, contacts: FloatArray, points: FloatArray) -> Scenario:
    """The scenario with other places in the limb's own frame, whole actuators all of them."""
    return scenario.changed({
        "device.contacts": _pairs(contacts), "device.rotation": 0.0, "device.out_of_contact": (), "device.gains": {},
        "device.contact_springs": {}, "grid.points": _pairs(points),
    })  # fmt: skip


def _pairs(places: FloatArray) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in places)


def _lattice(arm: ArmLibrary, scenario: Scenario, most: int) -> FloatArray:
    """Places (n, 2), ``most`` at most, on an even net over the patch where the library takes a disc."""
    patch, a = arm.scenario.library, scenario.device.cone.radius
    sides = np.array([patch.length, patch.width]) - 2 * a
    step = float(np.sqrt(np.prod(sides) / most))
    counts = np.maximum(np.floor(sides / step + 1e-9).astype(int), 2)
    axes = [np.linspace(-0.5, 0.5, int(n)) * side * (1 - 1e-6) for n, side in zip(counts, sides, strict=True)]
    points, _ = arm.skin.places(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2))
    return np.array([place for place in points[:, :2] if _taken(arm, scenario, place)])


def _alone(arm: ArmLibrary, scenario: Scenario, place: FloatArray) -> Port:
    """One disc at ``place`` (2,) seen from above.

    Some point must be asked with it: the middle of the patch, or one beside it if the disc covers that.
    """
    a = scenario.device.cone.radius
    point = np.where(place > 0, -1.5, 1.5) * a if np.linalg.norm(place) < 1.5 * a else np.zeros(2)
    return arm.ports(moved(scenario, place[None], point[None]))[0]


def _taken(arm: ArmLibrary, scenario: Scenario, place: FloatArray) -> bool:
    try:
        _alone(arm, scenario, place)
    except GeometryError:
        return False
    return True


def _difference(arm: ArmLibrary, scenario: Scenario, bare: Places, progress: Progress | None) -> ComplexArray:
    """Library less layered model (n_frequency, n, n): a disc at each place, seen at all of them."""
    found = []
    for i, place in enumerate(bare.xy):
        tell(progress, "places", i, len(bare.xy))
        found.append(_sent(arm, scenario, bare, place, bare.flat[i], bare.xy, bare.flat))
    return np.stack(found, axis=1)


def _near(arm: ArmLibrary, scenario: Scenario, bare: Places, points: FloatArray, progress: Progress | None) -> Near:
    """The difference from a disc anywhere to each of the grid's points.

    By reciprocity: a disc stands at the point, and its motion is read at the places, as many as one likes. Which of the
    two is the disc and which the point is exchanged; the difference to the layered model hardly tells.
    """
    xy = _lattice(arm, scenario, _FINE)
    flat = np.asarray(arm.skin.flat(positions(tuple(_alone(arm, scenario, place) for place in xy))))
    rows = []
    for q, place in enumerate(points):
        tell(progress, "points", q, len(points))
        rows.append(_sent(arm, scenario, bare, place, bare.points[q], xy, flat))
    left, right = _few(np.stack(rows, axis=2))
    scale, inverse = _process(xy, right, left)
    return Near(xy, left, np.einsum("mn,rnq->rmq", inverse, right), scale)


def _sent(
    arm: ArmLibrary,
    scenario: Scenario,
    bare: Places,
    place: FloatArray,
    here: FloatArray,
    xy: FloatArray,
    flat: FloatArray,
) -> ComplexArray:
    """Library less layered model (n_frequency, n) of a disc at ``place`` (``here`` along the skin), seen at ``xy`` (n,
    2).

    Under the disc and at its rim its own difference stands.
    """
    away = np.linalg.norm(flat - here, axis=1)
    open_ = np.flatnonzero(away > bare.radius + _RIM)
    found = np.empty((len(bare.frequency), len(xy)), dtype=complex)
    for rows in np.array_split(open_, max(len(open_) // _AT_ONCE, 1)):
        answer = arm.compliance(moved(scenario, place[None], xy[rows]))
        contact = answer.indices("contact")[0]
        found[:, rows] = answer.values[:, answer.indices("point"), contact] - bare.layered_at(away[rows])
        own = answer.values[:, contact, contact] - bare.layered[:, 0]
    found[:, np.setdiff1d(np.arange(len(xy)), open_)] = own[:, None]
    return found


def _few(difference: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """``difference`` (n_frequency, ...) as (n_frequency, r) times (r, ...)."""
    u, s, v = np.linalg.svd(difference.reshape(len(difference), -1), full_matrices=False)
    rank = max(int((s > _RANK * s[0]).sum()), 1)
    return u[:, :rank] * s[:rank], v[:rank].reshape(rank, *difference.shape[1:])


def _process(xy: FloatArray, right: ComplexArray, left: ComplexArray) -> tuple[float, FloatArray]:
    """The scale that predicts each place best from all others, and the inverse of the process' covariance.

    ``right`` (r, n, m) by the place of the disc, as large as its columns of ``left``; the residual of a place left
    out is (K^-1 y)_i / (K^-1)_ii.
    """
    values = np.moveaxis(right * np.linalg.norm(left, axis=0)[:, None, None], 1, 0).reshape(len(xy), -1)
    best: tuple[float, float, FloatArray] | None = None
    for scale in _SCALES:
        inverse = np.asarray(np.linalg.inv(kernel(scale, xy, xy) + _NOISE * np.eye(len(xy))), dtype=float)
        miss = float(np.linalg.norm(inverse @ values / np.diag(inverse)[:, None]))
        if best is None or miss < best[0]:
            best = (miss, float(scale), inverse)
    assert best is not None
    return best[1], best[2]


def _missed_by_library(arm: ArmLibrary, scenario: Scenario, places: Places) -> ErrorEstimate:
    """G of the places against G of the library, on the scenario's arrangement and drawn ones; the worst of them."""
    layout = layout_of(scenario)
    home = arm.compliance(moved(scenario, layout.contacts, layout.points))
    arrangements = [(layout.contacts, home), *_drawn_places(arm, scenario, layout.contacts)]
    worst, band = np.zeros(len(places.frequency)), 0.0
    for contacts, exact in arrangements:
        values, discs = exact.values.copy(), list(exact.indices("contact"))
        rows = [*discs, *exact.indices("point")]
        values[:, np.array(rows)[:, None], np.array(discs)] = answer = places.compliance(contacts)
        values[:, np.array(discs)[:, None], np.array(rows)] = answer.swapaxes(1, 2)
        said = finite(close_loop(replace(exact, values=values), scenario.device)).values
        true = finite(close_loop(exact, scenario.device)).values
        worst = np.maximum(worst, np.abs(said - true).max(axis=(1, 2)) / np.abs(true).max(axis=(1, 2)))
        band = max(band, float(np.linalg.norm(said - true) / np.linalg.norm(true)))
    return ErrorEstimate(
        "interpolation", band, f"the page's own: G between {len(places.xy)} places against the library's, the worst of "
        f"{len(arrangements)} arrangements", tuple(places.frequency.tolist()), tuple(worst.tolist()),
    )  # fmt: skip


def _drawn_places(arm: ArmLibrary, scenario: Scenario, home: FloatArray) -> list[tuple[FloatArray, Compliance]]:
    """Arrangements of as many discs that the library takes, and its answers."""
    rng, points = np.random.default_rng(_DRAWN), layout_of(scenario).points
    found: list[tuple[FloatArray, Compliance]] = []
    half = 0.5 * np.array([arm.scenario.library.length, arm.scenario.library.width])
    for _ in range(_MOST_TRIES):
        contacts = rng.uniform(-1, 1, size=home.shape) * half
        try:
            arm.ports(asked := moved(scenario, contacts, points))
            found.append((contacts, arm.compliance(asked)))
        except GeometryError:
            continue
        if len(found) == _HELD_AGAINST:
            break
    return found
