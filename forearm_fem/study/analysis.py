"""What answers say: errors (eq. 10 of de Vlam 2022), accuracy and precision, confusion, confidence, tests.

Subjects are participants. Repetitions are averaged within a participant and cell before an analysis of variance: taken
as further subjects they would triple the degrees of freedom (see :mod:`.thesis`).
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
from .comparisons import (
    Correction,
    Friedman,
    MixedModel,
    Normality,
    Pair,
    corrected_p,
    friedman,
    mixed_model,
    pairwise,
    residual_normality,
)

FACTORS = ("location", "method")


@dataclass(frozen=True)
class Ellipse:
    """Answers to one target by one method: ``mean`` (2,) [m] and ``covariance`` (2, 2) [m2] over ``count`` trials.

    The mean tells accuracy, the covariance precision; figure 8 draws it at one standard deviation.
    """

    target: str
    method: str
    mean: FloatArray
    covariance: FloatArray
    count: int


@dataclass(frozen=True)
class Tests:
    """Two-way analysis of one measure, and what belongs to it.

    ``simple_methods`` are one-way analyses over methods at each target and ``simple_locations`` over targets for each
    method, their ``p_gg`` corrected by the number of such tests (Table II). ``left_out`` are participants without all
    cells: these are in the mixed model only. ``notes`` say which assumptions fail.
    """

    measure: str
    participants: tuple[str, ...]
    left_out: tuple[str, ...]
    effects: tuple[Effect, ...]
    methods: tuple[Pair, ...]
    simple_methods: tuple[tuple[str, Effect, float], ...]
    simple_locations: tuple[tuple[str, Effect, float], ...]
    normality: Normality
    friedman: Friedman | None
    mixed: MixedModel | None
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


def ellipses(table: pd.DataFrame) -> tuple[Ellipse, ...]:
    """Mean and covariance of the answers to each target by each method; the covariance is NaN for one trial, and both
    without any."""
    found = []
    for (target, method), rows in table.groupby(["target", "method"], sort=True):
        xy = rows[["response_x", "response_y"]].to_numpy(float)
        xy = xy[np.isfinite(xy).all(axis=1)]
        spread = np.cov(xy.T) if len(xy) > 1 else np.full((2, 2), np.nan)
        middle = xy.mean(axis=0) if len(xy) else np.full(2, np.nan)
        found.append(Ellipse(str(target), str(method), middle, spread, len(xy)))
    return tuple(found)


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


def cell_means(table: pd.DataFrame, measure: str) -> tuple[FloatArray, list[str], list[str], list[str]]:
    """Means (n_participant, n_target, n_method) of a measure over repetitions, NaN where a cell has none; and names."""
    means = table.groupby(["participant", "target", "method"])[measure].mean()
    levels = [in_order(table, k) for k in ("participant", "target", "method")]
    index = pd.MultiIndex.from_product(levels, names=["participant", "target", "method"])
    values = means.reindex(index).to_numpy(float).reshape([len(level) for level in levels])
    return values, *levels


def analyse(table: pd.DataFrame, measure: str, *, correction: Correction = "bonferroni", mixed: bool = True) -> Tests:
    """Location x method analysis of ``measure``, complete participants only, with comparisons and checks.

    A factor of one level leaves the simple effects of the other. Raises DataError where fewer than two participants are
    complete.
    """
    values, people, targets, methods = cell_means(table, measure)
    complete = [bool(np.isfinite(cells).all()) for cells in values]
    left_out = tuple(p for p, whole in zip(people, complete, strict=True) if not whole)
    if sum(complete) < 2:
        raise DataError(f"{measure}: {sum(complete)} participant(s) answered every cell; two are needed")
    whole = values[complete]
    effects = repeated_measures(whole, FACTORS) if min(whole.shape[1:]) > 1 else ()
    per_method = whole.mean(axis=1)
    many = len(methods) > 2
    normality = residual_normality(whole)
    each = table[["participant", "target", "method", measure]].rename(columns={"target": "location"})
    varied = [factor for factor in FACTORS if each[factor].nunique() > 1]
    fitted, notes = None, _notes(effects, normality, left_out)
    try:
        if mixed and varied:
            fitted = mixed_model(each.dropna().reset_index(drop=True), measure, varied, "participant")
    except DataError as problem:  # the rest holds all the same
        notes = (*notes, f"{problem}.")
    return Tests(
        measure,
        tuple(p for p, ok in zip(people, complete, strict=True) if ok),
        left_out,
        effects,
        pairwise(per_method, methods, correction) if len(methods) > 1 else (),
        _simple(whole, targets, correction),
        _simple(whole.swapaxes(1, 2), methods, correction),
        normality,
        friedman(per_method) if many else None,
        fitted,
        notes,
    )


def _simple(values: FloatArray, names: Sequence[str], correction: Correction) -> tuple[tuple[str, Effect, float], ...]:
    """One-way analyses of ``values`` (n, k, levels) at each of k ``names``; equal answers throughout are left out."""
    found = []
    for k, name in enumerate(names):
        part = values[:, k]
        if part.shape[1] > 1 and np.ptp(part) > 0:
            found.append((name, repeated_measures(part, ("level",))[0]))
    p = corrected_p(np.array([effect.p_gg for _, effect in found]), correction) if found else np.zeros(0)
    return tuple((name, effect, float(q)) for (name, effect), q in zip(found, p, strict=True))


def _notes(effects: Sequence[Effect], normality: Normality, left_out: Sequence[str]) -> tuple[str, ...]:
    notes = []
    if left_out:
        notes.append(
            f"{len(left_out)} participant(s) lack cells and are in the mixed model only: {', '.join(left_out)}."
        )
    if rough := [e.name for e in effects if e.mauchly_p < 0.05]:
        notes.append(f"Sphericity does not hold for {', '.join(rough)}; read the corrected probabilities.")
    if untested := [e.name for e in effects if not np.isfinite(e.mauchly_p) and e.df > 1]:
        notes.append(
            f"Sphericity cannot be tested for {', '.join(untested)}: there are too few participants, or nothing varies."
        )
    if any(np.isnan(e.hf) for e in effects):
        notes.append("Two participants leave Huynh and Feldt's epsilon unknown, Greenhouse and Geisser's at its least.")
    if still := [e.name for e in effects if np.isnan(e.f)]:
        notes.append(f"Neither {', '.join(still)} nor its error vary: there is no F.")
    if normality.p < 0.05:
        notes.append("Residuals are not normal (Shapiro and Wilk); compare with the rank test.")
    return tuple(notes)


def _natural(text: object) -> tuple[int, str]:
    digits = "".join(c for c in str(text) if c.isdigit())
    return (int(digits) if digits else -1, str(text))
