"""Pictures of a study: answers with their ellipses (figure 8), points chosen (figure 9), confusion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse
from scipy.spatial.distance import pdist

from ..ports import Port
from ..show.style import FAINT, INK, letter, method_look, styled
from ..typing import FloatArray
from .analysis import in_order

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
