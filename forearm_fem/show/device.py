"""Drives against their limits, and driving-point impedance of the skin."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..device import driving_point_impedance, respond
from ..rendering.drives import limits_of
from ..typing import FloatArray
from .data import Results
from .style import ACTUATORS, COLUMN, GREY, LINES, PAGE, decimal, letter, method_look, sheet, styled


def impedance(results: Results) -> xr.Dataset:
    """Driving points of a run (frequency, actuator): ``skin`` F / v under the cone, and ``electrical`` V / I where the
    drive is a voltage. Needs the compliance."""
    compliance, device = results.compliance, results.scenario.device
    dims = ("frequency", "actuator")
    found = {"skin": (dims, driving_point_impedance(compliance), {"units": "Ns_per_m"})}
    if device.drive == "voltage":
        found["electrical"] = (dims, respond(compliance, device).input_impedance, {"units": "ohm"})
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
