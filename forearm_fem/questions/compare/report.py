"""The comparison as tables, JSON and pictures."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...show.style import ACTUATORS, GREY, INK, MICRO, SIZE, decimal, letter, micro, sign, single, styled
from ...store.folder import atomic_path, set_kind, write_text
from ...store.text import markdown_table
from .agreement import fdac_matrix
from .common import CommonGround
from .compare import Comparison, comparison_record
from .crossplay import CrossPlay

FILES = ("comparison.json", "comparison.csv", "comparison.md", "comparison.png")
_SIDES = (("A", ACTUATORS[0], "-"), ("B", ACTUATORS[5], "--"))
_COLUMNS = ("output", "input", "e", "dB_rms", "dB_bias", "phase_rad", "delay_s", "FRAC", "misfit_in_sigma")


def as_json(c: Comparison, asked: Mapping[str, Any] | None = None) -> str:
    """All numbers as JSON, after what was ``asked``; what is unknown is null."""
    return json.dumps({"asked": asked or {}, **comparison_record(c)}, indent=1, allow_nan=False)


def as_csv(c: Comparison) -> str:
    """One line per entry; empty cells are unknown."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS)
    entries = comparison_record(c)["entries"]
    writer.writerows([row[k] if row[k] is not None else "" for k in _COLUMNS] for row in entries)
    return stream.getvalue()


def as_markdown(c: Comparison) -> str:
    """The comparison for people: what was compared, the overall numbers, entries, condition and S."""
    s = comparison_record(c)
    parts = [
        f"# {s['B']} against {s['A']}",
        *(f"**Note:** {note}." for note in s["notes"]),
        _ground(s),
        _overall(s),
        _entries(s),
        _condition(s),
        _strengths(c),
    ]
    return "\n\n".join(part.rstrip("\n") for part in parts) + "\n"


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


def _overall(s: dict[str, Any]) -> str:
    o = s["overall"]
    rows = [
        ("e_band", o["e_band"], "norm of the difference over the norm of A, whole band and matrix"),
        ("worst e(f)", o["worst_e_f"], "largest difference over largest |A| at one frequency"),
        ("FRAC", o["FRAC"], "1 if B is a constant times A"),
        ("misfit", o["misfit_in_sigma"], "rms difference in standard deviations; 1 = noise alone"),
    ]
    return markdown_table(("figure", "value", "meaning"), [(n, _number(v), m) for n, v, m in rows])


def _entries(s: dict[str, Any]) -> str:
    header = ("entry", "e", "dB rms", "dB mean", "phase rms [rad]", "delay [ms]", "FRAC")
    rows = [
        (
            f"{r['output']} <- {r['input']}",
            _number(r["e"]),
            _number(r["dB_rms"]),
            _number(r["dB_bias"]),
            _number(r["phase_rad"]),
            _number(None if r["delay_s"] is None else 1e3 * r["delay_s"]),
            _number(r["FRAC"]),
        )
        for r in s["entries"]
    ]
    return markdown_table(header, rows)


def _condition(s: dict[str, Any]) -> str:
    rows = [(n, *(_number(v) for v in s["condition_number"][n].values())) for n in ("A", "B")]
    return markdown_table(("condition number", "smallest", "median", "largest", "frequencies where infinite"), rows)


def _strengths(c: Comparison) -> str:
    if c.crossed is None:
        return f"Signal strength: {c.not_crossed}."
    x = c.crossed
    header = ("S, mean over targets", "A on A", "B on B", "A on B", "B on A", "worth")
    arrays = (x.a_on_a, x.b_on_b, x.a_on_b, x.b_on_a, x.worth)
    table = markdown_table(header, [(m, *(_number(_mean(a[j])) for a in arrays)) for j, m in enumerate(x.methods)])
    return f"{table.rstrip()}\n\nS by {x.how}.\n"


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
    for name, text in zip(FILES, (as_json(c, asked), as_csv(c), as_markdown(c)), strict=False):
        write_text(target / name, text)
    with atomic_path(target / FILES[-1]) as beside:
        picture(c).savefig(beside, dpi=200)
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
