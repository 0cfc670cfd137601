"""Content of the report, as plain text and numbers; nothing here knows HTML or Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ..accuracy.estimates import short_verdict
from ..metrics import condition_number, condition_summary, thesis_table
from ..metrics.strength import GROUPS, strength_text
from ..ports import is_thesis_grid
from ..rendering.limits import beyond_limits, limits_of
from ..scenario import Scenario
from ..scenario.device import GridPlaces, Places
from ..transfer import entry_band_errors, percent, total_error
from ..typing import FloatArray
from .data import Results
from .judge import ERRORS, TABLE_ONE, Strengths, spreads, strengths, table_one, table_one_rows
from .page import Block

_ENGINES = {"fem": "finite elements", "layered": "layered model (semi-analytic; flat, no bone)"}


def scene_block(results: Results) -> Block:
    """Scene asked for, in a reader's words."""
    s = results.scenario
    changed = ", ".join(
        name if override.fibres in (None, 1) else f"{name} (fibres: {override.fibres:g} times as stiff along the limb)"
        for name, override in s.tissues.override.items()
    )
    own = [key for key in s.changed_keys() if key not in ("name", "description")]
    of_limb = "scenario" in results.transfer.provenance
    solved = [
        ["limb", limb_words(s)],
        ["tissues", f"preset {s.tissues.preset}" + (f"; changed: {changed}" if changed else "")],
        ["supports", f"bone {s.supports.bone}, underside {s.supports.underside}, cut ends {s.supports.ends}"],
        ["engine", _ENGINES.get(s.engine, s.engine)],
    ]
    rows = [
        *(solved if of_limb else [["G", "measured or imported: nothing is said of the limb"]]),
        ["device", _device(s)],
        ["grid", _grid(s, len(results.transfer.outputs))],
        ["sweep", f"{len(results.transfer.frequency)} frequencies, {results.transfer.frequency[0]:g} to "
                  f"{results.transfer.frequency[-1]:g} Hz"],
        ["accuracy asked", f"{100 * s.accuracy:g} % (e_band)"],
        ["keys that differ from their defaults", ", ".join(own) or "none"],
    ]  # fmt: skip
    return Block(["", ""], rows, s.description)


def limb_words(s: Scenario) -> str:
    """Shape, layers and bones of the limb."""
    inside = ", ".join(f"{x.tissue} {_mm(x.thickness)}" for x in getattr(s.limb, "layers", ()))
    core, bones = getattr(s.limb, "core", ""), ", ".join(b.name for b in getattr(s.limb, "bones", ()))
    flat = s.engine == "layered"  # which leaves bones out
    within = (inside, f"on {core}" if core else "", f"bones {bones}" if bones and not flat else "")
    told = ", ".join(part for part in within if part)
    shape = s.limb.shape
    article = "a" if shape[0] not in "aeiou" else "an"
    return f"{article} {shape}{f' of {told}' if told else ''}"


def _mm(length: float) -> str:
    return f"{1e3 * length:g} mm"


def _device(s: Scenario) -> str:
    d = s.device
    absent = f"; out of contact: {', '.join(d.out_of_contact)}" if d.out_of_contact else ""
    if isinstance(d, Places):
        arranged = f"at own places{_nearest(d.contacts)}"
    else:
        counts = d.columns if isinstance(d.columns, tuple) else (d.columns,) * d.rows
        rows = f"in rows of {', '.join(map(str, counts))}" if len(set(counts)) > 1 else f"in {d.rows} x {counts[0]}"
        across = d.spacing_y or d.spacing
        aside = f", rows staggered by {_mm(d.stagger * across)}" if d.stagger else ""
        arranged = f"{rows}, {_mm(d.spacing)}{'' if across == d.spacing else f' x {_mm(across)}'} apart{aside}"
    count = _counted(len(d.centres), "actuator")
    return (f"{count} {arranged}, {d.drive} drive, cones of {_mm(2 * d.cone.radius)} diameter, "
            f"{d.cone.contact} contact{absent}")  # fmt: skip


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _grid(s: Scenario, count: int) -> str:
    g = s.grid
    if isinstance(g, GridPlaces):
        return f"{_counted(count, 'point')} at own places{_nearest(g.points)}"
    across = g.pitch_y or g.pitch
    return f"{g.rows} x {g.columns} points, pitch {_mm(g.pitch)}{'' if across == g.pitch else f' x {_mm(across)}'}"


def _nearest(places: Sequence[tuple[float, float]]) -> str:
    """Distance of the two nearest of ``places`` (x, y) [m]; nothing for one place."""
    if len(places) < 2:
        return ""
    return f", the nearest {1e3 * min(math.dist(a, b) for a, b in combinations(places, 2)):.3g} mm apart"


def mesh_block(results: Results) -> Block | None:
    """Size, quality and resolution of the mesh; None without one."""
    facts = results.account.mesh
    if not results.has("mesh.vtu"):
        return None
    mesh = results.mesh
    rows = [
        ["vertices", f"{len(mesh.points):,}"],
        ["tetrahedra", f"{len(mesh.tetrahedra):,} ({results.scenario.element} elements)"],
        ["SHA-256", results.mesh_hash[:16]],
    ]
    if facts.quality:
        rows.append(["quality (1 = regular)", f"least {facts.quality.least:.2f}, median {facts.quality.median:.2f}"])
    for r in facts.resolution:
        near, far = r.per_wavelength_near_ports, r.per_wavelength
        rows.append([f"nodes per shear wavelength, {r.tissue}", f"{near:.1f} near the device, {far:.1f} anywhere"])
    return Block(["", ""], rows, "Six nodes per wavelength near the device are a rule of thumb, not a proof.")


def errors_block(results: Results) -> Block:
    """Estimated error of G by source, in the manual's words."""
    rows = []
    for e in results.transfer.errors:
        name, how = ERRORS.get(e.source, (e.source, e.method))
        how = how if e.known else e.method  # why it is not known
        rows.append([name, percent(e.band), percent(e.worst), how])
    if not rows:
        return Block([], [], "G carries no error estimate.")
    note = (f"Shares of the largest entry of G. {capital(accuracy_words(results))}. The manual's page on errors "
            "says what each estimate sees.")  # fmt: skip
    return Block(["source", "whole band (e_band)", "worst frequency", "estimated by"], rows, note)


def capital(text: str) -> str:
    """``text`` with a capital letter first."""
    return text[:1].upper() + text[1:]


def accuracy_words(results: Results) -> str:
    """The error of G beside what was asked for."""
    sentence, total = results.account.accuracy, total_error(results.transfer.errors)
    if not sentence:
        return "the accuracy of G is not on record"
    asked = f"{100 * results.scenario.accuracy:g} % asked"
    if math.isnan(total) or not results.transfer.errors:
        return f"the error of G is UNKNOWN ({asked}; error sources below)"
    return f"error of G {percent(total)} of {asked}: {short_verdict(sentence)}"


def matrix_block(results: Results) -> Block:
    """Size of G and how well it can be inverted."""
    g = results.transfer
    values = g.values if g.valid is None else np.where(g.valid, g.values, np.nan)
    condition = condition_number(values)
    size = np.abs(values)
    at = np.unravel_index(int(np.nanargmax(size)), size.shape)
    error, ends = entry_band_errors(g), list[tuple[np.intp, ...]]()
    if np.isfinite(error).any():  # of the best entry and of the worst
        ends = [np.unravel_index(int(find(error)), error.shape) for find in (np.nanargmin, np.nanargmax)]
    told = (f"{percent(error[o, i])} ({g.outputs[o].name} ← {g.inputs[i].name})" for o, i in ends)
    rows = [
        ["entries", f"{size.shape[1]} points × {size.shape[2]} actuators × {size.shape[0]} frequencies, {g.unit}"],
        ["largest entry", f"{1e6 * size[at]:.3g} µ{g.unit} at {g.frequency[at[0]]:g} Hz, "
                          f"{g.outputs[at[1]].name} ← {g.inputs[at[2]].name}"],
        ["condition number", condition_words(condition)],
        ["entries err by, of their own size", " to ".join(told) or "unknown"],
    ]  # fmt: skip
    return Block(["", ""], rows, "Errors of G are amplified in the drives by up to the condition number.")


def condition_words(condition: FloatArray) -> str:
    """Median and largest of ``condition`` (n,), NaN where unknown; a singular G is said to be one."""
    found = condition_summary(condition)
    if found.singular:
        at = f"{found.singular} of {found.regular + found.singular} frequencies"
        return f"infinite at {at}: an actuator moves nothing there, or two move alike"
    return "unknown" if found.median is None else f"median {found.median:.1f}, largest {found.largest:.1f}"


def renderer_block(results: Results) -> Block:
    """Per method: largest drive, power and displacement over the targets."""
    drives, moved, limits = results.drives, results.displacements, limits_of(results.scenario.device)
    rows = []
    for m, method in enumerate(drives.methods):
        peak = np.abs(drives.values[m]).max(axis=(1, 2))
        own = [np.nanmax(np.abs(moved.values[m, t, moved.channels.index(n)])) for t, n in enumerate(moved.targets)]
        mean_square = float(np.mean(drives.values[m] ** 2, axis=2).max())
        power = f"{1e3 * mean_square / limits.resistance:.2g} mW" if limits is not None else "–"
        rows.append([method, _span(peak, drives.unit), power, _span(1e6 * np.array(own), "µm")])  # fmt: skip
    header = ["method", "largest drive", "largest mean power", "target's own peak"]
    return Block(header, rows, "Ranges are over the targets. Everything is linear: scaled drives scale all alike.")


def play_block(results: Results, methods: Sequence[str]) -> Block:
    """Drives to play: per target and method the peak on each actuator, time and size of the target's motion, room."""
    drives, moved, limits = results.drives, results.displacements, limits_of(results.scenario.device)
    rows = []
    for t, target in enumerate(drives.targets):
        own = np.nan_to_num(moved.values[:, t, moved.channels.index(target)])
        for m in (drives.methods.index(name) for name in methods):
            signals = drives.values[m, t]
            peaks = signals[np.arange(len(signals)), np.abs(signals).argmax(axis=1)]
            at = int(np.abs(own[m]).argmax())
            room = "–"
            if drives.unit == "V" and limits is not None and signals.any():
                power = float(np.mean(signals**2, axis=1).max()) / limits.resistance
                room = f"{min(limits.voltage / np.abs(peaks).max(), math.sqrt(limits.power / power)):.3g} times"
            rows.append([target, drives.methods[m], *(f"{p:.3g}".replace("-", "\N{MINUS SIGN}") for p in peaks),
                         f"{1e6 * abs(own[m, at]):.2g} µm", f"{1e3 * moved.time[at]:.1f} ms", room])  # fmt: skip
    header = ["target", "method", *(f"{name} [{drives.unit}]" for name in drives.channels), "target moves",
              "its peak after t = 0", "room to a limit"]  # fmt: skip
    return Block(header, rows, "Largest value of each drive, with its sign; t = 0 is the wavelet's centre. Whole "
                               "signals: drives.nc.")  # fmt: skip


def band_words(results: Results) -> str:
    """Sentence on what the band of G cuts from the wavelet; empty where that is less than 1 % of its energy."""
    f, g = results.record.frequency, results.transfer.frequency
    inside = (f >= g[0] - 1e-6) & (f <= g[-1] + 1e-6)
    spectrum = results.wavelet.spectrum
    energy = float(np.sum(np.abs(spectrum[inside]) ** 2) / np.sum(np.abs(spectrum) ** 2))
    peak = float(np.sum(spectrum[inside].real) / np.sum(spectrum.real))
    if energy > 0.99:
        return ""
    return (f"G's band, {g[0]:g} to {g[-1]:g} Hz, cuts the wavelet: {100 * energy:.2g} % of its energy and "
            f"{100 * peak:.2g} % of its peak lie inside; what moves is longer and smaller than asked for.")  # fmt: skip


def limit_words(results: Results) -> str:
    """Sentence on drives against the limits of the actuators."""
    drives, limits = results.drives, limits_of(results.scenario.device)
    if drives.unit != "V" or limits is None:
        return "The drives are no voltages, so limits were not checked."
    peak = float(np.abs(drives.values).max()) / limits.voltage
    power = float(np.mean(drives.values**2, axis=3).max()) / limits.resistance / limits.power
    share = max(peak, np.sqrt(power))  # of the amplitude that reaches a limit
    told = (f"largest drive {100 * peak:.2g} % of {limits.voltage:g} V, mean power {100 * power:.2g} % of "
            f"{limits.power:g} W")  # fmt: skip
    if share > 1:
        return f"Beyond a limit ({told}): rendering.amplitude times {1 / share:.2g} is within."
    return f"Within all limits ({told}): the amplitude may grow {1 / share:.2g} times." if share > 0 else "All still."


def _span(values: FloatArray, unit: str) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.2g} {unit}" if np.isclose(low, high) else f"{low:.2g} to {high:.2g} {unit}"


def exceeded(results: Results) -> list[str]:
    """A sentence per method that passes a limit of the scenario, with the remedy."""
    drives, limits = results.drives, limits_of(results.scenario.device)
    if drives.unit != "V" or limits is None:
        return []
    peak = np.abs(drives.values).max(axis=3)
    power = np.mean(drives.values**2, axis=3) / limits.resistance
    return list(beyond_limits(drives.methods, drives.targets, drives.channels, peak, power, limits))


def strength_block(results: Results) -> Block | None:
    """Table I, here and in the thesis; None for a grid that is not 3 by 3."""
    data = strengths(results)
    if not is_thesis_grid(results.transfer.outputs):
        return None
    note = (f"Here: S {window_words(data)}. Record: the same motion over the whole record of "
            f"{results.scenario.sweep.duration:g} s, as the thesis may have summed it; that reading grows with the "
            "record, as the edges of the band ring on. Thesis: one participant (P2), by laser vibrometer.")  # fmt: skip
    if data.arms is not None:
        note += f" Arms: 5-95 % of the group's mean S over {data.arms['draws']} arms, apart from the numerics."
    return Block(list(TABLE_ONE), table_one_rows(table_one(data)), note)


def window_words(data: Strengths) -> str:
    """Window of S in words."""
    if not data.window:
        return "over a window that the folder does not name"
    if data.window == "record":
        return "over the whole record, as in the thesis"
    return f"over {data.window} about the wavelet's centre".replace("-", "\N{MINUS SIGN}")


def by_target_block(results: Results) -> Block:
    """S of every target with its numerical interval, and what edges of the band and holes of G do to it."""
    data = strengths(results)
    account = results.account.signal_strength
    holes = account.largest("holes")[0] > 0
    rows = []
    for t, target in enumerate(data.targets):
        cells = [target if data.counted[t] else f"({target})"]
        for m, method in enumerate(data.methods):
            low, high = data.low[m, t], data.high[m, t]
            known = np.isfinite(low) and np.isfinite(high)
            ends = f"{strength_text(low)} to {strength_text(high)}"
            same = strength_text(low) == strength_text(high)  # narrower than the digits shown
            span = " (unknown)" if not known else "" if same else f" ({ends})"
            entry = account.methods.get(method, {}).get(target) if holes else None
            lost = f", holes ± {entry.holes:.2g}" if entry and entry.holes else ""
            cells.append(f"{strength_text(data.values[m, t])}{spreads(data, method, target) or span}{lost}")
        rows.append(cells)
    said = ["In brackets: S within the errors stated for G, nine in ten of them, where that moves a digit shown; "
            "how arms differ is not in it."]  # fmt: skip
    if data.arms is not None:
        said = [
            "Numerics: S within the errors stated for G, nine in ten of them. Arms: 5-95 % of "
            f"{data.arms['draws']} arms ({data.arms['model']}; {data.arms['left_out']}). Never add the two."
        ]
    said += ["A point in brackets is not counted: under or beside a motor."] if not data.counted.all() else []
    said += [f"{capital(account.unknown)}."] if account.unknown else []
    said += [f"S is taken {window_words(data)}."]
    edge, where = account.largest("edges")
    if where:
        said += [f"With the edges of the band tapered S changes by at most {edge:.0%} ({where})."]
    if holes:
        worst, at = account.largest("holes")
        said += [f"Holes of G that could not be bridged may have cost up to {worst:.0%} of S ({at}), given per S."]
    return Block(["target", *data.methods], rows, " ".join(said))


def differences(results: Results) -> list[str]:
    """A sentence for each entry of Table I that differs by more than the thesis' own spread and our interval, and one
    on those that agree."""
    data = strengths(results)
    if not is_thesis_grid(results.transfer.outputs):
        return []
    ours, theirs = data.table(), thesis_table()
    error = _group_error(data)
    lines, alike = [], []
    for g, group in enumerate(ours.groups):
        for m, method in enumerate(ours.methods):
            if group in theirs.groups and method in theirs.methods:
                at = (theirs.groups.index(group), theirs.methods.index(method))
                here, there = float(ours.mean[g, m]), float(theirs.mean[at])
                line = _difference(group, method, here, there, float(theirs.std[at]), error.get((group, method)))
                lines += [line] if line else []
                alike += [] if line else [f"{group}, {method} ({here:.2f} here, {there:.2f} in the thesis)"]
    said = [f"Alike within the thesis' spread and our interval, or 5 %: {'; '.join(alike)}."] if alike else []
    return [*lines, *said]


def _group_error(data: Strengths) -> dict[tuple[str, str], float]:
    """Mean half width of the intervals of S over a group's targets; NaN where one is unknown."""
    out = {}
    for label, members in GROUPS:
        columns = [i for i, t in enumerate(data.targets) if t in members and data.counted[i]]
        for m, method in enumerate(data.methods):
            if columns:
                out[label, method] = float(np.mean((data.high - data.low)[m, columns]) / 2)
    return out


def _difference(group: str, method: str, ours: float, theirs: float, spread: float, error: float | None) -> str:
    gap, room = abs(ours - theirs), float(np.nansum([spread, error if error is not None else np.nan]))
    if gap <= max(room, 0.05 * theirs):
        return ""
    way = "above" if ours > theirs else "below"
    stated = error is not None and np.isfinite(error)
    known = f"; our own interval is ±{max(error, 0.01):.2f}" if stated and error else "; our own interval is unknown"
    among = "one value, so its spread is unknown" if np.isnan(spread) else f"spread {spread:.2g}"
    side = " The verdict on focusing (S > 1) differs." if (ours > 1) != (theirs > 1) else ""
    return (f"{group}, {method}: {ours:.2f} here, {theirs:.2f} in the thesis ({among}); {gap / theirs:.0%} "
            f"{way}{known}.{side}")  # fmt: skip


def warnings_of(results: Results) -> list[str]:
    """Notes of the run, each once."""
    account = results.account
    notes = [*account.notes, *account.warnings]
    if not results.has("run.json"):
        notes.append("run.json is missing: cost, notes and verdict on accuracy of this run are unknown.")
    return list(dict.fromkeys(notes))


def cost_block(results: Results) -> Block | None:
    """Seconds and memory per stage."""
    stages = results.account.stages
    rows = [[name, f"{s.seconds:.1f} s", f"{s.peak_memory_bytes / 1e9:.2f} GB"] for name, s in stages.items()]
    return Block(["stage", "wall clock", "peak memory"], rows) if rows else None


def provenance_block(results: Results) -> Block:
    """Provenance of these results."""
    rows = [["forearm_fem", results.version], ["scene", results.scenario.name], ["mesh SHA-256", results.mesh_hash]]
    account = results.account
    rows += [["direct solver", account.solution.solver or ""], *([k, v] for k, v in account.versions.items())]
    return Block(["", ""], [r for r in rows if r[1]])
