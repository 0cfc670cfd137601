"""The device: drives and limits, impedance, figure 4, and the waves towards a target (figures 6 and 7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from scipy.interpolate import griddata

from ..device import driving_point_impedance
from ..device import respond as loop_response
from ..errors import DataError, NotApplicable
from ..measurement.estimators import ExponentialSweep
from ..ports import positions
from ..rendering import Record, on_record_bins, respond, to_spectrum
from ..rendering.limits import limits_of
from ..typing import FloatArray
from .data import Results, places
from .matrix import shown, unwrapped, zero_points
from .motion import drive_series, signal_of, volar_patch
from .style import (
    ACTUATORS,
    COLUMN,
    FAINT,
    GREY,
    INK,
    LINES,
    MICRO,
    PAGE,
    SIGNED,
    decimal,
    letter,
    method_look,
    minus,
    round_down_125,
    sheet,
    single,
    styled,
)


def impedance(results: Results) -> xr.Dataset:
    """Driving points of a run (frequency, actuator): ``skin`` F / v under the cone, and ``electrical`` V / I where the
    drive is a voltage. Needs the compliance."""
    compliance, device = results.compliance, results.scenario.device
    dims = ("frequency", "actuator")
    found = {"skin": (dims, driving_point_impedance(compliance), {"units": "Ns_per_m"})}
    if device.drive == "voltage":
        found["electrical"] = (dims, loop_response(compliance, device).input_impedance, {"units": "ohm"})
    names = [compliance.ports[i].name for i in compliance.indices("contact")]
    return xr.Dataset(found, {"frequency": ("frequency", compliance.frequency, {"units": "Hz"}), "actuator": names})


@styled
def plot_impedance(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """Size and phase of the skin's impedance under each cone, and the impedance the amplifier sees."""
    n = len(data.data_vars) + 1
    figure = sheet(width, 69 if width > COLUMN else 52 * n)
    axes = figure.subplots(1, n) if width > COLUMN else figure.subplots(n, 1)
    for k, name in enumerate(data.actuator.values):
        look: dict[str, Any] = {"color": ACTUATORS[k % len(ACTUATORS)], "ls": LINES[k % 4], "label": name}
        skin = data.skin.values[:, k]
        axes[0].plot(data.frequency, np.abs(skin), **look)
        axes[1].plot(data.frequency, np.angle(skin, deg=True), **look)
        if "electrical" in data:
            axes[2].plot(data.frequency, np.abs(data.electrical.values[:, k]), **look)
    axes[0].set(ylabel="|Z| of the skin under a cone [N s/m]", yscale="log")
    axes[1].set(ylabel="phase of Z [degrees]", yticks=(-90, -45, 0, 45, 90), ylim=(-95, 95))
    axes[0].legend(title="actuator", ncols=2)
    decimal(axes[0].yaxis)
    if "electrical" in data:
        axes[2].set_ylabel("electrical |V / I|, others at 0 V [Ω]")
    for panel, text in zip(axes, "abc", strict=False):
        panel.set_xlabel("frequency [Hz]")
        letter(panel, text)
    return figure


def drive_levels(results: Results, target: str | None = None) -> xr.Dataset:
    """Drives of a run: ``drive`` (method, actuator, time) towards one ``target`` (default: 5, or the first), and
    ``peak`` and mean ``power`` [W] (method, target) of the most loaded actuator.

    Attributes: the target shown, ``max_peak`` and ``max_power``. Limits and power are NaN where the drive is no
    voltage.
    """
    drives = results.drives
    limits = limits_of(results.scenario.device) if drives.unit == "V" else None
    chosen = target or ("5" if "5" in drives.targets else drives.targets[0])
    mean_square = np.mean(drives.values**2, axis=3).max(axis=2)
    signals = drives.values[:, drives.targets.index(chosen)]
    keep = active_span(signals.reshape(-1, signals.shape[-1]), drives.time)
    unit, by_target = {"units": drives.unit}, ("method", "target")
    power = np.full(mean_square.shape, np.nan) if limits is None else mean_square / limits.resistance
    return xr.Dataset(
        {"drive": (("method", "actuator", "time"), signals[:, :, keep], unit),
         "peak": (by_target, np.abs(drives.values).max(axis=(2, 3)), unit),
         "power": (by_target, power, {"units": "W"})},
        {"method": list(drives.methods), "target": list(drives.targets), "actuator": list(drives.channels),
         "time": ("time", drives.time[keep], {"units": "s"})},
        {"target": chosen, "max_peak": np.nan if limits is None else limits.voltage,
         "max_power": np.nan if limits is None else limits.power},
    )  # fmt: skip


def active_span(signals: FloatArray, time: FloatArray, share: float = 0.995, least: float = 0.01) -> slice:
    """The samples around t = 0 that hold ``share`` of the energy of the rows of ``signals`` (m, n_t).

    At least ``least`` [s] to each side.
    """
    energy = np.sum(np.nan_to_num(signals) ** 2, axis=0)
    done = np.cumsum(energy) / max(float(energy.sum()), np.finfo(float).tiny)
    first, last = np.searchsorted(done, [(1 - share) / 2, (1 + share) / 2])
    left = min(int(first), int(np.searchsorted(time, -least)))
    right = max(int(last), int(np.searchsorted(time, least)))
    return slice(left, min(right + 1, len(time)))


@styled
def plot_drives(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """Drives towards one target over time with the voltage limit; peak and power of all targets below."""
    methods = list(data.method.values)
    n, wide = len(methods), width > COLUMN
    figure = sheet(width, 122 if wide else 42 * (n + 2))
    grid = figure.add_gridspec(2, 2 * n) if wide else figure.add_gridspec(n + 2, 1)
    shown = [figure.add_subplot(grid[0, 2 * m : 2 * m + 2] if wide else grid[m, 0]) for m in range(n)]
    for m, (panel, method) in enumerate(zip(shown, methods, strict=True)):
        signals = data.drive.values[m]
        for k, name in enumerate(data.actuator.values):
            panel.plot(1e3 * data.time, signals[k], color=ACTUATORS[k % 6], ls=LINES[k % 4], label=name)
        panel.set_xlabel("time [ms]")
        if np.isfinite(data.max_peak) and np.abs(data.drive).max() > 0.3 * data.max_peak:
            for sign in (-1, 1):
                panel.axhline(sign * data.max_peak, color=GREY, ls="--", lw=0.8)
        panel.set_title(f"{method}, target {data.attrs['target']}")
        panel.set_ylabel(f"drive [{data.drive.units}]" if m == 0 or not wide else "")
    below = (grid[1, :n], grid[1, n:]) if wide else (grid[n, 0], grid[n + 1, 0])
    left, right = (figure.add_subplot(place) for place in below)
    _by_target(left, data.peak, data.max_peak, f"largest peak [{data.peak.units}]")
    _by_target(right, data.power, data.max_power, "largest mean power [W]")
    handles, labels = shown[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    left.legend(loc="lower left", bbox_to_anchor=(0, 1.06), ncols=n, columnspacing=1.0)
    return figure


def _by_target(ax: Axes, values: xr.DataArray, limit: float, label: str) -> None:
    methods, place = list(values.method.values), np.arange(values.sizes["target"])
    for m, method in enumerate(methods):
        shift = 0.2 * (m - (len(methods) - 1) / 2)
        colour, marker, _ = method_look(method, methods)
        ax.plot(place + shift, values[m], marker, color=colour, label=method)
    ax.set_xticks(place, list(values.target.values))
    known = values.values[np.isfinite(values.values)]  # none of powers where the drive is no voltage
    ax.set(xlabel="target", ylabel=label, yscale="log" if len(known) and known.min() > 0 else "linear")
    if len(known) and 0 < known.max() < 1e3 * known.min():
        decimal(ax.yaxis)
    if np.isfinite(limit):
        ax.axhline(limit, color=GREY, ls="--", lw=0.8)
        ax.annotate(f"limit {limit:g}", (1, limit), xycoords=("axes fraction", "data"), ha="right", va="bottom",
                    fontsize=7, color=GREY)  # fmt: skip


_TARGET, _POINT, _MOTOR = "#D55E00", INK, ACTUATORS[0]


def method(results: Results) -> xr.Dataset:
    """Entry G_11 under the scenario's sweep, and the inverse filter's drives of target 5 (or the first).

    ``wanted`` and ``reached`` (control, time) [m], ``drive`` (input, time); ``sweep`` and ``response`` over
    ``sweep_time``; ``entry`` over ``frequency``.
    """
    g, moved, sent = results.transfer, results.displacements, results.drives
    if "inverse filter" not in sent.methods:
        raise NotApplicable(f"{results.folder}: the inverse filter was not rendered; figure 4 shows it")
    target = "5" if "5" in sent.targets else sent.targets[0]
    at = (sent.methods.index("inverse filter"), sent.targets.index(target))
    on_record = results.account.signal_strength.zeros.get("inverse filter", {}).get(target)
    controls = (target, *(on_record or zero_points(g, target)))
    keep = active_span(sent.values[at], sent.time)
    wanted = np.zeros((len(controls), len(sent.time)))
    wanted[0] = 1e-6 * results.scenario.rendering.amplitude * results.wavelet.samples
    sweep = ExponentialSweep.of(results.scenario)
    controlled, metres, driven = ("control", "time"), {"units": "m"}, {"units": sent.unit}
    return xr.Dataset(
        {"wanted": (controlled, wanted[:, keep], metres),
         "reached": (controlled, moved.values[at][[moved.channels.index(c) for c in controls]][:, keep], metres),
         "drive": (("input", "time"), sent.values[at][:, keep], driven),
         "sweep": ("sweep_time", sweep.samples(), driven),
         "response": ("sweep_time", _response(results, sweep), metres),
         "entry": ("frequency", shown(g)[:, 0, 0], {"units": g.unit})},
        {"control": list(controls), "time": ("time", sent.time[keep], {"units": "s"}),
         "sweep_time": ("sweep_time", np.arange(sweep.n) / sweep.sample_rate, {"units": "s"}),
         "frequency": ("frequency", g.frequency, {"units": "Hz"}), **places(g.outputs, g.inputs)},
    )  # fmt: skip


def _response(results: Results, sweep: ExponentialSweep) -> FloatArray:
    """Motion (n_t,) [m] of the first point under the sweep on the first actuator."""
    record = Record(sweep.sample_rate, sweep.n)
    placed = on_record_bins(results.transfer, record)
    spectrum = np.zeros((len(placed.bins.index), len(results.transfer.inputs)), dtype=complex)
    spectrum[:, 0] = to_spectrum(sweep.samples(), record)[placed.bins.index]
    return np.asarray(respond(placed, spectrum)[0])


@styled
def plot_method(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """One entry of G from a sweep (top), and from controls to drives to what the points do (bottom)."""
    wide, rows = width > COLUMN, max(data.sizes["control"], data.sizes["input"])
    above, below = 58 if wide else 84, 18 + 13 * rows
    figure = sheet(width, above + below)
    top, bottom = figure.subfigures(2, 1, height_ratios=(above, below), squeeze=False)[:, 0]
    _entry(top, data, wide)
    _filter(bottom, data, rows, wide)
    return figure


def _entry(figure: Any, data: xr.Dataset, wide: bool) -> None:
    shape: dict[str, Any] = {"width_ratios": (0.9, 1, 1, 1.1)} if wide else {"height_ratios": (1, 1)}
    where, drive, response, entry = figure.subplots(*((1, 4) if wide else (2, 2)), **shape).ravel()
    point, motor = str(data.output.values[0]), str(data.input.values[0])
    aim = [_TARGET if name == data.control.values[0] else GREY for name in data.output.values]
    motors = [ACTUATORS[k % 6] for k in range(data.sizes["input"])]
    for side, mark, edges in (("output", "o", [_POINT, *aim[1:]]), ("input", "s", motors)):
        at = 1e3 * data[f"{side}_place"].values
        where.scatter(at[:, 0], at[:, 1], c=[edges[0], *["w"] * (len(at) - 1)], marker=mark, s=70, edgecolors=edges)
        for k, (spot, name) in enumerate(zip(at, data[side].values, strict=True)):
            where.annotate(name, spot[:2], ha="center", va="center", fontsize=5, color=INK if k else "w")
    where.margins(0.3)
    where.set_aspect("equal", adjustable="datalim")
    where.set(xlabel="x [mm]", ylabel="y [mm]", title="device")
    drive.plot(data.sweep_time, data.sweep, color=_MOTOR, lw=0.3, rasterized=True)
    drive.set(xlabel="time [s], repeated", ylabel=f"[{data.sweep.units}]", title=f"sweep to {motor}")
    response.plot(data.sweep_time, MICRO * data.response, color=_POINT, lw=0.3, rasterized=True)
    response.set(xlabel="time [s], repeated", ylabel="[µm]", title=f"response of point {point}")
    entry.plot(data.frequency, MICRO * np.abs(data.entry), color=INK)
    entry.set(xlabel="frequency [Hz]", ylabel=f"[µ{data.entry.units}]", title=f"|G| and phase, {point} ← {motor}")
    phase = entry.twinx()
    phase.plot(data.frequency, unwrapped(data.entry.values), color=GREY, ls="--", lw=0.8)
    phase.set_ylabel("phase [cycles]", color=GREY)
    phase.grid(False)
    phase.spines["right"].set_visible(True)
    for panel, text in zip((where, drive, response, entry), "abcd", strict=True):
        panel.text(-0.05 if wide else -0.3, 1.06, text, transform=panel.transAxes, fontweight="bold", ha="right")
        panel.title.set_fontsize(8 if wide else 7)


def _filter(figure: Any, data: xr.Dataset, rows: int, wide: bool) -> None:
    controls, motors = ([str(n) for n in data[side].values] for side in ("control", "input"))
    kinds = [f"{'zero' if k else 'target'} {name}" for k, name in enumerate(controls)]
    shades = [INK if k else _TARGET for k in range(len(controls))]
    colours = [ACTUATORS[k % 6] for k in range(len(motors))]
    for part, values, names, unit, title, shade in zip(
        figure.subfigures(1, 3, squeeze=False)[0],
        (MICRO * data.wanted, data.drive, MICRO * data.reached),
        (kinds, motors, kinds),
        ("µm", data.drive.units, "µm"),
        (r"$\mathbf{e}$   wanted", r"$\mathbf{f}$   drives, $G^{+}$ wanted", r"$\mathbf{g}$   reached"),
        (shades, colours, shades),
        strict=True,
    ):
        most = 1.1 * float(np.nanmax(np.abs(values))) or 1.0
        axes = np.atleast_1d(part.subplots(rows, 1, sharex=True))
        for k, panel in enumerate(axes):
            if k >= len(names):
                panel.axis("off")
                continue
            panel.plot(1e3 * data.time, values[k], color=shade[k])
            panel.set(ylim=(-most, most), xlim=(1e3 * data.time[0], 1e3 * data.time[-1]))
            if wide:
                panel.set_ylabel(f"{names[k]}\n[{unit}]", rotation=0, ha="right", va="center")
            else:  # above the curve, which the column is narrow for
                panel.set_title(names[k], loc="left", fontsize=6, pad=1)
                panel.tick_params(labelsize=6)
        last = axes[min(len(names), rows) - 1]
        last.set_xlabel("time [ms]")
        last.tick_params(labelbottom=True)
        words = f"{title}, own scale" if "reached" in title else title
        part.suptitle(words if wide else f"{title} [{unit}]", fontsize=8 if wide else 7)

_INSTANTS = 6
_FLAT = 1e-3  # of the grid's size: points that are no further off a line span no surface
_BAR = 10.0  # mm: the scale below a map
_AROUND = 0.04  # s to either side of the focus: what a trace shows
_MESH = 41  # points per side of the interpolated map


def target_waves(results: Results, target: str) -> xr.Dataset:
    """Everything that figure 6 shows, for ``target``.

    ``u`` (method, output, time) [m]; ``when`` (method, instant) [s]; ``between`` (method, instant, y, x) interpolated
    between the grid points; with a wavefield ``field`` (method, instant, vertex), the skin's own outward motion.
    """
    moved, g = results.displacements, results.transfer
    if target not in moved.targets:
        raise DataError(f"{results.folder}: nothing was rendered at target '{target}', only at "
                        f"{', '.join(moved.targets)}; `forearm-fem render` can")  # fmt: skip
    at = positions(g.outputs)[:, :2]
    span = np.ptp(at, axis=0)  # a line of points, or one, is given a width to be seen by
    aside = np.where(span > 0, 0.0, max(float(span.max()), 0.01) / 20)
    x, y = (np.linspace(p.min() - a, p.max() + a, _MESH) for p, a in zip(at.T, aside, strict=True))
    values = np.array([signal_of(moved, m, target) for m in moved.methods])
    when = np.array([moments(moved.time, v, moved.channels.index(target)) for v in values])
    samples = np.searchsorted(moved.time, when - 1e-9)
    between = [_between(at, v[:, s].T, x, y) for v, s in zip(values, samples, strict=True)]
    spans = [active_span(v, moved.time) for v in values]
    keep = slice(min(s.start for s in spans), max(s.stop for s in spans))
    metres, maps = {"units": "m"}, ("method", "instant", "y", "x")
    data = xr.Dataset(
        {"u": (("method", "output", "time"), values[:, :, keep], metres),
         "between": (maps, np.array(between), {"table": "no"}), "when": (("method", "instant"), when, {"units": "s"})},
        {"method": list(moved.methods), "time": ("time", moved.time[keep], {"units": "s"}), "x": x, "y": y,
         "instant": np.arange(_INSTANTS), **places(g.outputs, g.inputs)},
        {"target": target},
    )  # fmt: skip
    if not _has_waves(results, target):
        return data
    patch = volar_patch(results.field_mesh, (*g.inputs, *g.outputs))
    normal = patch.normal_field(results.wavefield)
    series = [drive_series(results.drives, m, target, results.wavefield) for m in moved.methods]
    field = [normal.in_time(s, t) for s, t in zip(series, when, strict=True)]
    data = data.assign({f"vertex_{c}": ("vertex", patch.points[:, k], metres) for k, c in enumerate("xyz")})
    data["field"] = (("method", "instant", "vertex"), np.array(field), metres)
    return data.assign_coords(triangles=(("triangle", "corner"), patch.triangles))


def moments(time: FloatArray, values: FloatArray, row: int) -> FloatArray:
    """Six instants [s] on samples, evenly spaced through the motion: the target's own peak is the fourth, the largest
    motion of any point is among them.

    The step is near a sixth of the span that holds 90 % of the motion: 0.5 to 3 ms, or as large as it must be.
    """
    keep = active_span(values, time, share=0.9, least=0.0)
    peak = int(np.argmax(np.abs(np.nan_to_num(values[row]))))
    span = float(time[keep][-1] - time[keep][0])
    dt = float(time[1] - time[0])
    step = max(1, round(float(np.clip(span / _INSTANTS, 0.5e-3, 3e-3)) / dt))
    largest = int(np.argmax(np.abs(np.nan_to_num(values)).max(axis=0)))
    step = _through(largest - peak, step)
    return np.asarray(time[np.clip(peak + step * (np.arange(_INSTANTS) - 3), 0, len(time) - 1)])


def _through(gap: int, step: int) -> int:
    """The step nearest to ``step`` of which ``gap`` [samples] is -3 to 2 times one."""
    most = 3 if gap < 0 else 2
    count = min(max(1, round(abs(gap) / step)), most)
    return max(1, round(abs(gap) / count)) if gap else step


def _between(places: FloatArray, values: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Cubic interpolation (n, ny, nx) between grid points, as MATLAB's griddata and the thesis do.

    Points on one line span no surface: there each place shows the nearest point, up to half the points' distance off.
    """
    mesh = np.stack(np.meshgrid(x, y), axis=-1)
    rank = np.linalg.matrix_rank(places - places.mean(axis=0), tol=_FLAT * np.ptp(places, axis=0).max())
    method: Literal["cubic", "nearest"] = "cubic" if rank == 2 else "nearest"
    return np.array([griddata(places, v, mesh, method=method) for v in values])


def _has_waves(results: Results, target: str) -> bool:
    """True if the field between the points is known on the bins of the drives towards ``target``."""
    if not results.has_field:
        return False
    try:
        drive_series(results.drives, results.drives.methods[0], target, results.wavefield)
    except NotApplicable:
        return False
    return True


@dataclass(frozen=True)
class _Sheet:
    """Places [mm] of a figure's axes, from its upper left; each kind of axes has one left edge for all methods."""

    wide: bool
    rows: int
    shown: int
    methods: int

    @property
    def width(self) -> int:
        """Of the figure."""
        return PAGE if self.wide else COLUMN

    @property
    def size(self) -> float:
        """Of a map, which is square."""
        return 15.5

    @property
    def bar(self) -> float:
        """Left edge of the colour bars."""
        return _LEFT + self.shown * (self.size + _GAP) + 1.0

    @property
    def tall(self) -> float:
        """Of what belongs to one method."""
        maps = _HEAD + self.rows * (self.size + 4.0)
        return maps + (6.0 if self.wide else 23.5)

    @property
    def height(self) -> float:
        """Of the figure: legend above, label of the time axis and footer below."""
        return 2.0 + self.tall * self.methods + (6.0 if self.wide else 7.5)

    def axes(self, figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
        """New axes there."""
        across, up = self.width, self.height
        return figure.add_axes((left / across, 1 - (top + height) / up, width / across, height / up))

    def write(self, figure: Figure, left: float, top: float, text: str, **look: Any) -> None:
        """``text`` there."""
        figure.text(left / self.width, 1 - top / self.height, text, va="center", **look)

    def maps(self, figure: Figure, top: float, row: int) -> list[Axes]:
        """One row of maps of the method whose band begins at ``top``."""
        at = top + _HEAD + row * (self.size + 4.0)
        return [self.axes(figure, _LEFT + k * (self.size + _GAP), at, self.size, self.size) for k in range(self.shown)]

    def traces(self, figure: Figure, top: float) -> Axes:
        """Axes over time beside the maps, or below them."""
        if self.wide:
            left = self.bar + 25.0
            return self.axes(figure, left, top + _HEAD, self.width - left - 3.0, self.tall - _HEAD - 6.0)
        below = top + _HEAD + self.rows * (self.size + 4.0) + 1.5
        return self.axes(figure, _LEFT, below, self.width - _LEFT - 3.0, 15.0)


_LEFT, _HEAD, _GAP = 11.5, 8.0, 0.8  # mm: left of maps, and of axes over time in a column; above the maps of a method


@styled
def plot_target(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """Per method: maps at some instants (interpolated, and the field itself), and the grid points over time.

    A page has six instants and the time series beside the maps, a journal's column four of them and the series below.
    Each method has a scale of its own, whose factor stands at its bar.
    """
    rows, wide = 2 if "field" in data else 1, width > COLUMN
    room = _Sheet(wide, rows, _INSTANTS if wide else 4, data.sizes["method"])
    figure = sheet(width, room.height)
    figure.set_layout_engine("none")
    most = MICRO * np.nanmax(np.abs(data.between.values), axis=(1, 2, 3), initial=0.0)
    for m, method in enumerate(data.method.values):
        top = 2.0 + m * room.tall
        factor = most[m] / most[0] if most[0] > 0 else 1.0
        room.write(figure, _LEFT, top + 2.0, str(method), color=_colour(data, m), fontweight="bold", fontsize=9)
        _maps(figure, room, top, data, m, float(most[m]), "" if abs(factor - 1) < 0.005 else f"scale\n× {factor:.2g}")
        axes = room.traces(figure, top)
        _curves(axes, data, m)
        for t in data.when.values[m][_chosen(data, m, room.shown)]:
            axes.axvline(1e3 * t, color=FAINT, lw=0.5, zorder=0)
        reach = MICRO * float(np.nanmax(np.abs(data.u.values[m]))) or 1.0
        tick = round_down_125(reach)
        axes.set(ylim=(-1.08 * reach, 1.08 * reach), yticks=(-tick, 0, tick))
        axes.tick_params(labelsize=6)
        axes.set_xlabel("time [ms]" if m == room.methods - 1 else "")
        axes.yaxis.label.set_fontsize(6.5)
        axes.yaxis.set_label_coords(-9.0 / (room.width * axes.get_position().width), 0.5)
        if m == 0:
            lines = axes.get_legend_handles_labels()
            figure.legend(*lines, loc="upper right", bbox_to_anchor=(0.985, 1 - 1.0 / room.height), ncols=2,
                          borderaxespad=0, borderpad=0)  # fmt: skip
    return figure


def _colour(data: xr.Dataset, m: int) -> str:
    return method_look(str(data.method.values[m]), list(data.method.values)).colour


def _chosen(data: xr.Dataset, m: int, count: int) -> slice:
    """Successive instants, ``count`` of them: the target's peak and the largest motion of any point among them."""
    largest = int(np.argmax(np.nanmax(np.abs(data.between.values[m]), axis=(1, 2))))
    spare = _INSTANTS - count
    first = 0 if largest == 0 else spare if largest == _INSTANTS - 1 else spare // 2
    return slice(first, first + count)


def _maps(figure: Figure, room: _Sheet, top: float, data: xr.Dataset, m: int, most: float, factor: str) -> None:
    scale, chosen = Normalize(-most or -1.0, most or 1.0), _chosen(data, m, room.shown)
    points, coils = (1e3 * data[f"{side}_place"].values[:, :2] for side in ("output", "input"))
    middle = points.mean(axis=0)
    reaches = [1.15 * np.abs(p - middle).max() for p in (points, np.concatenate([points, coils]))][2 - room.rows :]
    for row, reach in enumerate(reaches):
        panels = room.maps(figure, top, row)
        for panel, k in zip(panels, range(_INSTANTS)[chosen], strict=True):
            if row == 0:
                when = f"{1e3 * data.when.values[m, k]:+.1f} ms"
                panel.set_title("0 ms" if float(when[:-3]) == 0 else minus(when), fontsize=6.5, pad=2)
                panel.pcolormesh(1e3 * data.x, 1e3 * data.y, MICRO * data.between[m, k], cmap=SIGNED, norm=scale,
                                 shading="gouraud", rasterized=True)  # fmt: skip
            else:
                seen = Triangulation(1e3 * data.vertex_x, 1e3 * data.vertex_y, data.triangles)
                panel.tripcolor(seen, MICRO * data.field.values[m, k], cmap=SIGNED, norm=scale, shading="gouraud",
                                rasterized=True)  # fmt: skip
            panel.plot(*points.T, "o", color=INK, ms=2.2, mew=0)
            panel.plot(*points[_row(data)], "o", mfc="none", mec=INK, ms=6, mew=0.9)
            panel.plot(*coils.T, "o", mfc="none", mec=GREY, ms=5, mew=0.7)
            panel.set(aspect="equal", xticks=(), yticks=(), xlim=(middle[0] - reach, middle[0] + reach),
                      ylim=(middle[1] - reach, middle[1] + reach))  # fmt: skip
            panel.grid(False)
            panel.spines[:].set_visible(False)
        below = -1.8 / room.size
        panels[0].plot([0, _BAR / (2 * reach)], [below, below], color=INK, lw=1.5, solid_capstyle="butt", clip_on=False,
                       transform=panels[0].transAxes)  # fmt: skip
        panels[0].annotate(f"{_BAR:g} mm", (_BAR / (2 * reach), below), (3, 0), xycoords="axes fraction", va="center",
                           textcoords="offset points", fontsize=6, annotation_clip=False)  # fmt: skip
        panels[0].set_ylabel("between\npoints" if row == 0 else "skin\nitself", fontsize=7)
    side = room.axes(figure, room.bar, top + _HEAD + 1.8, 1.8, room.rows * (room.size + 4.0) - (9.5 if factor else 6.0))
    bar = figure.colorbar(ScalarMappable(scale, SIGNED), cax=side, extend="both")
    bar.ax.tick_params(labelsize=6, pad=1.5, length=2)
    bar.ax.set_yticks([t * round_down_125(most or 1.0) for t in (-1, 0, 1)])
    room.write(figure, room.bar, top + _HEAD - 1.5, "u [µm]", fontsize=6.5)
    room.write(figure, room.bar, top + _HEAD - 3.5 + room.rows * (room.size + 4.0), factor, fontsize=6.5)


def _row(data: xr.Dataset) -> int:
    """Index of the target among the outputs."""
    return list(data.output.values).index(data.target)


def _curves(ax: Axes, data: xr.Dataset, m: int) -> None:
    time, u, row = 1e3 * data.time, MICRO * data.u.values[m], _row(data)
    for k, trace in enumerate(u):
        if k != row:
            ax.plot(time, trace, color=GREY, lw=0.7, ls=":")
    ax.plot([], [], color=GREY, lw=0.7, ls=":", label="the others")
    ax.plot(time, u[row], color=INK, label=f"target {data.target}")
    ax.set(xlabel="time [ms]", ylabel="u [µm]", xlim=_shown(data))


def _shown(data: xr.Dataset) -> tuple[float, float]:
    """Span of the traces [ms]: 40 ms to either side of the focus, and all instants of the maps."""
    low, high = min(-_AROUND, float(data.when.min())), max(_AROUND, float(data.when.max()))
    return 1e3 * max(low, float(data.time[0])), 1e3 * min(high, float(data.time[-1]))


@styled
def plot_trace(data: xr.Dataset, method: str, title: str, *, ax: Axes | None = None) -> Axes:
    """The grid points over time under one ``method``: the target solid, the others dotted."""
    axes = single(ax, (2.9, 2.2))
    m = list(data.method.values).index(method)
    _curves(axes, data, m)
    axes.set_title(title, color=_colour(data, m), fontweight="bold")
    return axes
