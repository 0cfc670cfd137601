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
from .adaptive import Track
from .analysis import Tests, analyse, confusion, ellipses, in_order, with_errors
from .comparisons import Correction
from .figures import plot_areas, plot_confusion, plot_ellipses, plot_outlines, plot_points
from .plan import Answer, Study
from .store import ANALYSIS
from .thesis import verdicts

_SELECTION = (
    "Trials with the target inside are selected for larger answers: whoever names k of nine points at random "
    "holds the target in k of nine trials. Compare methods over all trials."
)
_SOURCE = f"forearm_fem {__version__}"


@dataclass(frozen=True, eq=False)
class Analysed:
    """A task's analysis: ``sections`` of the page, ``tables`` by file name."""

    sections: list[Section]
    tables: dict[str, pd.DataFrame]


def write_analysis(
    study: Study, answers: dict[str, pd.DataFrame], grid: Sequence[Port], folder: Path,
    *, correction: Correction = "bonferroni", compare_with_thesis: bool = False,
    devices: Sequence[Mapping[str, str]] | None = None,
) -> Path:  # fmt: skip
    """``analysis/report.html`` and its CSVs in ``folder``; ``answers`` are tables by task. Returns the page's path.

    ``devices`` are the rows of ``devices.tsv``; None for somebody else's table.
    """
    sections: list[Section] = []
    tables: dict[str, pd.DataFrame] = {}
    for task in study.tasks:
        if task.name not in answers:
            sections.append(Section(task.name, task.name, paragraphs=["Nobody has answered this task yet."]))
            continue
        done = (
            _detection(answers[task.name], task.name, study)
            if task.adaptive is not None
            else _places(answers[task.name], task.name, grid, correction, task.answer)
        )
        sections += done.sections
        tables |= done.tables
    if devices is not None:
        sections.append(_device_section(devices, answers))
    if compare_with_thesis:
        lines = [v.sentence for v in verdicts()]
        sections.append(Section("thesis", "Do the thesis' own degrees of freedom add up?", bullets=lines))
    out = folder / ANALYSIS
    earlier = (file for t in study.tasks for kind in ("csv", "png") for file in out.glob(f"{t.name}-*.{kind}"))
    for file in (out / "report.html", *earlier):  # of other answers, as far as these have no such table or picture
        file.unlink(missing_ok=True)
    for name, table in tables.items():
        write_text(out / f"{name}.csv", table.to_csv(index=False))
    for picture in (p for s in sections for p in s.pictures):
        with atomic_path(out / f"{picture.name}.png") as target:
            target.write_bytes(base64.b64decode(picture.data))
    people = sorted({p for t in answers.values() for p in t["participant"]})
    lead = f"{len(people)} participant(s); subjects are participants, repetitions are averaged within their cells."
    write_text(out / "report.html", Page(f"Study {study.name}", [], sections, _SOURCE, lead).html())
    return out / "report.html"


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


def _places(table: pd.DataFrame, name: str, grid: Sequence[Port], correction: Correction, answer: Answer) -> Analysed:
    main = with_errors(table, grid)
    found = ellipses(main)
    names = [p.name for p in grid]
    shares = {m: confusion(main, names, m) for m in in_order(main, "method")}
    pictures = [
        (plot_ellipses(found, grid), "ellipses", "Answers to each target: means and ellipses of one standard deviation "
         "over all trials, the target a star (figure 8 of the thesis)"),
    ]  # fmt: skip
    measures, said = {"error": "error of place (eq. 10) [m]"}, list[str]()
    named = answer != "drawing" and bool(main["points"].notna().any())
    if named:
        pictures.append((plot_confusion(shares, names), "confusion", "Which points were answered to which target"))
    if answer == "several points" and named:
        pictures.append((plot_points(main), "points", "Points chosen (figure 9 of the thesis)"))
        measures["points"], said = "points chosen", [_SELECTION]
    if answer == "drawing":
        pictures.append((plot_areas(main), "areas", "Areas drawn, as figure 9 for points"))
        pictures.append((plot_outlines(main, grid), "outlines", "Where outlines lie"))
        measures["response_area"], said = "area drawn [m²]", [_SELECTION]
    kept = [embedded(figure, title, _SOURCE, f"{name}-{what}") for figure, what, title in pictures]
    sections = [Section(name, f"Task {name}", _counts(main), pictures=kept, paragraphs=said)]
    drawn = [
        {"target": e.target, "method": e.method, "mean_x_m": e.mean[0], "mean_y_m": e.mean[1],
         "var_x_m2": e.covariance[0, 0], "var_y_m2": e.covariance[1, 1], "cov_xy_m2": e.covariance[0, 1],
         "trials": e.count} for e in found
    ]  # fmt: skip
    tables = {f"{name}-trials": main, f"{name}-ellipses": pd.DataFrame(drawn)}
    for measure, words in measures.items():
        try:
            tests = analyse(main, measure, correction=correction)
        except DataError as problem:
            sections.append(Section(f"{name}-{measure}", f"{name}: {words}", paragraphs=[f"Not analysed: {problem}."]))
            continue
        sections += _test_sections(name, words, tests, correction)
        tables |= _test_tables(f"{name}-{measure}", tests)
    return Analysed(sections, tables)


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


def _test_sections(name: str, words: str, tests: Tests, correction: Correction) -> list[Section]:
    effects = [
        [e.name, f"F({e.gg * e.df:.2f}, {e.gg * e.df_error:.1f}) = {e.f:.3f}", _p(e.p_gg), _p(e.p_hf), _p(e.p),
         f"{e.gg:.3f}", _p(e.mauchly_p), f"{e.partial_eta2:.3f}", f"{e.generalised_eta2:.3f}"]
        for e in tests.effects
    ]  # fmt: skip
    head = ["effect", "F (Greenhouse-Geisser)", "p (GG)", "p (HF)", "p (uncorrected)", "epsilon", "sphericity p",
            "partial eta²", "generalised eta²"]  # fmt: skip
    anova = Block(head, effects, f"{len(tests.participants)} participants with all cells. " + " ".join(tests.notes))
    pairs = [[f"{p.first} - {p.second}", f"{p.difference:.4g}", f"t({p.df}) = {p.t:.2f}", _p(p.p), f"{p.d_z:.2f}"]
             for p in tests.methods]  # fmt: skip
    simple = [["methods at target " + n, f"{e.f:.2f}", _p(p)] for n, e, p in tests.simple_methods]
    simple += [["targets by " + n, f"{e.f:.2f}", _p(p)] for n, e, p in tests.simple_locations]
    sections = [Section(f"{name}-anova-{tests.measure}", f"{name}: {words}, repeated measures", anova)]
    if not effects:
        sections[0].paragraphs.append("With one method or one target alone there is no two-way analysis.")
    if pairs:
        block = Block(["pair", "difference", "paired test", f"p ({correction})", "d_z"], pairs)
        sections.append(Section(f"{name}-pairs-{tests.measure}", f"{name}: {words}, pairs of methods", block))
    if simple:
        block = Block(["effect", "F", f"p ({correction}, GG)"], simple)
        sections.append(Section(f"{name}-simple-{tests.measure}", f"{name}: {words}, simple effects (Table II)", block))
    if tests.friedman is not None:
        f = tests.friedman
        said = f"Friedman's rank test of the methods: chi²({f.df}) = {f.statistic:.2f}, p {_p(f.p)}, "
        said += f"W = {f.kendall_w:.2f}."
        said += f" Residuals: Shapiro and Wilk's W = {tests.normality.w:.3f}, p {_p(tests.normality.p)}."
        sections[0].paragraphs.append(said)
    if tests.mixed is not None:
        rows = [[n, f"{b:.4g}", f"{s:.2g}", _p(p)] for n, b, s, _, p in tests.mixed.terms]
        m = tests.mixed
        note = f"Random intercepts per participant: sd {m.subject_sd:.3g}, residual {m.residual_sd:.3g}."
        if not tests.mixed.converged:
            note += " The fit did not converge: do not quote it."
        sections.append(
            Section(f"{name}-mixed-{tests.measure}", f"{name}: {words}, mixed model of all trials",
                    Block(["term", "estimate", "standard error", "p"], rows, note))
        )  # fmt: skip
    return sections


def _test_tables(name: str, tests: Tests) -> dict[str, pd.DataFrame]:
    simple = [
        {"effect": n, **asdict(e), "p_corrected": p} for n, e, p in (*tests.simple_methods, *tests.simple_locations)
    ]
    tables = {
        f"{name}-anova": pd.DataFrame([asdict(e) for e in tests.effects]),
        f"{name}-pairs": pd.DataFrame([asdict(p) for p in tests.methods]),
        f"{name}-simple": pd.DataFrame(simple),
    }
    if tests.mixed is not None:
        tables[f"{name}-mixed"] = pd.DataFrame(tests.mixed.terms, columns=["term", "estimate", "se", "z", "p"])
    return {name: table for name, table in tables.items() if not table.empty}


def _detection(table: pd.DataFrame, name: str, study: Study) -> Analysed:
    rows = []
    for participant, part in table.groupby("participant"):
        track = Track.of(study.task(name), part.to_dict("records"))
        assert track is not None
        rows += [{"participant": participant, **asdict(t)} for t in track.thresholds()]
    found, asked = pd.DataFrame(rows), study.task(name).adaptive
    assert asked is not None
    lines = []
    for m, part in found.groupby("method"):
        level, beyond = part["level"], part["beyond"] != ""
        mean, spread = (_told(value, "{:.1f} dB") for value in (level.mean(), level.std(ddof=1)))
        lines.append([str(m), mean, spread, str(int(beyond.sum())), str(int((level.isna() & ~beyond).sum()))])
    what = "threshold" if asked.reference is None else "level of equal strength"
    head = ["method", f"mean {what}", "standard deviation over tracks", "tracks beyond the levels played",
            "tracks too short to tell"]  # fmt: skip
    against = "" if asked.reference is None else f" The reference is {asked.reference} at its own level."
    note = f"Levels are re the stimulus' own; by {asked.rule}.{against} Only tracks that tell are in the mean."
    block = Block(head, lines, note)
    return Analysed([Section(name, f"Task {name}: {what}", block)], {f"{name}-thresholds": found})


def _p(value: float) -> str:
    if value != value:
        return "unknown"
    return "< 0.001" if value < 1e-3 else f"{value:.3f}"
