"""Compliance of discs anywhere on a library's patch, in few enough numbers for a page to work with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...device import close_loop
from ...engines.library import ArmLibrary
from ...errors import GeometryError
from ...geometry.device.layout import layout_of
from ...ports import Port, positions
from ...progress import Progress, tell
from ...scenario import Scenario
from ...scenario.sweep import frequencies
from ...transfer import Compliance, ErrorEstimate, finite
from ...typing import ComplexArray, FloatArray
from .field import Field, Surface
from .flat import net_faces, profile

_FINE, _AT_ONCE = 300, 100  # places for what the grid's points feel, and how many are read at once
_MOST = 60  # places that the library is asked for, seconds each; the page holds a number for each two of them
_SCALES = 1e3 / np.array([6.0, 9.0, 13.0, 20.0, 30.0, 45.0])  # [1/m] tried for the length over which fields change
_NOISE = 1e-6  # of the variance: no two places are alike to rounding
_RADII, _FARTHEST = 64, 1.05  # of the layered model's profile, and how far it reaches in diagonals of the patch
_RANK = 1e-4  # of the largest combination of places: far below the error of interpolating between them
_CHECKED, _SEED = 4, 0  # arrangements besides the scenario's own on which all of it is held against the library
_TRIES = 400
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
    steps = np.arange(_RADII) * np.sqrt(reach - radius) / (_RADII - 1)
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
    return found, _missed(arm, plain, found)


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


def _missed(arm: ArmLibrary, scenario: Scenario, places: Places) -> ErrorEstimate:
    """G of the places against G of the library, on the scenario's arrangement and drawn ones; the worst of them."""
    layout = layout_of(scenario)
    home = arm.compliance(moved(scenario, layout.contacts, layout.points))
    arrangements = [(layout.contacts, home), *_drawn(arm, scenario, layout.contacts)]
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


def _drawn(arm: ArmLibrary, scenario: Scenario, home: FloatArray) -> list[tuple[FloatArray, Compliance]]:
    """Arrangements of as many discs that the library takes, and its answers."""
    rng, points = np.random.default_rng(_SEED), layout_of(scenario).points
    found: list[tuple[FloatArray, Compliance]] = []
    half = 0.5 * np.array([arm.scenario.library.length, arm.scenario.library.width])
    for _ in range(_TRIES):
        contacts = rng.uniform(-1, 1, size=home.shape) * half
        try:
            arm.ports(asked := moved(scenario, contacts, points))
            found.append((contacts, arm.compliance(asked)))
        except GeometryError:
            continue
        if len(found) == _CHECKED:
            break
    return found
