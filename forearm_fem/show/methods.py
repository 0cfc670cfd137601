"""Figure 4: how one entry of G is measured, and how the inverse filter gets its drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase

from ..errors import NotApplicable
from ..measurement.estimators import ExponentialSweep
from ..ports import Port, positions
from ..rendering import Record, place, respond, to_spectrum
from ..typing import ComplexArray, FloatArray
from .data import Results
from .device import busy
from .matrix import shown, unwrapped, zero_points
from .page import Table
from .style import ACTUATORS, GREY, INK, MICRO, panels, styled, widen


@dataclass(frozen=True, eq=False)
class SweptEntry:
    """One entry of G from a sweep: ``drive`` and ``response`` (n_t,) over ``time`` [s], ``entry`` (n,) over
    ``frequency`` [Hz]."""

    actuator: Port
    point: Port
    drive_unit: str
    time: FloatArray
    drive: FloatArray
    response: FloatArray
    frequency: FloatArray
    entry: ComplexArray
    unit: str


@dataclass(frozen=True, eq=False)
class Method:
    """Figure 4: the entry, and for a target the controls wanted, the drives, and what the points then do.

    ``wanted`` and ``reached`` (n_control, n_t) [m], ``drives`` (n_in, n_t) at ``time`` (n_t,) [s].
    """

    measured: SweptEntry
    outputs: tuple[Port, ...]
    inputs: tuple[Port, ...]
    target: str
    controls: tuple[str, ...]
    time: FloatArray
    wanted: FloatArray
    drives: FloatArray
    reached: FloatArray
    drive_unit: str


def method(results: Results) -> Method:
    """Entry G_11 under the scenario's sweep, and the inverse filter's drives of target 5 (or the first)."""
    g, moved, sent = results.transfer, results.displacements, results.drives
    if "inverse filter" not in sent.methods:
        raise NotApplicable(f"{results.folder}: the inverse filter was not rendered; figure 4 shows it")
    target = "5" if "5" in sent.targets else sent.targets[0]
    at = (sent.methods.index("inverse filter"), sent.targets.index(target))
    on_record = results.account.signal_strength.zeros.get("inverse filter", {}).get(target)
    controls = (target, *(on_record or zero_points(g, target)))  # in folders before 0.14 the default ones
    rows = [moved.channels.index(c) for c in controls]
    keep = busy(sent.values[at], sent.time)
    wanted = np.zeros((len(rows), len(sent.time)))
    wanted[0] = 1e-6 * results.scenario.rendering.amplitude * results.wavelet.samples
    return Method(
        measured=_measure(results),
        outputs=g.outputs,
        inputs=g.inputs,
        target=target,
        controls=controls,
        time=sent.time[keep],
        wanted=wanted[:, keep],
        drives=sent.values[at][:, keep],
        reached=moved.values[at][rows][:, keep],
        drive_unit=sent.unit,
    )


def _measure(results: Results) -> SweptEntry:
    g = results.transfer
    sweep = ExponentialSweep.of(results.scenario)
    record = Record(sweep.sample_rate, sweep.n)
    samples = sweep.samples()
    placed = place(g, record)
    spectrum = np.zeros((len(placed.bins.index), len(g.inputs)), dtype=complex)
    spectrum[:, 0] = to_spectrum(samples, record)[placed.bins.index]
    moved = respond(placed, spectrum)[0]
    time = np.arange(sweep.n) / sweep.sample_rate
    unit = g.unit.rpartition("/")[2]
    return SweptEntry(g.inputs[0], g.outputs[0], unit, time, samples, moved, g.frequency, shown(g)[:, 0, 0], g.unit)


def method_table(data: Method) -> Table:
    """Controls wanted and reached, and drives, over time."""
    columns: dict[str, FloatArray] = {"time_s": data.time}
    for k, name in enumerate(data.controls):
        columns[f"wanted_{name}_m"] = data.wanted[k]
        columns[f"reached_{name}_m"] = data.reached[k]
    for k, port in enumerate(data.inputs):
        columns[f"drive_{port.name}_{data.drive_unit}"] = data.drives[k]
    return Table(columns)


def method_extra(data: Method) -> dict[str, str]:
    """The sweep and the response; the transfer function."""
    m = data.measured
    over_time = {"time_s": m.time, f"drive_{m.drive_unit}": m.drive, "response_m": m.response}
    entry = {f"abs_G_{m.unit}": np.abs(m.entry), "phase_G_rad": np.angle(m.entry)}
    return {
        "sweep.csv": Table(over_time).as_csv(),
        "entry.csv": Table({"frequency_Hz": m.frequency, **entry}).as_csv(),
    }


@styled
def plot_method(data: Method, *, ax: Axes | None = None) -> FigureBase:
    """One entry of G from a sweep (top), and from controls to drives to what the points do (bottom)."""
    below = 3.3 + 0.5 * max(0, max(len(data.controls), len(data.inputs)) - 5)  # inches: labels of rows keep apart
    figure = panels(ax, (7.4, 2.3 + below))
    top, bottom = figure.subfigures(2, 1, height_ratios=(2.3, below), squeeze=False)[:, 0]
    _entry(top, data)
    _filter(bottom, data)
    return figure


def _entry(figure: FigureBase, data: Method) -> None:
    m = data.measured
    where, drive, response, entry = figure.subplots(1, 4, width_ratios=(0.9, 1, 1, 1.1))
    for ports, mark, colour in ((data.outputs, "o", "#D55E00"), (data.inputs, "s", "#CC79A7")):
        at = 1e3 * positions(ports)
        filled = [colour if p in (m.point, m.actuator) else "w" for p in ports]
        where.scatter(at[:, 0], at[:, 1], c=filled, marker=mark, s=70, edgecolors=colour)
        for spot, port in zip(at, ports, strict=True):
            ink = "w" if port in (m.point, m.actuator) else INK
            where.annotate(port.name, spot[:2], ha="center", va="center", fontsize=5, color=ink)
    where.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title="device")
    where.margins(0.15)
    widen(where)
    drive.plot(m.time, m.drive, color="#CC79A7", lw=0.3, rasterized=True)
    drive.set(xlabel="time [s]", ylabel=f"[{m.drive_unit}]", title=f"sweep to {m.actuator.name}")
    response.plot(m.time, MICRO * m.response, color="#D55E00", lw=0.3, rasterized=True)
    response.set(xlabel="time [s]", ylabel="[µm]", title=f"response of point {m.point.name}")
    entry.plot(m.frequency, MICRO * np.abs(m.entry), color=INK)
    entry.set(
        xlabel="frequency [Hz]", ylabel=f"[µ{m.unit}]", title=f"|G| and phase, {m.point.name} ← {m.actuator.name}"
    )
    phase = entry.twinx()
    phase.plot(m.frequency, unwrapped(m.entry), color=GREY, ls="--", lw=0.8)
    phase.set_ylabel("phase [cycles]", color=GREY)
    phase.grid(False)
    phase.spines["right"].set_visible(True)
    for panel, text in zip((where, drive, response, entry), "abcd", strict=True):
        panel.text(-0.05, 1.06, text, transform=panel.transAxes, fontweight="bold", ha="right")


def _filter(figure: FigureBase, data: Method) -> None:
    n = max(len(data.controls), len(data.inputs))
    left, middle, right = figure.subfigures(1, 3, squeeze=False)[0]
    ms = 1e3 * data.time
    for part, rows, title in (
        (left, data.wanted, "wanted: target and zeros"),
        (right, data.reached, "reached (own scale)"),
    ):
        most = MICRO * float(np.nanmax(np.abs(rows))) or 1.0
        axes = np.atleast_1d(part.subplots(n, 1, sharex=True))
        for k, panel in enumerate(axes):
            if k >= len(data.controls):
                panel.axis("off")
                continue
            panel.plot(ms, MICRO * rows[k], color="#D55E00" if k == 0 else INK)
            panel.set(ylim=(-1.1 * most, 1.1 * most), xlim=(ms[0], ms[-1]))
            kind = "target" if k == 0 else "zero"
            panel.set_ylabel(f"{kind} {data.controls[k]}\n[µm]", rotation=0, ha="right", va="center")
        axes[-1].set_xlabel("time [ms]")
        part.suptitle(title, fontsize=8)
    axes = np.atleast_1d(middle.subplots(n, 1, sharex=True))
    most = 1.1 * float(np.abs(data.drives).max()) or 1.0
    last = min(len(data.inputs), len(axes)) - 1
    for k, panel in enumerate(axes):
        if k > last:
            panel.axis("off")
            continue
        panel.plot(ms, data.drives[k], color=ACTUATORS[k % 6])
        panel.set(ylim=(-most, most), xlim=(ms[0], ms[-1]))
        panel.set_ylabel(f"{data.inputs[k].name}\n[{data.drive_unit}]", rotation=0, ha="right", va="center")
    axes[last].set_xlabel("time [ms]")
    axes[last].tick_params(labelbottom=True)
    middle.suptitle("drives, $S = H^{+} U$", fontsize=8)
