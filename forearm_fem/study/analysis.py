"""Analysis of answers: errors (eq. 10 of de Vlam 2022), accuracy and precision, confusion, confidence, tests.

Subjects are participants. Repetitions are averaged within a participant and cell before an analysis of variance: taken
as further subjects they would triple the degrees of freedom, as in the thesis, where F(6, 360) fits 60 rows and not 20.

By pingouin, which agrees with R's afex and car to 1e-11: F, Greenhouse and Geisser's epsilon, Mauchly's W, partial
eta^2, Friedman's test, corrections for families. By scipy: paired tests and intervals (pingouin's have five digits),
Shapiro and Wilk's test. By the formulas below, as pingouin has them otherwise than R or not together: Mauchly's p,
Huynh and Feldt's epsilon, generalised eta^2.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from ..errors import DataError, optional
from ..ports import Port
from ..typing import FloatArray
from .plan import Analysis

FACTORS = ("location", "method")
_ROUNDING = 1e-12  # of the answers' size: smaller differences are none
_AXES = ["response_x", "response_y"]


@dataclass(frozen=True, eq=False)
class Tests:
    """Analysis of one measure by the plan of the study, a table each; empty ones could not be made.

    ``anova`` are location, method and their interaction; ``simple`` one-way analyses over methods at each target and
    over targets by each method, each of the two a family; ``pairs`` of methods over all targets (``where`` "") and at
    each, each a family; ``normal`` Shapiro and Wilk's test of participants' means by each method, and ``friedman`` the
    rank test of them. ``left_out`` are participants without all cells. ``notes`` say what is not known.
    """

    measure: str
    participants: tuple[str, ...]
    left_out: tuple[str, ...]
    means: pd.DataFrame
    pairs: pd.DataFrame
    normal: pd.DataFrame
    anova: pd.DataFrame = field(default_factory=pd.DataFrame)
    simple: pd.DataFrame = field(default_factory=pd.DataFrame)
    friedman: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def with_errors(table: pd.DataFrame, grid: Sequence[Port]) -> pd.DataFrame:
    """The main trials with ``target_x``, ``target_y`` [m], ``error`` [m] (eq. 10), ``points`` chosen and ``inside``.

    ``table`` has the columns of an events file and ``participant``. ``inside`` tells whether the target is among the
    points chosen. Without an answer, or with its place alone, both are missing, not 0. DataError for a target that is
    no grid point, and without main trials.
    """
    places = {p.name: p.position[:2] for p in grid}
    main = table[table["phase"] == "main"].copy()
    if main.empty:
        raise DataError("there are no trials to analyse: all answers are to training")
    targets = main["target"].astype(str)
    if unknown := sorted(set(targets) - set(places)):
        raise DataError(f"target '{unknown[0]}' is no point of the grid; it has {', '.join(places)}")
    main["target"] = targets
    main["target_x"] = [places[t][0] for t in targets]
    main["target_y"] = [places[t][1] for t in targets]
    main["error"] = np.hypot(main["response_x"] - main["target_x"], main["response_y"] - main["target_y"])
    chosen = main["response"].astype(object).fillna("").astype(str).str.split()
    main["points"] = chosen.str.len().where(chosen.str.len() > 0)
    held = [t in c if c else pd.NA for t, c in zip(targets, chosen, strict=True)]
    main["inside"] = pd.Series(held, index=main.index, dtype="boolean")
    return main


def ellipses(table: pd.DataFrame) -> pd.DataFrame:
    """Mean [m] and covariance [m2] of answers to each target by each method: of "all", and of each participant.

    The mean tells accuracy and the covariance precision; figure 8 draws it at one standard deviation. ``within_`` is
    the covariance about each participant's own mean, pooled. Missing is what too few trials do not tell.
    """
    answered = table[np.isfinite(table[_AXES].to_numpy(float)).all(axis=1)]
    own = answered[_AXES] - answered.groupby(["participant", "target", "method"])[_AXES].transform("mean")
    answered = answered.assign(own_x=own["response_x"], own_y=own["response_y"])
    rows = []
    for who, part in [("all", answered), *answered.groupby("participant")]:
        for (target, method), cell in part.groupby(["target", "method"]):
            x, y = (cell[a].to_numpy(float) for a in _AXES)
            row = {"participant": who, "target": target, "method": method, "trials": len(cell),
                   "mean_x_m": x.mean(), "mean_y_m": y.mean()}  # fmt: skip
            row |= _covariance("", np.array([x - x.mean(), y - y.mean()]), len(cell) - 1)
            if who == "all":
                apart = cell[["own_x", "own_y"]].to_numpy(float).T
                row |= _covariance("within_", apart, len(cell) - cell["participant"].nunique())
            rows.append(row)
    return pd.DataFrame(rows)


def _covariance(what: str, apart: FloatArray, df: int) -> dict[str, float]:
    c = apart @ apart.T / df if df > 0 else np.full((2, 2), np.nan)
    return {f"{what}var_x_m2": c[0, 0], f"{what}var_y_m2": c[1, 1], f"{what}cov_xy_m2": c[0, 1]}


def confusion(table: pd.DataFrame, names: Sequence[str], method: str) -> FloatArray:
    """Share of answers (n_target, n_point) to each target that name each point; k points count 1/k each."""
    counts = np.zeros((len(names), len(names)))
    for target, response in table.loc[table["method"] == method, ["target", "response"]].itertuples(index=False):
        chosen = [n for n in str(response).split() if n in names]
        for name in chosen:
            counts[names.index(target), names.index(name)] += 1 / len(chosen)
    total = counts.sum(axis=1, keepdims=True)
    return np.asarray(np.divide(counts, total, out=np.full_like(counts, np.nan), where=total > 0))


def in_order(table: pd.DataFrame, column: str) -> list[str]:
    """The values of a column, numbers by size: trials come in random order, which no figure may take over."""

    def natural(text: object) -> tuple[int, str]:
        """The number in it, then the text."""
        digits = "".join(c for c in str(text) if c.isdigit())
        return (int(digits) if digits else -1, str(text))

    return sorted(table[column].unique(), key=natural)


def cells(table: pd.DataFrame, measure: str) -> tuple[FloatArray, list[str], list[str], list[str]]:
    """A measure (n_participant, n_target, n_method) of repetitions together, NaN where a cell has too few; and names.

    Means, but for "precision": the root mean square of answers' distances from their own mean [m], of two or more.
    """
    keys = ["participant", "target", "method"]
    if measure == "precision":
        found = np.sqrt(table.groupby(keys)[_AXES].var(ddof=1).sum(axis=1, skipna=False))
    else:
        found = table.groupby(keys)[measure].mean()
    levels = [in_order(table, k) for k in keys]
    index = pd.MultiIndex.from_product(levels, names=keys)
    return found.reindex(index).to_numpy(float).reshape([len(level) for level in levels]), *levels


def analyse(table: pd.DataFrame, measure: str, plan: Analysis | None = None) -> Tests:
    """Location x method analysis of ``measure``, complete participants only, with comparisons.

    A factor of one level leaves the comparisons of the other. DataError where fewer than three participants are
    complete, as two tell nothing of sphericity.
    """
    plan = plan or Analysis()
    values, people, targets, methods = cells(table, measure)
    complete = np.asarray(np.isfinite(values).all(axis=(1, 2)))
    left_out = tuple(p for p, ok in zip(people, complete, strict=True) if not ok)
    if complete.sum() < 3:
        raise DataError(f"{measure}: {complete.sum()} participant(s) answered every cell; three are needed")
    whole, many = values[complete], (len(targets) > 1, len(methods) > 1)
    per_method = whole.mean(axis=1)
    anova = repeated_measures(whole, FACTORS, plan.sphericity) if all(many) and np.ptp(whole) > 0 else pd.DataFrame()
    notes = [f"{len(left_out)} participant(s) lack cells and are left out: {', '.join(left_out)}."] if left_out else []
    if not anova.empty and (still := anova.loc[anova["F"].isna(), "effect"].tolist()):
        notes.append(f"Neither {', '.join(still)} nor its error vary: there is no F.")
    families = [(per_method[:, None], [""])] + ([(whole, targets)] if many[0] else [])
    found = [paired(part, methods, plan, where) for part, where in families] if many[1] else []
    simple = [
        _simple(whole, [f"methods at target {t}" for t in targets], plan) if many[1] else pd.DataFrame(),
        _simple(whole.swapaxes(1, 2), [f"targets by {m}" for m in methods], plan) if many[0] else pd.DataFrame(),
    ]
    return Tests(
        measure, tuple(p for p, ok in zip(people, complete, strict=True) if ok), left_out,
        means(per_method, methods), pd.concat(found, ignore_index=True) if found else pd.DataFrame(),
        _normal(per_method, methods), anova, pd.concat(simple, ignore_index=True),
        friedman(per_method) if len(methods) > 2 else {}, tuple(notes),
    )  # fmt: skip


def repeated_measures(
    values: FloatArray, factors: Sequence[str], sphericity: str = "Greenhouse-Geisser"
) -> pd.DataFrame:
    """Analysis of variance over one or two within-subject ``factors`` of ``values`` (n_subject, levels[, levels]).

    A line per effect: F, degrees of freedom and p corrected by ``sphericity``, both epsilons, Mauchly's test (missing
    with fewer subjects than contrasts), partial and generalised eta^2. Where neither effect nor error vary, F is
    missing.
    """
    index = pd.MultiIndex.from_product([range(k) for k in values.shape], names=["subject", *factors])
    table = pd.Series(values.ravel(), index, name="value").reset_index()
    with warnings.catch_warnings():  # of zeros, below
        warnings.simplefilter("ignore")
        told = _pingouin().rm_anova(table, "value", list(factors), "subject", True, True, "np2")
    told = told[told["Source"] != "Error"].reindex(columns=[*told.columns, *{"W_spher"}.difference(told.columns)])
    n, d = len(values), (told["ddof1"] if "ddof1" in told else told["DF"]).to_numpy(float)
    square = told["SS"].to_numpy(float)
    f, gg = told["F"].to_numpy(float), told["eps"].to_numpy(float)
    flat = values.reshape(n, -1)
    within = flat - flat.mean(axis=1, keepdims=True) - flat.mean(axis=0) + flat.mean()  # all effects' errors
    least = _ROUNDING**2 * float(np.sum(flat**2))
    with np.errstate(all="ignore"):
        error = np.where(f > 0, square * (n - 1) / f, np.sum(within**2))
        f = np.where(error <= least, np.where(square <= least, np.nan, np.inf), f)
        gg = np.where(np.isfinite(f) & np.isfinite(gg), gg, 1.0)
        room = n - 1 - d * gg  # Huynh and Feldt's epsilon grows without bound as that nears 0
        hf = np.where((d > 1) & (room > 0), np.minimum((n * d * gg - 2) / (d * room), 1.0), 1.0)
        epsilon = gg if sphericity == "Greenhouse-Geisser" else hf
        p = stats.f.sf(f, epsilon * d, epsilon * d * (n - 1))
    rest = float(np.sum((flat - flat.mean()) ** 2)) - square.sum()  # subjects' and all errors
    w = np.where((d > 1) & (n > d), told["W_spher"].to_numpy(float), np.nan)
    return pd.DataFrame({
        "effect": told["Source"].str.replace("*", "x").to_numpy(), "F": f, "df": epsilon * d,
        "df_error": epsilon * d * (n - 1), "p": p, "epsilon_gg": gg, "epsilon_hf": hf, "mauchly_w": w,
        "mauchly_p": [_mauchly_p(*k, flat.shape[1], n - 1) for k in zip(w, d, strict=True)],
        "partial_eta2": np.where(np.isnan(f), np.nan, told["np2"].to_numpy(float)),
        "generalised_eta2": square / (square + rest),
    })  # fmt: skip


def _mauchly_p(w: float, d: float, count: int, df: int) -> float:
    """Probability of Mauchly's W of ``d`` contrasts of ``count`` cells, by Box's two terms as R's car has them.

    pingouin counts the levels of the effect alone: p of nine targets by three methods differ by 2 % then.
    """
    if not w > 0:
        return float("nan")
    rho = 1 - (2 * d**2 + d + 2) / (6 * d * df)
    second = (d + 2) * (d - 1) * (d - 2) * (2 * d**3 + 6 * d**2 + 3 * count + 2) / (288 * (df * d * rho) ** 2)
    chi2, free = -df * rho * np.log(w), d * (d + 1) / 2 - 1
    first = stats.chi2.sf(chi2, free)
    return float(first + second * (stats.chi2.sf(chi2, free + 4) - first))


def _pingouin() -> Any:
    return optional("pingouin", "study", "the statistics of a study")


def paired(
    values: FloatArray, levels: Sequence[str], plan: Analysis | None = None, where: Sequence[str] = ("",)
) -> pd.DataFrame:
    """Paired t tests of all levels of ``values`` (n_subject, n_where, n_level) at each ``where``: one family.

    ``low`` and ``high`` hold all differences of the family at once in 1 - alpha of studies or more (Bonferroni); ``p``
    is corrected for the family. ``d_z`` is the mean difference over its standard deviation (Cohen). Where nobody's
    answers differ, t, p and d_z are missing.
    """
    plan = plan or Analysis()
    keys = [(w, i, j) for w in range(values.shape[1]) for i, j in combinations(range(len(levels)), 2)]
    apart = _without_rounding(np.array([values[:, w, i] - values[:, w, j] for w, i, j in keys]).T, np.abs(values).max())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        test = stats.ttest_1samp(apart, 0.0)
        low, high = test.confidence_interval(1 - plan.alpha / len(keys))
        p = _corrected(test.pvalue, plan.correction)
    return pd.DataFrame({
        "where": [where[w] for w, *_ in keys], "first": [levels[i] for _, i, _ in keys],
        "second": [levels[j] for *_, j in keys], "difference": apart.mean(axis=0), "low": low, "high": high,
        "t": test.statistic, "df": len(values) - 1, "p": p, "d_z": test.statistic / np.sqrt(len(values)),
    })  # fmt: skip


def _corrected(p: FloatArray, correction: str) -> FloatArray:
    return np.asarray(_pingouin().multicomp(p, method="holm" if correction == "holm" else "bonf")[1])


def _without_rounding(values: FloatArray, size: float) -> FloatArray:
    """The same on a lattice so fine that only sums in another order tell values apart that fall together on it."""
    step = _ROUNDING * float(size)
    return np.asarray(step * np.rint(values / step)) if step > 0 else values


def friedman(values: FloatArray) -> Mapping[str, float]:
    """Do the columns of ``values`` (n_subject, n_level) differ, by ranks within subjects? Q, ddof1, p_unc, W (Kendall).

    Means of the same answers in another order are ties. NaN where everybody's answers are all tied.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = _pingouin().friedman(pd.DataFrame(_without_rounding(values, np.abs(values).max())))
    return {str(k): float(found[k].iloc[0]) for k in ("Q", "ddof1", "p_unc", "W")}


def means(values: FloatArray, levels: Sequence[str]) -> pd.DataFrame:
    """Mean over subjects of each column of ``values`` (n_subject, n_level) and its 95 % interval (t)."""
    mean = values.mean(axis=0)
    reach = stats.t.isf(0.025, len(values) - 1) * values.std(axis=0, ddof=1) / np.sqrt(len(values))
    return pd.DataFrame({"level": levels, "mean": mean, "low": mean - reach, "high": mean + reach})


def _normal(values: FloatArray, levels: Sequence[str]) -> pd.DataFrame:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = [stats.shapiro(column) for column in values.T]
    return pd.DataFrame({"level": levels, "W": [f.statistic for f in found], "p": [f.pvalue for f in found]})


def _simple(values: FloatArray, names: Sequence[str], plan: Analysis) -> pd.DataFrame:
    """One-way analyses of ``values`` (n, k, levels) at each of k ``names``; equal answers throughout are left out."""
    found = [
        repeated_measures(values[:, k], ("level",), plan.sphericity).assign(effect=name)
        for k, name in enumerate(names) if np.ptp(values[:, k]) > 0
    ]  # fmt: skip
    if not found:
        return pd.DataFrame()
    table = pd.concat(found, ignore_index=True)
    return table.assign(p_corrected=_corrected(table["p"].to_numpy(float), plan.correction))
