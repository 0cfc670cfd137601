"""Figures and report of a prediction over arms, and the page of its validation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from ..metrics.strength import numerics_words
from ..store.folder import write_text
from ..usercode import is_code
from .answer import track_record
from .page import Block, Page, Section, as_csv, embedded
from .style import GREY, INK, SIGNED, Drawn, letter, method_look, panels, styled

# Figures of a prediction: bands of S over arms, which method wins, and what drives S.

_TICKS = (0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7, 10, 15, 20, 30)
_DENSE = 60.0  # largest over smallest S from which labels would overlap
_MOST = 14  # drivers shown


def bands_table(data: Mapping[str, Any]) -> pd.DataFrame:
    """One line per method and target: S of the scene, its numerical interval, quantiles over arms, shares.

    Quantiles hold each arm's own numerics but in S_bare; so do the shares that are surely or possibly above 1.
    """
    lines = []
    for m in data["methods"]:
        for t in data["targets"]:
            cell = data["by_target"][m][t]
            line = {"method": m, "target": t, **{f"S_{k}": cell[k] for k in ("value", "low", "high")}}
            line |= {k: cell[k] for k in ("above_one", "wins")}
            line |= dict(zip(("surely_above_one", "possibly_above_one"), cell["above_one_range"], strict=True))
            for what in ("arms", "bare", "reported", "record"):
                line |= {f"S_{what}_{100 * q:g}": s for q, s in zip(data["levels"], cell[what], strict=True)}
            lines.append(line)
    return pd.DataFrame(lines)


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


@styled
def plot_bands(data: Mapping[str, Any]) -> Figure:
    """S at every target: bars span 5-95 % (thin) and 25-75 % (thick) of arms, the line is the median, the cross the
    scene itself with its numerical interval."""
    methods, targets = data["methods"], data["targets"]
    figure = panels((6.6, 1.0 + 1.35 * len(methods)))
    axes = np.atleast_1d(figure.subplots(len(methods), 1, sharex=True, sharey=True))
    for m, (axes_m, method) in enumerate(zip(axes, methods, strict=True)):
        colour = method_look(method, methods).colour
        for t, target in enumerate(targets):
            cell = data["by_target"][method][target]
            q5, q25, q50, q75, q95 = cell["arms"]
            axes_m.plot([t, t], [q5, q95], color=colour, lw=1, solid_capstyle="butt")
            axes_m.plot([t, t], [q25, q75], color=colour, lw=5, alpha=0.55, solid_capstyle="butt")
            axes_m.plot([t - 0.14, t + 0.14], [q50, q50], color=colour, lw=1.4)
            if (value := cell["value"]) is not None:
                known = cell["low"] is not None and cell["high"] is not None
                error = [[max(value - cell["low"], 0)], [max(cell["high"] - value, 0)]] if known else None
                axes_m.errorbar(t + 0.26, value, error, fmt="x", ms=4, color=INK, lw=0.8, capsize=1.5)
        axes_m.axhline(1, color=GREY, lw=0.8, ls="--")
        letter(axes_m, f"{'abcdef'[m % 6]}  {method}")
        axes_m.set(yscale="log", ylabel="S [-]")
    low, high = axes[0].get_ylim()
    fine = [t for t in _TICKS if low <= t <= high]
    ticks = fine if high / low < _DENSE else [t for t in np.logspace(-4, 6, 11) if low <= t <= high]
    axes[0].set_yticks(ticks, [f"{t:g}" for t in ticks])
    for each in axes:
        each.minorticks_off()
    axes[-1].set_xticks(range(len(targets)), targets)
    axes[-1].set_xlabel(f"target; {data['draws']} arms, {data['model']}")
    return figure


@styled
def plot_wins(data: Mapping[str, Any]) -> Figure:
    """Share of arms in which each method has the largest S at a target."""
    methods, targets = data["methods"], data["targets"]
    figure = panels((5.2, 2.4))
    axes = figure.subplots()
    below = np.zeros(len(targets))
    for method in methods:
        share = np.array([100 * data["by_target"][method][t]["wins"] for t in targets])
        colour, _, hatch = method_look(method, methods)
        axes.bar(targets, share, 0.7, below, color=colour, hatch=hatch, edgecolor="w", lw=0.5, label=method)
        below += share
    axes.set(xlabel="target", ylabel="arms in which it wins [%]", ylim=(0, 100))
    axes.legend(ncols=len(methods), loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def drivers_table(data: Mapping[str, Any]) -> pd.DataFrame:
    """One line per driver, method and group: rank correlation and first-order Sobol' index."""
    return pd.DataFrame(
        {"driver": d["name"], "method": m, "group": g,
         **{what: _number(d[what][m][g]) for what in ("rank", "sobol") if what in d}}
        for d in data["drivers"] for m in data["methods"] for g in data["groups"]
    )  # fmt: skip


@styled
def plot_drivers(data: Mapping[str, Any]) -> Figure:
    """Rank correlation of the strongest drivers with S of each method and group."""
    columns = [(m, g) for m in data["methods"] for g in data["groups"]]
    values = np.array([[_number(d["rank"][m][g]) for m, g in columns] for d in data["drivers"]])
    strongest = np.argsort(-np.nanmax(np.abs(np.nan_to_num(values)), axis=1))[:_MOST]
    figure = panels((1.9 + 0.42 * len(columns), 1.4 + 0.21 * len(strongest)))
    axes = figure.subplots()
    shown = axes.imshow(values[strongest], cmap=SIGNED, vmin=-1, vmax=1, aspect="auto")
    axes.set_yticks(range(len(strongest)), [data["drivers"][int(k)]["name"] for k in strongest])
    axes.set_xticks(range(len(columns)), [f"{m}, {g.partition(' ')[0].lower()}" for m, g in columns], rotation=60,
                    ha="right", rotation_mode="anchor")  # fmt: skip
    for row, k in enumerate(strongest):
        for column, value in enumerate(values[k]):
            if np.isfinite(value) and abs(value) >= 0.2:
                axes.annotate(f"{value:.1f}", (column, row), ha="center", va="center", fontsize=5.5,
                              color="w" if abs(value) > 0.6 else INK)  # fmt: skip
    axes.tick_params(length=0)
    axes.grid(False)
    figure.colorbar(shown, ax=axes, label="rank correlation with S", shrink=0.8)
    return figure


# The report of a prediction: what S people will see, with the band over arms apart from the error of the numerics.

_STRONG = 0.2  # rank correlation that is named
_WIDE = 1.1  # factor of S, by errors of the arms' own G, from which on the report says what to do


def write_prediction(folder: str | Path, data: Mapping[str, Any]) -> tuple[Path, Path]:
    """``prediction.html`` (self-contained) and ``prediction.md`` of ``data``, and ``figures/`` with their numbers.

    ``data`` is what :func:`forearm_fem.questions.predict.statistics.summary` makes. Returns the paths of the two.
    """
    out = Path(folder)
    stamp = f"scene {data['scenario']['name']} · {data['draws']} arms, {data['model']} · forearm_fem {data['program']}"
    pictures = {name: embedded(draw(data), title, stamp, name) for name, (title, draw) in _FIGURES.items()}
    for name, table in (("bands", bands_table), ("drivers", drivers_table)):
        write_text(out / "figures" / f"{name}.csv", as_csv(table(data), stamp))
    title, lead = f"Prediction for scene {data['scenario']['name']}", lead_of(data)
    wins = [
        [group, *(f"{data['by_group'][m][group]['wins']:.0%}" for m in data["methods"])] for group in data["groups"]
    ]
    note = "Share of arms in which the method's mean S there is the largest."
    won = Block(["place", *data["methods"]], wins, note)
    sections = [
        Section("strength", "S at each target", _targets(data), pictures=[pictures["bands"]]),
        Section("groups", "Middle, edges and corners" if "All" not in data["groups"] else "Mean S", _groups(data)),
        Section("methods", "Which method wins", won, pictures=[pictures["methods"]]),
        Section("drivers", "What drives S", _drivers(data), pictures=[pictures["drivers"]]),
        Section("numerics", "How wrong the numerics may be", paragraphs=[_numerics(data)]),
        Section("scope", "What is in the band, and what is not", bullets=_scope(data)),
    ]
    return Page(title, [lead, track_record().sentence], sections, stamp).save(out, "prediction")


_FIGURES: Mapping[str, tuple[str, Callable[[Mapping[str, Any]], Drawn]]] = {
    "bands": ("S over arms: 5-95 % thin, 25-75 % thick, median; the cross is the scene itself", plot_bands),
    "methods": ("Which method has the largest S", plot_wins),
    "drivers": ("What drives S: rank correlation over the arms", plot_drivers),
}


def lead_of(data: Mapping[str, Any]) -> str:
    """The finding in words: how wide arms spread each method, and which wins."""
    group = next(iter(data["groups"]))
    parts = []
    for method in data["methods"]:
        low, high = data["by_group"][method][group]["arms"][0], data["by_group"][method][group]["arms"][-1]
        parts.append(f"{method} {low:.2g} to {high:.2g}")
    lost = sum(data["failed"].values())
    missing = f" {lost} arm{'' if lost == 1 else 's'} more without S left out (see below)." if lost else ""
    return (f"Nine in ten of {data['draws']} arms have, at {group}, on the skin: {', '.join(parts)}. Errors of each "
            f"arm's own G are in these bands; those of the scene's S are stated apart.{missing}")  # fmt: skip


def strength_words(cell: Mapping[str, Any]) -> str:
    """E.g. ``1.31 (numerics 1.30-1.32, arms 0.70-1.80)``: the scene's S, its numerical interval, 5-95 % of arms."""
    low, high = cell.get("low"), cell.get("high")
    numerics = numerics_words(math.nan if low is None else low, math.nan if high is None else high)
    value = "unknown" if cell.get("value") is None else f"{cell['value']:.2f}"
    return f"{value} (numerics {numerics}, arms {cell['arms'][0]:.2f}-{cell['arms'][-1]:.2f})"


def _targets(data: Mapping[str, Any]) -> Block:
    rows = [[t, *(strength_words(data["by_target"][m][t]) for m in data["methods"])] for t in data["targets"]]
    note = ("S of the scene itself, the interval of its numerics, and 5-95 % over arms and measurements, as played on "
            "the skin by drives that were designed on the G that the rig measured; errors of each arm's own G "
            "included. The two spreads are of different things and are never added.")  # fmt: skip
    return Block(["target", *data["methods"]], rows, note)


def _groups(data: Mapping[str, Any]) -> Block:
    rows = []
    for group in data["groups"]:
        for method in data["methods"]:
            cell = data["by_group"][method][group]
            low, high = (f"{share:.0%}" for share in cell["above_one_range"])
            above = f"{cell['above_one']:.0%}" + ("" if low == high else f" ({low[:-1]}-{high})")  # e.g. 88% (75-92%)
            rows.append([group, method, *(f"{x:.2f}" for x in cell["arms"]), f"{cell['reported'][0]:.2f}-"
                         f"{cell['reported'][-1]:.2f}", f"{cell['record'][0]:.2f}-{cell['record'][-1]:.2f}",
                         f"{cell['bare'][0]:.2f}-{cell['bare'][-1]:.2f}", above])  # fmt: skip
    levels = [f"{100 * x:g} %" for x in data["levels"]]
    header = [
        "place",
        "method",
        *levels,
        "as the rig reports, 5-95 %",
        "over the record, 5-95 %",
        "without errors of the arms' G, 5-95 %",
        "S > 1",
    ]
    note = ("Quantiles over arms of the group's mean S as played on the skin: below the median of the low ends, above "
            "it of the high ends that errors of each arm's own G leave its S, so that they widen a band and never "
            "narrow it. S > 1, in brackets: of how many arms that is sure, and of how many possible. As the rig "
            "reports: the same drives on the G that was measured, with its noise, its gains and the places that the "
            "laser met; compare measurements with this. Over the record: as the thesis may have summed.")  # fmt: skip
    return Block(header, rows, note)


def _drivers(data: Mapping[str, Any]) -> Block:
    rows = []
    for group in data["groups"]:
        for method in data["methods"]:
            ranked = sorted(data["drivers"], key=lambda d: -abs(d["rank"][method][group] or 0.0))
            named = [d for d in ranked if abs(d["rank"][method][group] or 0.0) >= _STRONG][:4]
            told = ", ".join(f"{d['name']} {d['rank'][method][group]:+.2f}{_share(d, method, group)}" for d in named)
            rows.append([group, method, told or "none above 0.2"])
    note = ("Spearman's rank correlation with the group's S; in brackets, from 100 arms on, the first-order Sobol' "
            "index, the share of the variance of log S that the driver explains alone. Laws count in alphabetical "
            f"order. With {data['draws']} arms correlations within "
            f"{2 / max(data['draws'] - 1, 1) ** 0.5:.2f} may be chance.")  # fmt: skip
    return Block(["place", "method", "strongest drivers"], rows, note)


def _share(driver: Mapping[str, Any], method: str, group: str) -> str:
    share = driver.get("sobol", {}).get(method, {}).get(group)
    return "" if share is None else f" ({share:.0%})"


def _numerics(data: Mapping[str, Any]) -> str:
    told, lost = data["numerics"], sum(data["failed"].values())
    parts = [
        "The scene's own interval stands in the first table and is in no band over arms. G of each arm has an error of "
        f"its own, what mesh or series may miss for its waves included: e_band {told['median']:.1e} in the median, "
        f"{told['largest']:.1e} at most. It leaves S of an arm a factor of {told['factor']:.2f} to either side in the "
        f"median, {told['largest factor']:.2f} at most, and that is in the bands."
    ]
    if told["factor"] > _WIDE:
        free = " ".join(f"--hold {g}" for g in ("thickness", "contact", "placement") if g not in data["held"])
        hold = f"hold what you know ({free}), or " if free else ""
        parts.append(f"This widens the bands much: {hold}ask for a finer mesh (lower accuracy or mesh sizes), or draw "
                     "the arms on the layered model (--layered).")  # fmt: skip
    if (mesh := data["shorter_waves"]) is not None and mesh["share"]:
        parts.append(f"The mesh was made for the scene's own tissue: {mesh['share']:.0%} of the arms have shorter "
                     f"waves in some tissue, one in twenty by a factor of {mesh['factor']:.2g} or more.")  # fmt: skip
    if data["unknown"]:
        parts.append(f"But {data['unknown']}, and in no band.")
    if lost:
        parts.append(f"Of {data['draws'] + lost} arms {lost} are left out, for the reasons below.")
    return " ".join(parts)


def _scope(data: Mapping[str, Any]) -> list[str]:
    named = [law.rpartition(":")[2] if is_code(law) else law for law in data["laws"]]  # a class by its own name
    laws = f"Law{'s' if len(named) > 1 else ''} of the tissues{', equally likely' if len(named) > 1 else ''}: "
    laws += f"{', '.join(named)}."
    if "tissue" in data["held"]:
        laws = "Tissues and their laws: the scene's own in every arm."
    elif kept := data.get("kept_tissues"):
        laws += f" As the scene has them in every arm: {', '.join(kept)}, for only skin, fat and muscle are drawn."
    lines = [f"Model of the arms: {data['model']}; {data['left_out']}.",
             f"{laws} Inputs, spreads and sources: questions/predict/priors.toml and "
             "tissue_laws.json in the package; none was fitted to the thesis' Table I."]  # fmt: skip
    if data["held"]:
        lines.append(f"Held at the scene's own values: {', '.join(data['held'])}.")
    lines += [f"Left out, {count} of {data['draws'] + sum(data['failed'].values())} arms: {problem}"
              for problem, count in data["failed"].items()]  # fmt: skip
    return lines

_NAMES = {"all": "all laws", "kelvin-voigt": "Kelvin-Voigt", "zener": "standard linear solid", "springpot": "springpot"}
_READINGS = {"window": "over the wavelet's window", "record": "over the whole record"}


def validation_page(data: Mapping[str, Any], scene: str = "thesis") -> Page:
    """The page of what :func:`forearm_fem.questions.predict.validate.validate` found: where it fails first."""
    compared = list(_compared(data))
    inside = sum(t["all"]["inside"] for t in compared)
    measured = _measured(data)
    sections = [
        Section("fails", "Where it fails",
                Block(["outside the band", "measured", "arms, 5-95 %"], _rows(failures(data)))),
        Section("inside", "How many findings lie inside",
                Block(["findings", "inside the band"], _rows(coverage(data)))),
        *([measured] if measured else []),
        Section("next", "What to do next", commands=[
            ("See S of your device on people", f"forearm-fem predict {scene} --set engine=layered"),
            ("Judge a measured G of your own", f"forearm-fem validate {scene} --set engine=layered --measured G.nc"),
        ]),
        Section("purpose", "What it is for", Block(["question", "answer"], _rows(_PURPOSE)),
                ["In the spirit of ASME V&V 40 and the ten rules of credible practice."], folded=True),
        _published(data),
        *_table_one(data),
        _shah(data["shah"]),
        Section("scope", "What is covered, and what is not", bullets=[f"Model: {data['left_out']}.", *_SCOPE],
                folded=True),
    ]  # fmt: skip
    title = f"Validation: {inside} of {len(compared)} published findings lie in the band over arms"
    stamp = f"{data['draws']} arms, seed {data['seed']}, {data['model']} · forearm_fem {data['program']}"
    return Page(title, joint_words(data), sections, stamp)


def _rows(found: Iterable[Sequence[str]]) -> list[list[str]]:
    return [list(row) for row in found]


_PURPOSE = (
    (
        "question of interest",
        "Will four voice coils on a forearm make one of nine points move more than the others, and by which method?",
    ),
    (
        "context of use",
        "Choosing among devices and methods before hardware exists, by an engineer who will measure G before anything "
        "is worn.",
    ),
    (
        "what hangs on it",
        "A wrong choice costs a prototype; nobody is harmed. The band decides nothing about one person: measure G for "
        "that.",
    ),
    (
        "verification",
        "Numerics against closed forms and independent codes: `forearm-fem verify`.",
    ),
    (
        "inputs",
        "Spreads and sources of every input: priors.toml and tissue_laws.json in the package, physics data in the "
        "manual.",
    ),
    ("validation", "This page: relaxed forearms, 50-500 Hz, normal motion."),
    (
        "open to others",
        "One command makes this page from the package alone; seed and draws are kept in `draws.nc`.",
    ),
)
_SCOPE = (
    "Covered: relaxed volar forearms of adults, small motions (linear), normal motion, 10-500 Hz.",
    "Not covered: tense muscle, motion along the skin, wet or taped skin, thresholds of perception.",
    "Applicability: appendix A and Table I are the same device on one participant each; Zhang, Sueda, Sofia and Shah "
    "are other devices on other people, and test the tissue rather than S.",
    "No public G of a forearm with actuators on the skin was found; the next one is the best test there can be.",
)


def verdict(judged: Mapping[str, Any]) -> str:
    """E.g. ``yes`` or ``no, just``."""
    return ("yes" if judged["inside"] else "no") + ("" if judged["sure"] else ", just")


def failures(data: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Findings outside the band: name, measured value, value of the arms."""
    rows = [
        (f"Table I, S {words}: {e['method']} at {_short(e['group'])}", f"{e['measured']:.2f}",
         f"{e['low']:.2f}-{e['high']:.2f}{'' if e['sure'] else ' (just)'}")
        for reading, words in _READINGS.items()
        for e in data["table_one"][reading]["all"]["entries"]
        if not e["inside"]
    ]  # fmt: skip
    outside = (t for t in _compared(data) if not t["all"]["inside"])
    return rows + [
        (f"{t['name']}: {t['what']}{_note(t)}", _measured_cell(t),
         _cell(t, "all") + ("" if t["all"]["sure"] else " (just)"))
        for t in outside
    ]  # fmt: skip


def joint_words(data: Mapping[str, Any]) -> list[str]:
    """Number of Table I's entries outside, their joint distance, and the one that no law explains."""
    lines = []
    if other := data.get("other_device"):
        verb = "is" if len(other) == 1 else "are"
        lines.append(f"The scene's {', '.join(other)} {verb} not the thesis': Table I is of another device or stimulus "
                     "and judges these arms less.")  # fmt: skip
    for reading, words in _READINGS.items():
        every = data["table_one"][reading]["all"]
        out = sum(not e["inside"] for e in every["entries"])
        jointly = "Too few arms to say how far the nine lie jointly." if every["distance"] is None else (
            f"Jointly {_share_of_arms(every['beyond'])} of the arms lie as far from the middle as the thesis' nine do "
            f"({every['distance']:.1f} times the median distance)."
        )  # fmt: skip
        lines.append(f"Table I, S {words}: {out} of 9 entries lie outside. {jointly}")
    if (found := data["measured"]) is not None:
        lines.append(f"The measured G of {found['name']}: {9 - found['inside']} of 9 entries lie outside.")
    hit: dict[str, bool] = {}  # whether some law and reading has an entry in its band
    for of_law in (f for reading in data["table_one"].values() for f in reading.values()):
        for e in of_law["entries"]:
            key = f"{e['method']} at {_short(e['group'])}"
            hit[key] = hit.get(key, False) or e["inside"]
    never, laws = [key for key, ever in hit.items() if not ever], any(len(f) > 1 for f in data["table_one"].values())
    whose = "In no law's band, whichever the reading" if laws else "In the band of all arms in neither reading"
    lines.append(f"{whose}: {', '.join(never)}." if never else
                 f"Every entry of Table I lies in the band of some {'law and ' if laws else ''}reading.")  # fmt: skip
    return lines


def coverage(data: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Number of findings inside: those that made no prior, those that did, and by source."""
    compared = list(_compared(data))
    groups = {
        "that made no prior": [t for t in compared if not t["fitted"]],
        "that the laws were fitted to": [t for t in compared if t["fitted"]],
        **{g: [t for t in compared if t["group"] == g] for g in dict.fromkeys(t["group"] for t in compared)},
    }
    return [(name, f"{sum(t['all']['inside'] for t in found)} of {len(found)}") for name, found in groups.items()]


def _compared(data: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    return [t for t in data["targets"] if t["kind"] != "not comparable" and t["all"] is not None]


def _short(group: str) -> str:
    return group.partition(" ")[0].lower()


def _share_of_arms(share: float) -> str:
    return "none" if share == 0 else f"{share:.0%}" if share >= 0.01 else "fewer than 1%"


def _note(target: Mapping[str, Any]) -> str:
    return f" ({target['note']})" if target["note"] else ""


def _measured_cell(target: Mapping[str, Any]) -> str:
    if target["kind"] == "not comparable":
        return "not seen"
    return "shown" if target["kind"] == "trend" else f"{target['measured']:g}{target['spread']} {target['unit']}"


def _cell(target: Mapping[str, Any], which: str) -> str:
    band = target.get(which)
    if target["kind"] == "not comparable":
        return "–"
    if band is None:
        return "too few arms"
    if target["kind"] == "trend":
        return f"{band['share']:.0%} of arms"
    return f"{band['low']:.3g}-{band['high']:.3g}"


def _published(data: Mapping[str, Any]) -> Section:
    header = ["finding", "measured", *_NAMES.values(), "half width, x/÷", "inside", "source"]
    rows = []
    for t in data["targets"]:
        told = "not comparable" if t["kind"] == "not comparable" or t["all"] is None else (
            verdict(t["all"]) + (", fitted" if t["fitted"] else ""))  # fmt: skip
        width = (t.get("all") or {}).get("width")
        rows.append(
            [f"{t['name']}: {t['what']}{_note(t)}", _measured_cell(t), *(_cell(t, k) for k in _NAMES),
             "–" if width is None else f"{width:.2f}", told, t["source"]]
        )  # fmt: skip
    note = (
        "Band: 5-95 % over arms. Half width: half of the band in the logarithm; a wide band says little. A trend is "
        "inside where 5 % of the arms or more show it. Just: other draws of as many arms may say otherwise. Fitted "
        "findings made the tissue laws and are no test of them. Priors and laws were committed before any of these "
        f"comparisons was run. Numerics: {data['numerics']['observables']:.0e} of the largest displacement."
    )
    return Section("published", "Published measurements", Block(header, rows, note), folded=True)


def _table_one(data: Mapping[str, Any]) -> list[Section]:
    """Table I by both readings, since the thesis does not state the time that S is summed over."""
    lost = sum(data["failed"].values())
    left_out = f" {lost} of {data['draws']} arms gave no S and are left out: {'; '.join(data['failed'])}."
    note = (
        "One participant, on the G that was measured: judged by S as the rig of each arm reports it, one sweep an "
        "entry. Deviations are over the four edges, and the four corners. The log score is the logarithm of the arms' "
        "density at the nine means: bands that are wide for no reason lose by it. Bands are of the arms as they are, "
        "so that poor numerics widen none. Just: other draws of as many arms, or the numerics, may say otherwise. "
        "Numerics of the arms' G: e_band "
        f"{data['numerics']['S']:.0e} in the median, {data['numerics']['largest']:.0e} at most. It leaves S a factor "
        f"of {data['numerics']['factor']:.3f} in the median.{left_out if lost else ''}"
    )
    sections = []
    for reading, words in _READINGS.items():
        found = data["table_one"][reading]
        header = ["place", "method", "thesis", *(f"{_NAMES[k]}, 5-95 %" for k in found), "inside"]
        rows = []
        for k, entry in enumerate(found["all"]["entries"]):
            bands = [found[law]["entries"][k] for law in found]
            cells = [f"{b['low']:.2f}-{b['high']:.2f}{'' if b['inside'] else ' (out)'}" for b in bands]
            rows.append([entry["group"], entry["method"], f"{entry['measured']:.2f}", *cells, verdict(entry)])
        few = [name for law, name in _NAMES.items() if law not in found]
        missing = f" Too few arms for a band of its own: {', '.join(few)}." if few else ""
        told = [
            f"{_NAMES[k]}: {f['inside']} of 9 inside, {sum(d['inside'] for d in f['deviations'])} of "
            f"{len(f['deviations'])} deviations, {f['draws']} arms, half width x/÷ {f['width']:.2f}"
            + ("" if f["distance"] is None else f", {_share_of_arms(f['beyond'])} of the arms further out, joint "
               f"distance {f['distance']:.1f}, log score {f['score']:.1f}")
            for k, f in found.items()
        ]
        sections.append(Section(f"table-one-{reading}", f"Table I of the thesis, S {words}",
                                Block(header, rows, f"{note}{missing}"), bullets=told, folded=True))  # fmt: skip
    return sections


def _shah(subjects: Sequence[Mapping[str, Any]]) -> Section:
    steps = subjects[0]["frequency"]
    header = ["arm", "girth at the source [cm]", "fat [mm]",
              *(f"{f:g} Hz, {place}" for f in steps for place in ("4 cm", "8 cm"))]  # fmt: skip
    rows = [
        [f"{s['subject']} ({s['sex']})", f"{100 * s['circumference'][0]:.1f}", f"{1e3 * s['fat']:.1f}",
         *(f"{s['low'][k][p]:.2g}-{s['high'][k][p]:.2g}" for k in range(len(steps)) for p in (0, 1))]
        for s in subjects
    ]  # fmt: skip
    note = (
        "Acceleration [g], 5-95 % over arms, of a motor with the amplitude that the paper gives. Fat is from sex and "
        "girth (Maughan 1984); girth, taper and bones themselves are not in the model, which is flat. The paper's own "
        "accelerations were not seen, so that nothing is judged here."
    )
    return Section("shah", "The six arms of Shah et al. 2019", Block(header, rows, note), folded=True)


def _measured(data: Mapping[str, Any]) -> Section | None:
    if (found := data["measured"]) is None:
        return None
    ends = [f" ({e['interval'][0]:.2f}-{e['interval'][1]:.2f})" if e["interval"] else "" for e in found["entries"]]
    rows = [[e["group"], e["method"], f"{e['measured']:.2f}{own}", f"{e['low']:.2f}-{e['high']:.2f}", verdict(e)]
            for e, own in zip(found["entries"], ends, strict=True)]  # fmt: skip
    told = (f"G of {found['name']}, at the places that it declares: one measured elsewhere tests this comparison "
            f"and not the arms. {found['inside']} of {len(rows)} inside.")  # fmt: skip
    if found["distance"] is not None:
        told += (f" {_share_of_arms(found['beyond']).capitalize()} of the arms lie as far out ({found['distance']:.1f} "
                 "times the median distance).")  # fmt: skip
    missed = f" {found['note']}." if found.get("note") else ""
    header = ["place", "method", "this G", "arms, 5-95 %", "inside"]
    return Section("measured", "A measured G through the same comparison", Block(header, rows, f"{told}{missed}"))
