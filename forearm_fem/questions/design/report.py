"""Report and figures of a search."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from ... import __version__
from ...metrics.strength import strength_text
from ...show.page import Block, Page, Picture, Section, embedded
from ...show.registry import save_drawn
from ...show.style import ACTUATORS, FAINT, GREY, INK, panels, styled, widen
from ...show.track import track_record
from ...store.folder import write_text
from ...store.record import save_arrays
from ...store.text import write_json
from .candidate import Candidate
from .run import DesignResult

if TYPE_CHECKING:
    from .run import DesignResult


# Pictures of a design: Pareto front, S over two variables, and the winner beside the scenario's device.

MM = 1e3
_LEAST = 6  # candidates that a map is drawn from


@styled
def plot_front(result: DesignResult) -> Figure:
    """Score against number of actuators and against power; the front and the scenario's own device stand out."""
    figure = panels((7.2, 3.0))
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
def plot_map(result: DesignResult) -> Figure | None:
    """Score over the first two variables that are numbers, one dot per candidate; None without two of them.

    Where a third varies, dots that lie together differ by it.
    """
    keys = [v.key for v in result.design.asked.variables
            if all(isinstance(c.values.get(v.key), int | float) for c in result.candidates)][:2]  # fmt: skip
    feasible = [c for c in result.candidates if c.feasible]
    if not keys or len(feasible) < _LEAST:
        return None
    figure = panels((4.6, 3.2))
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
def plot_devices(result: DesignResult) -> Figure:
    """The scenario's device and the winner from above, points coloured by S."""
    figure = panels((7.2, 3.2))
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


# Folder of a design: tables, pictures and a page.

_TITLES: Mapping[str, str] = MappingProxyType({  # of the page's columns; tables in CSV keep the bare names
    "voltage": "voltage [V]", "power": "power [W]", "total_power": "total power [W]", "mass": "mass [kg]",
    "error": "e_band of G",
})  # fmt: skip
_PICTURES: Mapping[str, str] = MappingProxyType({
    "front": "Score against the number of actuators and against power; the Pareto front stands out",
    "device": "The scenario's own device and the winner from above, points coloured by S",
    "map": "Score over the first two variables, a dot for each candidate",
})  # fmt: skip
_NUMBERS = ("score", "actuators", "voltage", "power", "total_power", "mass", "error")


def write_design_report(result: DesignResult) -> None:
    """``candidates.csv`` and ``.nc``, ``front.csv``, ``best.json``, the pictures, ``report.html`` and ``report.md``."""
    out = result.folder
    write_text(out / "candidates.csv", table(result.candidates))
    write_text(out / "front.csv", table(result.front))
    write_json(out / "best.json", {"values": result.best.values, "candidate": result.best.as_json()})
    save_arrays(out / "candidates.nc", "design", arrays(result), {"design": result.design.asked.name})
    pictures = []
    for name, figure in (("device", plot_devices(result)), ("front", plot_front(result)), ("map", plot_map(result))):
        if figure is not None:
            save_drawn(figure, out / name, ("png",), _stamp(result))
            pictures.append(embedded(figure, _PICTURES[name]))
    design_page(result, pictures).save(out)


def table(candidates: Sequence[Candidate]) -> str:
    """One line per candidate: its values, numbers, S by target, what does not hold."""
    rows = pd.DataFrame([row(c) for c in candidates], dtype=object)
    return str(rows.to_csv(index=False, lineterminator="\n"))


def row(c: Candidate) -> dict[str, Any]:
    """A candidate in plain columns."""
    numbers = {name: getattr(c, name) for name in _NUMBERS}
    strengths = {f"S {t}": s for t, s in c.strengths.items()}
    return {**c.values, **numbers, **strengths, "not held": " ".join(c.violations), "problem": c.problem}


def arrays(result: DesignResult) -> dict[str, tuple[tuple[str, ...], Any, dict[str, str]]]:
    """Values, numbers and S of all candidates: dimensions, array, units."""
    all_ = result.candidates
    targets = list(result.best.strengths)
    numbers = {
        name: (("candidate",), np.array([float(getattr(c, name)) for c in all_]), {"units": unit})
        for name, unit in zip(_NUMBERS, ("1", "1", "V", "W", "W", "kg", "1"), strict=True)
    }
    s = np.array([[c.strengths.get(t, math.nan) for t in targets] for c in all_]).reshape(len(all_), len(targets))
    varied = {v.key for v in result.design.asked.variables}
    free = {
        key: (("candidate",), np.array([float(c.values[key]) for c in all_]), {"units": "SI"})
        for key in sorted(varied)
        if all(isinstance(c.values.get(key), int | float) for c in all_)
    }
    feasible = np.array([int(c.feasible) for c in all_], dtype=np.int8)
    return {
        **free, **numbers, "strength": (("candidate", "target"), s, {"units": "1"}),
        "target": (("target",), np.array(targets, dtype=object), {}),
        "feasible": (("candidate",), feasible, {"units": "1"}),
    }  # fmt: skip


def outcome_words(result: DesignResult) -> list[str]:
    """The outcome in a few sentences."""
    best, reference, objective = result.best, result.reference, result.design.asked.objective
    what = {"mean": "Mean S", "least": "Least S", "share": "Share of targets with S above 1"}[objective.of]
    low, high = result.interval
    known = f"{strength_text(low)} to {strength_text(high)}" if math.isfinite(low + high) else "unknown"
    lines = [
        f"{what} of the {result.design.method} is {best.score:.3g} ({known} by the model's own errors, e_band of G at "
        f"most {best.error:.1g}) with {values_words(best.values)}.",
        f"The scenario's own device has {reference.score:.3g}"
        + (f" and does not hold {', '.join(reference.violations)}." if reference.violations else ".")
        if not reference.problem
        else f"The scenario's own device cannot serve: {reference.problem}.",
    ]
    if result.idle:
        lines.append(f"Without effect: {', '.join(result.idle)}. All of its choices give the winner the same numbers.")
    if (c := result.confirmation) is not None:
        lines.append(
            f"Confirmed by a full run ({c.folders[0].name}/): {c.score:.3g}, {c.difference:+.1%} off the model."
        )
    else:
        lines.append("Not confirmed by a full run (--no-confirm): what the model leaves out is in no error.")
    return lines


def values_words(values: Mapping[str, Any]) -> str:
    """Values in a line; places as their number."""
    words = []
    for key, value in values.items():
        if key == "device.contacts":
            words.append(f"{len(value)} free places (best.json)")
        else:
            words.append(f"{key} = {value:.4g}" if isinstance(value, float) else f"{key} = {value}")
    return ", ".join(words)


def design_page(result: DesignResult, pictures: Sequence[Picture] = ()) -> Page:
    """The page of a design: outcome, picture, Pareto front, and what was not feasible."""
    front = [
        {_TITLES.get(k, k): v for k, v in row(c).items() if k not in ("not held", "problem", "device.contacts")}
        for c in result.front
    ]
    columns = list(dict.fromkeys(key for r in front for key in r))
    count, bad = len(result.candidates), [c for c in result.candidates if not c.feasible]
    reasons: dict[str, int] = {}
    for c in bad:
        reason = "cannot be" if c.problem else ", ".join(c.violations) or "S unknown"
        reasons[reason] = reasons.get(reason, 0) + 1
    told = "; ".join(f"{n} {reason}" for reason, n in sorted(reasons.items(), key=lambda kv: -kv[1]))
    peak = 1e6 * result.design.asked.constraints.target_peak
    note = ("No other candidate has more S with as few actuators and as little power (all actuators together). Voltage "
            f"and power are of the actuator that needs most, for a motion of the target of {peak:g} µm.")  # fmt: skip
    sections = [
        Section("pictures", "The winner, and what it was chosen from", pictures=list(pictures)),
        Section("front", "Pareto front", Block.of(columns, front, note)),
        Section("candidates", "Candidates",
                paragraphs=[f"{count} candidates; {len(bad)} not feasible{': ' + told if told else ''}. All are in "
                            "candidates.csv."]),
    ]  # fmt: skip
    answer = [*outcome_words(result), track_record().sentence]
    return Page(f"Design {result.design.asked.name}", answer, sections, _stamp(result))


def _stamp(result: DesignResult) -> str:
    return f"design {result.design.asked.name} · forearm_fem {__version__}"
