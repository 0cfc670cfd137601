"""How good is it: signal strength beside the thesis' Table I, maps of S, and error estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import FigureBase
from matplotlib.patches import Circle

from ..errors import DataError
from ..metrics import StrengthTable, signal_strength_table, thesis_table
from ..ports import Port, positions
from ..store.text import markdown_table
from ..transfer import ErrorEstimate, size_words
from ..typing import BoolArray, FloatArray
from .data import Results
from .page import Table
from .style import ACTUATORS, GREY, INK, method_colour, panels, single, styled, widen

TABLE_ONE = ("place", "method", "here", "record", "thesis")  # S over the window, over the whole record, and measured


@dataclass(frozen=True, eq=False)
class Strengths:
    """S (n_method, n_target) [-] with the places of targets and actuators.

    ``low`` to ``high`` is the numerical interval, NaN where unknown; ``arms`` is what a prediction says of people (its
    summary, None without one), which is no error of the numerics; ``record`` is S over the whole record, ``window``
    what ``values`` are taken over; ``counted`` (n_target,) leaves out points under or beside a motor.
    """

    methods: tuple[str, ...]
    targets: tuple[str, ...]
    values: FloatArray
    outputs: tuple[Port, ...]
    inputs: tuple[Port, ...]
    low: FloatArray
    high: FloatArray
    record: FloatArray
    window: str
    counted: BoolArray
    arms: Mapping[str, Any] | None = None

    def table(self, values: FloatArray | None = None) -> StrengthTable:
        """``values`` (default: S) of the points that count in the layout of Table I."""
        return signal_strength_table(
            self.methods, self.targets, self.values if values is None else values, self.counted
        )


def strengths(results: Results) -> Strengths:
    """S of a run, from signal_strength.csv."""
    found = {(r.method, r.target): r for r in results.strengths}
    methods, targets = (tuple(dict.fromkeys(key[i] for key in found)) for i in (0, 1))

    def column(name: str) -> FloatArray:
        """One column of the table (n_method, n_target); NaN where it has no line."""
        return np.array([[getattr(found.get((m, t)), name, np.nan) for t in targets] for m in methods], dtype=float)

    by_name = {p.name: p for p in results.transfer.outputs}
    if stray := [t for t in targets if t not in by_name]:
        raise DataError(f"{results.folder}: signal_strength.csv names the target {stray[0]}, which G has not; "
                        "`forearm-fem render` makes it anew")  # fmt: skip
    outputs = tuple(by_name[t] for t in targets)
    return Strengths(
        methods, targets, column("S"), outputs, results.transfer.inputs,
        column("S_low"), column("S_high"), column("S_record"), results.strengths[0].window,
        results.counted(targets), results.prediction,
    )  # fmt: skip


def strengths_table(data: Strengths) -> Table:
    """One line per target, a column per method."""
    places = positions(data.outputs)
    columns: dict[str, Any] = {"target": data.targets, "x_m": places[:, 0], "y_m": places[:, 1]}
    for prefix, values in (("S", data.values), ("S_low", data.low), ("S_high", data.high), ("S_record", data.record)):
        columns |= {f"{prefix}_{m}": s for m, s in zip(data.methods, values, strict=True)}
    return Table({**columns, "window": [data.window] * len(data.targets)})


@styled
def plot_strength_maps(data: Strengths, *, ax: Axes | None = None) -> FigureBase:
    """S at each target seen from above, one map per method; white is 1, points that do not count are grey."""
    width = 2.3
    figure = panels(ax, (width * len(data.methods) + 0.7, width * _aspect(data) + 0.3))
    axes = np.atleast_1d(figure.subplots(1, len(data.methods), sharey=True))
    norm = _norm(data)
    for m, panel in enumerate(axes):
        _map(panel, data, m, norm, ("",) * len(data.targets))
        panel.set_title(data.methods[m])
    bar = figure.colorbar(ScalarMappable(norm, "PuOr_r"), ax=list(axes), shrink=0.9, fraction=0.04)
    ticks = [t for t in (0.125, 0.25, 0.5, 1, 2, 4, 8, 16) if abs(np.log2(t)) <= float(norm.vmax or 0)]
    bar.set_ticks([float(np.log2(t)) for t in ticks], labels=[f"{t:g}" for t in ticks])
    bar.ax.minorticks_off()
    bar.set_label("signal strength S")
    return figure


@styled
def plot_strength_map(
    data: Strengths, method: str, notes: Sequence[str], *, alike: Sequence[Strengths] = (), ax: Axes | None = None
) -> Axes:
    """S of one ``method`` seen from above with a note below each target; ``notes`` (n_target,), e.g. ``±0.12``.

    Its colours are good for ``alike``, whose maps lie beside it, too.
    """
    axes = single(ax, (3.0, 3.0 * _aspect(data)))
    norm = max((_norm(each) for each in (data, *alike)), key=lambda n: float(n.vmax or 0))
    _map(axes, data, data.methods.index(method), norm, notes)
    return axes


def _norm(data: Strengths) -> TwoSlopeNorm:
    """Colours of log2 S, the same to both sides of S = 1, by the points that count."""
    counted = data.values[:, data.counted] if data.counted.any() else data.values
    with np.errstate(divide="ignore"):
        size = np.abs(np.log2(counted))
    spread = float(np.clip(np.max(size[np.isfinite(size)], initial=0.1), 0.1, 5.0))
    return TwoSlopeNorm(0, -spread, spread)


def _extent(data: Strengths) -> tuple[FloatArray, FloatArray, float]:
    """Corners (x, y) [mm] of a map, and the radius [mm] of a point's disc on it."""
    at, coils = 1e3 * positions(data.outputs)[:, :2], 1e3 * positions(data.inputs)[:, :2]
    apart = np.linalg.norm(at[:, None] - at[None], axis=2)
    radius = 0.36 * float(np.min(apart[apart > 0], initial=20.0))
    rims = np.array([1e3 * p.radius for p in data.inputs])[:, None]
    low = np.concatenate([at - radius, coils - rims]).min(axis=0) - (1.0, 6.0)
    high = np.concatenate([at + radius, coils + rims]).max(axis=0) + 1.0
    return low, high, radius


def _aspect(data: Strengths) -> float:
    """Height of a map over its width."""
    low, high, _ = _extent(data)
    wide, tall = high - low
    return float(np.clip(tall / wide, 0.4, 1.5))


def _map(panel: Axes, data: Strengths, m: int, norm: TwoSlopeNorm, notes: Sequence[str]) -> None:
    at, coils, values = 1e3 * positions(data.outputs), 1e3 * positions(data.inputs), data.values[m]
    low, high, radius = _extent(data)
    named = len(at) <= 25  # enough room for numbers
    for place, port in zip(coils, data.inputs, strict=True):
        panel.add_patch(Circle(place[:2], 1e3 * port.radius, facecolor="#EEEEEE", edgecolor=GREY, lw=0.8, zorder=3))
        hidden = np.linalg.norm(at[:, :2] - place[:2], axis=1).min() < radius
        beside = place[0] - max(radius, 1e3 * port.radius) - 0.5 if hidden else place[0]
        panel.annotate(port.name, (beside, place[1]), ha="right" if hidden else "center", va="center", fontsize=6,
                       color=GREY, zorder=6)  # fmt: skip
    for k, (place, value) in enumerate(zip(at, values, strict=True)):
        counts = bool(data.counted[k])
        with np.errstate(divide="ignore"):
            shade = float(np.clip(norm(np.log2(value)), 0, 1)) if np.isfinite(value) else 1.0 if value > 0 else 0.5
        look: dict[str, Any] = {"edgecolor": INK if counts else GREY, "lw": 0.5, "ls": "-" if counts else ":"}
        face = colormaps["PuOr_r"](shade) if counts else "#DDDDDD"
        panel.add_patch(Circle(place[:2], radius, facecolor=face, zorder=4, **look))
        if not named:
            continue
        ink = GREY if not counts else "w" if abs(shade - 0.5) > 0.36 else INK
        panel.annotate(f"{value:.2f}" if value < 10 else f"{value:.3g}", place[:2], ha="center", va="center",
                       fontsize=7.5, color=ink, zorder=5)  # fmt: skip
        below = f"{data.targets[k]} {notes[k] if counts else ''}".rstrip()
        panel.annotate(below, (place[0], place[1] - radius), (0, -1.5), textcoords="offset points", ha="center",
                       va="top", fontsize=6, color="#555555", zorder=5)  # fmt: skip
    panel.plot([low[0], low[0] + 10], [low[1] + 1.5] * 2, color=INK, lw=1.5, solid_capstyle="butt")
    panel.annotate("10 mm", (low[0] + 10, low[1] + 1.5), (3, 0), textcoords="offset points", va="center", fontsize=6)
    panel.annotate("elbow →", (high[0], low[1] + 1.5), ha="right", va="center", fontsize=6, color=GREY)
    panel.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    panel.axis("off")
    widen(panel)


def table_one_rows(data: Strengths) -> list[list[str]]:
    """Rows of Table I: place, method, S over the window, over the whole record, and the thesis'."""
    ours, theirs = data.table(), thesis_table()
    record = data.table(data.record)
    rows = []
    for g, group in enumerate(ours.groups):
        for m, method in enumerate(ours.methods):
            whole = _cell(record.mean[g, m], record.std[g, m]) if np.isfinite(record.mean[g, m]) else "–"
            here = _cell(ours.mean[g, m], ours.std[g, m]) + spreads(data, method, group)
            thesis = "–"
            if group in theirs.groups and method in theirs.methods:
                at = theirs.groups.index(group), theirs.methods.index(method)
                thesis = _cell(theirs.mean[at], theirs.std[at])
            rows.append([group, method, here, whole, thesis])
    return rows


def spreads(data: Strengths, method: str, place: str) -> str:
    """E.g. `` (numerics 1.30-1.32, arms 0.70-1.80)`` for a target or a group of Table I; empty without a prediction."""
    by_group = data.arms is not None and place in data.arms["by_group"].get(method, {})
    known = (data.arms or {}).get("by_group" if by_group else "by_target", {}).get(method, {}).get(place)
    if data.arms is None or known is None:
        return ""
    inside = data.arms["groups"][place] if by_group else [place]
    columns = [i for i, t in enumerate(data.targets) if t in inside and (data.counted[i] or not by_group)]
    low, high = (each[data.methods.index(method), columns].mean() for each in (data.low, data.high))
    numerics = f"{low:.2f}-{high:.2f}" if np.isfinite(low) and np.isfinite(high) else "unknown"
    return f" (numerics {numerics}, arms {known['arms'][0]:.2f}-{known['arms'][-1]:.2f})"


def _cell(mean: float, std: float) -> str:
    return f"{mean:.2f}" if np.isnan(std) else f"{mean:.2f} ± {std:.2f}"


def table_one_markdown(data: Strengths) -> str:
    """Table I, simulated and thesis side by side."""
    return markdown_table(TABLE_ONE, table_one_rows(data))


def table_one_extra(data: Strengths) -> dict[str, str]:
    """The table as Markdown and as LaTeX (``booktabs``) beside the figure."""
    return {"table.md": table_one_markdown(data), "table.tex": table_one_latex(data)}


def table_one_latex(data: Strengths) -> str:
    """Table I as a LaTeX ``tabular`` with the rules of ``booktabs``."""
    rows, shown = table_one_rows(data), ""
    lines = [r"\begin{tabular}{llccc}", r"\toprule", " & ".join(TABLE_ONE) + r" \\", r"\midrule"]
    for place, method, *numbers in rows:
        named = place if place != shown else ""
        shown = place
        cells = (named, method, *(n.replace("±", r"$\pm$").replace("–", "--").replace("%", r"\%") for n in numbers))
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def table_one_csv(data: Strengths) -> Table:
    """Mean and standard deviation, here over the window and over the record, and in the thesis."""
    ours, theirs = data.table(), thesis_table()
    record = data.table(data.record)
    lines = [(g, m) for g in ours.groups for m in ours.methods]
    sides = (("here", ours), ("here_record", record), ("thesis", theirs))
    columns: dict[str, Any] = {f"{prefix}_{what}": [] for prefix, _ in sides for what in ("mean", "std")}
    for g, m in lines:
        for prefix, table in sides:
            known = g in table.groups and m in table.methods
            at = (table.groups.index(g), table.methods.index(m)) if known else None
            columns[f"{prefix}_mean"].append(float(table.mean[at]) if at else np.nan)
            columns[f"{prefix}_std"].append(float(table.std[at]) if at else np.nan)
    groups, methods = [g for g, _ in lines], [m for _, m in lines]
    return Table({"group": groups, "method": methods, **columns, "window": [data.window] * len(lines)})


@styled
def plot_table_one(data: Strengths, *, ax: Axes | None = None) -> FigureBase:
    """Signal strength by place on the grid, here (filled) and in the thesis (open), and the numbers below."""
    first = data.methods[0]  # a place is named once
    cells = [[place if method == first else "", method, *numbers] for place, method, *numbers in table_one_rows(data)]
    below = 0.16 * (len(cells) + 1)  # inches: lines of 7 pt
    figure = panels(ax, (7.1 if data.arms else 6.4, 2.5 + below))
    top, bottom = figure.subplots(2, 1, height_ratios=(2.5, below))
    _points(top, data)
    bottom.axis("off")
    header = list(TABLE_ONE)
    table = bottom.table(cells, colLabels=header, bbox=(0, 0, 1, 1), cellLoc="left", colLoc="left")
    table.auto_set_font_size(False)
    table.set_fontsize(7)
    wide = [max(map(len, column)) + 2 for column in zip(header, *cells, strict=True)]
    for (row, column), cell in table.get_celld().items():
        cell.set_width(wide[column])
        cell.PAD = 0.02
        cell.set_linewidth(0.5)
        cell.visible_edges = "T" if row == 0 or cells[row - 1][0] else ""
    return figure


def _points(ax: Axes, data: Strengths) -> None:
    ours, theirs = data.table(), thesis_table()
    place = np.arange(len(ours.groups), dtype=float)
    for m, method in enumerate(ours.methods):
        x = place + 0.24 * (m - (len(ours.methods) - 1) / 2)
        look: dict[str, Any] = {"color": method_colour(method, ours.methods), "capsize": 2, "lw": 0.8, "ls": "none"}
        ax.errorbar(x - 0.04, ours.mean[:, m], np.nan_to_num(ours.std[:, m]), fmt="o", label=f"{method}, here", **look)
        if method in theirs.methods:
            rows = [theirs.groups.index(g) for g in ours.groups]
            k = theirs.methods.index(method)
            ax.errorbar(x + 0.04, theirs.mean[rows, k], np.nan_to_num(theirs.std[rows, k]), fmt="o", mfc="w",
                        label=f"{method}, thesis P2", **look)  # fmt: skip
    ax.axhline(1, color=GREY, lw=0.8, ls="--")
    if data.window:
        over = data.window.replace("-", "\N{MINUS SIGN}") if data.window != "record" else "the whole record"
        ax.set_title(f"S over {over}", fontsize=7)
    ax.set_xticks(place, ours.groups)
    ax.set(ylabel="signal strength S [-]", yscale="log")
    low, high = ax.get_ylim()
    ax.set_ylim(low, high := high * 1.8)
    ticks = [t for t in (0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7, 10, 15) if low <= t <= high]
    ax.set_yticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.legend(ncols=3, loc="upper left", fontsize=6)


@dataclass(frozen=True, eq=False)
class Errors:
    """Error estimates of G by source, and the accuracy asked for (NaN for measured G)."""

    estimates: tuple[ErrorEstimate, ...]
    asked: float


def errors(results: Results) -> Errors:
    """Estimates of a run's G."""
    if not results.transfer.errors:
        raise DataError(f"{results.folder}: G carries no error estimate; it was imported without one")
    return Errors(results.transfer.errors, results.scenario.accuracy)


def errors_table(data: Errors) -> Table:
    """One line per source and frequency."""
    lines = []
    for e in data.estimates:
        curve = zip(e.frequency, e.per_frequency, strict=True) if e.per_frequency else [(np.nan, e.band)]
        lines += [(e, f, v) for f, v in curve]
    return Table(
        {
            "source": [e.source for e, _, _ in lines],
            "frequency_Hz": np.array([f for _, f, _ in lines]),
            "e": np.array([v for _, _, v in lines]),
            "e_band": np.array([e.band for e, _, _ in lines]),
        }
    )


@styled
def plot_errors(data: Errors, *, ax: Axes | None = None) -> Axes:
    """e(f) of each source of error on a log scale, band values in the legend, and the accuracy asked for."""
    axes = single(ax, (3.5, 3.2))
    for k, e in enumerate(data.estimates):
        label, colour = f"{e.source}: {size_words(e.band, '.1g')}", ACTUATORS[k % len(ACTUATORS)]
        if e.per_frequency:
            marker = "o" if len(e.frequency) < 40 else ""
            axes.plot(e.frequency, np.maximum(e.per_frequency, 1e-16), marker=marker, ms=2.5, color=colour, label=label)
        else:
            axes.axhline(max(e.band, 1e-16), color=colour, ls=":", label=label + " (band only)")
    if np.isfinite(data.asked):
        axes.axhline(data.asked, color=GREY, ls="--", lw=0.8)
        axes.annotate(f"asked {data.asked:g}", (0.01, data.asked), xycoords=("axes fraction", "data"), ha="left",
                      va="bottom", fontsize=7, color=GREY)  # fmt: skip
    axes.set(xlabel="frequency [Hz]", ylabel="e(f) = max |ΔG| / max |G| [-]", yscale="log")
    axes.legend(title="source: $e_{band}$", loc="upper center", bbox_to_anchor=(0.45, -0.18), ncols=2)
    return axes
