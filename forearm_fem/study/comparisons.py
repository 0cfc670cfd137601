"""Comparisons after an analysis of variance, its assumptions, and what serves where they fail or cells are missing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy import optimize, stats

from ..errors import DataError, optional
from ..typing import FloatArray
from .anova import ROUNDING

if TYPE_CHECKING:
    import pandas as pd

Correction = Literal["bonferroni", "holm"]
_RATIOS = (-25.0, 20.0)  # logarithms of variances between subjects over within that are looked at


@dataclass(frozen=True)
class Pair:
    """Paired t test of two levels over subjects: ``difference`` first minus second, ``p`` corrected for all pairs.

    ``d_z`` is the mean difference over its standard deviation (Cohen). Where nobody's answers differ, ``t``, ``p`` and
    ``d_z`` are NaN.
    """

    first: str
    second: str
    difference: float
    t: float
    df: int
    p: float
    d_z: float


def pairwise(values: FloatArray, levels: Sequence[str], correction: Correction = "bonferroni") -> tuple[Pair, ...]:
    """All pairs of the columns of ``values`` (n_subject, n_level), one mean per subject and level.

    Raises DataError for missing values or fewer than two subjects or levels.
    """
    cells = np.asarray(values, dtype=float)
    if cells.ndim != 2 or min(cells.shape) < 2 or not np.all(np.isfinite(cells)):
        raise DataError(f"paired tests need a value of two subjects and levels or more each, got {cells.shape}")
    pairs = list(combinations(range(cells.shape[1]), 2))
    cells = _without_rounding(cells)
    apart = _without_rounding(np.array([cells[:, i] - cells[:, j] for i, j in pairs]), np.abs(cells).max())
    spread = np.where(np.ptp(apart, axis=1) > 0, apart.std(axis=1, ddof=1), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        d_z = apart.mean(axis=1) / spread
    t = d_z * np.sqrt(len(cells))
    p = corrected_p(2 * stats.t.sf(np.abs(t), len(cells) - 1), correction)
    return tuple(
        Pair(levels[i], levels[j], float(a.mean()), float(t[k]), len(cells) - 1, float(p[k]), float(d_z[k]))
        for k, ((i, j), a) in enumerate(zip(pairs, apart, strict=True))
    )


def _without_rounding(values: FloatArray, size: float | None = None) -> FloatArray:
    """The same on a lattice so fine that only sums in another order tell values apart that fall together on it."""
    step = ROUNDING * float(np.abs(values).max() if size is None else size)
    return np.asarray(step * np.rint(values / step)) if step > 0 else values


def corrected_p(p: FloatArray, correction: Correction) -> FloatArray:
    """Probabilities (n,) corrected for n tests; NaN (no variation) stays NaN and counts as a test."""
    p = np.asarray(p, dtype=float)
    if correction == "bonferroni":
        return np.minimum(len(p) * p, 1.0)
    order = np.argsort(p)
    stepped = np.maximum.accumulate((len(p) - np.arange(len(p))) * p[order])
    result = np.empty_like(p)
    result[order] = np.minimum(stepped, 1.0)
    return result


@dataclass(frozen=True)
class Friedman:
    """Friedman's rank test over subjects: chi-square, degrees of freedom, p, and Kendall's W as effect size."""

    statistic: float
    df: int
    p: float
    kendall_w: float


def friedman(values: FloatArray) -> Friedman:
    """Do the columns of ``values`` (n_subject, n_level) differ, by ranks within subjects? Needs three levels.

    Means of the same answers in another order are ties. NaN where everybody's answers are all tied.
    """
    if values.shape[1] < 3:
        raise DataError(f"Friedman's test needs three levels or more, got {values.shape[1]}; use a paired test")
    with np.errstate(divide="ignore", invalid="ignore"):
        found = stats.friedmanchisquare(*_without_rounding(values).T)
    n, k = values.shape
    return Friedman(float(found.statistic), k - 1, float(found.pvalue), float(found.statistic) / (n * (k - 1)))


@dataclass(frozen=True)
class Normality:
    """Shapiro and Wilk's test of the residuals of the cell means, subject and cell effects removed; NaN without any."""

    w: float
    p: float


def residual_normality(values: FloatArray) -> Normality:
    """Are residuals of ``values`` (n_subject, ...cells) about subjects and cells normal?"""
    flat = values.reshape(len(values), -1)
    residual = flat - flat.mean(axis=1, keepdims=True) - flat.mean(axis=0) + flat.mean()
    if residual.size < 3 or np.ptp(residual) <= ROUNDING * np.abs(flat).max():
        return Normality(float("nan"), float("nan"))
    found = stats.shapiro(residual.ravel()[:5000])  # its probability is tabulated for no more
    return Normality(float(found.statistic), float(found.pvalue))


@dataclass(frozen=True)
class MixedModel:
    """Linear mixed model value ~ factors with a random intercept per subject, fitted by REML to every trial.

    ``terms`` hold (name, estimate, standard error, z, p) for treatment contrasts against the first levels;
    ``subject_sd`` and ``residual_sd`` are standard deviations. ``converged`` False: do not quote it.
    """

    terms: tuple[tuple[str, float, float, float, float], ...]
    subject_sd: float
    residual_sd: float
    converged: bool


def mixed_model(table: pd.DataFrame, value: str, factors: Sequence[str], subject: str) -> MixedModel:
    """Fit all main effects and interactions of ``factors``; missing trials need no special care.

    MissingExtra without statsmodels (extra "study"), which makes the contrasts; DataError where the model cannot be
    fitted. Its own fit of a random intercept ends in a wrong intercept, or in none, where nothing varies between
    subjects: the one ratio of variances is found here.
    """
    formula = optional("statsmodels.formula.api", "study", "the mixed-effects model", package="statsmodels")
    model = formula.ols(f"{value} ~ " + " * ".join(f"C({f})" for f in factors), table)
    design, values = np.asarray(model.exog, dtype=float), np.asarray(model.endog, dtype=float)
    whose = table[subject].to_numpy()
    parts = [(design[whose == s], values[whose == s]) for s in dict.fromkeys(whose)]
    if len(values) <= design.shape[1] or np.linalg.matrix_rank(design) < design.shape[1]:
        raise DataError(f"the mixed model of {value} cannot be fitted: some of its cells have no answer at all")
    best = optimize.minimize_scalar(
        lambda u: _restricted(parts, math.exp(u))[0], bounds=_RATIOS, method="bounded", options={"xatol": 1e-7}
    )
    ratio = 0.0 if _restricted(parts, 0.0)[0] <= best.fun else math.exp(best.x)
    _, within, estimate, inverse = _restricted(parts, ratio)
    with np.errstate(divide="ignore", invalid="ignore"):  # without any scatter there is no error
        error = np.sqrt(within * np.diag(inverse))
        z = estimate / error
    columns = estimate, error, z, 2 * stats.norm.sf(np.abs(z))
    terms = tuple((n, *(float(c[k]) for c in columns)) for k, n in enumerate(model.exog_names))
    ended = best.x < _RATIOS[1] - 1e-3
    return MixedModel(terms, math.sqrt(ratio * within), math.sqrt(within), bool(best.success and ended))


def _restricted(
    parts: Sequence[tuple[FloatArray, FloatArray]], ratio: float
) -> tuple[float, float, FloatArray, FloatArray]:
    """Minus twice the restricted logarithmic likelihood of a random intercept, but for a constant, where its variance
    is ``ratio`` times that of trials; the latter, the estimates (k,) and the inverse (k, k) of the normal equations.

    ``parts`` are design (n, k) and values (n,) of each subject (Laird and Ware 1982).
    """
    count, k = sum(len(y) for _, y in parts), parts[0][0].shape[1]
    normal, right, square, spread = np.zeros((k, k)), np.zeros(k), 0.0, 0.0
    for design, values in parts:
        share, total, whole = ratio / (1 + ratio * len(values)), design.sum(axis=0), float(values.sum())
        normal += design.T @ design - share * np.outer(total, total)
        right += design.T @ values - share * total * whole
        square += float(values @ values) - share * whole**2
        spread += math.log1p(ratio * len(values))
    estimate = np.linalg.solve(normal, right)
    rest = max(square - float(right @ estimate), np.finfo(float).tiny)
    likelihood = (count - k) * math.log(rest) + spread + float(np.linalg.slogdet(normal)[1])
    return likelihood, rest / (count - k), np.asarray(estimate), np.asarray(np.linalg.inv(normal))
