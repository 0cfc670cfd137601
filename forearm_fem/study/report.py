"""The analysis of a study as one page, and beside it each figure's and table's numbers as CSV and the tests in R."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from scipy.spatial.distance import pdist

from .. import __version__
from ..errors import DataError
from ..ports import Port
from ..show.page import Block, Page, Picture, Section, embedded
from ..show.style import FAINT, INK, letter, method_look, styled
from ..store.folder import atomic_path, write_text
from ..typing import FloatArray
from .analysis import Tests, analyse, cells, confusion, ellipses, in_order, with_errors
from .plan import MEASURES, Analysis, Study, Task
from .stimuli import AUDIBLE
from .store import ANALYSIS

_MM = 1e3


@styled
def plot_ellipses(found: pd.DataFrame, grid: Sequence[Port]) -> Figure:
    """One panel per target: mean answers of all methods with one-standard-deviation ellipses, the target a star.

    ``found`` is the table of :func:`forearm_fem.study.analysis.ellipses`. Filled are ellipses over all answers, dotted
    ones about participants' own means. Points lie as the page shows them: across the limb to the right, along it down.
    """
    found = found[found["participant"] == "all"]
    targets, methods = in_order(found, "target"), in_order(found, "method")
    columns = int(np.ceil(np.sqrt(len(targets))))
    rows = int(np.ceil(len(targets) / columns))
    figure = Figure(figsize=(7.1, 7.1 * rows / columns + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    places = {p.name: _MM * np.array([p.position[1], p.position[0]]) for p in grid}
    xy = np.array(list(places.values()))
    reach = 0.75 * float(pdist(xy).min()) if len(xy) > 1 else 7.5
    for ax, target in zip(axes, targets, strict=False):
        ax.plot(xy[:, 0], xy[:, 1], ".", color=FAINT, ms=4)
        for row in found[found["target"] == target].to_dict("records"):
            colour, marker, _ = method_look(row["method"], methods)
            at = _MM * row["mean_y_m"], _MM * row["mean_x_m"]
            ax.plot(*at, marker, color=colour, ms=4)
            _draw(ax, at, [row[f"{k}_m2"] for k in ("var_y", "cov_xy", "var_x")], facecolor=colour, edgecolor=colour,
                  alpha=0.18)  # fmt: skip
            _draw(ax, at, [row[f"within_{k}_m2"] for k in ("var_y", "cov_xy", "var_x")], fill=False, edgecolor=colour,
                  ls=":")  # fmt: skip
        ax.plot(*places[target], "*", color="#B3261E", ms=9, zorder=5)
        ax.set_aspect("equal")
        letter(ax, target)
    for ax in axes[len(targets) :]:
        ax.set_visible(False)
    axes[0].set_xlim(xy[:, 0].min() - reach, xy[:, 0].max() + reach)
    axes[0].set_ylim(xy[:, 1].max() + reach, xy[:, 1].min() - reach)
    figure.supxlabel("across the limb [mm]")
    figure.supylabel("along the limb [mm]")
    looks = [method_look(m, methods) for m in methods]
    handles = [Line2D([], [], ls="none", marker=look.marker, color=look.colour, ms=5) for look in looks]
    figure.legend(handles, methods, loc="outside upper center", ncols=len(methods))
    return figure


def _draw(ax: Axes, at: tuple[float, float], spread: Sequence[float], **style: object) -> None:
    """The ellipse of one standard deviation of variances and covariance ``spread`` (uu, uv, vv) [m2]."""
    if np.isfinite(spread).all():
        uu, uv, vv = spread
        values, vectors = np.linalg.eigh([[uu, uv], [uv, vv]])
        width, height = 2 * _MM * np.sqrt(np.maximum(values[::-1], 0))
        angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
        ax.add_patch(Ellipse(at, width, height, angle=angle, **style))


@styled
def plot_points(table: pd.DataFrame) -> Figure:
    """Points chosen per trial, participants' means as box plots: all trials, those with the target inside, others."""
    methods = in_order(table, "method")
    figure = Figure(figsize=(7.1, 3.0), layout="constrained")
    held = table["inside"]
    parts = {"all trials": table, "target among the points": table[held.fillna(False)],
             "the other trials": table[~held.fillna(True)]}  # fmt: skip
    for ax, (title, part), sign in zip(figure.subplots(1, 3, sharey=True), parts.items(), "abc", strict=True):
        means = [part[part["method"] == m].groupby("participant")["points"].mean().to_numpy() for m in methods]
        boxes = ax.boxplot([m if len(m) else [np.nan] for m in means], widths=0.5, patch_artist=True, showmeans=True)
        for box, method in zip(boxes["boxes"], methods, strict=True):
            box.set(facecolor=method_look(method, methods).colour, alpha=0.5)
        for line in boxes["medians"]:
            line.set(color=INK)
        ax.set_xticks(range(1, len(methods) + 1), methods)
        ax.set_title(title)
        letter(ax, sign)
        ax.tick_params(axis="x", labelrotation=20)
    figure.axes[0].set_ylabel("points chosen, mean of a participant")
    return figure


@styled
def plot_confusion(shares: dict[str, FloatArray], names: Sequence[str]) -> Figure:
    """Share of answers to each target (row) that name each point (column), one panel per method."""
    figure = Figure(figsize=(7.1, 2.9), layout="constrained")
    axes = figure.subplots(1, len(shares), sharey=True, squeeze=False)[0]
    top = max(0.01, float(np.nanmax(list(shares.values()))))
    for ax, (method, values) in zip(axes, shares.items(), strict=True):
        image = ax.imshow(values, vmin=0, vmax=top, cmap="cividis")
        ax.grid(False)
        ax.set_title(method)
        ax.set_xticks(range(len(names)), names)
        ax.set_yticks(range(len(names)), names)
        ax.set_xlabel("answered")
    axes[0].set_ylabel("target")
    figure.colorbar(image, ax=axes, label="share of answers", shrink=0.8)
    return figure


_SELECTION = (
    "Trials with the target inside are selected for larger answers: whoever names k of nine points at random "
    "holds the target in k of nine trials. Compare methods over all trials."
)
_SHOWN = {"error": (1e3, " mm"), "precision": (1e3, " mm"), "points": (1.0, "")}
_SOURCE = f"forearm_fem {__version__}"


def write_analysis(study: Study, answers: Mapping[str, pd.DataFrame], grid: Sequence[Port], folder: Path) -> Path:
    """``analysis/report.html`` with its CSVs and R scripts in ``folder``; ``answers`` are tables by task."""
    levels = _level_section(answers)
    answer, sections = list(levels.paragraphs if levels.warn else ()), [levels, _plan_section(study, answers)]
    files: dict[str, str] = {}
    for task in study.tasks:
        if task.name in answers:
            said, parts, made = _task(answers[task.name], task, study, grid)
            answer, sections, files = answer + said, sections + parts, files | made
        else:
            sections.append(Section(task.name, task.name, paragraphs=["Nobody has answered this task yet."]))
    sections.append(_device_section(answers))
    out = folder / ANALYSIS
    earlier = (file for t in study.tasks for kind in ("csv", "png", "R") for file in out.glob(f"{t.name}-*.{kind}"))
    for file in (out / "report.html", *earlier):  # of other answers, as far as these have no such table or picture
        file.unlink(missing_ok=True)
    for name, text in files.items():
        write_text(out / name, text)
    for picture in (p for s in sections for p in s.pictures):
        with atomic_path(out / f"{picture.name}.png") as target:
            target.write_bytes(base64.b64decode(picture.data))
    people = {p for t in answers.values() for p in t["participant"]}
    lead = f"{len(people)} participant(s); subjects are participants, repetitions are averaged within their cells."
    write_text(out / "report.html", Page(f"Study {study.name}", answer, sections, _SOURCE, lead).html())
    return out / "report.html"


def _plan_section(study: Study, answers: Mapping[str, pd.DataFrame]) -> Section:
    """Tests of the answers, and since when they have been fixed."""
    plan = study.analysis
    first = min((str(d) for t in answers.values() if "date" in t for d in t["date"].dropna()), default="")
    since = f", fixed in study.json before the first answer ({first})" if first else ""
    said = f"Plan {plan.digest}{since}: {plan.sphericity}, {plan.correction} within each table, alpha {plan.alpha:g}. "
    said += f"Tasks are in {study.order.tasks} order, methods {study.order.methods}."
    return Section("plan", "Plan of the analysis", paragraphs=[said])


def _level_section(answers: Mapping[str, pd.DataFrame]) -> Section:
    """Levels of the methods at the target, and a warning where they differ by more than 1 dB."""
    played = [t[["method", "target", "participant", "weighted_db"]] for t in answers.values() if "weighted_db" in t]
    if not played or (all_played := pd.concat(played).dropna()).empty:
        return Section("levels", "Levels", paragraphs=["How strong stimuli were is unknown."], warn=True)
    each = all_played.groupby(["participant", "target", "method"])["weighted_db"].mean().unstack("method")
    apart = each.max(axis=1) - each.min(axis=1)
    person, target = apart.idxmax()
    said = f"Methods differ by up to {apart.max():.1f} dB at a target (participant {person}, target {target})."
    if apart.max() > AUDIBLE:
        said = f"Methods are not equally strong: {said} What is found of them may come of that alone."
    rows = [[str(m), *(f"{v:.1f}" for v in (each[m].mean(), each[m].min(), each[m].max()))] for m in each]
    note = "Weighted level at the target, re 1 um rms at 220 Hz, by each participant's G."
    block = Block(["method", "mean [dB]", "least", "largest"], rows, note)
    return Section("levels", "Levels", block, paragraphs=[said], warn=bool(apart.max() > AUDIBLE))


def _device_section(answers: Mapping[str, pd.DataFrame]) -> Section:
    """Device that played, its latency and level."""
    keys = ["device", "latency", "cable_gain"]
    played = pd.concat([t.reindex(columns=keys) for t in answers.values()])
    rows = [
        [str(device), str(count), f"{1e3 * latency:.3g} ms" if latency == latency else "unknown",
         f"{gain:.3g}" if gain == gain else "unknown"]
        for (device, latency, gain), count in played.value_counts(keys, dropna=False, sort=False).items()
    ]  # fmt: skip
    note = "Response times run from the end of the stimulus as it was sent; a latency that is unknown is in them."
    block = Block(["device", "answers", "latency, out and in", "gain of a cable [V/V]"], rows, note)
    return Section("devices", "What played", block)


def _task(
    table: pd.DataFrame, task: Task, study: Study, grid: Sequence[Port]
) -> tuple[list[str], list[Section], dict[str, str]]:
    """Results of a task: a sentence a measure, its sections, and its CSVs and R scripts by file name."""
    main, name, plan = with_errors(table, grid), task.name, study.analysis
    found, several = ellipses(main), task.answer == "several points"
    sections = [Section(name, f"Task {name}", _counts(main), pictures=_pictures(main, found, name, several, grid),
                        paragraphs=[_SELECTION] if several else [])]  # fmt: skip
    tables, said, files = {"trials": main, "ellipses": found}, list[str](), dict[str, str]()
    for measure in study.measures(task):
        if measure in main and main[measure].isna().all():
            continue
        try:
            tests = analyse(main, measure, plan)
        except DataError as problem:
            paragraph = f"Not analysed: {problem}."
            sections.append(Section(f"{name}-{measure}", f"{name}: {MEASURES[measure]}", paragraphs=[paragraph]))
            continue
        sections += _test_sections(name, tests, plan)
        said.append(_verdict(name, tests, plan))
        tables |= {f"{measure}-{k}": getattr(tests, k) for k in ("anova", "means", "pairs", "simple", "normal")}
        values, people, targets, methods = cells(main, measure)
        index = pd.MultiIndex.from_product([people, targets, methods], names=["participant", "location", "method"])
        flat = pd.Series(values.ravel(), index, name="value").reset_index()
        tables[f"{measure}-cells"] = flat[flat["participant"].isin(tests.participants)]
        if not tests.anova.empty:
            files[f"{name}-{measure}.R"] = _script(f"{name}-{measure}", f"{name}-trials", measure, plan)
    files |= {f"{name}-{k}.csv": t.to_csv(index=False) for k, t in tables.items() if not t.empty}
    return said, sections, files


def _script(name: str, trials: str, measure: str, plan: Analysis) -> str:
    """An R script that reads the cells of ``name`` and the table ``trials``, and writes its own results beside them."""
    words = {
        "what": name.replace("-", ", "), "name": name, "trials": trials, "measure": measure, "digest": plan.digest,
        "sphericity": plan.sphericity, "short": "GG" if plan.sphericity == "Greenhouse-Geisser" else "HF",
        "correction": plan.correction, "alpha": f"{plan.alpha:g}",
    }  # fmt: skip
    text = resources.files(__package__).joinpath("pages/tests.R.txt").read_text(encoding="utf-8")
    return re.sub("@([a-z]+)@", lambda m: words[m[1]], text)


def _pictures(
    main: pd.DataFrame, found: pd.DataFrame, name: str, several: bool, grid: Sequence[Port]
) -> list[Picture]:
    names = [p.name for p in grid]
    figures = [(plot_ellipses(found, grid), "ellipses", "Answers to each target: means and ellipses of one standard "
                "deviation over all trials, dotted about participants' own means, the target a star (figure 8 of the "
                "thesis)")]  # fmt: skip
    if bool(main["points"].notna().any()):
        shares = {m: confusion(main, names, m) for m in in_order(main, "method")}
        figures.append((plot_confusion(shares, names), "confusion", "Which points were answered to which target"))
        if several:
            figures.append((plot_points(main), "points", "Points chosen (figure 9 of the thesis)"))
    return [embedded(figure, title, _SOURCE, f"{name}-{what}") for figure, what, title in figures]


def _verdict(name: str, tests: Tests, plan: Analysis) -> str:
    """Methods that differ, over all targets."""
    unit, word = _SHOWN[tests.measure]
    found = [p for p in tests.pairs.to_dict("records") if not p["where"] and p["p"] < plan.alpha]
    said = [
        f"{p['first']} − {p['second']} = {unit * p['difference']:.3g}{word} ({unit * p['low']:.3g} to "
        f"{unit * p['high']:.3g}{word}, p {_p(p['p'])})"
        for p in found
    ]
    none = "there is one method" if tests.pairs.empty else "no two methods differ"
    return f"{name}, {tests.measure}: {'; '.join(said) or none}, {len(tests.participants)} participants."


def _counts(main: pd.DataFrame) -> Block:
    def told(value: float, words: str) -> str:
        """A number in ``words``, or that it is not known."""
        return "unknown" if pd.isna(value) else words.format(value)

    rows = [
        [str(method), str(len(part)), told(1e3 * part["error"].mean(), "{:.1f} mm"),
         told(100 * part["inside"].mean(), "{:.0f} %"), told(part["points"].mean(), "{:.2f}"),
         told(part["response_time"].median(), "{:.1f} s")]
        for method, part in main.groupby("method", sort=False)
    ]  # fmt: skip
    head = ["method", "trials", "mean error", "target among the answer", "points chosen", "median time"]
    silent = int((main["inside"].isna() & main["error"].isna()).sum())
    note = f" Of these, {silent} have no answer and are in no mean." if silent else ""
    return Block(head, rows, f"Main trials; training is left out.{note}")


def _test_sections(name: str, tests: Tests, plan: Analysis) -> list[Section]:
    """Tables of one measure: analysis of variance, what it assumes, means, pairs, simple effects."""
    measure, (unit, word), shown = tests.measure, _SHOWN[tests.measure], list[tuple[str, str, Block]]()
    rows = [
        [e["effect"], _f(e), _p(e["p"]), *(f"{e[k]:.3f}" for k in ("epsilon_gg", "partial_eta2", "generalised_eta2"))]
        for e in tests.anova.to_dict("records")
    ]  # fmt: skip
    head = ["effect", f"F ({plan.sphericity})", "p", "epsilon (GG)", "partial eta²", "generalised eta²"]
    note = f"{len(tests.participants)} participants with all cells. " + " ".join(tests.notes)
    note += "" if rows else "With one method or one target alone, or equal answers, there is no two-way analysis."
    if f := tests.friedman:
        note += f" Friedman's rank test of the methods: chi²({f['ddof1']:.0f}) = {f['Q']:.2f}, p {_p(f['p_unc'])}, "
        note += f"W = {f['W']:.2f}."
    shown.append(("anova", "repeated measures", Block(head, rows, note)))
    rows = [[f"Mauchly, {e['effect']}", f"{e['mauchly_w']:.4g}", _p(e["mauchly_p"])]
            for e in tests.anova.to_dict("records") if e["mauchly_w"] == e["mauchly_w"]]  # fmt: skip
    rows += [[f"Shapiro-Wilk, means by {e['level']}", f"{e['W']:.3f}", _p(e["p"])]
             for e in tests.normal.to_dict("records")]  # fmt: skip
    note = "Degrees of freedom are corrected whatever Mauchly's test says; Friedman's test needs no normal answers."
    shown.append(("assumed", "what is assumed", Block(["test", "W", "p"], rows, note)))
    rows = [[m["level"], f"{unit * m['mean']:.4g}{word}", f"{unit * m['low']:.4g} to {unit * m['high']:.4g}{word}"]
            for m in tests.means.to_dict("records")]  # fmt: skip
    shown.append(("means", "means", Block(["method", "mean", "95 % interval over participants"], rows)))
    for at, anchor, where in ((False, "pairs", "pairs of methods"), (True, "at-targets", "pairs at each target")):
        some = [p for p in tests.pairs.to_dict("records") if bool(p["where"]) == at]
        if some:
            shown.append((anchor, where, _pair_block(some, at, measure, plan)))
    if not tests.simple.empty:
        rows = [[e["effect"], _f(e), _p(e["p_corrected"])] for e in tests.simple.to_dict("records")]
        block = Block(["effect", f"F ({plan.sphericity})", f"p ({plan.correction})"], rows)
        shown.append(("simple", "simple effects (Table II)", block))
    return [Section(f"{name}-{a}-{measure}", f"{name}: {MEASURES[measure]}, {t}", b) for a, t, b in shown]


def _pair_block(pairs: Sequence[Mapping[Any, Any]], at: bool, measure: str, plan: Analysis) -> Block:
    unit, word = _SHOWN[measure]
    rows = [
        [*([p["where"]] if at else []), f"{p['first']} − {p['second']}", f"{unit * p['difference']:.4g}{word}",
         f"{unit * p['low']:.4g} to {unit * p['high']:.4g}{word}", f"t({p['df']}) = {p['t']:.2f}", _p(p["p"]),
         f"{p['d_z']:.2f}"]
        for p in pairs
    ]  # fmt: skip
    head = ["pair", "difference", f"{100 * (1 - plan.alpha):g} % interval", "paired test", f"p ({plan.correction})",
            "d_z"]  # fmt: skip
    note = f"Intervals hold all {len(pairs)} differences at once (Bonferroni), and are wider than Holm's tests."
    return Block([*(["target"] if at else []), *head], rows, note)


def _f(effect: Mapping[Any, Any]) -> str:
    return f"F({effect['df']:.2f}, {effect['df_error']:.1f}) = {effect['F']:.3f}"


def _p(value: float) -> str:
    if value != value:
        return "unknown"
    return "< 0.001" if value < 1e-3 else f"{value:.3f}"
