"""Pictures of a study: answers with their ellipses (figure 8), points chosen (figure 9), confusion, power."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse as Patch
from matplotlib.path import Path

from ..ports import Port
from ..show.style import FAINT, INK, letter, method_colour, styled
from ..typing import FloatArray
from .analysis import Ellipse, in_order, outline
from .power import Power

_MM = 1e3


@styled
def plot_ellipses(found: Sequence[Ellipse], grid: Sequence[Port]) -> Figure:
    """One panel per target: mean answers of all methods with one-standard-deviation ellipses, the target a star.

    Filled are ellipses over all answers, dotted ones about participants' own means.

    Points lie as the page shows them: across the limb to the right, along it downwards.
    """
    targets = list(dict.fromkeys(e.target for e in found))
    methods = list(dict.fromkeys(e.method for e in found))
    columns = int(np.ceil(np.sqrt(len(targets))))
    rows = int(np.ceil(len(targets) / columns))
    figure = Figure(figsize=(7.1, 7.1 * rows / columns + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    places = {p.name: _MM * np.array([p.position[1], p.position[0]]) for p in grid}
    reach = 0.75 * _pitch(list(places.values()))
    xy = np.array(list(places.values()))
    for ax, target in zip(axes, targets, strict=False):
        ax.plot(xy[:, 0], xy[:, 1], ".", color=FAINT, ms=4)
        for e in (e for e in found if e.target == target and e.count):
            colour = method_colour(e.method, methods)
            values, vectors = np.linalg.eigh(np.nan_to_num(e.covariance[::-1, ::-1]))
            width, height = 2 * _MM * np.sqrt(np.maximum(values[::-1], 0))
            angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
            at = _MM * e.mean[::-1]
            ax.add_patch(Patch(tuple(at), width, height, angle=angle, facecolor=colour, alpha=0.18, edgecolor=colour))
            ax.plot(*at, "o", color=colour, ms=4)
            if e.within is not None and np.isfinite(e.within).all():
                values, vectors = np.linalg.eigh(e.within[::-1, ::-1])
                width, height = 2 * _MM * np.sqrt(np.maximum(values[::-1], 0))
                angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
                ax.add_patch(Patch(tuple(at), width, height, angle=angle, fill=False, edgecolor=colour, ls=":"))
        ax.plot(*places[target], "*", color="#B3261E", ms=9, zorder=5)
        ax.set_aspect("equal")
        letter(ax, target)
    for ax in axes[len(targets) :]:
        ax.set_visible(False)
    axes[0].set_xlim(xy[:, 0].min() - reach, xy[:, 0].max() + reach)
    axes[0].set_ylim(xy[:, 1].max() + reach, xy[:, 1].min() - reach)
    figure.supxlabel("across the limb [mm]")
    figure.supylabel("along the limb [mm]")
    handles = [Patch((0, 0), 1, 1, facecolor=method_colour(m, methods), alpha=0.6) for m in methods]
    figure.legend(handles, methods, loc="outside upper center", ncols=len(methods))
    return figure


def _pitch(places: Sequence[FloatArray]) -> float:
    if len(places) < 2:
        return 10.0
    xy = np.array(places)
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    return float(apart[apart > 0].min())


@styled
def plot_points(table: pd.DataFrame) -> Figure:
    """Points chosen per trial, participants' means as box plots: all trials, those with the target inside, others."""
    return _extents(table, "points", 1.0, "points chosen, mean of a participant", "target among the points")


@styled
def plot_areas(table: pd.DataFrame) -> Figure:
    """Area drawn per trial [cm2], as :func:`plot_points`."""
    return _extents(table, "response_area", 1e4, "area drawn [cm²], mean of a participant", "target inside the outline")


def _extents(table: pd.DataFrame, measure: str, unit: float, label: str, inside: str) -> Figure:
    methods = in_order(table, "method")
    figure = Figure(figsize=(7.1, 3.0), layout="constrained")
    held = table["inside"]
    parts = {"all trials": table, inside: table[held.fillna(False)], "the other trials": table[~held.fillna(True)]}
    for ax, (title, part), sign in zip(figure.subplots(1, 3, sharey=True), parts.items(), "abc", strict=True):
        means = [unit * part[part["method"] == m].groupby("participant")[measure].mean().to_numpy() for m in methods]
        boxes = ax.boxplot([m if len(m) else [np.nan] for m in means], widths=0.5, patch_artist=True, showmeans=True)
        for box, method in zip(boxes["boxes"], methods, strict=True):
            box.set(facecolor=method_colour(method, methods), alpha=0.5)
        for line in boxes["medians"]:
            line.set(color=INK)
        ax.set_xticks(range(1, len(methods) + 1), methods)
        ax.set_title(title)
        letter(ax, sign)
        ax.tick_params(axis="x", labelrotation=20)
    figure.axes[0].set_ylabel(label)
    return figure


@styled
def plot_outlines(table: pd.DataFrame, grid: Sequence[Port]) -> Figure:
    """Share of answers whose outline holds each place: a row per target, a column per method."""
    methods, targets = in_order(table, "method"), in_order(table, "target")
    figure = Figure(figsize=(2.0 * len(methods) + 1.0, 1.9 * len(targets) + 0.6), layout="constrained")
    axes = figure.subplots(len(targets), len(methods), sharex=True, sharey=True, squeeze=False)
    places = {p.name: _MM * np.array([p.position[1], p.position[0]]) for p in grid}
    xy = np.array(list(places.values()))
    reach = 1.2 * _pitch(list(xy))
    u = np.linspace(xy[:, 0].min() - reach, xy[:, 0].max() + reach, 61)
    v = np.linspace(xy[:, 1].min() - reach, xy[:, 1].max() + reach, 61)
    every = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    for row, target in zip(axes, targets, strict=True):
        letter(row[0], target)
        for ax, method in zip(row, methods, strict=True):
            drawn = table[(table["target"] == target) & (table["method"] == method)]["response_outline"].dropna()
            held = [Path(outline(text)[:, ::-1]).contains_points(every) for text in drawn]
            share = (np.mean(held, axis=0) if held else np.full(len(every), np.nan)).reshape(len(v), len(u))
            image = ax.pcolormesh(u, v, share, vmin=0, vmax=1, cmap="cividis", rasterized=True)
            ax.plot(xy[:, 0], xy[:, 1], ".", color=FAINT, ms=3)
            ax.plot(*places[target], "*", color="#B3261E", ms=8)
            ax.set_aspect("equal")
    axes[0, 0].invert_yaxis()
    for ax, method in zip(axes[0], methods, strict=True):
        ax.set_title(method)
    figure.supxlabel("across the limb [mm]")
    figure.supylabel("along the limb [mm]")
    figure.colorbar(image, ax=axes, label="share of outlines", shrink=0.6)
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


@styled
def plot_power(curve: Sequence[Power]) -> Figure:
    """Power against the number of participants, with the 95 % interval of what the pilot tells."""
    figure = Figure(figsize=(3.5, 2.6), layout="constrained")
    ax = figure.subplots()
    n = [p.participants for p in curve]
    ax.fill_between(n, [p.low for p in curve], [p.high for p in curve], alpha=0.2)
    ax.plot(n, [p.share for p in curve], "o-", ms=3)
    ax.axhline(0.8, color=FAINT, lw=0.8)
    ax.set(xlabel="participants", ylabel="share of studies that find it", ylim=(0, 1.02))
    return figure
