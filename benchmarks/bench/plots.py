"""The plots of the benchmark, drawn from its CSV files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator

from forearm_fem.store.folder import atomic_path

from .tables import Row, read_rows

_TICK = FuncFormatter(lambda v, _: f"{v:g}")
# (method, element, precision) -> label, colour, marker, line
CURVES: Mapping[tuple[str, str, str], tuple[str, str, str, str]] = MappingProxyType(
    {
        ("direct", "P2", "double"): ("direct solve per bin, P2", "#444444", "s", "-"),
        ("interpolated", "P2", "double"): ("11 direct solves interpolated, P2", "#8c6bb1", "D", "-"),
        ("reduced", "P2", "double"): ("reduced, P2, double precision", "#56b4e9", "o", "--"),
        ("reduced", "P2", "auto"): ("reduced, P2 (single, refined)", "#0072b2", "o", "-"),
        ("reduced", "P3", "auto"): ("reduced, P3", "#009e73", "^", "-"),
        ("reduced", "P1", "auto"): ("reduced, P1 (MINI)", "#d55e00", "v", "-"),
    }
)


def draw_all(folder: Path) -> list[Path]:
    """Every plot whose CSV is there."""
    written = []
    for name, draw in _PLOTS.items():
        if rows := read_rows(folder / f"{name}.csv"):
            figure = draw(rows)
            with atomic_path(folder / f"{name}.png") as beside:
                figure.savefig(beside, dpi=150)
            written.append(folder / f"{name}.png")
    return written


def _speed_against_error(rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(9.5, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True)
    for key, (label, colour, marker, line) in CURVES.items():
        mine = [r for r in rows if (r["method"], r["element"], r["precision"]) == key]
        mine.sort(key=lambda r: (int(r["unknowns"]), -float(r["scale"])))
        if not mine:
            continue
        x = [float(r["error_worst"]) for r in mine]
        style: dict[str, Any] = {
            "color": colour,
            "marker": marker,
            "linestyle": line,
            "markersize": 5,
            "label": label,
        }
        left.loglog(x, [float(r["seconds_cpu"]) for r in mine], **style)
        right.loglog(x, [float(r["peak_bytes"]) / 1e9 for r in mine], **style)
    _twin_lines(left, right, rows)
    _labelled(
        left,
        "true error  max|dG| / max|G|, worst over 80-400 Hz",
        "scenario to G at 161 bins, processor time [s]",
    )
    _labelled(right, "true error", "peak memory of the process [GB]")
    left.invert_xaxis()
    figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def _twin_lines(left: Axes, right: Axes, rows: Sequence[Row]) -> None:
    """The twin as level lines: its errors lie decades below what meshes reach, its cost does not depend on them."""
    mine = [r for r in rows if r["method"] == "twin"]
    if not mine:
        return
    error = max(float(r["error_worst"]) for r in mine)
    for axes, cost in (
        (left, max(float(r["seconds_cpu"]) for r in mine)),
        (right, max(float(r["peak_bytes"]) for r in mine) / 1e9),
    ):
        axes.axhline(cost, color="#cc79a7", linestyle=":", label=f"layered twin (no mesh), e below {error:.0e}")


def _cost_against_size(rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(9.5, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    steps = {"assembly": "#009e73", "analysis": "#e69f00", "factorisation": "#0072b2", "solve": "#d55e00"}
    for precision, line in (("double", "-"), ("single", "--")):
        mine = sorted((r for r in rows if r["precision"] == precision), key=lambda r: int(r["unknowns"]))
        n = [int(r["unknowns"]) for r in mine]
        for step, colour in steps.items():
            y = [float(r[f"seconds_{step}"]) for r in mine]
            left.loglog(n, y, line, color=colour, marker="o", markersize=4, label=f"{step}, {precision}{_slope(n, y)}")
        right.loglog(n, [float(r["peak_bytes"]) / 1e9 for r in mine], line, color="#444444", marker="o", markersize=4,
                     label=f"{precision}")  # fmt: skip
    _labelled(left, "unknowns", "one frequency [s]")
    _labelled(right, "unknowns", "peak memory of the process [GB]")
    for axes in (left, right):
        axes.legend(fontsize=7, frameon=False)
    return figure


def _slope(n: Sequence[int], y: Sequence[float]) -> str:
    start = max(0, len(n) // 2 - 1)
    if len(n) - start < 2 or min(y[start:]) <= 0:
        return ""
    return f" ~ n^{np.polyfit(np.log(n[start:]), np.log(y[start:]), 1)[0]:.1f}"


def _reduced_against_direct(rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(9.5, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    n = [int(r["unknowns"]) for r in rows]
    for key, label, colour in (
        ("seconds_direct_sweep", "direct sweep, 981 bins (from 10)", "#444444"),
        ("seconds_reduced_sweep", "reduced sweep, 981 bins", "#0072b2"),
        ("seconds_direct_frequency", "one direct frequency", "#8c6bb1"),
        ("seconds_factorisation", "one factorisation", "#e69f00"),
        ("seconds_many_evaluations", "20,000 more frequencies", "#009e73"),
    ):
        left.loglog(n, [float(r[key]) for r in rows], marker="o", color=colour, label=label)
    right.semilogy(n, [float(r["error_worst"]) for r in rows], marker="o", color="#0072b2", label="worst held-out bin")
    right.semilogy(n, [float(r["error_median"]) for r in rows], marker="o", color="#56b4e9", label="median")
    right.axhline(1e-4, color="#999999", linewidth=0.8, linestyle=":", label="tolerance asked")
    _labelled(left, "unknowns", "seconds")
    _labelled(right, "unknowns", "e(f) against direct solves")
    for axes in (left, right):
        axes.legend(fontsize=7, frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    return figure


def _asked_for(rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(9.5, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    mine = sorted(rows, key=lambda r: float(r["accuracy"]))
    x = [float(r["accuracy"]) for r in mine]
    for key, label, colour, line in (
        ("error_band", "true, all outputs", "#0072b2", "-"),
        ("error_points", "true, points at 10 and 20 mm", "#d55e00", "-"),
        ("estimated_band", "estimated, all outputs", "#0072b2", ":"),
    ):
        left.loglog(x, [float(r[key]) for r in mine], line, marker="o", markersize=4, color=colour, label=label)
    left.loglog(x, x, color="#999999", linewidth=0.8, label="asked")
    right.loglog(x, [float(r["seconds_cpu"]) for r in mine], marker="o", color="#0072b2", label="to G at 161 bins")
    right.loglog(
        x, [float(r["seconds_estimate"]) for r in mine], ":", marker="o", color="#0072b2", label="and its estimate"
    )
    _labelled(left, "accuracy asked for", "e_band against the exact solution")
    _labelled(right, "accuracy asked for", "processor time [s]")
    for axes in (left, right):
        axes.invert_xaxis()
        axes.legend(fontsize=7, frameon=False)
    return figure


def _labelled(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(visible=True, which="major", color="#dddddd", linewidth=0.6)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
            axis.set_minor_formatter(_TICK)
            axis.set_major_formatter(_TICK)
            axis.set_tick_params(which="both", labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


_PLOTS: Mapping[str, Callable[[Sequence[Row]], Figure]] = MappingProxyType(
    {
        "error": _speed_against_error,
        "size": _cost_against_size,
        "asked": _asked_for,
        "reduced": _reduced_against_direct,
    }
)
