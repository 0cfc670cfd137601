"""What the amplifiers and the skin see: drives against their limits, and driving-point impedance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from ..device import driving_point_impedance, respond
from ..rendering.limits import limits_of
from ..typing import ComplexArray, FloatArray
from .data import Results
from .page import Table
from .style import ACTUATORS, GREY, decimal, letter, method_colour, panels, styled

LINES: tuple[Any, ...] = ("-", (0, (4, 2)), (2, (2, 2)), (0, (1, 1.5)))  # equal lines stay visible


@dataclass(frozen=True, eq=False)
class ImpedanceCurves:
    """Per actuator (n, n_in): ``skin`` F / v under the cone [N s/m] and ``electrical`` V / I [ohm].

    ``electrical`` is None where the drive is no voltage.
    """

    frequency: FloatArray
    names: tuple[str, ...]
    skin: ComplexArray
    electrical: ComplexArray | None


def impedance(results: Results) -> ImpedanceCurves:
    """Driving points of a run; needs the compliance."""
    compliance, device = results.compliance, results.scenario.device
    names = tuple(compliance.ports[i].name for i in compliance.indices("contact"))
    electrical = respond(compliance, device).input_impedance if device.drive == "voltage" else None
    return ImpedanceCurves(compliance.frequency, names, driving_point_impedance(compliance), electrical)


def impedance_table(data: ImpedanceCurves) -> Table:
    """Real and imaginary parts over frequency."""
    columns: dict[str, FloatArray] = {"frequency_Hz": data.frequency}
    sources = {"skin": (data.skin, "Ns_per_m"), "electrical": (data.electrical, "ohm")}
    for what, (values, unit) in sources.items():
        for k, name in enumerate(data.names if values is not None else ()):
            assert values is not None
            columns[f"{what}_{name}_real_{unit}"] = values[:, k].real
            columns[f"{what}_{name}_imag_{unit}"] = values[:, k].imag
    return Table(columns)


@styled
def plot_impedance(data: ImpedanceCurves, *, ax: Axes | None = None) -> FigureBase:
    """Size and phase of the skin's impedance under each cone, and the impedance the amplifier sees."""
    n = 2 if data.electrical is None else 3
    figure = panels(ax, (2.4 * n, 2.7))
    axes = figure.subplots(1, n)
    for k, name in enumerate(data.names):
        look: dict[str, Any] = {"color": ACTUATORS[k % len(ACTUATORS)], "ls": LINES[k % 4], "label": name}
        axes[0].plot(data.frequency, np.abs(data.skin[:, k]), **look)
        axes[1].plot(data.frequency, np.angle(data.skin[:, k], deg=True), **look)
        if data.electrical is not None:
            axes[2].plot(data.frequency, np.abs(data.electrical[:, k]), **look)
    axes[0].set(ylabel="|Z| of the skin under a cone [N s/m]", yscale="log")
    axes[1].set(ylabel="phase of Z [degrees]", yticks=(-90, -45, 0, 45, 90), ylim=(-95, 95))
    axes[0].legend(title="actuator")
    decimal(axes[0].yaxis)
    if data.electrical is not None:
        axes[2].set_ylabel("electrical |V / I|, others at 0 V [Ω]")
    for panel, text in zip(axes, "abc", strict=False):
        panel.set_xlabel("frequency [Hz]")
        letter(panel, text)
    return figure


@dataclass(frozen=True, eq=False)
class DriveLevels:
    """Drives of one target over time, and peak and power of all targets against the limits.

    ``signals`` (n_method, n_in, n_t) in ``unit`` at ``time`` (n_t,) [s]; ``peak`` and ``power`` (n_method, n_target):
    the most loaded actuator's peak [unit] and mean power [W]; limits are NaN where the drive is no voltage.
    """

    target: str
    methods: tuple[str, ...]
    targets: tuple[str, ...]
    actuators: tuple[str, ...]
    unit: str
    time: FloatArray
    signals: FloatArray
    peak: FloatArray
    power: FloatArray
    max_peak: float
    max_power: float


def drive_levels(results: Results, target: str | None = None) -> DriveLevels:
    """Drives of a run; ``target`` (default: 5, or the first) is the one shown over time."""
    drives = results.drives
    limits = limits_of(results.scenario.device) if drives.unit == "V" else None
    chosen = target or ("5" if "5" in drives.targets else drives.targets[0])
    mean_square = np.mean(drives.values**2, axis=3).max(axis=2)
    signals = drives.values[:, drives.targets.index(chosen)]
    keep = busy(signals.reshape(-1, signals.shape[-1]), drives.time)
    return DriveLevels(
        target=chosen,
        methods=drives.methods,
        targets=drives.targets,
        actuators=drives.channels,
        unit=drives.unit,
        time=drives.time[keep],
        signals=signals[:, :, keep],
        peak=np.abs(drives.values).max(axis=(2, 3)),
        power=np.full(mean_square.shape, np.nan) if limits is None else mean_square / limits.resistance,
        max_peak=float("nan") if limits is None else limits.voltage,
        max_power=float("nan") if limits is None else limits.power,
    )


def busy(signals: FloatArray, time: FloatArray, share: float = 0.995, least: float = 0.01) -> slice:
    """The samples around t = 0 that hold ``share`` of the energy of the rows of ``signals`` (m, n_t).

    At least ``least`` [s] to each side.
    """
    energy = np.sum(np.nan_to_num(signals) ** 2, axis=0)
    done = np.cumsum(energy) / max(float(energy.sum()), np.finfo(float).tiny)
    first, last = np.searchsorted(done, [(1 - share) / 2, (1 + share) / 2])
    left = min(int(first), int(np.searchsorted(time, -least)))
    right = max(int(last), int(np.searchsorted(time, least)))
    return slice(left, min(right + 1, len(time)))


def levels_table(data: DriveLevels) -> Table:
    """The drives over time; peaks and powers are in the second file."""
    columns: dict[str, FloatArray] = {"time_s": data.time}
    for m, method in enumerate(data.methods):
        for k, name in enumerate(data.actuators):
            columns[f"{method}_{name}_{data.unit}"] = data.signals[m, k]
    return Table(columns)


def levels_extra(data: DriveLevels) -> dict[str, str]:
    """Peak and power of every method and target."""
    rows = [(m, t) for m in data.methods for t in data.targets]
    columns = {
        "method": [m for m, _ in rows],
        "target": [t for _, t in rows],
        f"peak_{data.unit}": data.peak.ravel(),
        "power_W": data.power.ravel(),
    }
    return {"levels.csv": Table(columns).as_csv()}


@styled
def plot_drives(data: DriveLevels, *, ax: Axes | None = None) -> FigureBase:
    """Drives towards one target over time with the voltage limit; peak and power of all targets below."""
    figure = panels(ax, (7.2, 4.8))
    n = len(data.methods)
    grid = figure.add_gridspec(2, 2 * n)
    first: Axes | None = None
    for m, method in enumerate(data.methods):
        panel = figure.add_subplot(grid[0, 2 * m : 2 * m + 2])
        first = first or panel
        for k, name in enumerate(data.actuators):
            panel.plot(1e3 * data.time, data.signals[m, k], color=ACTUATORS[k % 6], ls=LINES[k % 4], label=name)
        panel.set_xlabel("time [ms]")
        if np.isfinite(data.max_peak) and np.abs(data.signals).max() > 0.3 * data.max_peak:
            for sign in (-1, 1):
                panel.axhline(sign * data.max_peak, color=GREY, ls="--", lw=0.8)
        panel.set_title(f"{method}, target {data.target}")
        panel.set_ylabel(f"drive [{data.unit}]" if m == 0 else "")
    left, right = figure.add_subplot(grid[1, :n]), figure.add_subplot(grid[1, n:])
    _by_target(left, data, data.peak, data.max_peak, f"largest peak [{data.unit}]")
    _by_target(right, data, data.power, data.max_power, "largest mean power [W]")
    assert first is not None
    handles, labels = first.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _by_target(ax: Axes, data: DriveLevels, values: FloatArray, limit: float, label: str) -> None:
    place = np.arange(len(data.targets))
    for m, method in enumerate(data.methods):
        shift = 0.2 * (m - (len(data.methods) - 1) / 2)
        ax.plot(place + shift, values[m], "o", color=method_colour(method, data.methods), label=method)
    ax.set_xticks(place, data.targets)
    known = values[np.isfinite(values)]  # none of powers where the drive is no voltage
    ax.set(xlabel="target", ylabel=label, yscale="log" if len(known) and known.min() > 0 else "linear")
    if np.isfinite(limit):
        ax.axhline(limit, color=GREY, ls="--", lw=0.8)
        ax.annotate(f"limit {limit:g}", (1, limit), xycoords=("axes fraction", "data"), ha="right", va="bottom",
                    fontsize=7, color=GREY)  # fmt: skip
