"""Statistics of draws: quantiles of S, the best method, what drives S; and the summary, ``prediction.json``."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import multivariate_normal, rankdata

from ... import __version__
from ...errors import DataError, MissingExtra
from ...metrics.strength import GROUPS
from ...results.draws import READINGS, Outcome
from ...scenario.model import resolve_tissues
from ...store.text import write_json
from ...tissue import REFERENCE
from ...typing import BoolArray, FloatArray
from .draws import SOFT, kept_tissues

if TYPE_CHECKING:
    from .run import Prediction

LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
LEAST = 20  # draws, for quantiles of 5 and 95 %
_LEAST_SOBOL = 100
_DRAWS_AN_ENTRY = 5  # of a joint distance


@dataclass(frozen=True, eq=False)
class Draws:
    """Draws that gave S: ``strengths`` (n, n_reading, n_method, n_target) [-], ``drivers`` (n, n_driver) by ``names``
    (a categorical law as its index), ``laws`` (n,), ``numerics`` (n,) e_band of each G and ``spread``
    (n, n_method, n_target) the half width of the interval of log S that it leaves; ``problems`` of the others, and how
    many have them. ``thesis_grid`` says whether targets are of the thesis' 3 x 3 points, whose groups mean something;
    ``counted`` are the targets that no motor stands on or beside, None for all.
    """

    strengths: FloatArray
    methods: tuple[str, ...]
    targets: tuple[str, ...]
    laws: tuple[str, ...]
    names: tuple[str, ...]
    drivers: FloatArray
    numerics: FloatArray
    seconds: FloatArray
    spread: FloatArray
    problems: Mapping[str, int]
    thesis_grid: bool = True
    counted: tuple[str, ...] | None = None

    @property
    def groups(self) -> Mapping[str, list[int]]:
        """Columns of targets by group (:func:`group_columns`)."""
        return group_columns(self.targets, self.thesis_grid, self.counted)

    def reading(self, name: str) -> FloatArray:
        """S (n, n_method, n_target) by one of :data:`READINGS`."""
        return np.asarray(self.strengths[:, READINGS.index(name)])

    def enclosed(self, name: str) -> IntervalSamples:
        """The same with what the errors of each arm's G leave it."""
        value = self.reading(name)
        return IntervalSamples(value, value * np.exp(-self.spread), value * np.exp(self.spread))

    def of_law(self, law: str) -> Draws:
        """The draws of one law only."""
        chosen = np.array([x == law for x in self.laws])
        return replace(
            self, strengths=self.strengths[chosen], laws=tuple(x for x in self.laws if x == law),
            drivers=self.drivers[chosen], numerics=self.numerics[chosen], seconds=self.seconds[chosen],
            spread=self.spread[chosen], problems=MappingProxyType({}),
        )  # fmt: skip


def draws_of(
    outcomes: Sequence[Outcome],
    methods: Sequence[str],
    targets: Sequence[str],
    thesis_grid: bool = True,
    counted: tuple[str, ...] | None = None,
) -> Draws:
    """The outcomes as arrays; DataError where fewer than :data:`LEAST` gave S."""
    good = [o for o in sorted(outcomes, key=lambda o: o.number) if not o.problem]
    problems = MappingProxyType(Counter(o.problem for o in outcomes if o.problem))
    if len(good) < LEAST:
        why = f"; the first failure: {next(iter(problems))}" if problems else ""
        raise DataError(f"a band of 90 % needs {LEAST} draws with S, got {len(good)}; raise --draws{why}")
    shared = sorted(n for n in good[0].drivers if all(n in o.drivers for o in good))  # read back in any order
    laws = tuple(o.law for o in good)
    free = not shared or any(f"{t} stiffness" in shared for t in SOFT)  # a law of held tissues drives nothing
    drawn = ("law",) if free else ()
    known = sorted(set(laws))
    columns = [[o.drivers[n] for n in shared] + [float(known.index(o.law)) for _ in drawn] for o in good]
    return Draws(
        np.array([o.strengths for o in good]), tuple(methods), tuple(targets), laws, (*shared, *drawn),
        np.array(columns), np.array([o.numerics for o in good]), np.array([o.seconds for o in good]),
        np.array([o.spread for o in good]), problems, thesis_grid, counted,
    )  # fmt: skip


def quantiles(values: FloatArray) -> FloatArray:
    """Quantiles (n_level, ...) at :data:`LEVELS` of ``values`` (n, ...), linear between draws."""
    return np.asarray(np.quantile(values, LEVELS, axis=0))


@dataclass(frozen=True, eq=False)
class IntervalSamples:
    """Values of arms (n, ...): ``value``, and the ends ``low`` and ``high`` that each arm's own numerics leave it."""

    value: FloatArray
    low: FloatArray
    high: FloatArray

    def quantiles(self) -> FloatArray:
        """Quantiles (n_level, ...) at :data:`LEVELS`: of the low ends below the median, of the high ones above it, so
        that what numerics may do to an arm widens the band and never narrows it."""
        of = [self.low if level < 0.5 else self.high if level > 0.5 else self.value for level in LEVELS]
        return np.stack([np.quantile(values, level, axis=0) for values, level in zip(of, LEVELS, strict=True)])

    def of_groups(self, groups: Mapping[str, list[int]]) -> IntervalSamples:
        """Means over groups (:func:`group_means`); errors of a group's targets are taken to go together."""
        return IntervalSamples(*(group_means(x, groups) for x in (self.value, self.low, self.high)))

    def above(self, limit: float) -> FloatArray:
        """Shares of arms (3, ...) above ``limit``: whatever their numerics, as they are, as numerics may make them."""
        return np.stack([(x > limit).mean(axis=0) for x in (self.low, self.value, self.high)])

    def judged(self, point: FloatArray) -> tuple[BoolArray, BoolArray]:
        """True where ``point`` (...) lies in the arms' band of 5-95 %, and true where that is sure.

        Poor numerics do not widen the band. Sure: most other draws of as many arms would say the same, whichever way
        their numerics err.

        An end of the band is known as the binomial law knows a share of n arms, within 1.96 deviations.
        """
        band = quantiles(self.value)
        within = (point >= band[0]) & (point <= band[-1])
        n, tail = len(self.value), LEVELS[0]
        off = 1.96 * np.sqrt(tail * (1 - tail) / n)
        outer = max(tail - off, 0.0)
        widest = point < np.quantile(self.low, outer, axis=0), point > np.quantile(self.high, 1 - outer, axis=0)
        narrow = (point >= np.quantile(self.high, tail + off, axis=0)) & (
            point <= np.quantile(self.low, 1 - tail - off, axis=0)
        )
        return np.asarray(within), np.asarray(np.where(within, narrow, (widest[0] | widest[1]) & (outer > 0)))


def group_columns(
    targets: Sequence[str], thesis_grid: bool = True, counted: Collection[str] | None = None
) -> dict[str, list[int]]:
    """Columns of the thesis' middle, edges and corners among ``targets``; all targets as one group on other grids,
    whatever their names. Only those ``counted`` are in any, but where none is."""
    kept = [i for i, t in enumerate(targets) if counted is None or t in counted] or list(range(len(targets)))
    found = {label: [i for i in kept if targets[i] in members] for label, members in GROUPS}
    stray = set(targets) - {t for _, members in GROUPS for t in members}
    if stray or not thesis_grid:
        return {"All": kept}
    return {g: c for g, c in found.items() if c}


def group_means(values: FloatArray, groups: Mapping[str, list[int]]) -> FloatArray:
    """S (n, n_method, n_group): of each draw the mean over the columns of each of the ``groups``, as in Table I."""
    return np.stack([values[..., c].mean(axis=-1) for c in groups.values()], axis=-1)


def winners(values: FloatArray) -> FloatArray:
    """Share of draws (n_method, n_target) in which each method has the largest S there; ties are halved."""
    best = values == values.max(axis=1, keepdims=True)
    return np.asarray((best / best.sum(axis=1, keepdims=True)).mean(axis=0))


def rank_correlations(drivers: FloatArray, values: FloatArray) -> FloatArray:
    """Spearman's correlation (n_driver, ...) of ``drivers`` (n, n_driver) with ``values`` (n, ...); NaN where a column
    does not vary."""
    x, y = (_standard(rankdata(a.reshape(len(a), -1), axis=0)) for a in (drivers, values))
    return np.asarray((x.T @ y / len(x)).reshape(drivers.shape[1], *values.shape[1:]))


def _standard(ranks: FloatArray) -> FloatArray:
    centred = ranks - ranks.mean(axis=0)
    size = centred.std(axis=0)
    return np.asarray(np.divide(centred, size, out=np.full(centred.shape, np.nan), where=size > 0))


def sobol_indices(drivers: FloatArray, names: Sequence[str], values: FloatArray) -> FloatArray:
    """First-order Sobol' indices (n_driver, ...) of log ``values`` (n, ...), from these very draws (RBD-FAST, SALib).

    The share of the variance that goes when the driver is known. Drivers that are correlated share theirs, so that the
    indices may sum to more than 1. NaN for drivers that do not vary, and for fewer than 100 draws; small ones scatter
    by about 5 / n_draw. Raises MissingExtra without SALib.
    """
    out = np.full((len(names), *values.shape[1:]), np.nan)
    moving = np.flatnonzero(np.ptp(drivers, axis=0) > 0)
    if len(values) < _LEAST_SOBOL or not len(moving):
        return out
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of its own imports
            from SALib.analyze import rbd_fast
    except ImportError:
        raise MissingExtra("SALib", "prediction", "Sobol' indices") from None
    x = drivers[:, moving]
    problem = {"num_vars": len(moving), "names": [names[int(i)] for i in moving],
               "bounds": [[float(c.min()), float(c.max())] for c in x.T]}  # fmt: skip
    for at in np.ndindex(*values.shape[1:]):
        y = np.log(values[(slice(None), *at)])
        if np.ptp(y) > 0:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = rbd_fast.analyze(problem, x, y, num_resamples=2, seed=0)
            out[(moving, *at)] = np.clip(np.asarray(found["S1"], dtype=float), 0, 1)
    return out


def group_deviations(values: FloatArray, groups: Mapping[str, list[int]]) -> FloatArray:
    """Standard deviation (n, n_method, n_group) of S over the targets of each group, with n - 1; NaN of one."""
    one = np.full(values.shape[:-1], np.nan)
    found = [values[..., c].std(axis=-1, ddof=1) if len(c) > 1 else one for c in groups.values()]
    return np.stack(found, axis=-1)


def log_score(values: FloatArray, point: FloatArray) -> float:
    """Logarithm of the density at ``point`` (m,) of the normal law that logarithms of draws ``values`` (n, m) have.

    A proper score in nats: bands that miss lose, and so do bands that are wide. NaN where a joint distance is."""
    if len(values) < _DRAWS_AN_ENTRY * values.shape[1]:
        return float("nan")
    logs = np.log(values)
    law = multivariate_normal(logs.mean(axis=0), np.cov(logs.T), allow_singular=True)
    return float(law.logpdf(np.log(point)))


def joint_distance(values: FloatArray, point: FloatArray) -> tuple[float, float]:
    """Distance of ``point`` (m,) from draws ``values`` (n, m): Mahalanobis' of logarithms, over its median among the
    draws, and the share of draws further out.

    NaN for fewer than 5 m draws: they do not tell how entries go together, and a point off their span would count
    as near.
    """
    if len(values) < _DRAWS_AN_ENTRY * values.shape[1]:
        return float("nan"), float("nan")
    logs, at = np.log(values), np.log(point)
    centre = logs.mean(axis=0)
    inverse = np.linalg.pinv(np.cov(logs.T))

    def distance(rows: FloatArray) -> FloatArray:
        """Mahalanobis' distance (n,) of ``rows`` from the centre."""
        d = rows - centre
        return np.asarray(np.sqrt(np.einsum("ni,ij,nj->n", d, inverse, d)))

    own, there = distance(logs), float(distance(at[None])[0])
    return there / float(np.median(own)), float(np.mean(own > there))


# A prediction in numbers: ``prediction.json``, which reports and tables of the same scene quote.

FOLDER, FILE = "prediction", "prediction.json"
READING = "played"  # what a builder asks for; "reported" is what Table I is compared with


def summary(prediction: Prediction, sobol: bool = True) -> dict[str, Any]:
    """A prediction in plain numbers; quantiles are at ``levels``. NaN becomes None.

    ``failed`` says of how many arms there is no S, and why; ``numerics`` are e_band of the arms' G and what it leaves
    their S, as a factor to either side.
    """
    draws, nominal, asked = prediction.draws, prediction.nominal, prediction.question
    played, reported, record = (draws.enclosed(name) for name in ("played", "reported", "played, record"))
    groups = draws.groups
    grouped = played.of_groups(groups)
    return {
        "program": __version__, "scenario": asked.scenario.model_dump(mode="json"), "question": asked.digest,
        "seed": asked.seed, "laws": list(asked.laws), "held": list(prediction.held), "model": prediction.model,
        "left_out": prediction.left_out,
        "kept_tissues": list(kept_tissues(asked.scenario)),
        "draws": len(grouped.value),
        "failed": dict(draws.problems),
        "numerics": {
            "median": float(np.median(draws.numerics)), "largest": float(draws.numerics.max()),
            "factor": float(np.exp(np.median(draws.spread))), "largest factor": float(np.exp(draws.spread.max())),
        },
        "shorter_waves": shorter_waves(prediction),
        "unknown": prediction.unknown,
        "levels": list(LEVELS),
        "reading": READING,
        "methods": list(draws.methods),
        "targets": list(draws.targets),
        "groups": {g: [draws.targets[i] for i in c] for g, c in groups.items()},
        "by_target": _table(draws.methods, draws.targets, {
            "value": _aligned(nominal.value, prediction), "low": _aligned(nominal.low, prediction),
            "high": _aligned(nominal.high, prediction), **_spread(played), "reported": reported.quantiles(),
            "record": record.quantiles(), "wins": winners(played.value),
        }),
        "by_group": _table(draws.methods, tuple(groups), {
            **_spread(grouped), "reported": reported.of_groups(groups).quantiles(),
            "record": record.of_groups(groups).quantiles(), "wins": winners(grouped.value),
        }),
        "drivers": _drivers(draws, grouped.value, sobol),
        "seconds_per_draw": float(np.median(draws.seconds)),
    }  # fmt: skip


def shorter_waves(prediction: Prediction) -> dict[str, float] | None:
    """Of arms on a mesh: the ``share`` whose shear waves at 150 Hz are shorter in some tissue than the scene's own, for
    which the mesh was made, and the ``factor`` that one in twenty exceeds; None where arms have no mesh."""
    question, draws = prediction.question, prediction.draws
    if question.scenario.engine != "fem" or question.layered:
        return None
    own = {f"{n} stiffness": abs(complex(t.modulus.at(2 * np.pi * REFERENCE)))
           for n, t in resolve_tissues(question.scenario).items()}  # fmt: skip
    columns = [(draws.drivers[:, k], own[n]) for k, n in enumerate(draws.names) if n in own]
    if not columns:
        return None
    factor = np.sqrt(np.max([scene / drawn for drawn, scene in columns], axis=0))
    return {"share": float((factor > 1).mean()), "factor": float(np.quantile(factor, LEVELS[-1]))}


def _spread(arms: IntervalSamples) -> dict[str, FloatArray]:
    """Bands with what the arms' own numerics leave them and ``bare``, without; shares of arms with S above 1."""
    sure, shown, possible = arms.above(1.0)
    return {"arms": arms.quantiles(), "bare": quantiles(arms.value), "above_one": shown,
            "above_one_range": np.stack([sure, possible])}  # fmt: skip


def _drivers(draws: Draws, means: FloatArray, sobol: bool) -> list[dict[str, Any]]:
    """Influence of each input on the groups' ``means`` (n, n_method, n_group) of S."""
    found = {"rank": rank_correlations(draws.drivers, means)}
    if sobol:
        found["sobol"] = sobol_indices(draws.drivers, draws.names, means)
    return [
        {"name": name, **{what: _table(draws.methods, tuple(draws.groups), {"": values[k]}, flat=True)
                          for what, values in found.items()}}
        for k, name in enumerate(draws.names)
    ]  # fmt: skip


def _aligned(values: FloatArray, prediction: Prediction) -> FloatArray:
    """The scene's own numbers in the order of the draws' methods and targets."""
    nominal, draws = prediction.nominal, prediction.draws
    rows = [nominal.methods.index(m) for m in draws.methods]
    return np.asarray(values[np.ix_(rows, [nominal.targets.index(t) for t in draws.targets])])


def _table(
    methods: tuple[str, ...], columns: tuple[str, ...], parts: Mapping[str, FloatArray], flat: bool = False
) -> dict[str, Any]:
    """{method: {column: {part: number or list}}}; the last two axes of each part are method and column."""

    def cell(m: int, c: int) -> Any:
        """The parts of one method and column."""
        found = {name: _plain(values[..., m, c]) for name, values in parts.items()}
        return found[""] if flat else found

    return {method: {column: cell(m, c) for c, column in enumerate(columns)} for m, method in enumerate(methods)}


def _plain(values: Any) -> Any:
    if np.ndim(values):
        return [_plain(v) for v in values]
    return round(float(values), 6) if np.isfinite(values) else None


def write_summary(folder: str | Path, content: Mapping[str, Any]) -> Path:
    """``prediction.json`` in ``folder``."""
    file = Path(folder) / FILE
    write_json(file, content)
    return file
