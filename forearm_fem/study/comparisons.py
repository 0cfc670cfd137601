"""Comparisons after an analysis of variance: paired tests with intervals, their correction, and a rank test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from scipy import stats

from ..errors import DataError
from ..typing import FloatArray
from .anova import ROUNDING

Correction = Literal["bonferroni", "holm"]


@dataclass(frozen=True)
class Pair:
    """Paired t test of two levels over subjects: ``difference`` first minus second, ``where`` else "".

    ``low`` and ``high`` hold all differences of the family at once in 1 - alpha of studies or more (Bonferroni); ``p``
    is corrected for the family. ``d_z`` is the mean difference over its standard deviation (Cohen). Where nobody's
    answers differ, ``t``, ``p`` and ``d_z`` are NaN.
    """

    where: str
    first: str
    second: str
    difference: float
    low: float
    high: float
    t: float
    df: int
    p: float
    d_z: float


def pairwise(
    values: FloatArray, levels: Sequence[str], correction: Correction = "bonferroni", *, where: Sequence[str] = ("",),
    alpha: float = 0.05,
) -> tuple[Pair, ...]:  # fmt: skip
    """All pairs of the columns of ``values`` (n_subject, n_level), or at each ``where`` (n_subject, n_where, n_level).

    One mean per subject and cell; one family of all tests. Raises DataError for missing values or fewer than two
    subjects or levels.
    """
    cells = np.asarray(values, dtype=float)
    cells = cells[:, None] if cells.ndim == 2 else cells
    if cells.ndim != 3 or min(len(cells), cells.shape[2]) < 2 or not np.all(np.isfinite(cells)):
        raise DataError(f"paired tests need a value of two subjects and levels or more each, got {cells.shape}")
    cells, n = _without_rounding(cells), len(cells)
    keys = [(w, i, j) for w in range(cells.shape[1]) for i, j in combinations(range(cells.shape[2]), 2)]
    apart = np.array([cells[:, w, i] - cells[:, w, j] for w, i, j in keys])
    apart = _without_rounding(apart, float(np.abs(cells).max()))
    mean, spread = apart.mean(axis=1), np.where(np.ptp(apart, axis=1) > 0, apart.std(axis=1, ddof=1), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        d_z = mean / spread
    t = d_z * np.sqrt(n)
    p = corrected_p(2 * stats.t.sf(np.abs(t), n - 1), correction)
    reach = stats.t.isf(alpha / 2 / len(keys), n - 1) * spread / np.sqrt(n)
    return tuple(
        Pair(where[w], levels[i], levels[j], float(mean[k]), float(mean[k] - reach[k]), float(mean[k] + reach[k]),
             float(t[k]), n - 1, float(p[k]), float(d_z[k]))
        for k, (w, i, j) in enumerate(keys)
    )  # fmt: skip


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
class Mean:
    """Mean over subjects of one level and its 95 % interval (t)."""

    level: str
    mean: float
    low: float
    high: float


def means(values: FloatArray, levels: Sequence[str]) -> tuple[Mean, ...]:
    """Mean of each column of ``values`` (n_subject, n_level)."""
    reach = stats.t.isf(0.025, len(values) - 1) * values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return tuple(
        Mean(name, float(m), float(m - r), float(m + r))
        for name, m, r in zip(levels, values.mean(axis=0), reach, strict=True)
    )
