"""Fitting a model's parameters to a measured G: weighted least squares with uncertainty and identifiability.

Residuals are whitened: real and imaginary part of (model - measured) over sigma / sqrt(2), sigma the standard deviation
of the entry. At the minimum the covariance of the parameters is (J^T J)^-1, times the reduced chi^2 where that exceeds
1 (the model does not explain the data to within their noise, so it is the misfit that is uncertain). The singular
values of J, in units of each parameter's allowed range, tell which combinations the data do not determine.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats.qmc import LatinHypercube

from ...errors import DataError
from ...progress import Progress, tell
from ...transfer import TransferMatrix
from ...typing import BoolArray, ComplexArray, FloatArray
from .parameters import Direction, Parameter

Values = Mapping[str, float]
Model = Callable[[Values], "TransferMatrix | ComplexArray"]
Gradient = Callable[[Values], Mapping[str, ComplexArray]]

SCALE, DELAY, GAIN = "scale", "delay", "gain."
FALLBACK_NOISE = 0.05  # of the entries' rms, where no deviation is known
_VAGUE = 0.25  # of the allowed range: a combination known no better than this is called unknown
_MUCH = 0.3  # of the data's norm: a misfit that is said where nothing tells it from noise
_STEP = 1e-4  # of the allowed range, for differences
_APART = 2.0  # times what the model leaves of the other actuators' columns: a gain of its own is worth a try


def is_calibration(name: str) -> bool:
    """True for scale, delay and gains of single actuators, which :func:`adjusted` puts onto a model's G."""
    return name in (SCALE, DELAY) or name.startswith(GAIN)


def adjusted(g: ComplexArray, values: Values, omega: FloatArray, inputs: Sequence[str]) -> ComplexArray:
    """G (n_frequency, n_out, n_in) times scale, gain of each of ``inputs`` and exp(-i omega delay)."""
    turn = values.get(SCALE, 1.0) * np.exp(-1j * omega * values.get(DELAY, 0.0))
    return np.asarray(g * turn[:, None, None] * np.array([values.get(f"{GAIN}{n}", 1.0) for n in inputs]))


@dataclass(frozen=True, eq=False)
class FitResult:
    """``values`` with one standard ``deviation`` each, in the parameter's unit (for ``log``: half the 68 % interval).

    ``interval`` holds the 95 % bounds, lower and upper. ``covariance`` and ``correlation`` (k, k) are in
    the fitted coordinates (logarithms where ``log``). ``chi2`` is the reduced chi^2: 1 for noise alone, NaN
    if no deviation was known. ``singular_values`` (k,) of the whitened Jacobian over the allowed ranges.
    ``unknown`` are combinations that the data do not determine, ``at_bound`` names of parameters that ended
    on a bound. ``e_band`` is the misfit's norm over the data's. ``n_data`` counts real numbers.

    ``left`` is the misfit's norm over the data's by actuator.
    ``scatter`` [-] is what deviations, stated or taken where none are, had to be multiplied with for the misfit;
    ``systematic`` (k, k) the share of ``covariance`` that the model errs by, which more data leave as it is.
    """

    parameters: tuple[Parameter, ...]
    values: Values
    deviation: Values
    interval: Mapping[str, tuple[float, float]]
    covariance: FloatArray
    correlation: FloatArray
    chi2: float
    singular_values: FloatArray
    unknown: tuple[Direction, ...]
    at_bound: tuple[str, ...]
    e_band: float
    n_data: int
    evaluations: int
    converged: bool
    message: str
    scatter: float = 1.0
    systematic: FloatArray | None = None
    left: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def identified(self) -> bool:
        """True if every parameter is determined and none sits on a bound."""
        return not self.unknown and not self.at_bound

    @property
    def sentences(self) -> tuple[str, ...]:
        """Remarks besides the numbers."""
        ends = tuple(
            f"{n} ended on its bound, of which its interval knows nothing: start it elsewhere (--set, where it is a "
            "scenario's key) or widen it, or the model is wrong"
            for n in self.at_bound
        )
        misfit: tuple[str, ...] = ()
        if self.chi2 > 2:
            misfit = (f"the model misses the data by {math.sqrt(self.chi2):.1f} standard deviations (rms)",)
        elif math.isnan(self.chi2) and self.e_band > _MUCH:
            misfit = (
                f"the model leaves {100 * self.e_band:.0f} % of the data's norm unexplained, which intervals take for "
                "noise: no deviations say so; start elsewhere, or the model is wrong",
            )
        worst = max(self.left, key=self.left.__getitem__, default="")
        others = [x for n, x in self.left.items() if n != worst]
        if others and self.left[worst] > _APART * float(np.median(others)) and f"{GAIN}{worst}" not in self.values:
            misfit = (*misfit, f"the model leaves {100 * self.left[worst]:.2g} % of {worst}'s column, of others' "
                      f"{100 * float(np.median(others)):.2g} %: fit again with `gains`, one for each actuator, in "
                      "place of scale")  # fmt: skip
        stuck = () if self.converged else (f"the fit did not converge: {self.message}",)
        return (*(d.sentence for d in self.unknown), *ends, *misfit, *stuck)


def fit(
    model: Model,
    measured: TransferMatrix,
    parameters: Sequence[Parameter],
    *,
    gradient: Gradient | None = None,
    fallback_noise: float = FALLBACK_NOISE,
    starts: int = 1,
    max_evaluations: int = 200,
    tolerance: float = 1e-8,
    progress: Progress | None = None,
) -> FitResult:
    """The ``parameters`` with which ``model`` comes closest to ``measured``.

    ``model`` maps values by name to G (n_frequency, n_out, n_in) on ``measured``'s frequencies, ports and unit;
    ``gradient`` to its derivatives by name (from adjoints, say), differences are taken without it. Parameters called
    "scale", "gain.NAME" of an input and "delay" are applied here (:func:`adjusted`).

    Where some entries have a standard deviation those without are left out; where none has, each is weighted as if it
    were ``fallback_noise`` of the entries' rms, and the covariance then follows from the misfit. Phases make local
    minima: with ``starts`` > 1 the fit is repeated from other places in the ranges and the best is kept. ``progress``
    counts evaluations. Raises DataError without usable data or for fewer data than parameters.
    """
    problem = _Problem.of(model, measured, tuple(parameters), gradient, fallback_noise, progress)
    places = [np.array([p.to_unit(p.start) for p in problem.parameters])]
    if starts > 1:  # always the same others, spread over the ranges
        places += list(LatinHypercube(len(places[0]), rng=np.random.default_rng(0)).random(starts - 1))
    tries = [problem.staged(place, max_evaluations, tolerance) for place in places]
    best = min(tries, key=lambda t: t.cost)
    return _result(problem, best.place, best.converged, best.message)


@dataclass(frozen=True, eq=False)
class _Try:
    place: FloatArray
    cost: float
    converged: bool
    message: str


@dataclass(frozen=True, eq=False)
class _Problem:
    model: Model
    measured: TransferMatrix
    parameters: tuple[Parameter, ...]
    gradient: Gradient | None
    used: BoolArray
    weight: FloatArray
    sigma_known: bool
    count: list[int]
    progress: Progress | None

    @classmethod
    def of(
        cls,
        model: Model,
        measured: TransferMatrix,
        parameters: tuple[Parameter, ...],
        gradient: Gradient | None,
        fallback: float,
        progress: Progress | None,
    ) -> _Problem:
        """The data used and their weights sqrt(2) / sigma [1/unit of G]; sigma is ``fallback`` times the rms of G
        where no deviation is known. Raises DataError for repeated or no names and for too few data.
        """
        names = [p.name for p in parameters]
        if not names or len(set(names)) != len(names):
            raise DataError(f"a fit needs parameters with distinct names, got {names}")
        used = np.isfinite(measured.values) if measured.valid is None else measured.valid & np.isfinite(measured.values)
        sigma = np.full(used.shape, np.nan) if measured.deviation is None else measured.deviation
        known = used & np.isfinite(sigma) & (sigma > 0)
        sigma_known = bool(known.any())
        used = known if sigma_known else used
        if 2 * np.count_nonzero(used) <= len(names):
            raise DataError(
                f"{2 * np.count_nonzero(used)} usable numbers cannot determine {len(names)} parameters; measure more"
            )
        rms = float(np.sqrt(np.mean(np.abs(measured.values[used]) ** 2)))
        weight = np.sqrt(2) / (sigma[used] if sigma_known else np.full(np.count_nonzero(used), fallback * rms))
        return cls(model, measured, parameters, gradient, used, weight, sigma_known, [0], progress)

    def values(self, place: FloatArray) -> dict[str, float]:
        """Parameters by name at ``place`` (k,) in [0, 1]."""
        return {p.name: p.from_unit(float(x)) for p, x in zip(self.parameters, place, strict=True)}

    def full(self, place: FloatArray, free: BoolArray, x: FloatArray) -> FloatArray:
        """``place`` with the free entries replaced by ``x``."""
        out = place.copy()
        out[free] = x
        return out

    def residual(self, place: FloatArray) -> FloatArray:
        """Whitened residuals (n_data,): real parts, then imaginary ones."""
        values = self.values(place)
        self.count[0] += 1
        return self._whitened(self._scaled(self._computed(values), values) - self.measured.values)

    def _computed(self, values: Values) -> ComplexArray:
        computed = self.model({n: v for n, v in values.items() if not is_calibration(n)})
        array = computed.values if isinstance(computed, TransferMatrix) else np.asarray(computed)
        if array.shape != self.measured.values.shape:
            raise DataError(f"the model gives shape {array.shape}, the measurement has {self.measured.values.shape}")
        return array

    def _scaled(self, array: ComplexArray, values: Values) -> ComplexArray:
        return adjusted(array, values, self.measured.omega, self._inputs)

    @property
    def _inputs(self) -> list[str]:
        return [p.name for p in self.measured.inputs]

    def _whitened(self, difference: ComplexArray) -> FloatArray:
        flat = difference[self.used] * self.weight
        return np.concatenate([flat.real, flat.imag])

    def jacobian(self, place: FloatArray, central: bool = False) -> FloatArray:
        """(n_data, k) by place: the gradient's, or differences away from the nearer bound."""
        if self.gradient is None:
            return np.stack([self._difference(place, k, central) for k in range(len(place))], axis=1)
        values = self.values(place)
        inner = {n: v for n, v in values.items() if not is_calibration(n)}
        slopes = {n: self._scaled(g, values) for n, g in self.gradient(inner).items()}
        whole = self._scaled(self._computed(values), values)
        slopes[SCALE] = whole / values.get(SCALE, 1.0)
        slopes[DELAY] = -1j * self.measured.omega[:, None, None] * whole
        for k, name in enumerate(self._inputs):
            gain = values.get(f"{GAIN}{name}", 1.0)
            slopes[f"{GAIN}{name}"] = whole * (np.arange(whole.shape[2]) == k) / gain
        rows = [slopes[p.name] * (p.span * (values[p.name] if p.log else 1.0)) for p in self.parameters]
        return np.stack([self._whitened(r) for r in rows], axis=1)

    def _difference(self, place: FloatArray, k: int, central: bool) -> FloatArray:
        step = np.zeros(len(place))
        step[k] = _STEP if place[k] <= 0.5 else -_STEP
        near = self.residual(place - step) if central and 0 <= place[k] - step[k] <= 1 else self.residual(place)
        width = 2 * step[k] if central and 0 <= place[k] - step[k] <= 1 else step[k]
        return np.asarray((self.residual(place + step) - near) / width)

    def staged(self, place: FloatArray, most: int, tolerance: float) -> _Try:
        """One stage after the other from ``place``."""
        outcome = None
        for stage in sorted({p.stage for p in self.parameters}):
            free = np.array([p.stage <= stage for p in self.parameters])
            outcome = self.solve(place, free, most, tolerance)
            place = self.full(place, free, outcome.x)
        assert outcome is not None
        return _Try(place, float(outcome.cost), bool(outcome.success), str(outcome.message))

    def solve(self, place: FloatArray, free: BoolArray, most: int, tolerance: float) -> OptimizeResult:
        """Bounded least squares over the free parameters."""

        def residual(x: FloatArray) -> FloatArray:
            """Of the free parameters, and one more evaluation told."""
            r = self.residual(self.full(place, free, x))
            tell(self.progress, "evaluations of the fit", self.count[0], 0)
            return r

        def jacobian(x: FloatArray) -> FloatArray:
            """By the free parameters: the model's own, or differences."""
            at = self.full(place, free, x)
            if self.gradient is not None:
                return self.jacobian(at)[:, free]
            return np.stack([self._difference(at, int(k), False) for k in np.nonzero(free)[0]], axis=1)

        start = np.clip(place[free], 1e-6, 1 - 1e-6)
        return least_squares(
            residual,
            start,
            jacobian,
            bounds=(0.0, 1.0),
            max_nfev=most,
            ftol=tolerance,
            xtol=tolerance,
            gtol=1e-12,
        )


def with_model_error(result: FitResult, coarser: Values, factor: float) -> FitResult:
    """The same with intervals that hold what the model errs by, beside the noise.

    A model that errs moves all values together, and more data do not help. How far is told by the values that a
    ``coarser`` model finds in the same data: ``factor`` times that is taken for the half width of a 95 % interval.
    """
    parameters = result.parameters
    place, other = (np.array([p.to_unit(v[p.name]) for p in parameters]) for v in (result.values, coarser))
    moved = factor * (other - place) * np.array([p.span for p in parameters]) / 1.96
    return _widened(result, np.outer(moved, moved))


def with_scattered_error(result: FitResult, moved: FloatArray) -> FitResult:
    """The same with intervals that hold ``moved`` (n, k), in the fitted coordinates: how far answers that are wrong by
    what a model may err by move the values (:func:`moved_by`). 1.5 times their rms is taken for the half width, as for
    S (decision 0027)."""
    return _widened(result, (1.5 / 1.96) ** 2 * (moved.T @ moved) / len(moved))


def moved_by(model: Model, measured: TransferMatrix, result: FitResult, others: Sequence[ComplexArray]) -> FloatArray:
    """Change of the fitted values (n, k) by errors of the model, to first order in the fitted coordinates.

    ``model`` at the fitted values gave each of ``others``, G shaped like ``measured``, instead of what it gives.

    One answer on another mesh may by chance move a value not at all; many in all directions do not.
    """
    parameters = result.parameters
    problem = _Problem.of(model, measured, parameters, None, FALLBACK_NOISE, None)
    place = np.array([p.to_unit(result.values[p.name]) for p in parameters])
    own, values = problem.residual(place), problem.values(place)
    off = [problem._whitened(problem._scaled(g, values) - measured.values) - own for g in others]
    steps, *_ = np.linalg.lstsq(problem.jacobian(place, central=True), -np.array(off).T, rcond=1e-9)
    return np.asarray(steps.T * np.array([p.span for p in parameters]))


def _widened(result: FitResult, systematic: FloatArray) -> FitResult:
    """With a ``systematic`` covariance (k, k) in the fitted coordinates beside what is known."""
    parameters = result.parameters
    place = np.array([p.to_unit(result.values[p.name]) for p in parameters])
    span = np.array([p.span for p in parameters])
    covariance, known = result.covariance + systematic, result.systematic
    sd = np.sqrt(np.diag(covariance))
    each = list(zip(parameters, place, sd / span, strict=True))
    return replace(
        result, covariance=covariance, correlation=covariance / np.outer(sd, sd),
        deviation={p.name: _half_width(p, x, d) for p, x, d in each},
        interval={p.name: _interval(p, x, 1.96 * d) for p, x, d in each},
        systematic=systematic + (0 if known is None else known),
    )  # fmt: skip


def _result(problem: _Problem, place: FloatArray, converged: bool, message: str) -> FitResult:
    parameters = problem.parameters
    residual = problem.residual(place)
    freedom = len(residual) - len(place)
    chi2 = float(residual @ residual) / freedom
    inflate = max(chi2, 1.0) if problem.sigma_known else chi2
    _, s, directions = np.linalg.svd(problem.jacobian(place, central=True), full_matrices=False)
    size = np.sqrt(inflate) * np.divide(1, s, out=np.full(len(s), np.inf), where=s > 1e-12 * s[0])
    spread = (directions.T * np.minimum(size, 1e6)) @ (directions.T * np.minimum(size, 1e6)).T
    span = np.array([p.span for p in parameters])
    sd = np.sqrt(np.diag(spread))
    values = problem.values(place)
    whole = np.where(problem.used, problem.measured.values, 0)
    misfit = residual / np.concatenate([problem.weight, problem.weight])
    apart = np.zeros_like(whole)
    apart[problem.used] = misfit[: len(misfit) // 2] + 1j * misfit[len(misfit) // 2 :]
    sizes = [np.linalg.norm(x, axis=(0, 1)) for x in (apart, whole)]
    return FitResult(
        parameters=parameters,
        values=values,
        deviation={p.name: _half_width(p, x, d) for p, x, d in zip(parameters, place, sd, strict=True)},
        interval={p.name: _interval(p, x, 1.96 * d) for p, x, d in zip(parameters, place, sd, strict=True)},
        covariance=spread * np.outer(span, span),
        correlation=spread / np.outer(sd, sd),
        chi2=chi2 if problem.sigma_known else math.nan,
        singular_values=s,
        unknown=tuple(
            Direction({p.name: float(w) for p, w in zip(parameters, row, strict=True)}, float(d))
            for row, d in zip(directions, size, strict=True)
            if d > _VAGUE
        ),
        at_bound=tuple(p.name for p, x in zip(parameters, place, strict=True) if not 1e-4 < x < 1 - 1e-4),
        e_band=float(np.linalg.norm(misfit) / np.linalg.norm(whole)),
        n_data=len(residual),
        evaluations=problem.count[0],
        converged=converged,
        message=message,
        scatter=math.sqrt(inflate),
        left=MappingProxyType({n: float(a / b) for n, a, b in zip(problem._inputs, *sizes, strict=True) if b > 0}),
    )


def _half_width(p: Parameter, x: float, d: float) -> float:
    low, high = _interval(p, x, d)
    return (high - low) / 2


def _interval(p: Parameter, x: float, d: float) -> tuple[float, float]:
    """Values at x - d and x + d, unbounded: a standard deviation may reach past the bounds."""
    far = min(d, 50.0 / p.span) if p.log else d
    return p.from_unit(x - far), p.from_unit(x + far)
