"""Figures of merit: signal strength beside the thesis' Table I, maps of S, and error estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from ..errors import DataError, NotApplicable
from ..metrics import StrengthTable, signal_strength_table, thesis_table
from ..metrics.strength import numerics_words
from ..ports import Port, positions
from ..store.text import markdown_table
from ..transfer import size_words
from ..typing import BoolArray, FloatArray
from .data import Results, places
from .style import ACTUATORS, COLUMN, GREY, INK, PAGE, method_look, sheet, single, styled, widen

TABLE_ONE = ("place", "method", "here", "record", "thesis")  # S over the window, over the whole record, and measured


ERRORS: Mapping[str, tuple[str, str]] = MappingProxyType({
    "discretisation": ("mesh", "G solved again on a mesh with nodes further apart; on a slab the layered model"),
    "truncation": ("cut ends", "G with the ends of the modelled piece of arm freed; on a slab the layered model"),
    "linear solve": ("linear solver", "residual of the equations solved"),
    "reduction": ("reduced model", "difference from full solves at frequencies that it did not see"),
    "quadrature": ("integrals of the layered model", "last terms of series and integrals"),
    "interpolation": ("interpolation", "solves left out and found again from the others"),
    "bridging": ("bridged holes of G", "known frequencies left out and found again from the others"),
    "contact": ("contact on curved skin", "curvature of the skin below a cone"),
    "measurement": ("measurement", "scatter between repeated sweeps"),
})  # fmt: skip
"""Sources of error as the glossary names them, and how each is estimated."""


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

    def to_xarray(self) -> xr.Dataset:
        """``S``, its interval and ``S_record`` (method, target), which targets are ``counted``, places in metres."""
        columns = {"S": self.values, "S_low": self.low, "S_high": self.high, "S_record": self.record}
        seen = places(self.outputs, self.inputs)
        return xr.Dataset(
            {**{n: (("method", "target"), v) for n, v in columns.items()}, "counted": ("target", self.counted),
             **{c: ("target", positions(self.outputs)[:, k], {"units": "m"}) for k, c in enumerate("xy")}},
            {"method": list(self.methods), "target": list(self.targets), **seen}, {"window": self.window},
        )  # fmt: skip


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


@styled
def plot_strength_maps(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """S at each target seen from above, one map per method; white is 1, points that do not count are grey."""
    n, wide, bar_mm = data.sizes["method"], width > COLUMN, 16
    tall = aspect(*_extent(data)[:2]) * ((width - bar_mm) / n if wide else 56)
    figure = sheet(width, (tall + 8) * (1 if wide else n))
    axes = np.atleast_1d(figure.subplots(*((1, n) if wide else (n, 1)), sharey=True))
    norm = _norm(data)
    for m, panel in enumerate(axes):
        _map(panel, data, m, norm, ("",) * data.sizes["target"])
        panel.set_title(data.method.values[m])
    bar = figure.colorbar(ScalarMappable(norm, "PuOr_r"), ax=list(axes), shrink=0.9, fraction=0.04)
    ticks = [t for t in (0.125, 0.25, 0.5, 1, 2, 4, 8, 16) if abs(np.log2(t)) <= float(norm.vmax or 0)]
    bar.set_ticks([float(np.log2(t)) for t in ticks], labels=[f"{t:g}" for t in ticks])
    bar.ax.minorticks_off()
    bar.set_label("signal strength S")
    return figure


@styled
def plot_strength_map(
    data: xr.Dataset, method: str, notes: Sequence[str], *, alike: Sequence[xr.Dataset] = (), ax: Axes | None = None
) -> Axes:
    """S of one ``method`` seen from above with a note below each target; ``notes`` (n_target,), e.g. ``±0.12``.

    Its colours and its scale are good for ``alike``, whose maps lie beside it, too.
    """
    corners = [_extent(each)[:2] for each in (data, *alike)]
    low, high = np.min([c[0] for c in corners], axis=0), np.max([c[1] for c in corners], axis=0)
    axes = single(ax, (3.0, 3.0 * aspect(low, high)))
    norm = max((_norm(each) for each in (data, *alike)), key=lambda n: float(n.vmax or 0))
    _map(axes, data, list(data.method.values).index(method), norm, notes, (low, high))
    return axes


def _norm(data: xr.Dataset) -> TwoSlopeNorm:
    """Colours of log2 S, the same to both sides of S = 1, by the points that count."""
    counted = data.S.values[:, data.counted.values] if data.counted.any() else data.S.values
    with np.errstate(divide="ignore"):
        size = np.abs(np.log2(counted))
    spread = float(np.clip(np.max(size[np.isfinite(size)], initial=0.1), 0.1, 5.0))
    return TwoSlopeNorm(0, -spread, spread)


def _extent(data: xr.Dataset) -> tuple[FloatArray, FloatArray, float]:
    """Corners (x, y) [mm] of a map, and the radius [mm] of a point's disc on it."""
    at, coils = (1e3 * data[f"{side}_place"].values[:, :2] for side in ("output", "input"))
    radius = disc_radius(at)
    rims = 1e3 * data.radius.values[:, None]
    low = np.concatenate([at - radius, coils - rims]).min(axis=0) - (1.0, 6.0)
    high = np.concatenate([at + radius, coils + rims]).max(axis=0) + 1.0
    return low, high, radius


def aspect(low: FloatArray, high: FloatArray) -> float:
    """Height of a map over its width."""
    wide, tall = high - low
    return float(np.clip(tall / wide, 0.4, 1.5))


def _map(
    panel: Axes, data: xr.Dataset, m: int, norm: TwoSlopeNorm, notes: Sequence[str],
    corners: tuple[FloatArray, FloatArray] | None = None,
) -> None:  # fmt: skip
    at, coils = (1e3 * data[f"{side}_place"].values[:, :2] for side in ("output", "input"))
    own_low, own_high, radius = _extent(data)
    low, high = corners or (own_low, own_high)
    named = len(at) <= 25  # enough room for numbers
    for place, rim, name in zip(coils, 1e3 * data.radius.values, data.input.values, strict=True):
        panel.add_patch(Circle(place, rim, facecolor="#EEEEEE", edgecolor=GREY, lw=0.8, zorder=3))
        hidden = np.linalg.norm(at - place, axis=1).min() < radius
        beside = place[0] - max(radius, rim) - 0.5 if hidden else place[0]
        panel.annotate(name, (beside, place[1]), ha="right" if hidden else "center", va="center", fontsize=6,
                       color=GREY, zorder=6)  # fmt: skip
    counted = data.counted.values
    values = [f"{v:.2f}" if v < 10 else f"{v:.3g}" for v in data.S.values[m]]
    below = [f"{t} {n if c else ''}".rstrip() for t, n, c in zip(data.target.values, notes, counted, strict=True)]
    draw_points(panel, at, radius, data.S.values[m], norm, counted, values if named else (), below if named else ())
    panel.plot([low[0], low[0] + 10], [low[1] + 1.5] * 2, color=INK, lw=1.5, solid_capstyle="butt")
    panel.annotate("10 mm", (low[0] + 10, low[1] + 1.5), (3, 0), textcoords="offset points", va="center", fontsize=6)
    panel.annotate("elbow →", (high[0], low[1] + 1.5), ha="right", va="center", fontsize=6, color=GREY)
    panel.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    panel.axis("off")
    widen(panel)


def draw_points(
    panel: Axes, at: FloatArray, radius: float, ratios: FloatArray, norm: TwoSlopeNorm, counted: BoolArray,
    words: Sequence[str], below: Sequence[str],
) -> None:  # fmt: skip
    """Points at ``at`` (n, 2) [mm] of a map as discs, coloured by log2 of ``ratios`` (n,), grey where not ``counted``;
    ``words`` (n,) in them and ``below`` (n,), or none of either."""
    for k, (place, value) in enumerate(zip(at, ratios, strict=True)):
        counts = bool(counted[k])
        with np.errstate(divide="ignore", invalid="ignore"):
            shade = float(np.clip(norm(np.log2(value)), 0, 1)) if np.isfinite(value) else 1.0 if value > 0 else 0.5
        look: dict[str, Any] = {"edgecolor": INK if counts else GREY, "lw": 0.5, "ls": "-" if counts else ":"}
        face = colormaps["PuOr_r"](shade) if counts else "#DDDDDD"
        panel.add_patch(Circle(place, radius, facecolor=face, zorder=4, **look))
        if words:
            ink = GREY if not counts else "w" if abs(shade - 0.5) > 0.36 else INK
            panel.annotate(words[k], place, ha="center", va="center", fontsize=7.5, color=ink, zorder=5)
        if below:
            panel.annotate(below[k], (place[0], place[1] - radius), (0, -1.5), textcoords="offset points", ha="center",
                           va="top", fontsize=6, color="#555555", zorder=5)  # fmt: skip


def disc_radius(at: FloatArray) -> float:
    """Radius [mm] of discs at ``at`` (n, 2) [mm] that leave room between them."""
    apart = np.linalg.norm(at[:, None] - at[None], axis=2)
    return 0.36 * float(np.min(apart[apart > 0], initial=20.0))


def table_one(data: Strengths) -> xr.Dataset:
    """Table I: ``mean`` and ``std`` of S (group, method, side), here over the window, here over the whole record, and
    in the thesis; ``note`` (group, method) are the spreads that a prediction knows."""
    ours, record, theirs = data.table(), data.table(data.record), thesis_table()
    mean = np.full((len(ours.groups), len(ours.methods), 3), np.nan)
    std = mean.copy()
    for k, table in enumerate((ours, record, theirs)):
        for g, group in enumerate(ours.groups):
            for m, method in enumerate(ours.methods):
                if group in table.groups and method in table.methods:
                    at = table.groups.index(group), table.methods.index(method)
                    mean[g, m, k], std[g, m, k] = table.mean[at], table.std[at]
    notes = [[spreads(data, m, g) for m in ours.methods] for g in ours.groups]
    low, high = (np.where(np.arange(3) == 0, data.table(s).mean[..., None], np.nan) for s in (data.low, data.high))
    dims = ("group", "method", "side")
    return xr.Dataset(
        {"mean": (dims, mean), "std": (dims, std), "note": (dims[:2], np.array(notes), {"table": "no"}),
         "low": (dims, low), "high": (dims, high)},
        {"group": list(ours.groups), "method": list(ours.methods), "side": list(TABLE_ONE[2:])},
        {"window": data.window},
    )


def table_one_rows(data: xr.Dataset) -> list[list[str]]:
    """Rows of Table I as text: place, method, S over the window, over the whole record, and the thesis'."""
    rows = []
    for g, group in enumerate(data.group.values):
        for m, method in enumerate(data.method.values):
            sides = zip(data["mean"].values[g, m], data["std"].values[g, m], strict=True)
            here, *others = (_cell(*each) for each in sides)
            rows.append([str(group), str(method), f"{here}{data.note.values[g, m]}", *others])
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
    return f" (numerics {numerics_words(low, high)}, arms {known['arms'][0]:.2f}-{known['arms'][-1]:.2f})"


def _cell(mean: float, std: float) -> str:
    return "–" if np.isnan(mean) else f"{mean:.2f}" if np.isnan(std) or std < 0.005 else f"{mean:.2f} ± {std:.2f}"


_TABLE_SAYS = (
    "S by place: mean and standard deviation over the points of a group, which is no error.",
    "Here: over the wavelet's window. Record: over the whole record. Thesis: participant 2 of de Vlam (2022).",
    "Numerics: the mean interval of S here that the errors of G leave; people differ by more.",
)


def table_one_extra(data: xr.Dataset) -> dict[str, str]:
    """The table as Markdown and as a LaTeX ``table`` with its caption and the rules of ``booktabs``."""
    bounds = zip(data.low.values[..., 0].ravel(), data.high.values[..., 0].ravel(), strict=True)
    numerics = [f"{a:.2f} to {b:.2f}" if np.isfinite(a) and np.isfinite(b) else "unknown" for a, b in bounds]
    rows, shown = [[*row, n] for row, n in zip(table_one_rows(data), numerics, strict=True)], ""
    named_columns = (*TABLE_ONE, "numerics")
    said = " ".join(_TABLE_SAYS).replace("S by place: mean and", r"Signal strength $S$ by place: mean $\pm$")
    lines = [r"% needs \usepackage{booktabs}", r"\begin{table}", r"\centering", rf"\caption{{{said}}}",
             r"\label{tab:signal-strength}", r"\begin{tabular}{llcccc}", r"\toprule",
             " & ".join(named_columns) + r" \\", r"\midrule"]  # fmt: skip
    for place, method, *numbers in rows:
        named, shown = place if place != shown else "", place
        cells = (named, method, *(n.replace("±", r"$\pm$").replace("–", "--").replace("%", r"\%") for n in numbers))
        lines.append(" & ".join(cells) + r" \\")
    latex = "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}", ""])
    return {"table.md": markdown_table(named_columns, rows) + "\n" + " ".join(_TABLE_SAYS) + "\n", "table.tex": latex}


@styled
def plot_table_one(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """Signal strength by place on the grid, here (filled) and in the thesis (open), and the numbers below."""
    first, wide = data.method.values[0], width > COLUMN  # a place is named once
    if not wide and any(data.note.values.ravel()):
        raise NotApplicable(f"with what a prediction says of people its cells need {PAGE} mm, not {width} mm")
    cells = [[place if method == first else "", method, *numbers] for place, method, *numbers in table_one_rows(data)]
    if not wide:  # which points those are stands at the axis
        cells = [[place.partition(" (")[0], *others] for place, *others in cells]
    size = 7.0 if wide else 6.0
    below = 0.58 * size * (len(cells) + 1)  # mm: lines of that many points
    figure = sheet(width, 66 + below)
    top, bottom = figure.subplots(2, 1, height_ratios=(66, below))
    _points(top, data, 3 if wide else 2)
    bottom.axis("off")
    table = bottom.table(cells, colLabels=list(TABLE_ONE), bbox=(0, 0, 1, 1), cellLoc="left", colLoc="left")
    table.auto_set_font_size(False)
    table.set_fontsize(size)
    widths = [max(map(len, column)) + 2 for column in zip(TABLE_ONE, *cells, strict=True)]
    for (row, column), cell in table.get_celld().items():
        cell.set_width(widths[column])
        cell.PAD = 0.02
        cell.set_linewidth(0.5)
        cell.visible_edges = "T" if row == 0 or cells[row - 1][0] else ""
    return figure


def _points(ax: Axes, data: xr.Dataset, columns: int) -> None:
    methods, place = list(data.method.values), np.arange(data.sizes["group"], dtype=float)
    for m, method in enumerate(methods):
        x = place + 0.24 * (m - (len(methods) - 1) / 2)
        colour, marker, _ = method_look(method, methods)
        look: dict[str, Any] = {"color": colour, "fmt": marker, "capsize": 2, "lw": 0.8, "ls": "none"}
        for side, aside, words, face in ((TABLE_ONE[2], -0.04, "here", None), (TABLE_ONE[4], 0.04, "thesis P2", "w")):
            mean, std = (data[what].isel(method=m).sel(side=side).values for what in ("mean", "std"))
            if np.isfinite(mean).any():
                ax.errorbar(x + aside, mean, np.nan_to_num(std), mfc=face, label=f"{method}, {words}", **look)
    ax.axhline(1, color=GREY, lw=0.8, ls="--")
    if data.window:
        over = data.window.replace("-", "\N{MINUS SIGN}") if data.window != "record" else "the whole record"
        ax.set_title(f"S over {over}", fontsize=7)
    ax.set_xticks(place, list(data.group.values))
    ax.set(ylabel="signal strength S [-]", yscale="log")
    low, high = ax.get_ylim()
    ticks = [t for t in (0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7, 10, 15) if low <= t <= high]
    ax.set_yticks(ticks, [f"{t:g}" for t in ticks])
    ax.minorticks_off()
    ax.legend(ncols=columns, loc="lower center", bbox_to_anchor=(0.5, 1.12), fontsize=6)


def errors(results: Results) -> xr.Dataset:
    """Error estimates of a run's G: ``e`` (source, frequency) where known, ``band`` and ``method`` (source); the
    attribute ``asked`` is the accuracy asked for."""
    if not (estimates := results.transfer.errors):
        raise DataError(f"{results.folder}: G carries no error estimate; it was imported without one")
    known = [np.asarray(e.frequency if e.per_frequency else (), dtype=float) for e in estimates]
    frequency = np.unique(np.concatenate(known))
    values = np.full((len(estimates), len(frequency)), np.nan)
    for k, e in enumerate(estimates):
        values[k, np.searchsorted(frequency, known[k])] = e.per_frequency
    return xr.Dataset(
        {"e": (("source", "frequency"), values), "e_band": ("source", [e.band for e in estimates])},
        {"source": [e.source for e in estimates], "frequency": ("frequency", frequency, {"units": "Hz"})},
        {"asked": results.scenario.accuracy},
    )


@styled
def plot_errors(data: xr.Dataset, *, width: int = COLUMN) -> Figure:
    """e(f) of each source of error on a log scale, band values in the legend, and the accuracy asked for."""
    columns = 2 if width <= COLUMN else 4
    figure = sheet(width, 66 + 4 * -(-data.sizes["source"] // columns))
    axes = figure.add_subplot()
    for k, (source, band) in enumerate(zip(data.source.values, data.e_band.values, strict=True)):
        name = ERRORS.get(str(source), (source,))[0]
        label, colour = f"{name}: {size_words(float(band), '.1g')}", ACTUATORS[k % len(ACTUATORS)]
        curve = data.e[k].dropna("frequency")
        if len(curve):
            marker = "o" if len(curve) < 40 else ""
            axes.plot(curve.frequency, np.maximum(curve, 1e-16), marker=marker, ms=2.5, color=colour, label=label)
        else:
            axes.axhline(max(float(band), 1e-16), color=colour, ls=":", label=label + " (band only)")
    if np.isfinite(data.asked):
        axes.axhline(data.asked, color=GREY, ls="--", lw=0.8)
        axes.annotate(f"asked {data.asked:g}", (0.01, data.asked), xycoords=("axes fraction", "data"), ha="left",
                      va="bottom", fontsize=7, color=GREY)  # fmt: skip
    axes.set(xlabel="frequency [Hz]", ylabel="e(f) = max |ΔG| / max |G| [-]", yscale="log")
    axes.legend(title="source: $e_{band}$", loc="upper center", bbox_to_anchor=(0.45, -0.18), ncols=columns)
    return figure
