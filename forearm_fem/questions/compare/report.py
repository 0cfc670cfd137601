"""The comparison as tables, JSON and pictures."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ... import __version__
from ...files.declaration import arbitrary_gain
from ...metrics.common_ground import CommonGround
from ...metrics.strength import strength_text
from ...ports import positions
from ...rendering.limits import counted_points, not_counted_words
from ...scenario.model import shipped_scenarios
from ...show.page import Block, Page, Section, embedded
from ...show.style import ACTUATORS, GREY, INK, MICRO, SIZE, decimal, letter, micro, panels, sign, single, styled
from ...store.folder import atomic_path, set_kind, write_text
from ...typing import BoolArray
from .agreement import fdac_matrix, percent, where_words
from .compare import Comparison, CrossPlay, comparison_record

FILES = ("comparison.json", "comparison.csv", "comparison.png", "comparison.md", "comparison.html")
_SIDES = (("A", ACTUATORS[0], "-"), ("B", ACTUATORS[5], "--"))
_DARK = 0.6  # of the scale: names on darker colours are white
_COLUMNS = ("output", "input", "e", "dB_rms", "dB_bias", "phase_rad", "delay_s", "FRAC", "misfit_in_sigma")


def as_json(c: Comparison, asked: Mapping[str, Any] | None = None) -> str:
    """All numbers as JSON, after what was ``asked``; what is unknown is null."""
    return json.dumps({"asked": asked or {}, **comparison_record(c)}, indent=1, allow_nan=False)


def as_csv(c: Comparison) -> str:
    """One line per entry; empty cells are unknown."""
    table = pd.DataFrame(comparison_record(c)["entries"], columns=list(_COLUMNS))
    return str(table.to_csv(index=False, lineterminator="\n"))


def as_markdown(c: Comparison, asked: Mapping[str, Any] | None = None) -> str:
    """The short form of :func:`comparison_page`."""
    return comparison_page(c, asked, drawn=False).markdown()


def comparison_page(c: Comparison, asked: Mapping[str, Any] | None = None, *, drawn: bool = True) -> Page:
    """The comparison for people: how far apart, where, the likeliest cause and S first; entry by entry folded.

    Pictures, most of its time, are left out unless ``drawn``: the short form has none.
    """
    s = comparison_record(c)
    first, second = c.names
    warnings = [f"{named(c, note)}." for note in c.notes if note != c.where.cause]
    differ = drawn and bool(np.nanmax(c.where.error, initial=0.0) > 0)
    sections = [
        Section("where", "Where they differ", block=_bands(c), pictures=[
            embedded(plot_where(c), f"Difference of {second} from {first}, of the largest entry in each band: discs "
                     "are points (over all actuators), squares actuators (over all points)")] if differ else []),
        Section("strength", "Signal strength S", **_strengths(c)),
        Section("notes", "What to know first", bullets=warnings, warn=True),
        Section("next", "What to do next", commands=_next(c, asked or {})),
        Section("overall", "Overall", _overall(s), [_ground(s)], folded=True),
        Section("entries", "Entry by entry", _entries(s), folded=True),
        Section("condition", "Condition number", _condition(s), folded=True),
    ]  # fmt: skip
    if drawn:
        shown = [embedded(picture(c), "")]
        sections.append(Section("picture", "Worst entry, e(f), patterns and S", pictures=shown, folded=True))
    return Page(f"{second} against {first}", answer_lines(c), sections, f"forearm_fem {__version__}")


def _next(c: Comparison, asked: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Commands for the two files where they are known, else with a word to replace."""
    files = [str((asked.get(side) or [None])[0] or side) for side in "AB"]
    scenes = [p["scenario"]["name"] if isinstance(p.get("scenario"), Mapping) else "" for p in c.ground.provenance]
    side = 0 if scenes[1] and not scenes[0] else 1
    named = scenes[0] or scenes[1] or "SCENARIO"
    scene = named if named in ("SCENARIO", *shipped_scenarios()) else shlex.quote(f"{named}.toml")
    measured = shlex.quote(files[side])
    said = ((asked.get("AB"[side]) or [None, None])[1:] or [None])[0] or {}
    plain = {k: v for k, v in said.items() if isinstance(v, str | int | float) and not isinstance(v, bool)}
    declared = "".join(f" --declare {shlex.quote(f'{k}={v!r}')}" for k, v in plain.items())
    tissues = "skin.mu fat.mu muscle.mu"
    return [
        ("Fit tissue and gains", f"forearm-fem fit {scene} {measured} {tissues} gains delay{declared}"),
        ("Get drives and S of one of them", f"forearm-fem render {measured} --scenario {scene}{declared}"),
        ("Explore it in a browser", f"forearm-fem workbench {measured}"),
    ]  # fmt: skip


def console_lines(c: Comparison, folder: Path) -> list[str]:
    """The answer for a terminal: how far apart, where, why, S, and where to look."""
    return [*answer_lines(c), *(f"note: {named(c, note)}" for note in c.notes), f"open {folder / 'comparison.html'}"]


def answer_lines(c: Comparison) -> list[str]:
    """Answer: distance, where, the likeliest cause, what either states of its own error, and S of both."""
    first, second = c.names
    stated = f"Of itself {first} states: {c.stated[0]}; {second}: {c.stated[1]}."
    if any(arbitrary_gain(provenance) for provenance in c.ground.provenance):  # sizes mean nothing
        alike = f"{c.agreement.overall_frac:.2f}"
        return [f"{second} and {first} are compared by shape, as a gain is arbitrary: overall FRAC {alike} (1 is the "
                "same but for a factor).", stated, strength_words(c)]  # fmt: skip
    size, g = percent(c.agreement.band) if np.isfinite(c.agreement.band) else "an unknown share", c.ground
    over = f" over {g.frequency[0]:g} to {g.frequency[-1]:g} Hz, which both know" if g.only_a or g.only_b else ""
    cause = [f"Likeliest cause: {named(c, c.where.cause)}."] if c.where.cause else []
    place = where_words(c.where, c.ground)
    return [f"{second} differs from {first} by {size} (e_band){over}. {place}.", *cause, stated, strength_words(c)]


def named(c: Comparison, text: str) -> str:
    """``text`` with the names of the two in place of A and B."""
    return re.sub(r"\b[AB]\b", lambda found: c.names[found.group() == "B"], text)


def strength_words(c: Comparison) -> str:
    """S of both over the same points, and what drives made for the one are worth on the other."""
    if c.crossed is None:
        return f"S was not compared: {c.not_crossed}."
    x, (first, second) = c.crossed, c.names
    kept, left_out = compared_targets(c)
    if not kept.any():
        return "S was not compared: no point that counts is known to both."
    points = [t for t, k in zip(x.targets, kept, strict=True) if k]
    best = int(np.argmax([np.mean(row[kept]) for row in x.a_on_a]))
    over = f"over all {len(points)} points" if not left_out else f"over the same {len(points)} points for both"
    told = (f"S {over}, {x.methods[best]}: {np.mean(x.a_on_a[best, kept]):.2f} on {first}, "
            f"{np.mean(x.b_on_b[best, kept]):.2f} on {second}; drives made for {first} keep "
            f"{np.mean(x.worth[best, kept]):.0%} of that on {second}.")  # fmt: skip
    return f"{told} {left_out}" if left_out else told


def compared_targets(c: Comparison) -> tuple[BoolArray, str]:
    """True where both S are of a target (n_target,), and a sentence on those left out."""
    assert c.crossed is not None
    x = c.crossed
    known: BoolArray = np.min(np.isfinite(np.vstack([x.a_on_a, x.b_on_b, x.a_on_b, x.b_on_a])), axis=0)
    by_name = {p.name: p for p in c.ground.outputs}
    counted = counted_points([by_name[t] for t in x.targets], c.ground.inputs)
    unknown = [p.name for p, k in zip(c.ground.outputs, c.ground.whole_outputs, strict=True) if not k]
    unknown += [t for t, k in zip(x.targets, known, strict=True) if not k and t not in unknown]
    beside = [t for t, k, n in zip(x.targets, known, counted, strict=True) if k and not n]
    which = f"point{'' if len(unknown) == 1 else 's'} {', '.join(unknown)}"
    said = [f"left out of both, as one of them does not know all of it: {which}"] if unknown else []
    said += [not_counted_words(beside, c.ground.outputs, c.ground.inputs)] if beside else []
    return known & counted, f"{'; '.join(said)}.".capitalize() if said else ""


def _bands(c: Comparison) -> Block:
    """The three entries that differ most in each band."""
    rows = []
    for (low, high), error in zip(c.where.bands, c.where.error, strict=True):
        order = np.argsort(-np.nan_to_num(error), axis=None)[:3]
        worst = [np.unravel_index(int(k), error.shape) for k in order]
        told = ", ".join(f"{c.ground.outputs[o].name} <- {c.ground.inputs[i].name} ({percent(error[o, i])})"
                         for o, i in worst if np.isfinite(error[o, i]))  # fmt: skip
        rows.append([f"{low:.3g} to {high:.3g}", told])
    return Block(["band [Hz]", "differ most, of the largest entry in the band"], rows)


def _ground(s: dict[str, Any]) -> str:
    f = s["frequencies"]
    text = (
        f"{f['common']} common frequencies, {f['first_Hz']:g} to {f['last_Hz']:g} Hz; "
        f"{100 * f['entries_compared']:.1f} % of the entries compared"
    )
    text += f"; {f['interpolated'].upper()} interpolated" if f["interpolated"] else ""
    for name in ("A", "B"):
        text += "".join(f"; {lo:g}-{hi:g} Hz only in {name}" for lo, hi in f[f"only_in_{name}_Hz"])
    return text + "."


def _overall(s: dict[str, Any]) -> Block:
    o = s["overall"]
    rows = [
        ("e_band", o["e_band"], "norm of the difference over the norm of A, whole band and matrix"),
        ("worst e(f)", o["worst_e_f"], "largest difference over largest |A| at one frequency"),
        ("FRAC", o["FRAC"], "1 if B is a constant times A"),
        ("misfit", o["misfit_in_sigma"], "rms difference in standard deviations; 1 = noise alone"),
    ]
    return Block(["figure", "value", "meaning"], [[n, _number(v), m] for n, v, m in rows])


def _entries(s: dict[str, Any]) -> Block:
    header = ["entry", "e", "dB rms", "dB mean", "phase rms [rad]", "delay [ms]", "FRAC"]
    rows = [
        [
            f"{r['output']} <- {r['input']}",
            _number(r["e"]),
            _number(r["dB_rms"]),
            _number(r["dB_bias"]),
            _number(r["phase_rad"]),
            _number(None if r["delay_s"] is None else 1e3 * r["delay_s"]),
            _number(r["FRAC"]),
        ]
        for r in s["entries"]
    ]
    return Block(header, rows)


def _condition(s: dict[str, Any]) -> Block:
    rows = [[n, *(_number(v) for v in s["condition_number"][n].values())] for n in ("A", "B")]
    return Block(["condition number", "smallest", "median", "largest", "frequencies where infinite"], rows)


def _strengths(c: Comparison) -> dict[str, Any]:
    """Data of the section on S."""
    if c.crossed is None:
        return {"paragraphs": [f"Signal strength: {c.not_crossed}."]}
    x = c.crossed
    kept, left_out = compared_targets(c)
    a, b = c.names
    header = ["S, mean over the same points", a, b, f"drives for {a} on {b}", f"drives for {b} on {a}", f"kept on {b}"]
    arrays = (x.a_on_a, x.b_on_b, x.a_on_b, x.b_on_a, x.worth)
    means = [[_mean(s[j, kept]) for s in arrays] for j in range(len(x.methods))]
    cells = [["-" if s is None else strength_text(s) for s in row] for row in means]
    rows = [[m, *row] for m, row in zip(x.methods, cells, strict=True)]
    note = f"Kept: S of drives for {a}, over S of drives made for {b}, both played on {b}. S by {x.how}."
    return {"block": Block(header, rows, f"{left_out} {note}".strip())}


def _mean(row: Any) -> float | None:
    known = row[np.isfinite(row)]
    return float(known.mean()) if len(known) else None


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


@styled
def plot_overlay(ground: CommonGround, output: int, source: int, *, ax: Axes | None = None) -> Axes:
    """|G| of one entry of A and B over frequency; gaps stay gaps."""
    ax = single(ax)
    for (name, colour, line), values in zip(_SIDES, (ground.a, ground.b), strict=True):
        size = np.abs(values[:, output, source])
        size = np.where(ground.valid[:, output, source] & (size > 0), size, np.nan)
        ax.loglog(ground.frequency, MICRO * size, line, color=colour, label=name)
    label = f"point {ground.outputs[output].name} from {ground.inputs[source].name}"
    ax.set(xlabel="frequency [Hz]", ylabel=f"|G| [{micro(ground.unit)}]", title=label)
    ax.legend()
    _band(ax, ground)
    return ax


@styled
def plot_where(c: Comparison) -> Figure:
    """Map of the differences, seen from above, a panel a band: discs are points, squares actuators."""
    found, ground = c.where, c.ground
    at, coils = (1e3 * positions(p)[:, :2] for p in (ground.outputs, ground.inputs))
    if not np.isfinite([*at.ravel(), *coils.ravel()]).all():  # places are unknown: points in a row, actuators below
        at = np.column_stack([10.0 * np.arange(len(ground.outputs)), np.full(len(ground.outputs), 10.0)])
        coils = np.column_stack([10.0 * np.arange(len(ground.inputs)), np.zeros(len(ground.inputs))])
    every = np.concatenate([at, coils])
    low, high = every.min(axis=0) - 8, every.max(axis=0) + 8
    wide = 1.75
    tall = float(np.clip((high - low)[1] / (high - low)[0], 0.4, 1.5))
    figure = panels((wide * len(found.bands) + 0.7, wide * tall + 0.3))
    axes = np.atleast_1d(figure.subplots(1, len(found.bands)))
    with np.errstate(invalid="ignore"):
        by_point, by_coil = (np.sqrt(np.nanmean(found.error**2, axis=k)) for k in (2, 1))
    norm = Normalize(0, float(np.nanmax([by_point.max(initial=0), by_coil.max(initial=0)])) or 1.0)
    look: dict[str, Any] = {"cmap": "YlOrBr", "norm": norm, "edgecolors": INK, "linewidths": 0.5}
    for panel, (start, end), points, motors in zip(axes, found.bands, by_point, by_coil, strict=True):
        panel.scatter(*at.T, c=points, s=150, **look)
        panel.scatter(*coils.T, c=motors, s=170, marker="s", **look)
        for places, ports, errors in ((at, ground.outputs, points), (coils, ground.inputs, motors)):
            for place, port, error in zip(places, ports, errors, strict=True):
                ink = "white" if norm(error) > _DARK else INK
                panel.annotate(port.name, place, ha="center", va="center", fontsize=6, color=ink)
        panel.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]), title=f"{start:.3g}–{end:.3g} Hz")
        panel.axis("off")
    bar = figure.colorbar(ScalarMappable(norm, "YlOrBr"), ax=list(axes), shrink=0.9, fraction=0.04)
    bar.set_label("difference over largest |G| [-]")
    return figure


@styled
def plot_difference(c: Comparison, *, ax: Axes | None = None) -> Axes:
    """e(f) over frequency, and e_band as a line across."""
    ax = single(ax)
    differ = bool(np.nanmax(c.agreement.per_frequency, initial=0) > 0)  # A on A: nothing that a logarithm could show
    (ax.loglog if differ else ax.semilogx)(c.ground.frequency, c.agreement.per_frequency, color=INK)
    if c.agreement.band > 0:
        ax.axhline(c.agreement.band, color=GREY, ls="--", lw=0.8, label=f"e_band {c.agreement.band:.2g}")
        ax.legend()
    ax.set(xlabel="frequency [Hz]", ylabel="e(f)", title="difference over largest |A|")
    _band(ax, c.ground)
    if differ:
        decimal(ax.yaxis)
    return ax


@styled
def plot_fdac(ground: CommonGround, *, ax: Axes | None = None) -> Axes:
    """FDAC between all frequencies of A and B, at most 200 of each; a ridge off the dotted diagonal is a shift."""
    ax = single(ax)
    step = max(1, len(ground.frequency) // 200)
    f = ground.frequency[::step]
    matrix = fdac_matrix(ground)[::step, ::step]
    image = ax.pcolormesh(f, f, matrix, cmap=SIZE, vmin=0, vmax=1, shading="nearest", rasterized=True)
    ax.plot(f[[0, -1]], f[[0, -1]], ":", color="white", lw=0.8)
    ax.set(xlabel="frequency of B [Hz]", ylabel="frequency of A [Hz]", title="likeness of patterns (FDAC)")
    ax.set_aspect("equal")
    ax.grid(False)
    ax.figure.colorbar(image, ax=ax, ticks=(0, 0.5, 1), shrink=0.9)
    return ax


@styled
def plot_cross_play(x: CrossPlay, *, ax: Axes | None = None) -> Axes:
    """Mean S per method: full colours for each G's own drives, faint ones for those designed on the other."""
    ax = single(ax)
    (_, blue, _), (_, red, _) = _SIDES
    rows = (
        ("A on A", x.a_on_a, blue, 1.0), ("B on B", x.b_on_b, red, 1.0),
        ("A on B", x.a_on_b, red, 0.4), ("B on A", x.b_on_a, blue, 0.4),
    )  # fmt: skip
    place = np.arange(len(x.methods))
    for k, (label, s, colour, alpha) in enumerate(rows):
        heights = [np.nan if (mean := _mean(row)) is None else mean for row in s]
        ax.bar(place + 0.2 * (k - 1.5), heights, 0.18, label=label, color=colour, alpha=alpha)
    ax.set_xticks(place, [m.replace(", ", ",\n") for m in x.methods])
    ax.tick_params(axis="x", length=0)
    ax.grid(False, axis="x")
    ax.set(ylabel="signal strength S", title="drives of one played on the other")
    ax.axhline(1, lw=0.6, color=GREY, zorder=0)
    ax.margins(y=0.25)
    ax.legend(ncols=2)
    return ax


def _band(ax: Axes, ground: CommonGround) -> None:
    """The common band over the whole width, with plain numbers."""
    if len(ground.frequency) > 1:
        ax.set_xlim(float(ground.frequency[0]), float(ground.frequency[-1]))
    decimal(ax.xaxis)


def save_report(c: Comparison, folder: str | Path, asked: Mapping[str, Any] | None = None) -> tuple[Path, ...]:
    """:data:`FILES` in ``folder``, each whole or absent, in place of an earlier comparison's."""
    target = Path(folder)
    set_kind(target, "comparison", asked, FILES)
    for name, text in zip(FILES, (as_json(c, asked), as_csv(c)), strict=False):
        write_text(target / name, text)
    with atomic_path(target / "comparison.png") as beside:
        picture(c).savefig(beside, dpi=200)
    comparison_page(c, asked).save(target, "comparison")
    return tuple(target / name for name in FILES)


@styled
def picture(c: Comparison) -> Figure:
    """All of the comparison on one figure: worst entry, e(f), FDAC, and S crossed where there is any."""
    worst = np.unravel_index(np.argmax(np.nan_to_num(c.agreement.error)), c.agreement.error.shape)
    figure = Figure(figsize=(7.0, 5.2), layout="constrained")
    grid = figure.subplots(2, 2).ravel()
    plot_overlay(c.ground, int(worst[0]), int(worst[1]), ax=grid[0])
    plot_difference(c, ax=grid[1])
    plot_fdac(c.ground, ax=grid[2])
    if c.crossed is not None:
        plot_cross_play(c.crossed, ax=grid[3])
    else:
        grid[3].set_axis_off()
    for ax, text in zip(grid, "abcd" if c.crossed is not None else "abc", strict=False):
        letter(ax, text)
    sign(figure, f"A {c.names[0]}, B {c.names[1]}; a: the entry that differs most")
    return figure
