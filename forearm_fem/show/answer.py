"""The answer of a run: where it focuses, by which method, how far to trust it, and what to do next."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from typing import Any, Self

import numpy as np

from ..metrics.strength import strength_text
from ..ports import positions
from ..rendering.limits import not_counted_words, rim_gaps
from ..scenario import Scenario
from ..scenario.model import shipped_scenarios
from .data import Results
from .facts import _device, _grid, accuracy_words, capital, limb_words
from .judge import Strengths, strengths

FILE = "track_record.json"
PAGE = "docs/trust.md"


@dataclass(frozen=True)
class TrackRecord:
    """Record of bands of 5-95 % over ``arms`` of the layered model: how much of the thesis they held.

    entries, deviations : of Table I's nine means of S and its six, as the rig reports them, over the wavelet's window
    findings : of so many ``compared`` others that no law was fitted to
    width, joint, score : factor to either side, distance of the nine over the arms' median, their log score
    """

    arms: int
    entries: int
    deviations: int
    findings: int
    compared: int
    width: float
    joint: float
    score: float

    @classmethod
    def of(cls, validation: Mapping[str, Any]) -> Self:
        """The record that :func:`forearm_fem.questions.predict.validate.validate` found."""
        found = validation["table_one"]["window"]["all"]
        other = [t for t in validation["targets"] if t.get("all") is not None and not t["fitted"]]
        return cls(
            found["draws"], found["inside"], sum(d["inside"] for d in found["deviations"]),
            sum(t["all"]["inside"] for t in other), len(other), round(found["width"], 2), round(found["distance"], 2),
            round(found["score"], 1),
        )  # fmt: skip

    @property
    def sentence(self) -> str:
        """One line for reports."""
        return (
            f"Of published values {self.entries} of 9 S of one person and {self.findings} of {self.compared} other "
            f"findings lay inside such bands of the layered model; more in {PAGE}."
        )

    def as_text(self) -> str:
        """The file's text."""
        return json.dumps({f.name: getattr(self, f.name) for f in fields(self)}, indent=1) + "\n"


@cache
def track_record() -> TrackRecord:
    """The record that comes with the program; ``benchmarks/track_record.py`` makes it."""
    return TrackRecord(**json.loads(files("forearm_fem").joinpath(FILE).read_text(encoding="utf-8")))


_NEAR = 3e-3  # m: beyond the clearance, from a motor's rim to a point that counts
_SURE = 0.005  # relative half width below which an interval is not worth its room


@dataclass(frozen=True)
class MethodAnswer:
    """Result of one method over the points that count.

    ``focused`` are the points where S > 1, ``open`` those whose interval holds 1, ``unknown`` those without S;
    ``mean`` and ``least`` are of the others, NaN where there are none; ``least_at`` names the point of the least.
    """

    method: str
    points: int
    focused: tuple[str, ...]
    open: tuple[str, ...]
    unknown: tuple[str, ...]
    mean: float
    least: float
    least_at: str


def method_answers(data: Strengths) -> tuple[MethodAnswer, ...]:
    """The methods, the best first: most points focused, then the largest mean."""
    found = []
    for m, method in enumerate(data.methods):
        at = [i for i in range(len(data.targets)) if data.counted[i]]
        values = data.values[m]
        known = [i for i in at if not np.isnan(values[i])]
        finite = [i for i in known if np.isfinite(values[i])]
        least = min(known, key=lambda i: float(values[i]), default=None)
        found.append(
            MethodAnswer(
                method, len(at),
                tuple(data.targets[i] for i in known if values[i] > 1),
                tuple(data.targets[i] for i in known if data.low[m, i] <= 1 <= data.high[m, i]),
                tuple(data.targets[i] for i in at if i not in known),
                float(values[finite].mean()) if finite else math.nan,
                math.nan if least is None else float(values[least]),
                "" if least is None else data.targets[least],
            )
        )  # fmt: skip
    return tuple(sorted(found, key=lambda a: (-len(a.focused), -np.nan_to_num(a.mean))))


def headline(data: Strengths) -> str:
    """E.g. ``focuses (S > 1) at 6 of 7 points``."""
    best = method_answers(data)[0]
    if not best.points:
        return "no point can be judged"
    if not best.focused:
        return f"focuses (S > 1) at none of {_points(best.points)}"
    return f"focuses (S > 1) at {len(best.focused)} of {_points(best.points)}"


def _points(count: int) -> str:
    return f"{count} point{'' if count == 1 else 's'}"


def answer_of(results: Results, data: Strengths) -> list[str]:
    """The verdict in sentences: where, which method, what the numerics leave open, what is not counted."""
    best, *rest = method_answers(data)
    said = []
    if best.points:
        means = f"mean S {strength_text(best.mean)}" if not math.isnan(best.mean) else "mean S unknown"
        least = f", least {strength_text(best.least)} at point {best.least_at}" if best.points > 1 else ""
        which = "best method" if rest else "method"
        said.append(f"{capital(headline(data))}; {which} {best.method}: {means}{least}.")
    else:
        said.append(f"{capital(headline(data))}: every point lies under or beside a motor.")
    if best.open:
        said.append(f"The numerics leave open whether S is above 1 at {named(best.open)} ({best.method}).")
    if best.unknown:
        said.append(f"S of {best.method} is unknown at {named(best.unknown)}.")
    if left_out := not_counted(results, data):
        said.append(f"{capital(left_out)}.")
    if near := just_counted(results, data):
        said.append(near)
    return said


def not_counted(results: Results, data: Strengths) -> str:
    """Points in no mean and no verdict, and why; empty where all count."""
    names = [t for t, counts in zip(data.targets, data.counted, strict=True) if not counts]
    return not_counted_words(names, data.outputs, results.touching, results.scenario.rendering.clearance)


def just_counted(results: Results, data: Strengths) -> str:
    """Sentence on points that count by less than :data:`_NEAR`, with the mean S of the best method without them; empty
    where all lie further off."""
    margin = rim_gaps(data.outputs, results.touching) - results.scenario.rendering.clearance
    near = data.counted & (margin < _NEAR)
    if not near.any():
        return ""
    low, high = (f"{1e3 * max(float(end), 0.0):.1f}" for end in (margin[near].min(), margin[near].max()))
    names = named([t for t, n in zip(data.targets, near, strict=True) if n])
    best = method_answers(data)[0].method
    others = data.values[data.methods.index(best), data.counted & ~near]
    verb, them = ("lies", "it") if near.sum() == 1 else ("lie", "them")
    mean = f"; without {them} mean S of {best} is {others.mean():.2f}" if len(others) else ""
    by, least = low if low == high else f"{low} to {high}", 1e3 * results.scenario.rendering.clearance
    return (f"{capital(names)} {verb} only {by} mm beyond the {least:g} mm from a motor at which points begin to "
            f"count. A motor so near raises S{mean}.")  # fmt: skip


def named(points: Sequence[str]) -> str:
    """Points by their names, e.g. "points 1, 3"."""
    return f"point{'' if len(points) == 1 else 's'} {', '.join(points)}"


def subject_of(results: Results) -> str:
    """Device and arm in words."""
    s, g = results.scenario, results.transfer
    if is_measured(results):
        return (f"A measured or imported G of {len(g.outputs)} points and {len(g.inputs)} actuators, "
                f"{g.frequency[0]:g} to {g.frequency[-1]:g} Hz.")  # fmt: skip
    engine = {"fem": "finite elements", "layered": "the layered model (flat layers, no bone)"}.get(s.engine, s.engine)
    return (f"{_device(s)}, on {limb_words(s)}; {_grid(s, len(g.outputs))}. Solved by {engine}, {g.frequency[0]:g} to "
            f"{g.frequency[-1]:g} Hz.")  # fmt: skip


def is_measured(results: Results) -> bool:
    """True if G came from outside, so that nothing is known of the limb."""
    return "scenario" not in results.transfer.provenance and not results.has("compliance")


def half_widths(data: Strengths) -> np.ndarray:
    """Half widths (n_method, n_target) of the intervals of S, of S itself; NaN where unknown or not counted."""
    with np.errstate(divide="ignore", invalid="ignore"):
        half = np.maximum(data.high - data.values, data.values - data.low) / data.values
    return np.where(data.counted, half, np.nan)


def interval_words(data: Strengths, m: int, t: int) -> str:
    """E.g. ``±0.12``; empty where S does not move in its second decimal, ``±?`` where the interval is unknown."""
    value, low, high = data.values[m, t], data.low[m, t], data.high[m, t]
    if not np.isfinite(value):
        return ""
    if not (np.isfinite(low) and np.isfinite(high)):
        return "±?"
    half = max(high - value, value - low)
    return "" if half < 0.005 else f"±{half:.2f}" if half < 0.995 else f"±{half:.1f}"


def trust_of(results: Results, data: Strengths) -> str:
    """One line: how wrong the numerics may be, and that people differ."""
    half = half_widths(data)
    if is_measured(results) and not np.isfinite(half).any():
        return f"This G states no errors, so the uncertainty of S is unknown. {others_words()}"
    if np.isfinite(half).any():
        m, t = np.unravel_index(int(np.nanargmax(half)), half.shape)
        worst = float(half[m, t])
        size = "less than 0.5 %" if worst < _SURE else f"up to {100 * worst:.2g} %"
        where = "" if worst < _SURE else f" ({data.methods[m]}, point {data.targets[t]})"
        numerics = f"The numerics leave S uncertain by {size}{where}"
    else:
        numerics = "How wrong the numerics may leave S is unknown"
        if why := results.account.signal_strength.unknown:
            numerics += f": {why}"
    if is_measured(results):
        return f"{numerics.replace('numerics leave', 'errors stated for G leave')}. {others_words()}"
    return f"{numerics}; {accuracy_words(results)}. {people_words(data)}"


def others_words() -> str:
    """Spread of people about the one arm that was measured."""
    record = track_record()
    return (f"S is of the arm that was measured; others differ by about a factor of {record.width:.2g} to either side. "
            f"{record.sentence}")  # fmt: skip


def people_words(data: Strengths) -> str:
    """Effect of arms on S: of a prediction where the folder holds one, else that it is not included."""
    record = track_record()
    if data.arms is None:
        return (f"People differ by about a factor of {record.width:.2g} to either side, not included: `forearm-fem "
                f"predict`. {record.sentence}")  # fmt: skip
    best = method_answers(data)[0].method
    group, cell = next(iter(data.arms["by_group"][best].items()))
    return (f"People differ: over {data.arms['draws']} arms S of {best}, {group}, is {cell['arms'][0]:.2g} to "
            f"{cell['arms'][-1]:.2g} on the skin (5-95 %, apart from the numerics). {record.sentence}")  # fmt: skip


def asked_of(results: Results) -> str:
    """The scenario as a command names it, with what was set."""
    if results.account.asked:
        return results.account.asked
    name = results.scenario.name
    return name if name in shipped_scenarios() else f"{name}.toml"


def next_steps(results: Results, data: Strengths) -> list[tuple[str, str]]:
    """Three commands that can be copied, each with what it is for."""
    folder, asked = shlex.quote(str(results.folder)), asked_of(results)
    steps = [("Explore the waves in a browser", f"forearm-fem workbench {folder}")]
    if is_measured(results):
        steps.append(("Simulate the thesis' device, in seconds",
                      "forearm-fem run thesis --set engine=layered --out results/simulated"))  # fmt: skip
        steps.append(("See where the two differ", f"forearm-fem compare results/simulated {folder}"))
    elif data.arms is None:
        steps.append(("See what S people will have", f"forearm-fem predict {asked}"))
    if results.scenario.engine == "layered" and not is_measured(results):
        steps.append(("Solve the same with bones and curvature", f"forearm-fem run {_finite_elements(asked)}"))
    steps.append(("Make every figure with its numbers", f"forearm-fem figures {folder}"))
    return steps[:3]


def _finite_elements(asked: str) -> str:
    words = shlex.split(asked)
    kept: list[str] = []
    for word in words:
        if word == "engine=layered" and kept[-1:] == ["--set"]:
            kept.pop()
        else:
            kept.append(word)
    return shlex.join(kept if len(kept) < len(words) else [*kept, "--set", "engine=fem"])


def console_lines(results: Results, seconds: float | None = None) -> list[str]:
    """About eight lines for a terminal: headline, S by point, accuracy, where to look."""
    data = strengths(results)
    first, *more = answer_of(results, data)
    lines = [f"{results.scenario.name}: {first[:1].lower()}{first[1:]}", *more, *_strength_lines(data)]
    took = "" if seconds is None else f" ({seconds:.0f} s)"
    page = results.folder / "report.html"
    where = f"open {page}" if page.is_file() else f"results: {results.folder}"
    return [*lines, trust_of(results, data), f"{where}{took}"]


def _strength_lines(data: Strengths) -> list[str]:
    """S by point and method in columns; only least, mean and largest of many points."""
    answers = {a.method: a for a in method_answers(data)}
    if len(data.targets) <= 12:
        names = (t if counts else f"({t})" for t, counts in zip(data.targets, data.counted, strict=True))
        header = ["S at point", *names, "mean"]
        rows = [[m, *map(strength_text, values), strength_text(answers[m].mean)]
                for m, values in zip(data.methods, data.values, strict=True)]  # fmt: skip
    else:
        header = ["S", "S > 1 at", "least", "mean"]
        rows = [[a.method, f"{len(a.focused)} of {a.points}", f"{a.least:.2f} ({a.least_at})", f"{a.mean:.2f}"]
                for a in answers.values()]  # fmt: skip
    widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
    return ["  ".join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))])
            for row in (header, *rows)]  # fmt: skip


def beside_thesis(results: Results) -> bool:
    """True if G is of the device of the thesis' Table I, by the scenario and by the places that G itself states."""
    g = results.transfer
    own = (positions(ports)[:, :2] for ports in (g.inputs, g.outputs))
    return is_thesis_device(results.scenario) and _thesis_places(*(map(tuple, at.tolist()) for at in own))


def is_thesis_device(scenario: Scenario) -> bool:
    """True if the actuators are those of the thesis' Table I: 2 x 2, 45 mm apart, over points 13.3 mm apart."""
    d = scenario.device
    return not d.out_of_contact and _thesis_places(d.centres, scenario.grid.places)


def _thesis_places(feet: Iterable[tuple[float, ...]], places: Iterable[tuple[float, ...]]) -> bool:
    square = sorted((x, y) for x in (-0.0225, 0.0225) for y in (-0.0225, 0.0225))
    points = sorted((x, y) for x in (-0.0133, 0.0, 0.0133) for y in (-0.0133, 0.0, 0.0133))
    pairs = ((sorted(_rounded(feet)), square), (sorted(_rounded(places)), points))
    return all(len(a) == len(b) and np.allclose(a, b, atol=5e-4) for a, b in pairs)


def _rounded(places: Iterable[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """To a tenth of a millimetre, so that rounding does not change their order."""
    return [tuple(round(x, 4) + 0.0 for x in place) for place in places]
