"""Figure 4: how one entry of G is measured, and how the inverse filter gets its drives."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from ..errors import NotApplicable
from ..measurement.estimators import ExponentialSweep
from ..rendering import Record, on_record_bins, respond, to_spectrum
from ..typing import FloatArray
from .data import Results, places
from .device import active_span
from .matrix import shown, unwrapped, zero_points
from .style import ACTUATORS, COLUMN, GREY, INK, MICRO, PAGE, sheet, styled

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
