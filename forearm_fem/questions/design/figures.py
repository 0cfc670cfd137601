"""Pictures of a design: Pareto front, S over two variables, and the winner beside the scenario's device."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import FigureBase
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from ...show.style import ACTUATORS, FAINT, GREY, INK, panels, styled, widen

if TYPE_CHECKING:
    from .run import DesignResult

MM = 1e3
_LEAST = 6  # candidates that a map is drawn from


@styled
def plot_front(result: DesignResult) -> FigureBase:
    """Score against number of actuators and against power; the front and the scenario's own device stand out."""
    figure = panels(None, (7.2, 3.0))
    axes = figure.subplots(1, 2, sharey=True)
    feasible = [c for c in result.candidates if c.feasible]
    parts = ((feasible, {"color": FAINT, "s": 10, "label": "candidates"}),
             (result.front, {"color": ACTUATORS[0], "s": 24, "label": "Pareto front"}),
             ([result.best], {"color": ACTUATORS[5], "s": 60, "marker": "*", "label": "best"}),
             ([result.reference] if not result.reference.problem else [],
              {"color": INK, "s": 40, "marker": "x", "label": "scenario's device"}))  # fmt: skip
    for ax, key in zip(axes, ("actuators", "total_power"), strict=True):
        for candidates, look in parts:
            ax.scatter([getattr(c, key) for c in candidates], [c.score for c in candidates], **look)
    axes[0].set(xlabel="number of actuators", ylabel=_score_label(result))
    axes[0].xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    axes[1].set(xlabel="power of all actuators [W]")
    power = [c.total_power for c in feasible if np.isfinite(c.total_power) and c.total_power > 0]
    if power:
        axes[1].set_xscale("log")
    axes[0].legend(fontsize=7)
    return figure


@styled
def plot_map(result: DesignResult) -> FigureBase | None:
    """Score over the first two variables that are numbers, one dot per candidate; None without two of them.

    Where a third varies, dots that lie together differ by it.
    """
    keys = [v.key for v in result.design.asked.variables
            if all(isinstance(c.values.get(v.key), int | float) for c in result.candidates)][:2]  # fmt: skip
    feasible = [c for c in result.candidates if c.feasible]
    if not keys or len(feasible) < _LEAST:
        return None
    figure = panels(None, (4.6, 3.2))
    ax = figure.subplots()
    x, *rest = (np.array([float(c.values[k]) for c in feasible]) for k in keys)
    score = np.array([c.score for c in feasible])
    order = np.argsort(score)
    if rest:
        dots = ax.scatter(x[order], rest[0][order], c=score[order], cmap="viridis", s=18)
        figure.colorbar(dots, ax=ax).set_label(_score_label(result))
        ax.set_ylabel(keys[1])
        bad = [c for c in result.candidates if not c.feasible]
        ax.scatter([c.values[keys[0]] for c in bad], [c.values[keys[1]] for c in bad], marker="x", s=8, color=FAINT,
                   lw=0.6, label="not feasible")  # fmt: skip
        ax.plot(result.best.values[keys[0]], result.best.values[keys[1]], "*", color=ACTUATORS[5], ms=11, label="best")
        ax.legend(fontsize=7)
    else:
        ax.plot(x, score, ".", color=ACTUATORS[0])
        ax.set_ylabel(_score_label(result))
    ax.set_xlabel(keys[0])
    return figure


@styled
def plot_devices(result: DesignResult) -> FigureBase:
    """The scenario's device and the winner from above, points coloured by S."""
    figure = panels(None, (7.2, 3.2))
    axes = figure.subplots(1, 2)
    pairs = ((result.reference, "scenario's device"), (result.best, "best"))
    every = [s for c, _ in pairs for s in c.strengths.values()]
    top = max(2.0, float(np.nanmax(every))) if every else 2.0
    dots: Any = None
    for ax, (candidate, title) in zip(axes, pairs, strict=True):
        scenario = result.design.scenarios(candidate.values)[0]
        places, centres = MM * np.array(scenario.grid.places), MM * np.array(scenario.device.centres)
        for k, (x, y) in enumerate(centres):
            ax.add_patch(Circle((x, y), MM * scenario.device.cone.radius, fill=False, ec=GREY))
            ax.annotate(f"A{k + 1}", (x, y), ha="center", va="center", fontsize=5, color=GREY)
        ax.plot(places[:, 0], places[:, 1], ".", color=FAINT, ms=3)
        reach = np.concatenate([places, centres])
        low, high = reach.min(axis=0) - 7, reach.max(axis=0) + 7
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
        widen(ax)
        if s := candidate.strengths:
            at = np.array([places[int(t) - 1] for t in s])
            dots = ax.scatter(at[:, 0], at[:, 1], c=list(s.values()), vmin=0, vmax=top, cmap="viridis", s=45)
        ax.set_title(f"{title}: {candidate.score:.3g}" if not candidate.problem else f"{title}: cannot serve")
    if dots is not None:
        figure.colorbar(dots, ax=list(axes)).set_label("S [-]")
    return figure


def _score_label(result: DesignResult) -> str:
    return {"mean": "mean S [-]", "least": "least S [-]", "share": "share of S > 1 [-]"}[
        result.design.asked.objective.of
    ]
