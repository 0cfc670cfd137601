"""The device: drives and their limits, driving-point impedance, and figure 4, from a sweep to drives."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..device import driving_point_impedance
from ..device import respond as loop_response
from ..errors import NotApplicable
from ..measurement.estimators import ExponentialSweep
from ..rendering import Record, on_record_bins, respond, to_spectrum
from ..rendering.limits import limits_of
from ..typing import FloatArray
from .data import Results, places
from .matrix import shown, unwrapped, zero_points
from .style import ACTUATORS, COLUMN, GREY, INK, LINES, MICRO, PAGE, decimal, letter, method_look, sheet, styled


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
