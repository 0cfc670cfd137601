"""What a design leaves in its folder: tables, pictures and a page."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from ... import __version__
from ...metrics.strength import strength_text
from ...show.page import Block, Page, Picture, Section, embedded
from ...show.registry import save_drawn
from ...store.folder import write_text
from ...store.record import save_arrays
from ...store.text import write_json
from .candidate import Candidate
from .figures import plot_devices, plot_front, plot_map
from .run import DesignResult

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
    _netcdf(result)
    pictures = []
    for name, figure in (("device", plot_devices(result)), ("front", plot_front(result)), ("map", plot_map(result))):
        if figure is not None:
            save_drawn(figure, out / name, ("png",), _stamp(result))
            pictures.append(embedded(figure, _PICTURES[name]))
    design_page(result, pictures).save(out)


def table(candidates: Sequence[Candidate]) -> str:
    """One line per candidate: its values, numbers, S by target, what does not hold."""
    rows = [row(c) for c in candidates]
    columns = list(dict.fromkeys(key for r in rows for key in r))
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def row(c: Candidate) -> dict[str, Any]:
    """A candidate in plain columns."""
    numbers = {name: getattr(c, name) for name in _NUMBERS}
    strengths = {f"S {t}": s for t, s in c.strengths.items()}
    return {**c.values, **numbers, **strengths, "not held": " ".join(c.violations), "problem": c.problem}


def _netcdf(result: DesignResult) -> None:
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
    save_arrays(
        result.folder / "candidates.nc", "design",
        {**free, **numbers, "strength": (("candidate", "target"), s, {"units": "1"}),
         "target": (("target",), np.array(targets, dtype=object), {}),
         "feasible": (("candidate",), feasible, {"units": "1"})},
        {"design": result.design.asked.name},
    )  # fmt: skip


def outcome_words(result: DesignResult) -> list[str]:
    """The outcome in a few sentences."""
    best, reference, objective = result.best, result.reference, result.design.asked.objective
    what = {"mean": "Mean S", "least": "Least S", "share": "Share of targets with S above 1"}[objective.of]
    low, high = result.interval
    known = f"{strength_text(low)} to {strength_text(high)}" if math.isfinite(low + high) else "unknown"
    lines = [
        f"{what} of the {objective.method} is {best.score:.3g} ({known} by the model's own errors, e_band of G at most "
        f"{best.error:.1g}) with {values_words(best.values)}.",
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
    return Page(f"Design {result.design.asked.name}", outcome_words(result), sections, _stamp(result))


def _stamp(result: DesignResult) -> str:
    return f"design {result.design.asked.name} · forearm_fem {__version__}"
