"""Devices side by side: which of several runs focuses better on one arm, and where."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.patches import Circle

from ..errors import DataError
from ..metrics.strength import strength_text
from ..ports import positions
from ..progress import Progress, tell
from ..rendering.drives import rim_gaps
from ..transfer import total_error
from ..typing import BoolArray, FloatArray
from .answer import MethodAnswer, interval_words, method_answers, not_counted, people_words, subject_of
from .data import Results
from .facts import accuracy_words
from .judge import Strengths, plot_strength_map, strengths
from .page import Block, Page, Section, embedded
from .style import GREY, INK, single, styled

_SAME = 1e-3  # m: points this near are the same
_PEAK = 1e-6  # m: the motion of a target that volts are told for


@dataclass(frozen=True, eq=False)
class Device:
    """One run: its S, what each method reaches, and what it takes.

    ``drive`` (n_method, n_target) is the largest drive [unit] that moves a target by 1 um at its peak; ``gap`` [m] the
    nearest rim of a point that counts; ``error`` e_band of G [-].
    """

    name: str
    results: Results
    data: Strengths
    answers: tuple[MethodAnswer, ...]
    drive: FloatArray
    unit: str
    gap: float
    error: float

    @property
    def best(self) -> MethodAnswer:
        """The method that focuses at most points."""
        return self.answers[0]


@dataclass(frozen=True, eq=False)
class Devices:
    """Several runs; ``shared`` (n_target,) marks points that count in all of them, None where the grids differ."""

    devices: tuple[Device, ...]
    shared: BoolArray | None

    @property
    def ranked(self) -> tuple[Device, ...]:
        """The better first: most points in focus (of other grids the largest share), then the largest mean S."""

        def order(d: Device) -> tuple[float, float]:
            """Less is better."""
            focused = float(len(d.best.focused))
            return -(focused if self.shared is not None else focused / max(d.best.points, 1)), -self.mean(d)

        return tuple(sorted(self.devices, key=order))

    def mean(self, device: Device) -> float:
        """Mean S of a device's best method over the shared points; over its own where the grids differ."""
        values = device.data.values[device.data.methods.index(device.best.method)]
        return _mean(values[device.data.counted if self.shared is None else self.shared])


def compare_devices(folders: Sequence[str | Path], progress: Progress | None = None) -> Devices:
    """The runs in ``folders`` as devices; DataError for a folder without S and for fewer than two."""
    if len(folders) < 2:
        raise DataError(f"devices: expected at least two results folders, got {len(folders)}; name another one")
    names = _names([Path(f) for f in folders])
    found = []
    for k, (folder, name) in enumerate(zip(folders, names, strict=True)):
        tell(progress, "reading devices", k, len(folders))
        found.append(_device(name, Results.open(folder)))
    tell(progress, "reading devices", len(folders), len(folders))
    places = [positions(d.data.outputs)[:, :2] for d in found]
    alike = all(d.data.targets == found[0].data.targets for d in found) and all(
        np.abs(p - places[0]).max() < _SAME for p in places
    )
    shared = np.all([d.data.counted for d in found], axis=0) if alike else None
    return Devices(tuple(found), shared)


def are_devices(folders: Sequence[Path]) -> bool:
    """True if ``folders`` are runs of several devices: more than two, or two whose actuators stand elsewhere."""
    if not all(f.is_dir() and (f / "signal_strength.csv").is_file() for f in folders):
        return False
    if len(folders) != 2:
        return True
    a, b = (positions(Results.open(f).transfer.inputs) for f in folders)
    return a.shape != b.shape or bool(np.abs(a - b)[:, :2].max() > _SAME)


def _names(folders: Sequence[Path]) -> list[str]:
    """Names of ``folders``, with their parents where these do not tell them apart."""
    names = [f.resolve().name for f in folders]
    return names if len(set(names)) == len(names) else [str(f) for f in folders]


def _device(name: str, results: Results) -> Device:
    data, sent, moved = strengths(results), results.drives, results.displacements
    own = [moved.channels.index(t) for t in moved.targets]
    reached = np.stack([np.abs(moved.values[:, t, row]).max(axis=-1) for t, row in enumerate(own)], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        drive = np.abs(sent.values).max(axis=(2, 3)) * _PEAK / reached
    order = [[moved.methods.index(m)] for m in data.methods], [moved.targets.index(t) for t in data.targets]
    gaps = rim_gaps(data.outputs, results.touching)
    known = gaps[np.isfinite(gaps) & data.counted]
    return Device(name, results, data, method_answers(data), drive[order], sent.unit,
                  float(known.min()) if len(known) else float("nan"), total_error(results.transfer.errors))  # fmt: skip


def _mean(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def answer_lines(found: Devices) -> list[str]:
    """The verdict: which device, by how much, over which points."""
    reached = (f"{d.name} at {len(d.best.focused)} of {d.best.points} points that count ({d.best.method})"
               for d in found.ranked)  # fmt: skip
    said = [f"S > 1: {'; '.join(reached)}."]
    if found.shared is None:
        said.append("The grids differ, so S is compared as a whole only: lay the same points for both.")
    elif found.shared.any():
        points = [t for t, s in zip(found.devices[0].data.targets, found.shared, strict=True) if s]
        means = ", ".join(f"{strength_text(found.mean(d))} {d.name}" for d in found.ranked)
        some = f"the {len(points)} points that count in all ({', '.join(points)})"
        over = "all points" if found.shared.all() else some
        said.append(f"Mean S over {over}: {means}.")
    else:
        said.append("No point counts in all of them, so no mean is over the same points.")
    told = ((device.name, not_counted(device.results, device.data)) for device in found.devices)
    said += [f"{name}: {left_out}." for name, left_out in told if left_out]
    if overlap := _undecided(found):
        said.append(overlap)
    return said


def _undecided(found: Devices) -> str:
    """Said where the numerics' intervals of the two best devices' means overlap."""
    first, second, *_ = found.ranked
    spans = []
    for d in (first, second):
        m, kept = d.data.methods.index(d.best.method), d.data.counted if found.shared is None else found.shared
        spans.append((_mean(d.data.low[m, kept]), _mean(d.data.high[m, kept])))
    (low, _), (_, high) = spans
    if not np.isfinite([*spans[0], *spans[1]]).all():
        return "How far apart the two are is not known to the numerics: an interval of S is unknown."
    if low <= high and spans[1][0] <= spans[0][1]:
        return "The intervals of the two means overlap: call it a draw, or ask for a smaller `accuracy`."
    return ""


def devices_block(found: Devices) -> Block:
    """One row each."""
    rows = []
    for d in found.ranked:
        b, m = d.best, d.data.methods.index(d.best.method)
        least = f"{strength_text(b.least)} (point {b.least_at})" if b.least_at else "unknown"
        known = d.drive[m][d.data.counted & np.isfinite(d.drive[m])]
        volts = f"{known.min():.2g} to {known.max():.2g} {d.unit}" if len(known) else "unknown"
        rows.append([
            d.name, str(len(d.results.transfer.inputs)), b.method, f"{len(b.focused)} of {b.points}", least,
            strength_text(found.mean(d)), volts, f"{1e3 * d.gap:.1f} mm" if np.isfinite(d.gap) else "unknown",
            f"{100 * d.error:.2g} %" if np.isfinite(d.error) else "unknown",
        ])  # fmt: skip
    over = "the points that count in all" if found.shared is not None else "its own points that count"
    note = (f"Mean S over {over}. Drive: the largest of any actuator that moves the target by 1 µm. Clearance: from a "
            "point that counts to the nearest rim.")  # fmt: skip
    return Block(["device", "actuators", "best method", "S > 1 at", "least S", "mean S", "drive for 1 µm", "clearance",
                  "error of G"], rows, note)  # fmt: skip


def points_block(found: Devices) -> Block:
    """S at each point by each method, a column a device; brackets where a point does not count."""
    targets = list(dict.fromkeys(t for d in found.devices for t in d.data.targets))
    methods = list(dict.fromkeys(m for d in found.devices for m in d.data.methods))
    rows = [[t, m, *(_cell(d.data, m, t) for d in found.devices)] for m in methods for t in targets]
    return Block(["point", "method", *(d.name for d in found.devices)], rows,
                 "In round brackets: not counted, under or beside a motor. ± is of the numerics.")  # fmt: skip


def _cell(data: Strengths, method: str, target: str) -> str:
    if method not in data.methods or target not in data.targets:
        return "–"
    m, t = data.methods.index(method), data.targets.index(target)
    text = f"{strength_text(data.values[m, t])} {interval_words(data, m, t)}".rstrip()
    return text if data.counted[t] else f"({text})"


@styled
def plot_difference_map(found: Devices, a: Device, b: Device, *, ax: Axes | None = None) -> Axes:
    """S of ``b`` over S of ``a``, each by its best method, at the points that count in all; both devices' motors."""
    ours, theirs = (d.data.values[d.data.methods.index(d.best.method)] for d in (a, b))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = theirs / ours
    at = 1e3 * positions(a.data.outputs)[:, :2]
    motors = [(d, 1e3 * positions(d.data.inputs)[:, :2]) for d in (a, b)]
    apart = np.linalg.norm(at[:, None] - at[None], axis=2)
    radius = 0.36 * float(np.min(apart[apart > 0], initial=20.0))
    every = np.concatenate([at - radius, at + radius, *(p for _, p in motors)])
    low, high = every.min(axis=0) - 5, every.max(axis=0) + 5
    axes = single(ax, (3.0, 3.0 * float(np.clip((high - low)[1] / (high - low)[0], 0.4, 1.5))))
    size = np.abs(np.log2(ratio[np.isfinite(ratio) & (ratio > 0)]))
    norm = TwoSlopeNorm(0, -max(size.max(initial=0.1), 0.1), max(size.max(initial=0.1), 0.1))
    for (device, places), line in zip(motors, ("-", ":"), strict=True):
        for place, port in zip(places, device.data.inputs, strict=True):
            axes.add_patch(Circle(place, 1e3 * port.radius, facecolor="none", edgecolor=GREY, ls=line, lw=0.9))
    for k, (place, value) in enumerate(zip(at, ratio, strict=True)):
        counts = found.shared is not None and bool(found.shared[k]) and np.isfinite(value) and value > 0
        face = colormaps["PuOr_r"](float(norm(np.log2(value)))) if counts else "#DDDDDD"
        axes.add_patch(Circle(place, radius, facecolor=face, edgecolor=INK if counts else GREY, lw=0.5))
        if counts:
            ink = "w" if abs(float(norm(np.log2(value))) - 0.5) > 0.36 else INK
            axes.annotate(f"×{value:.2g}", place, ha="center", va="center", fontsize=7.5, color=ink)
        axes.annotate(a.data.targets[k], (place[0], place[1] - radius), (0, -1.5), textcoords="offset points",
                      ha="center", va="top", fontsize=6, color="#555555")  # fmt: skip
    axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.axis("off")
    return axes


def devices_page(found: Devices) -> Page:
    """The page of a comparison of devices."""
    first, every = found.ranked[0], [d.data.to_xarray() for d in found.devices]
    maps = []
    for d in found.devices:
        m = d.data.methods.index(d.best.method)
        notes = [interval_words(d.data, m, t) for t in range(len(d.data.targets))]
        drawn = plot_strength_map(d.data.to_xarray(), d.best.method, notes, alike=every)
        maps.append(embedded(drawn, f"{d.name}: S, {d.best.method}"))
    differences = [
        embedded(plot_difference_map(found, first, d),
                 f"S of {d.name} (dotted) over S of {first.name} (solid): orange where {d.name} is better")
        for d in found.ranked[1:] if found.shared is not None
    ]  # fmt: skip
    trust = [
        f"{d.name}: {accuracy_words(d.results)}" for d in found.devices
    ] + [people_words(first.data)]  # fmt: skip
    folders = " ".join(shlex.quote(str(d.results.folder)) for d in found.devices)
    asked = first.results.account.asked or first.results.scenario.name
    sections = [
        Section("devices", "One row each", devices_block(found)),
        Section("maps", "S on the skin", pictures=maps,
                paragraphs=["The best method of each. White is S = 1, orange more, purple less, grey not counted."]),
        Section("differences", "Where they differ", pictures=differences),
        Section("trust", "How far to trust it", bullets=trust),
        Section("next", "What to do next", commands=[
            ("See on how many people the order stays", f"forearm-fem predict {asked}"),
            ("Explore the better one in a browser", f"forearm-fem workbench {shlex.quote(str(first.results.folder))}"),
            ("Compare again with a third", f"forearm-fem compare {folders} results/THIRD"),
        ]),
        Section("points", "S at each point", points_block(found), folded=True),
        Section("what", "What they are", bullets=[f"{d.name}: {subject_of(d.results)}" for d in found.devices],
                folded=True),
    ]  # fmt: skip
    title = f"{first.name} focuses at {len(first.best.focused)} of {len(first.data.targets)} points"
    return Page(title, answer_lines(found), sections, first.results.stamp)


def devices_console(found: Devices, page: Path) -> list[str]:
    """The answer for a terminal: verdict, one row each, where to look."""
    block = devices_block(found)
    table = [block.header, *block.rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    rows = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
    return [*answer_lines(found), *rows, f"open {page}"]
