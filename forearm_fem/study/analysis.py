"""What answers say: errors (eq. 10 of de Vlam 2022), accuracy and precision, confusion, confidence, tests.

Subjects are participants. Repetitions are averaged within a participant and cell before an analysis of variance: taken
as further subjects they would triple the degrees of freedom, as in the thesis, where F(6, 360) fits 60 rows and not 20.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.path import Path

from ..errors import DataError
from ..ports import Port
from ..typing import FloatArray
from .anova import Effect, repeated_measures
from .comparisons import Friedman, Mean, Pair, corrected_p, friedman, means, pairwise
from .plan import Analysis

FACTORS = ("location", "method")


@dataclass(frozen=True)
class Ellipse:
    """Answers to one target by one method, of one ``participant`` or of all (""), over ``count`` trials.

    ``mean`` (2,) [m] tells accuracy and ``covariance`` (2, 2) [m2] precision; figure 8 draws it at one standard
    deviation. ``within`` (2, 2) [m2] is the covariance about each participant's own mean, pooled.
    """

    target: str
    method: str
    mean: FloatArray
    covariance: FloatArray
    count: int
    participant: str = ""
    within: FloatArray | None = None


@dataclass(frozen=True)
class Tests:
    """Analysis of one measure by the plan of the study.

    ``simple`` are one-way analyses over methods at each target, and over targets for each method: (label, effect,
    corrected p), each of the two a family. ``methods`` are pairs of methods over all targets, ``at_targets`` at each.
    ``left_out`` are participants without all cells. ``notes`` say what is not known.
    """

    measure: str
    participants: tuple[str, ...]
    left_out: tuple[str, ...]
    effects: tuple[Effect, ...]
    means: tuple[Mean, ...]
    methods: tuple[Pair, ...]
    at_targets: tuple[Pair, ...]
    simple: tuple[tuple[str, Effect, float], ...]
    friedman: Friedman | None
    notes: tuple[str, ...]


def with_errors(table: pd.DataFrame, grid: Sequence[Port]) -> pd.DataFrame:
    """The main trials with ``target_x``, ``target_y`` [m], ``error`` [m] (eq. 10), ``points`` chosen and ``inside``.

    ``table`` has the columns of an events file and ``participant``. ``inside`` tells whether the target is among the
    points chosen, or inside the outline drawn. Without an answer, or with its place alone, both are missing, not 0.
    DataError for a target that is no grid point, and without main trials.
    """
    places = {p.name: p.position[:2] for p in grid}
    main = table[table["phase"] == "main"].copy()
    if main.empty:
        seen = ", ".join(sorted({str(p)[:20] for p in table["phase"]}))
        raise DataError(f"there are no trials to analyse: phase is 'main' in none of them, but {seen}"[:300])
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
    if "response_outline" in main:
        for index, text in main["response_outline"].dropna().items():
            shape = Path(outline(str(text)) / 1e3)
            main.loc[index, "inside"] = shape.contains_point(places[main.loc[index, "target"]])
    return main


def outline(text: str) -> FloatArray:
    """Points (n, 2) [mm] of an outline as an events file keeps it: "x,y x,y ..."; DataError for anything else."""
    try:
        points = np.array([[float(v) for v in pair.split(",")] for pair in text.split()])
    except ValueError:
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1] != 2:
        raise DataError(f"response_outline: expected pairs 'x,y' separated by spaces, got '{text[:40]}'")
    return points


def ellipses(table: pd.DataFrame, *, by_participant: bool = False) -> tuple[Ellipse, ...]:
    """Mean and covariance of the answers to each target by each method; the covariance is NaN for one trial, and both
    without any."""
    found = []
    keys = ["target", "method", *(["participant"] if by_participant else [])]
    for key, rows in table.groupby(keys, sort=True):
        rows = rows[np.isfinite(rows[["response_x", "response_y"]].to_numpy(float)).all(axis=1)]
        xy = rows[["response_x", "response_y"]].to_numpy(float)
        spread = np.cov(xy.T) if len(xy) > 1 else np.full((2, 2), np.nan)
        middle = xy.mean(axis=0) if len(xy) else np.full(2, np.nan)
        found.append(Ellipse(str(key[0]), str(key[1]), middle, spread, len(xy), str(key[2]) if by_participant else "",
                             None if by_participant else _within(rows)))  # fmt: skip
    return tuple(found)


def _within(rows: pd.DataFrame) -> FloatArray:
    """Covariance about participants' own means, NaN where nobody answered twice."""
    if "participant" not in rows:
        return np.full((2, 2), np.nan)
    axes = ["response_x", "response_y"]
    xy = (rows[axes] - rows.groupby("participant")[axes].transform("mean")).to_numpy(float)
    df = len(rows) - rows["participant"].nunique()
    return np.asarray(xy.T @ xy / df) if df > 0 else np.full((2, 2), np.nan)


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
    return sorted(table[column].unique(), key=_natural)


def cells(table: pd.DataFrame, measure: str) -> tuple[FloatArray, list[str], list[str], list[str]]:
    """A measure (n_participant, n_target, n_method) of repetitions together, NaN where a cell has too few; and names.

    Means, but for "precision": the root mean square of answers' distances from their own mean [m], of two or more.
    """
    keys = ["participant", "target", "method"]
    if measure == "precision":
        spread = table.groupby(keys)[["response_x", "response_y"]].var(ddof=1)
        found = np.sqrt(spread.sum(axis=1, skipna=False))
    else:
        found = table.groupby(keys)[measure].mean()
    levels = [in_order(table, k) for k in keys]
    index = pd.MultiIndex.from_product(levels, names=keys)
    values = found.reindex(index).to_numpy(float).reshape([len(level) for level in levels])
    return values, *levels


def analyse(table: pd.DataFrame, measure: str, plan: Analysis | None = None) -> Tests:
    """Location x method analysis of ``measure``, complete participants only, with comparisons.

    A factor of one level leaves the simple effects of the other. Raises DataError where fewer than two participants are
    complete.
    """
    plan = plan or Analysis()
    values, people, targets, methods = cells(table, measure)
    complete = [bool(np.isfinite(own).all()) for own in values]
    left_out = tuple(p for p, whole in zip(people, complete, strict=True) if not whole)
    if sum(complete) < 2:
        raise DataError(f"{measure}: {sum(complete)} participant(s) answered every cell; two are needed")
    whole = values[complete]
    effects = repeated_measures(whole, FACTORS) if min(whole.shape[1:]) > 1 else ()
    per_method, two = whole.mean(axis=1), len(methods) > 1
    return Tests(
        measure, tuple(p for p, ok in zip(people, complete, strict=True) if ok), left_out, effects,
        means(per_method, methods),
        pairwise(per_method, methods, plan.correction, alpha=plan.alpha) if two else (),
        pairwise(whole, methods, plan.correction, where=targets, alpha=plan.alpha) if two and len(targets) > 1 else (),
        _simple(whole, [f"methods at target {t}" for t in targets], plan)
        + _simple(whole.swapaxes(1, 2), [f"targets by {m}" for m in methods], plan),
        friedman(per_method) if len(methods) > 2 else None,
        _notes(effects, left_out),
    )  # fmt: skip


def _simple(values: FloatArray, names: Sequence[str], plan: Analysis) -> tuple[tuple[str, Effect, float], ...]:
    """One-way analyses of ``values`` (n, k, levels) at each of k ``names``; equal answers throughout are left out."""
    found = []
    for k, name in enumerate(names):
        part = values[:, k]
        if part.shape[1] > 1 and np.ptp(part) > 0:
            found.append((name, repeated_measures(part, ("level",))[0]))
    p = np.array([effect.corrected(plan.sphericity)[2] for _, effect in found])
    return tuple(
        (name, effect, float(q)) for (name, effect), q in zip(found, corrected_p(p, plan.correction), strict=True)
    )


def _notes(effects: Sequence[Effect], left_out: Sequence[str]) -> tuple[str, ...]:
    notes = []
    if left_out:
        notes.append(f"{len(left_out)} participant(s) lack cells and are left out: {', '.join(left_out)}.")
    if any(np.isnan(e.hf) for e in effects):
        notes.append("Two participants leave Huynh and Feldt's epsilon unknown, Greenhouse and Geisser's at its least.")
    if still := [e.name for e in effects if np.isnan(e.f)]:
        notes.append(f"Neither {', '.join(still)} nor its error vary: there is no F.")
    return tuple(notes)


def _natural(text: object) -> tuple[int, str]:
    digits = "".join(c for c in str(text) if c.isdigit())
    return (int(digits) if digits else -1, str(text))
