"""Renderers: inverse filter with its zero points, funneling, and their combination."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Protocol

import numpy as np

from ..errors import DataError, GeometryError, ScenarioError
from ..ports import (
    SLACK,
    Port,
    PortLattice,
    lattice_of,
    line_through,
    nearest_distance,
    positions,
    triangle_weights,
)
from ..typing import BoolArray, ComplexArray, FloatArray
from .signals import BinnedTransfer


@dataclass(frozen=True, eq=False)
class Aim:
    """A renderer's answer: ``spectrum`` (n_bins, n_in) [unit/Hz], the bins it ``used`` (n_bins,) and how."""

    spectrum: ComplexArray
    used: BoolArray
    zeros: tuple[str, ...] = ()
    inversion: Inversion | None = None


class Renderer(Protocol):
    """Turns G, a target and a wavelet into drive spectra; options live in its constructor."""

    @property
    def name(self) -> str:
        """Name under which results are filed."""

    def aim(self, placed: BinnedTransfer, target: str, wavelet: ComplexArray) -> Aim:
        """Drive spectra towards output ``target`` for the wavelet's spectrum (n_bins,) [1/Hz] on the same bins."""

RegularisationKind = Literal["rcond", "tikhonov", "discrepancy", "lcurve", "noise"]
_ROUNDING = 4e-15  # relative to s_max: what an SVD of a few rows leaves of a singular value that is zero
_KINDS = ("rcond", "tikhonov", "discrepancy", "lcurve", "noise")


@dataclass(frozen=True)
class Regularisation:
    """Regularisation of the pseudo-inverse for small singular values s; ``value`` [-] depends on ``kind``.

    ``rcond``: s < value s_max is dropped (MATLAB's pinv of a 5 x 4 matrix: value = 1.1e-15). ``tikhonov``: 1/s becomes
    s / (s^2 + lambda^2), lambda = value s_max at each frequency. ``discrepancy``: lambda such that the misfit exceeds
    the least-squares one by value |U| (Morozov, for a G known to about ``value``); a U that lies below that is left
    undriven. ``lcurve``: lambda at the corner of the L-curve (largest curvature of log|S| over log|misfit|), searched
    from value s_max to s_max. ``noise``: lambda = e max |H| sqrt(rows), e the error that G's measurement states at the
    frequency but at least ``value``: least squares in the mean over errors of that size, so that nothing is driven on
    the strength of them. In all kinds singular values below 4e-15 s_max are dropped: rounding.
    """

    kind: RegularisationKind = "rcond"
    value: float = 1e-12

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise ScenarioError(f"regularisation '{self.kind}' is unknown; known are {', '.join(_KINDS)}")
        if not 0 <= self.value < 1:
            raise ScenarioError(f"regularisation value must be in [0, 1), got {self.value:g}")


@dataclass(frozen=True, eq=False)
class Decomposed:
    """A ``matrix`` H (n, c, q) per frequency with what its inverses are made of, worked out once for whatever is asked
    of H (:func:`decomposed`).

    H = U diag(s) V^H, k = min(c, q): ``s`` (n, k) descending, ``inward`` U^H (n, k, c), ``outward`` V (n, q, k).
    ``largest`` (n,) is max |H|, ``driven`` (n, q) says which actuators move anything.
    """

    matrix: ComplexArray
    s: FloatArray
    inward: ComplexArray
    outward: ComplexArray
    largest: FloatArray
    driven: BoolArray


def decomposed(matrix: ComplexArray) -> Decomposed:
    """``matrix`` (n, c, q) with its singular value decomposition; entries must be finite."""
    left, s, right = np.linalg.svd(matrix, full_matrices=False)
    inward, outward = (np.ascontiguousarray(part.conj().swapaxes(1, 2)) for part in (left, right))
    return Decomposed(matrix, s, inward, outward, np.abs(matrix).max(axis=(1, 2)), np.asarray(matrix.any(axis=1)))


@dataclass(frozen=True, eq=False)
class Control:
    """Control points: H of some outputs, by increasing ``rows`` of G, on the bins that are ``used`` (n_bins,), those
    where all of it is known.

    What is wanted at these outputs is a right-hand side, so that targets and methods with the same ones share it.
    """

    rows: tuple[int, ...]
    used: BoolArray
    h: Decomposed


@dataclass(frozen=True, eq=False)
class Inversion:
    """Account of the inversion of ``h`` at each of its bins, worked out where it is asked for.

    ``wanted`` (n, c): motion asked for.
    ``drive`` (n, q): result.
    ``weights`` (n, k): of its singular vectors.

    ``frequency`` (n,) [Hz]; ``parameter`` (n,) the cut (rcond) or lambda in G's unit.
    """

    h: Decomposed
    wanted: ComplexArray
    drive: ComplexArray
    weights: FloatArray
    frequency: FloatArray
    parameter: FloatArray
    regularisation: Regularisation

    @property
    def singular_values(self) -> FloatArray:
        """Of H (n, k), descending."""
        return self.h.s

    @cached_property
    def condition(self) -> FloatArray:
        """s_max / s_min (n,), inf if singular to rounding."""
        large, small = self.h.s[:, 0], self.h.s[:, -1]
        regular = small > _ROUNDING * large
        return np.asarray(np.divide(large, small, out=np.full(len(large), np.inf), where=regular))

    @cached_property
    def rank(self) -> FloatArray:
        """Effective rank (n,): the sum of the filter factors."""
        return np.asarray((self.h.s * self.weights).sum(axis=1))

    @cached_property
    def misfit(self) -> FloatArray:
        """|H S - U| / |U| (n,), the part of the target and zeros that cannot be had."""
        residual = np.linalg.norm((self.h.matrix @ self.drive[:, :, None])[:, :, 0] - self.wanted, axis=1)
        return np.asarray(residual / np.maximum(np.linalg.norm(self.wanted, axis=1), np.finfo(float).tiny))


def least_squares(
    h: Decomposed,
    wanted: ComplexArray,
    regularisation: Regularisation,
    frequency: FloatArray,
    error: FloatArray | None = None,
) -> tuple[ComplexArray, Inversion]:
    """S (n, q) minimising |H S - U| per frequency, and the report.

    U is ``wanted`` (n, c), ``error`` (n,) the e(f) [-] that H was measured with, NaN or None where unknown. A zero
    column (dead actuator) gets no drive; equal columns share it evenly (minimum norm). Nothing costs more than a
    product with H, which is decomposed already.
    """
    s, kind, value = h.s, regularisation.kind, regularisation.value
    beta = (h.inward @ wanted[:, :, None])[:, :, 0]
    if kind == "noise":
        stated = np.zeros(len(s)) if error is None else np.nan_to_num(error)
        parameter = np.maximum(stated, value) * np.sqrt(h.matrix.shape[1]) * h.largest
    elif kind == "discrepancy":
        parameter = _discrepancy(s, beta, value * np.linalg.norm(wanted, axis=1))
    elif kind == "lcurve":
        parameter = _lcurve(s, beta, wanted, max(value, 1e-12))
    else:
        parameter = value * s[:, 0]
    weights = _weights(s, parameter, kind)
    drive = (h.outward @ (weights * beta)[:, :, None])[:, :, 0]
    drive *= h.driven  # rounding would leave 1e-16 on a dead actuator
    return drive, Inversion(h, wanted, drive, weights, frequency, parameter, regularisation)


def _weights(s: FloatArray, parameter: FloatArray, kind: RegularisationKind) -> FloatArray:
    """Weights (n, k) of U^H u in place of 1 / s."""
    floor = _ROUNDING * s[:, :1]
    if kind == "rcond":
        kept = (s > np.maximum(floor, parameter[:, None])) & (s > 0)
        return np.divide(1, s, out=np.zeros_like(s), where=kept)
    damped = s + parameter[:, None] * np.divide(parameter[:, None], s, out=np.zeros_like(s), where=s > 0)
    return np.divide(1, damped, out=np.zeros_like(s), where=(s > floor) & (s > 0))


def _factors(s: FloatArray, parameter: FloatArray) -> FloatArray:
    """1 - f = lambda^2 / (s^2 + lambda^2), (..., k) for lambda (...,)."""
    total = np.hypot(s, parameter[..., None])
    return np.asarray(np.divide(parameter[..., None], total, out=np.zeros_like(total), where=total > 0) ** 2)


def _discrepancy(s: FloatArray, beta: ComplexArray, misfit: FloatArray) -> FloatArray:
    """lambda (n,) by bisection of its logarithm: |lambda^2 / (s^2 + lambda^2) beta| = misfit, increasing in lambda."""
    low, high = np.full(len(s), np.log(1e-15)), np.full(len(s), np.log(1e6))
    for _ in range(60):
        middle = (low + high) / 2
        reached = np.linalg.norm(_factors(s, np.exp(middle) * s[:, 0]) * np.abs(beta), axis=1)
        low, high = np.where(reached < misfit, middle, low), np.where(reached < misfit, high, middle)
    return np.asarray(np.exp(low) * s[:, 0])


def _lcurve(s: FloatArray, beta: ComplexArray, wanted: ComplexArray, smallest: float) -> FloatArray:
    """lambda (n,) of largest curvature of (log misfit, log norm) among 80 values."""
    ratio = np.geomspace(smallest, 1, 80)
    parameter = ratio[:, None] * s[:, 0]
    rest = np.maximum(np.sum(np.abs(wanted) ** 2, axis=1) - np.sum(np.abs(beta) ** 2, axis=1), 0)
    open_part = _factors(s[None], parameter)
    tiny = np.finfo(float).tiny
    misfit = np.sum((open_part * np.abs(beta)) ** 2, axis=2) + rest
    inverse = np.divide(1, s, out=np.zeros_like(s), where=s > _ROUNDING * s[:, :1])
    norm = np.sum(((1 - open_part) * inverse * np.abs(beta)) ** 2, axis=2)
    curvature = _curvature(np.log(np.maximum(misfit, tiny)) / 2, np.log(np.maximum(norm, tiny)) / 2, np.log(ratio))
    return np.asarray(parameter[np.argmax(curvature, axis=0), np.arange(len(s))])


def _curvature(x: FloatArray, y: FloatArray, t: FloatArray) -> FloatArray:
    """Signed curvature of (x, y)(t) along axis 0; -inf where the curve stands still."""
    dx, dy = np.gradient(x, t, axis=0), np.gradient(y, t, axis=0)
    ddx, ddy = np.gradient(dx, t, axis=0), np.gradient(dy, t, axis=0)
    speed = np.hypot(dx, dy)
    still = speed < 1e-3
    return np.where(still, -np.inf, (dx * ddy - ddx * dy) / np.where(still, 1, speed) ** 3)
THESIS_ACTUATORS = 4


class ZeroRule(Protocol):
    """Chooses zero points for a target."""

    def choose(self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the zero points; ``aim`` gives the drives that a set of zero points would lead to."""


@dataclass(frozen=True)
class ThesisZeros:
    """Corners of the grid; for a corner target the other three corners and the centre.

    De Vlam 2022, III.B.1, states only target 5 (the four corners) and that four zeros are used. Edges -> the
    four corners and corners -> three corners and the centre are our choice. Needs outputs on a rectangular
    grid; the centre of a grid without a middle point is the one nearest to it.
    """

    def choose(self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the zero points; raises GeometryError if the outputs form no rectangle."""
        grid = lattice_of(placed.outputs, "zero points by the corner rule, outputs")
        last = np.array([len(grid.rows) - 1, len(grid.columns) - 1])
        corner = (np.isin(grid.place, 0) | (grid.place == last)).all(axis=1)
        names = [p.name for p in placed.outputs]
        chosen = [n for n, is_corner in zip(names, corner, strict=True) if is_corner and n != target]
        if len(chosen) == 3:
            middle = names[int(np.argmin(np.abs(grid.place - last / 2).sum(axis=1)))]
            chosen += [middle] if middle not in (*chosen, target) else []
        return tuple(chosen)


def within_thesis(placed: BinnedTransfer) -> bool:
    """True if G has at most the thesis' four actuators (columns known on some bin count)."""
    return int(np.count_nonzero(placed.bins.valid.any(axis=(0, 1)))) <= THESIS_ACTUATORS


@dataclass(frozen=True)
class AutoZeros:
    """The thesis' rule for its four actuators on a rectangular grid, else all other outputs.

    With all others held still, least squares gives at each frequency the drive with the largest energy at the target
    over that elsewhere. No further actuator can make it smaller. The corners alone leave the actuators
    beyond four free to move whatever lies between.
    """

    def choose(self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the zero points."""
        if within_thesis(placed):
            try:
                return ThesisZeros().choose(placed, target, aim)
            except GeometryError:  # no rectangle, so no corners
                pass
        return tuple(p.name for p in placed.outputs if p.name != target)


@dataclass(frozen=True)
class FixedZeros:
    """Zero points by ``target``, as found before: for studies that aim anew but do not search anew."""

    by_target: Mapping[str, tuple[str, ...]]

    def choose(self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the zero points; raises ScenarioError for a target without any on record."""
        if target not in self.by_target:
            raise ScenarioError(f"no zero points are on record for target '{target}'")
        return self.by_target[target]


Zeros = ZeroRule | tuple[str, ...]


def chosen_zeros(
    zeros: Zeros, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]
) -> tuple[str, ...]:
    """Names from a rule or a list, checked: known, distinct, not the target; raises ScenarioError."""
    if not hasattr(zeros, "choose") and not isinstance(zeros, list | tuple):
        raise ScenarioError(f"zero points: expected a rule or names of outputs such as ('1', '3'), got {zeros!r}")
    names = tuple(zeros) if isinstance(zeros, list | tuple) else zeros.choose(placed, target, aim)
    if target in names:
        raise ScenarioError(f"output '{target}' is both the target and a zero point; take it out of the zero points")
    if len(set(names)) != len(names):
        raise ScenarioError(f"zero points {', '.join(names)} name an output twice")
    for name in names:
        placed.row(name)
    return names


def settled_zeros(zeros: Zeros, placed: BinnedTransfer, targets: Sequence[str]) -> Zeros:
    """Zero points of ``targets`` by a rule that looks at places alone; others stay the rules that they are."""
    if not isinstance(zeros, ThesisZeros | AutoZeros):
        return zeros
    return FixedZeros({t: zeros.choose(placed, t, _unasked) for t in targets})


def _unasked(names: tuple[str, ...]) -> Aim:
    raise AssertionError(f"a rule of places aimed with {names}")


# Inverse filter: move the target as asked and hold the zero points still.

LEAST_ERROR = 0.02  # e(f): no G of an arm is known better, and what S gains from less is its own error


@dataclass(frozen=True)
class InverseFilter:
    """Inverse filter renderer, eq. 4 of de Vlam 2022: S = H^+ U at every frequency.

    H is the rows of G of the target and the zero points, U the wavelet at the target and zero elsewhere. With
    more control points than actuators this is least squares: neither target nor zeros are met exactly, and
    without damping the target reaches the share 1 - m^2 of what was asked, m = ``Drives.inversion.misfit``,
    which varies with frequency. So ``peak`` [m], which scales the wavelet, is not reached either. ``zeros`` is a rule
    or names of outputs. ``regularisation`` None follows the number of actuators: up to the thesis' four, the
    pseudo-inverse; more, the damping that the error of a measured G asks for (:class:`Regularisation`, "noise"), at
    least that for ``least_error`` [-], e(f) that G is taken to err by.
    """

    zeros: Zeros = field(default_factory=AutoZeros)
    regularisation: Regularisation | None = None
    peak: float = 1e-6
    least_error: float = LEAST_ERROR
    name: str = "inverse filter"

    def aim(self, placed: BinnedTransfer, target: str, wavelet: ComplexArray) -> Aim:
        """Drive spectra towards output ``target``; ``wavelet`` (n_bins,) [1/Hz]."""
        return aim_at(placed, target, self.peak * wavelet, self.zeros, self.regularisation or self.least_error)

    def with_zeros(self, zeros: Zeros) -> InverseFilter:
        """The same renderer with other zero points."""
        return replace(self, zeros=zeros)

    def precomputed_for_targets(self, placed: BinnedTransfer, targets: Sequence[str]) -> InverseFilter:
        """The same renderer with its zero points found for ``targets``, as far as places tell."""
        return replace(self, zeros=settled_zeros(self.zeros, placed, targets))


def aim_at(
    placed: BinnedTransfer,
    target: str,
    displacement: ComplexArray,
    zeros: Zeros,
    regularisation: Regularisation | float,
) -> Aim:
    """Drive spectra for ``displacement`` (n_bins,) [m/Hz] at output ``target`` and none at the zero points.

    A number in place of a ``regularisation`` is the least error of :class:`InverseFilter`.

    Bins where G is unknown between the control points and the inputs are not driven. Raises ScenarioError for
    unknown or repeated control points and DataError if no bin is left.
    """
    placed.row(target)
    rule = regularisation
    if not isinstance(rule, Regularisation):
        rule = Regularisation() if within_thesis(placed) else Regularisation("noise", rule)

    def towards(names: tuple[str, ...]) -> Aim:
        """Drives that move the target and hold the points ``names`` still."""
        control = control_of(placed, (target, *names))
        used = control.used
        wanted = np.zeros((int(used.sum()), len(control.rows)), dtype=complex)
        wanted[:, control.rows.index(placed.row(target))] = displacement[used]
        spectrum = np.zeros((len(used), len(placed.inputs)), dtype=complex)
        spectrum[used], report = least_squares(control.h, wanted, rule, placed.bins.frequency[used], placed.error[used])
        return Aim(spectrum, used, names, report)

    return towards(chosen_zeros(zeros, placed, target, towards))


def control_of(placed: BinnedTransfer, names: Iterable[str]) -> Control:
    """Control points by name, decomposed here unless ``placed`` has them already.

    Rows are in G's order whoever asks, so that drives are the same to the last bit either way. Raises DataError where G
    is known on no bin between these points and the inputs.
    """
    rows = tuple(sorted({placed.row(name) for name in names}))
    if rows in placed.controls:
        return placed.controls[rows]
    used = known_bins(placed, list(rows))
    matrix = placed.bins.values[used][:, rows]
    matrix[:, :, absent_inputs(placed, list(rows))] = 0
    return Control(rows, used, decomposed(matrix))


# Combination: the inverse filter, asked only for the displacement that funneling gives at the target.

@dataclass(frozen=True)
class Combination:
    """Combination renderer, III.B.3 of de Vlam 2022: eq. 4 with U at the target from funneling (eq. 3, 6, 8).

    With more control points than actuators the target's displacement is funneling's only up to the misfit, as
    in :class:`InverseFilter`; the thesis calls the two identical. ``amplitude`` [V], ``distance`` and
    ``weights`` are funneling's. The other options are the inverse filter's.
    """

    zeros: Zeros = field(default_factory=AutoZeros)
    regularisation: Regularisation | None = None
    amplitude: float = 1.0
    distance: Distance = "spacing"
    least_error: float = LEAST_ERROR
    weights: Weights | None = field(default=None, repr=False, compare=False)
    name: str = "combination"

    def aim(self, placed: BinnedTransfer, target: str, wavelet: ComplexArray) -> Aim:
        """Drive spectra towards output ``target``; ``wavelet`` (n_bins,) [1/Hz]."""
        funneling = Funneling(self.amplitude, self.distance, self.weights).aim(placed, target, wavelet)
        row = placed.bins.values[:, placed.row(target)]
        displacement = np.asarray((row * funneling.spectrum).sum(axis=1))
        aim = aim_at(placed, target, displacement, self.zeros, self.regularisation or self.least_error)
        return replace(aim, used=aim.used & funneling.used)

    def with_zeros(self, zeros: Zeros) -> Combination:
        """The same renderer with other zero points."""
        return replace(self, zeros=zeros)

    def precomputed_for_targets(self, placed: BinnedTransfer, targets: Sequence[str]) -> Combination:
        """The same renderer with zero points and shares found for ``targets``, as far as places tell."""
        weights = settled_weights(self.weights, placed, targets, self.distance)
        return replace(self, zeros=settled_zeros(self.zeros, placed, targets), weights=weights)


# Funneling: all actuators send the same signal, the nearer ones more of it.

Weights = Mapping[str, FloatArray]  # A_q / A (n_in,) by target
Distance = Literal["spacing", "diagonal"] | float  # D of eq. 6 [m]


def funneling_weights(inputs: tuple[Port, ...], target: Port, distance: Distance = "spacing") -> FloatArray:
    """A_q / A (n_in,) [-]; they sum to 1 where ``distance`` is the spacing.

    On a rectangle of N x M actuators eq. 6 of de Vlam 2022, (1 - d_x / D_x)(1 - d_y / D_y): the four around the target
    share its weight, so that eq. 6 holds within each cell. D, "the maximum distances between the actuators", is the
    cell's side along each axis; or its diagonal; or a length [m], which may not be shorter than a side.

    On a line, the one-dimensional form of eq. 6 between the two neighbours. Any other layout: the target's barycentric
    coordinates in the triangle of nearest actuators, the linear law of three-actuator phantoms
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
