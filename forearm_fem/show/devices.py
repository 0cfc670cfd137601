"""Devices side by side: which of several runs focuses better on one arm, and where."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.patches import Circle
from scipy.stats import binomtest

from ..errors import DataError
from ..metrics.strength import strength_text
from ..ports import positions
from ..progress import Progress, tell
from ..rendering.limits import rim_gaps
from ..results.draws import DRAWS_FILE, DrawsFile
from ..store.record import load
from ..transfer import percent, total_error
from ..typing import BoolArray, FloatArray
from .answer import (
    MethodAnswer,
    asked_of,
    interval_words,
    just_counted,
    method_answers,
    named,
    not_counted,
    subject_of,
    track_record,
)
from .data import Results
from .facts import accuracy_words
from .judge import Strengths, aspect, disc_radius, draw_points, plot_strength_map, strengths
from .page import Block, Page, Section, embedded
from .style import GREY, single, styled

_SAME = 1e-3  # m: points this near are the same
_PEAK = 1e-6  # m: the motion of a target that volts are told for
DRAWS = f"prediction/{DRAWS_FILE}"


@dataclass(frozen=True, eq=False)
class Device:
    """One run: its S, what each method reaches, and what it takes.

    ``drive`` (n_method, n_target) is the largest drive [unit] that moves a target by 1 um at its peak; ``gap`` [m] the
    least distance of a point from a rim; ``error`` e_band of G [-].
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
        """The better first: largest share of points in focus, then largest mean S, both over :meth:`judged` points."""

        def order(d: Device) -> tuple[float, float]:
            """Less is better."""
            values = d.data.values[d.data.methods.index(d.best.method), self.judged(d)]
            return -float((values > 1).sum()) / max(len(values), 1), -self.mean(d)

        return tuple(sorted(self.devices, key=order))

    def judged(self, device: Device) -> BoolArray:
        """Points (n_target,) of ``device`` that count in all; its own that count where there are none or grids differ.

        A point beside a motor of one device says nothing of the other.
        """
        return self.shared if self.shared is not None and self.shared.any() else device.data.counted

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
    known = gaps[np.isfinite(gaps)]
    return Device(name, results, data, method_answers(data), drive[order], sent.unit,
                  float(known.min()) if len(known) else float("nan"), total_error(results.transfer.errors))  # fmt: skip


def _mean(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def answer_lines(found: Devices) -> list[str]:
    """The verdict: which device, why, by how much over the same points, and on how many arms."""
    first, second, *_ = found.ranked
    said = [f"{_verdict(found)}."]
    for d in found.ranked:
        reached = f"{d.name} focuses (S > 1) at {len(d.best.focused)} of {len(d.data.targets)} points ({d.best.method})"
        left_out = not_counted(d.results, d.data)
        near = just_counted(d.results, d.data)
        said.append(f"{reached}{'; ' if left_out else ''}{left_out}.{' ' if near else ''}{near}")
    if found.shared is None:
        said.append("The grids differ, so S is compared as a whole only: lay the same points for both.")
    elif found.shared.any():
        points = [t for t, s in zip(first.data.targets, found.shared, strict=True) if s]
        means = ", ".join(f"{strength_text(found.mean(d))} {d.name}" for d in found.ranked)
        some = f"the {len(points)} points that count in all ({', '.join(points)})"
        over = "all points" if found.shared.all() else some
        said.append(f"Mean S over {over}: {means}.")
    else:
        said.append("No point counts in all of them, so no mean is over the same points.")
    said.append(_people_line(found, first, second))
    return said


def _verdict(found: Devices) -> str:
    """Title: the better device and why, or a draw; over the points that count in both."""
    first, second, *_ = found.ranked
    if found.shared is None or not found.shared.any():
        reached = [f"{len(d.best.focused)} of {d.best.points} points" for d in (first, second)]
        why = "The grids differ" if found.shared is None else "No point counts in both"
        return f"{why}: {first.name} focuses at {reached[0]}, {second.name} at {reached[1]}"
    low, high = (_mean_interval(found, d) for d in (first, second))
    (focused, _), (_, at_most) = (_focused(found, d) for d in (first, second))
    if focused > at_most:
        why = f"it focuses at {focused} of the {int(found.shared.sum())} points that count in both, not {at_most}"
    elif low[0] > high[1]:
        why = "its mean S where both count is larger beyond the numerics' error"
    elif np.isfinite([*low, *high]).all():
        return f"A draw between {first.name} and {second.name}, as far as the numerics tell{_alone(found)}"
    else:
        return f"Undecided between {first.name} and {second.name}: an interval of S is unknown"
    flat = all(d.results.scenario.engine == "layered" for d in found.devices)
    arm = "a flat arm without bones" if flat else "this arm"
    return f"{first.name} is better than {second.name} on {arm}: {why}{_alone(found)}"


def _alone(found: Devices) -> str:
    """Clauses on points that count for one of the best two alone; empty where there are none."""
    said = ""
    for d in found.ranked[:2]:
        if points := [t for t, own, s in zip(d.data.targets, d.data.counted, found.judged(d), strict=True) if own > s]:
            said += f"; {named(points)} count{'s' if len(points) == 1 else ''} for {d.name} alone"
    return said


def _focused(found: Devices, d: Device) -> tuple[int, int]:
    """Judged points at which the best method's S is above 1, and at which the numerics leave that open, too."""
    m, kept = d.data.methods.index(d.best.method), found.judged(d)
    return int((d.data.low[m, kept] > 1).sum()), int((~(d.data.high[m, kept] <= 1)).sum())


def _mean_interval(found: Devices, d: Device) -> tuple[float, float]:
    """Interval of the mean S of a device's best method over the points that count."""
    m, kept = d.data.methods.index(d.best.method), d.data.counted if found.shared is None else found.shared
    return _mean(d.data.low[m, kept]), _mean(d.data.high[m, kept])


@dataclass(frozen=True, eq=False)
class SameArms:
    """S of two devices on the same drawn arms.

    ``ratio`` (n_arm, n_method, n_target) is S of the second over S of the first; ``mean`` (n_arm,) that of their means
    over the shared points, each device by its best method.
    """

    ratio: FloatArray
    mean: FloatArray


def same_arms(found: Devices, a: Device, b: Device) -> SameArms | None:
    """Both devices on the arms that both folders' predictions drew; None without two predictions of the same arms."""
    if found.shared is None or not found.shared.any() or not all(d.results.has(DRAWS) for d in (a, b)):
        return None
    files = [load(d.results.path(DRAWS), DrawsFile) for d in (a, b)]
    good = [{n: k for k, n in enumerate(f.draw.tolist()) if not f.problem[k]} for f in files]
    both = sorted(good[0].keys() & good[1].keys())
    names = [n for n in files[0].driver if n in files[1].driver]
    rows = [np.array([g[n] for n in both], dtype=int) for g in good]
    drawn = [f.drivers[r][:, [f.driver.index(n) for n in names]] for f, r in zip(files, rows, strict=True)]
    alike = [tuple(f.law[k] for k in r) for f, r in zip(files, rows, strict=True)]
    if not both or alike[0] != alike[1] or not np.allclose(drawn[0], drawn[1], rtol=1e-6, equal_nan=True):
        return None
    methods, targets = a.data.methods, a.data.targets
    if any(set(methods) - set(f.method) or set(targets) - set(f.target) for f in files):
        return None
    played = [
        f.strengths[r, f.reading.index("played")][:, [f.method.index(m) for m in methods]][
            :, :, [f.target.index(t) for t in targets]
        ]
        for f, r in zip(files, rows, strict=True)
    ]
    best = [methods.index(d.best.method) for d in (a, b)]
    means = [s[:, m, found.shared].mean(axis=1) for s, m in zip(played, best, strict=True)]
    return SameArms(played[1] / played[0], means[1] / means[0])


def _people_line(found: Devices, first: Device, second: Device) -> str:
    """On how many arms the order of the two stays, or how that is found."""
    arms = same_arms(found, first, second)
    if arms is None and all(d.results.has(DRAWS) for d in (first, second)):
        return "The two predictions drew other arms: predict both with the same --seed, --law and --hold."
    if arms is None:
        return (f"People differ by about a factor of {track_record().width:.2g}, but both devices meet the same arm: "
                "draw arms for both (below) and compare again to see on how many the order stays.")
    low, middle, high = np.quantile(arms.mean, (0.05, 0.5, 0.95))
    share = binomtest(int((arms.mean < 1).sum()), len(arms.mean))
    between = share.proportion_ci(method="wilson")
    return (f"On {len(arms.mean)} drawn arms, the same for both, {first.name} has the larger mean S over the shared "
            f"points on {100 * share.statistic:.0f} % ({100 * between.low:.0f} to {100 * between.high:.0f} % by their "
            f"number); {second.name} has {middle:.2f} times its S ({low:.2f} to "
            f"{high:.2f} on 90 % of arms).")  # fmt: skip


def ratios_block(found: Devices, a: Device, b: Device) -> Block:
    """S of ``b`` over S of ``a`` at every point by each method, with the numerics' interval and the arms' agreement."""
    assert found.shared is not None
    arms, shared = same_arms(found, a, b), found.shared
    methods = [m for m in a.data.methods if m in b.data.methods]
    rows = []
    for t, target in enumerate(a.data.targets):
        cells = []
        for method in methods:
            i, j = a.data.methods.index(method), b.data.methods.index(method)
            with np.errstate(divide="ignore", invalid="ignore"):
                middle = b.data.values[j, t] / a.data.values[i, t]
                low, high = b.data.low[j, t] / a.data.high[i, t], b.data.high[j, t] / a.data.low[i, t]
            if not shared[t]:
                lost = [d.name for d in (a, b) if not d.data.counted[t]]
                cells.append(f"not counted for {' and '.join(lost)}")
                continue
            text = f"×{middle:.2f}{_brackets(low, high)}" if np.isfinite(middle) else "unknown"
            if arms is not None:
                text += f"; {100 * (arms.ratio[:, i, t] > 1).mean():.0f} % of arms above 1"
            cells.append(text)
        rows.append([target, *cells])
    note = f"Above 1: {b.name} is better. In brackets the numerics' interval, where two decimals show it."
    return Block(["point", *methods], rows, note)


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
            _with_interval(found, d), volts, f"{1e3 * d.gap:.1f} mm" if np.isfinite(d.gap) else "unknown",
            percent(d.error),
        ])  # fmt: skip
    over = "the points that count in all" if found.shared is not None else "its own points that count"
    note = (f"Mean S over {over}. Drive: the largest of any actuator that moves the target by 1 µm. Clearance: the "
            "least from a point to a motor's rim.")  # fmt: skip
    return Block(["device", "actuators", "best method", "S > 1 at", "least S", "mean S", "drive for 1 µm", "clearance",
                  "error of G"], rows, note)  # fmt: skip


def _with_interval(found: Devices, d: Device) -> str:
    low, high = _mean_interval(found, d)
    return f"{strength_text(found.mean(d))}{_brackets(low, high)}"


def _brackets(low: float, high: float) -> str:
    """E.g. `` (1.30 to 1.32)``; empty where the second decimal does not move."""
    if not np.isfinite([low, high]).all():
        return " (interval unknown)"
    return f" ({low:.2f} to {high:.2f})" if f"{low:.2f}" != f"{high:.2f}" else ""


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
def plot_difference_map(found: Devices, a: Device, b: Device, method: str, *, ax: Axes | None = None) -> Axes:
    """S of ``b`` over S of ``a`` by ``method`` at the points that count in all; both devices' motors."""
    ours, theirs = (d.data.values[d.data.methods.index(method)] for d in (a, b))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = theirs / ours
    at = 1e3 * positions(a.data.outputs)[:, :2]
    motors = [(d, 1e3 * positions(d.data.inputs)[:, :2]) for d in (a, b)]
    radius = disc_radius(at)
    every = np.concatenate([at - radius, at + radius, *(p for _, p in motors)])
    low, high = every.min(axis=0) - 5, every.max(axis=0) + 5
    axes = single(ax, (3.0, 3.0 * aspect(low, high)))
    norm = TwoSlopeNorm(0, -1, 1)  # a factor of two, for all maps
    for (device, places), line in zip(motors, ("-", ":"), strict=True):
        for place, port in zip(places, device.data.inputs, strict=True):
            axes.add_patch(Circle(place, 1e3 * port.radius, facecolor="none", edgecolor=GREY, ls=line, lw=0.9))
    shared = np.zeros(len(at), dtype=bool) if found.shared is None else found.shared
    counted = shared & np.isfinite(ratio) & (ratio > 0)
    words = [f"×{value:.2f}" if counts else "" for value, counts in zip(ratio, counted, strict=True)]
    draw_points(axes, at, radius, ratio, norm, counted, words, a.data.targets)
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
    against: list[Section] = []
    for d in found.ranked[1:] if found.shared is not None else ():
        pictures = [
            embedded(plot_difference_map(found, first, d, m),
                     f"{m}: S of {d.name} (dotted) over S of {first.name} (solid), orange where {d.name} is better")
            for m in first.data.methods if m in d.data.methods
        ]  # fmt: skip
        against.append(Section(f"against-{len(against) + 1}", f"{d.name} against {first.name}, point by point",
                               ratios_block(found, first, d), pictures=pictures))  # fmt: skip
    trust = [
        f"{d.name}: {accuracy_words(d.results)}" for d in found.devices
    ] + [
        "The grid is the same for all, so more points stand clear of a wider device's motors. Points that do not "
        "count still stand in the denominator of S at the others. A grid that scales with the device (`--set "
        "grid.pitch=...`) asks another question, and its answer may differ.",
    ]  # fmt: skip
    bare = [d for d in found.devices if not d.results.has(DRAWS)]
    folders = " ".join(shlex.quote(str(d.results.folder)) for d in found.devices)
    sections = [
        Section("devices", "One row each", devices_block(found)),
        Section("maps", "S on the skin", pictures=maps,
                paragraphs=["The best method of each. White is S = 1, orange more, purple less, grey not counted."]),
        *against,
        Section("trust", "How far to trust it", bullets=trust),
        Section("next", "What to do next", commands=[
            *((f"Draw arms for {d.name}; the others meet the same ones",
               f"forearm-fem predict {asked_of(d.results)} --out {shlex.quote(str(d.results.folder))}") for d in bare),
            *([("Compare again, now on the same arms", f"forearm-fem compare {folders}")] if bare else []),
            ("Explore the better one in a browser", f"forearm-fem workbench {shlex.quote(str(first.results.folder))}"),
        ]),
        Section("points", "S at each point", points_block(found), folded=True),
        Section("what", "What they are", bullets=[f"{d.name}: {subject_of(d.results)}" for d in found.devices],
                folded=True),
    ]  # fmt: skip
    verdict, *others = answer_lines(found)
    return Page(verdict.removesuffix("."), others, sections, first.results.stamp)


def devices_console(found: Devices, page: Path) -> list[str]:
    """The answer for a terminal: verdict, one row each, where to look."""
    block = devices_block(found)
    table = [block.header, *block.rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    rows = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in table]
    return [*answer_lines(found), *rows, f"open {page}"]
