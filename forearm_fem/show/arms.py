"""Figures of a prediction: bands of S over arms, which method wins, and what drives S."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from .style import GREY, INK, SIGNED, letter, method_colour, panels, styled
from .tables import Table

_TICKS = (0.2, 0.3, 0.5, 0.7, 1, 1.5, 2, 3, 5, 7, 10, 15, 20, 30)
_DENSE = 60.0  # largest over smallest S from which labels would overlap
_MOST = 14  # drivers shown


def bands_table(data: Mapping[str, Any]) -> Table:
    """One line per method and target: S of the scene, its numerical interval, quantiles over arms, shares.

    Quantiles hold each arm's own numerics but in S_bare; so do the shares that are surely or possibly above 1.
    """
    cells = [(m, t, data["by_target"][m][t]) for m in data["methods"] for t in data["targets"]]
    columns: dict[str, Any] = {"method": [m for m, _, _ in cells], "target": [t for _, t, _ in cells]}
    for key in ("value", "low", "high", "above_one", "wins"):
        columns[f"S_{key}" if key in ("value", "low", "high") else key] = [_number(c[key]) for _, _, c in cells]
    for k, which in enumerate(("surely", "possibly")):
        columns[f"{which}_above_one"] = [_number(c["above_one_range"][k]) for _, _, c in cells]
    for what in ("arms", "bare", "played", "record"):
        for k, level in enumerate(data["levels"]):
            columns[f"S_{what}_{100 * level:g}"] = [_number(c[what][k]) for _, _, c in cells]
    return Table({name: np.array(c) if not isinstance(c[0], str) else c for name, c in columns.items()})


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


@styled
def plot_bands(data: Mapping[str, Any], *, ax: Axes | None = None) -> FigureBase:
    """S at every target: bars span 5-95 % (thin) and 25-75 % (thick) of arms, the line is the median, the cross the
    scene itself with its numerical interval."""
    methods, targets = data["methods"], data["targets"]
    figure = panels(ax, (6.6, 1.0 + 1.35 * len(methods)))
    axes = np.atleast_1d(figure.subplots(len(methods), 1, sharex=True, sharey=True))
    for m, (axes_m, method) in enumerate(zip(axes, methods, strict=True)):
        colour = method_colour(method, methods)
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
def plot_wins(data: Mapping[str, Any], *, ax: Axes | None = None) -> FigureBase:
    """Share of arms in which each method has the largest S at a target."""
    methods, targets = data["methods"], data["targets"]
    figure = panels(ax, (5.2, 2.4))
    axes = figure.subplots()
    below = np.zeros(len(targets))
    for method in methods:
        share = np.array([100 * data["by_target"][method][t]["wins"] for t in targets])
        axes.bar(targets, share, 0.7, below, color=method_colour(method, methods), label=method)
        below += share
    axes.set(xlabel="target", ylabel="arms in which it wins [%]", ylim=(0, 100))
    axes.legend(ncols=len(methods), loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def drivers_table(data: Mapping[str, Any]) -> Table:
    """One line per driver, method and group: rank correlation and first-order Sobol' index."""
    lines = [(d, m, g) for d in data["drivers"] for m in data["methods"] for g in data["groups"]]
    columns: dict[str, Any] = {
        "driver": [d["name"] for d, _, _ in lines],
        "method": [m for _, m, _ in lines],
        "group": [g for _, _, g in lines],
    }
    for what in ("rank", "sobol"):
        if what in data["drivers"][0]:
            columns[what] = np.array([_number(d[what][m][g]) for d, m, g in lines])
    return Table(columns)


@styled
def plot_drivers(data: Mapping[str, Any], *, ax: Axes | None = None) -> FigureBase:
    """Rank correlation of the strongest drivers with S of each method and group."""
    columns = [(m, g) for m in data["methods"] for g in data["groups"]]
    values = np.array([[_number(d["rank"][m][g]) for m, g in columns] for d in data["drivers"]])
    strongest = np.argsort(-np.nanmax(np.abs(np.nan_to_num(values)), axis=1))[:_MOST]
    figure = panels(ax, (1.9 + 0.42 * len(columns), 1.4 + 0.21 * len(strongest)))
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
