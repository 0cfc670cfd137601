"""Regularised least squares per frequency: S = H^+ U, eq. 4 of de Vlam 2022."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from ..errors import ScenarioError
from ..typing import BoolArray, ComplexArray, FloatArray

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
