"""The analysis of a study as one page, with each figure's and table's numbers as CSV beside it."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import pandas as pd

from .. import __version__
from ..errors import DataError
from ..ports import Port
from ..show.page import Block, Page, Section, embedded
from ..store.folder import atomic_path, write_text
from .analysis import Ellipse, Tests, analyse, cells, confusion, ellipses, in_order, with_errors
from .anova import Effect
from .comparisons import Pair
from .figures import plot_areas, plot_confusion, plot_ellipses, plot_outlines, plot_points
from .levels import AUDIBLE
from .plan import MEASURES, Analysis, Study, Task
from .rscript import script
from .store import ANALYSIS

_SELECTION = (
    "Trials with the target inside are selected for larger answers: whoever names k of nine points at random "
    "holds the target in k of nine trials. Compare methods over all trials."
)
_SHOWN = {"error": (1e3, " mm"), "precision": (1e3, " mm"), "points": (1.0, ""), "response_area": (1e4, " cm²")}
_SOURCE = f"forearm_fem {__version__}"


@dataclass(frozen=True, eq=False)
class Analysed:
    """A task's analysis: its ``answer``, ``sections`` of the page, ``tables`` and R ``scripts`` by name."""

    answer: list[str]
    sections: list[Section]
    tables: dict[str, pd.DataFrame]
    scripts: dict[str, str]


def write_analysis(
    study: Study, answers: dict[str, pd.DataFrame], grid: Sequence[Port], folder: Path,
    *, devices: Sequence[Mapping[str, str]] | None = None,
) -> Path:  # fmt: skip
    """``analysis/report.html`` with its CSVs and R scripts in ``folder``; ``answers`` are tables by task.

    ``devices`` are the rows of ``devices.tsv``; None for answers of other programs. Returns the page's path.
    """
    sections = [_level_section(answers), _plan_section(study, answers)]
    answer = [p for p in sections[0].paragraphs if sections[0].warn]
    tables: dict[str, pd.DataFrame] = {}
    scripts: dict[str, str] = {}
    for task in study.tasks:
        if task.name not in answers:
            sections.append(Section(task.name, task.name, paragraphs=["Nobody has answered this task yet."]))
            continue
        done = _places(answers[task.name], task, study, grid)
        sections += done.sections
        answer += done.answer
        tables |= done.tables
        scripts |= done.scripts
    if devices is not None:
        sections.append(_device_section(devices, answers))
    out = folder / ANALYSIS
    earlier = (file for t in study.tasks for kind in ("csv", "png", "R") for file in out.glob(f"{t.name}-*.{kind}"))
    for file in (out / "report.html", *earlier):  # of other answers, as far as these have no such table or picture
        file.unlink(missing_ok=True)
    for name, table in tables.items():
        write_text(out / f"{name}.csv", table.to_csv(index=False))
    for name, text in scripts.items():
        write_text(out / f"{name}.R", text)
    for picture in (p for s in sections for p in s.pictures):
        with atomic_path(out / f"{picture.name}.png") as target:
            target.write_bytes(base64.b64decode(picture.data))
    people = sorted({p for t in answers.values() for p in t["participant"]})
    lead = f"{len(people)} participant(s); subjects are participants, repetitions are averaged within their cells."
    write_text(out / "report.html", Page(f"Study {study.name}", answer, sections, _SOURCE, lead).html())
    return out / "report.html"


def _plan_section(study: Study, answers: Mapping[str, pd.DataFrame]) -> Section:
    """How answers are tested, and since when that has been fixed."""
    plan = study.analysis
    first = min((str(d) for t in answers.values() if "date" in t for d in t["date"].dropna()), default="")
    since = f", fixed in study.json before the first answer ({first})" if first else ""
    said = f"Plan {plan.digest}{since}: {plan.sphericity}, {plan.correction} within each table, alpha {plan.alpha:g}. "
    said += f"Tasks are in {study.order.tasks} order, methods {study.order.methods}."
    return Section("plan", "Plan of the analysis", paragraphs=[said])


def _level_section(answers: Mapping[str, pd.DataFrame]) -> Section:
    """How strong methods were at the target, and a warning where they differ by more than 1 dB."""
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
    head = ["method", "mean [dB]", "least", "largest"]
    note = "Weighted level at the target, re 1 um rms at 220 Hz, by each participant's G."
    return Section("levels", "Levels", Block(head, rows, note), paragraphs=[said], warn=bool(apart.max() > AUDIBLE))


def _device_section(devices: Sequence[Mapping[str, str]], answers: Mapping[str, pd.DataFrame]) -> Section:
    """What played, and what is known of its latency and level; sittings without a record are unknown."""
    told = {(d["participant_id"].removeprefix("sub-"), d["task"], d["session"]) for d in devices}
    sittings = {
        (str(p), task, f"{s:g}")
        for task, table in answers.items()
        for p, s in table[["participant", "session"]].drop_duplicates().itertuples(index=False)
    }
    kinds: dict[tuple[str, ...], int] = {}
    for d in devices:
        gain = "unknown" if d["gain"] == "n/a" else d["gain"]
        late = "unknown" if d["latency"] == "n/a" else f"{1e3 * float(d['latency']):.3g} ms"
        key = (d["device"], late, d["latency_basis"], gain, d["level_basis"])
        kinds[key] = kinds.get(key, 0) + 1
    if lost := len(sittings - told):
        kinds[("unknown",) * 5] = lost
    rows = [[device, str(n), latency, how, gain, level] for (device, latency, how, gain, level), n in kinds.items()]
    head = ["device", "sittings", "latency, out and in", "how", "gain of a cable [V/V]", "level"]
    note = "Response times run from the end of the stimulus as it was sent; a latency that is unknown is in them."
    return Section("devices", "What played", Block(head, rows, note))


def _places(table: pd.DataFrame, task: Task, study: Study, grid: Sequence[Port]) -> Analysed:
    main, name, answer = with_errors(table, grid), task.name, task.answer
    found = ellipses(main)
    names = [p.name for p in grid]
    shares = {m: confusion(main, names, m) for m in in_order(main, "method")}
    pictures = [
        (plot_ellipses(found, grid), "ellipses", "Answers to each target: means and ellipses of one standard deviation "
         "over all trials, dotted about participants' own means, the target a star (figure 8 of the thesis)"),
    ]  # fmt: skip
    said = list[str]()
    if answer != "drawing" and bool(main["points"].notna().any()):
        pictures.append((plot_confusion(shares, names), "confusion", "Which points were answered to which target"))
        if answer == "several points":
            pictures.append((plot_points(main), "points", "Points chosen (figure 9 of the thesis)"))
            said = [_SELECTION]
    if answer == "drawing":
        pictures.append((plot_areas(main), "areas", "Areas drawn, as figure 9 for points"))
        pictures.append((plot_outlines(main, grid), "outlines", "Where outlines lie"))
        said = [_SELECTION]
    kept = [embedded(figure, title, _SOURCE, f"{name}-{what}") for figure, what, title in pictures]
    sections = [Section(name, f"Task {name}", _counts(main), pictures=kept, paragraphs=said)]
    each = (*found, *ellipses(main, by_participant=True))
    tables = {f"{name}-trials": main, f"{name}-ellipses": pd.DataFrame([_drawn(e) for e in each])}
    scripts, answer_said = dict[str, str](), list[str]()
    for measure in study.measures(task):
        words = MEASURES[measure]
        if measure in main and main[measure].isna().all():
            continue
        try:
            tests = analyse(main, measure, study.analysis)
        except DataError as problem:
            sections.append(Section(f"{name}-{measure}", f"{name}: {words}", paragraphs=[f"Not analysed: {problem}."]))
            continue
        sections += _test_sections(name, words, tests, study.analysis)
        answer_said.append(_verdict(name, measure, tests, study.analysis))
        tables |= _test_tables(f"{name}-{measure}", tests, study.analysis)
        tables[f"{name}-{measure}-cells"] = _cell_table(main, measure, tests.participants)
        if tests.effects:
            scripts[f"{name}-{measure}"] = script(f"{name}-{measure}", f"{name}-trials", measure, study.analysis)
    return Analysed(answer_said, sections, tables, scripts)


def _verdict(name: str, measure: str, tests: Tests, plan: Analysis) -> str:
    """Which methods differ, over all targets."""
    found = [p for p in tests.methods if p.p < plan.alpha]
    unit, word = _SHOWN[measure]
    said = [
        f"{p.first} − {p.second} = {unit * p.difference:.3g}{word} ({unit * p.low:.3g} to {unit * p.high:.3g}{word}, "
        f"p {_p(p.p)})"
        for p in found
    ]
    none = "no two methods differ" if tests.methods else "there is one method"
    return f"{name}, {measure}: {'; '.join(said) or none}, {len(tests.participants)} participants."




def _drawn(e: Ellipse) -> dict[str, object]:
    row = {"participant": e.participant or "all", "target": e.target, "method": e.method, "trials": e.count}
    spreads = {"": e.covariance} if e.within is None else {"": e.covariance, "within_": e.within}
    parts = {"mean_x_m": e.mean[0], "mean_y_m": e.mean[1]}
    for what, c in spreads.items():
        parts |= {f"{what}var_x_m2": c[0, 0], f"{what}var_y_m2": c[1, 1], f"{what}cov_xy_m2": c[0, 1]}
    return {**row, **parts}


def _cell_table(main: pd.DataFrame, measure: str, people: Sequence[str]) -> pd.DataFrame:
    """The cells that were tested, one a line."""
    values, everyone, targets, methods = cells(main, measure)
    rows = [
        {"participant": p, "location": t, "method": m, "value": values[i, j, k]}
        for i, p in enumerate(everyone) if p in people
        for j, t in enumerate(targets) for k, m in enumerate(methods)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def _counts(main: pd.DataFrame) -> Block:
    rows = []
    for method, part in main.groupby("method", sort=False):
        rows.append([str(method), str(len(part)), _told(1e3 * part["error"].mean(), "{:.1f} mm"),
                     _told(100 * part["inside"].mean(), "{:.0f} %"), _told(part["points"].mean(), "{:.2f}"),
                     _told(part["response_time"].median(), "{:.1f} s"), str(int(part["late"].sum()))])  # fmt: skip
    head = ["method", "trials", "mean error", "target among the answer", "points chosen", "median time", "late"]
    silent = int((main["inside"].isna() & main["error"].isna()).sum())
    note = f" Of these, {silent} have no answer and are in no mean." if silent else ""
    return Block(head, rows, f"Main trials; training is left out.{note}")


def _told(value: float, words: str) -> str:
    return "unknown" if pd.isna(value) else words.format(value)


def _f(effect: Effect, plan: Analysis) -> str:
    df, df_error, _ = effect.corrected(plan.sphericity)
    return f"F({df:.2f}, {df_error:.1f}) = {effect.f:.3f}"


def _test_sections(name: str, words: str, tests: Tests, plan: Analysis) -> list[Section]:
    effects = [
        [e.name, _f(e, plan), _p(e.corrected(plan.sphericity)[2]), f"{e.gg:.3f}", f"{e.partial_eta2:.3f}",
         f"{e.generalised_eta2:.3f}"]
        for e in tests.effects
    ]  # fmt: skip
    head = ["effect", f"F ({plan.sphericity})", "p", "epsilon (GG)", "partial eta²", "generalised eta²"]
    anova = Block(head, effects, f"{len(tests.participants)} participants with all cells. " + " ".join(tests.notes))
    sections = [Section(f"{name}-anova-{tests.measure}", f"{name}: {words}, repeated measures", anova)]
    if not effects:
        sections[0].paragraphs.append("With one method or one target alone there is no two-way analysis.")
    unit, word = _SHOWN[tests.measure]
    average = [[m.level, f"{unit * m.mean:.4g}{word}", f"{unit * m.low:.4g} to {unit * m.high:.4g}{word}"]
               for m in tests.means]  # fmt: skip
    block = Block(["method", "mean", "95 % interval over participants"], average)
    sections.append(Section(f"{name}-means-{tests.measure}", f"{name}: {words}, means", block))
    for pairs, where in ((tests.methods, "pairs of methods"), (tests.at_targets, "pairs of methods at each target")):
        if pairs:
            anchor = f"{name}-{'at-targets' if pairs[0].where else 'pairs'}-{tests.measure}"
            sections.append(Section(anchor, f"{name}: {words}, {where}", _pair_block(pairs, plan, tests.measure)))
    if tests.simple:
        simple = [[label, _f(e, plan), _p(p)] for label, e, p in tests.simple]
        block = Block(["effect", f"F ({plan.sphericity})", f"p ({plan.correction})"], simple)
        sections.append(Section(f"{name}-simple-{tests.measure}", f"{name}: {words}, simple effects (Table II)", block))
    if tests.friedman is not None:
        f = tests.friedman
        said = f"Friedman's rank test of the methods: chi²({f.df}) = {f.statistic:.2f}, p {_p(f.p)}, "
        sections[0].paragraphs.append(said + f"W = {f.kendall_w:.2f}.")
    return sections


def _pair_block(pairs: Sequence[Pair], plan: Analysis, measure: str) -> Block:
    unit, word = _SHOWN[measure]
    rows = [
        [*([p.where] if p.where else []), f"{p.first} − {p.second}", f"{unit * p.difference:.4g}{word}",
         f"{unit * p.low:.4g} to {unit * p.high:.4g}{word}", f"t({p.df}) = {p.t:.2f}", _p(p.p), f"{p.d_z:.2f}"]
        for p in pairs
    ]  # fmt: skip
    head = ["pair", "difference", f"{100 * (1 - plan.alpha):g} % interval", "paired test", f"p ({plan.correction})",
            "d_z"]  # fmt: skip
    note = f"Intervals hold all {len(pairs)} differences at once (Bonferroni), and are wider than Holm's tests."
    return Block([*(["target"] if pairs[0].where else []), *head], rows, note)


def _test_tables(name: str, tests: Tests, plan: Analysis) -> dict[str, pd.DataFrame]:
    def row(label: str, e: Effect) -> dict[str, object]:
        """An effect with its corrected degrees of freedom."""
        df, df_error, p = e.corrected(plan.sphericity)
        return {"effect": label, "F": e.f, "df": df, "df_error": df_error, "p": p, "epsilon_gg": e.gg,
                "partial_eta2": e.partial_eta2, "generalised_eta2": e.generalised_eta2}  # fmt: skip

    tables = {
        f"{name}-anova": pd.DataFrame([row(e.name, e) for e in tests.effects]),
        f"{name}-means": pd.DataFrame([asdict(m) for m in tests.means]),
        f"{name}-pairs": pd.DataFrame([asdict(p) for p in (*tests.methods, *tests.at_targets)]),
        f"{name}-simple": pd.DataFrame([{**row(label, e), "p_corrected": p} for label, e, p in tests.simple]),
    }
    return {name: table for name, table in tables.items() if not table.empty}


def _p(value: float) -> str:
    if value != value:
        return "unknown"
    return "< 0.001" if value < 1e-3 else f"{value:.3f}"
