"""One actuator, one line on the skin: the thesis' figures 2 and A.2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import FigureBase
from scipy.special import hankel2

from ..engines.layered import flat_layers, flat_surface
from ..errors import NotApplicable, ScenarioError
from ..geometry.device.layout import layers_of
from ..layered import surface_kernel
from ..metrics import WaveFit, fit_waves
from ..metrics.waves import beside
from ..ports import Port, distances, positions
from ..rendering import Drives, InverseFilter, Wavelet, displacements, drives, place
from ..rendering.drives import Aim
from ..rendering.funneling import known_bins
from ..rendering.spectrum import Placed
from ..scenario import Scenario
from ..transfer import TransferMatrix
from ..typing import ComplexArray, FloatArray
from .data import Results
from .matrix import shown
from .page import Table, stacked_rows
from .patch import volar_patch
from .style import FAINT, GREY, MICRO, letter, panels, styled, trace_root

_STRAIGHT = 0.5  # rad: beyond, the phase along the line is no line
_STEP, _POINTS = 2.5e-3, 10  # appendix A: 10 points every 2.5 mm
_LOCATIONS = (4e-3, 8e-3, 12e-3, 16e-3)  # figure 2: four places besides the actuator


@dataclass(frozen=True, eq=False)
class Line:
    """Responses (n, m) along a line on the skin to one actuator, at ``distance`` (m,) [m] from its centre.

    ``cone`` (n,) is the cone's own motion where known; ``origin`` says where the numbers come from.
    """

    actuator: str
    frequency: FloatArray
    distance: FloatArray
    values: ComplexArray
    cone: ComplexArray | None
    unit: str
    origin: str


def line(results: Results, places: tuple[float, ...]) -> Line:
    """From the first actuator in contact towards the grid's middle at ``places`` [m], from the wavefield.

    Without a wavefield: the row of grid points nearest to the actuator.
    """
    g, first = results.transfer, results.scenario.device.first_in_contact
    name, cone = g.inputs[first].name, None if g.contacts is None else g.contacts[:, first, first]
    if not results.has_field:
        chosen = _row(g.outputs, g.inputs[first])
        gap = distances(g.outputs, g.inputs)[chosen, first]
        return Line(name, g.frequency, gap, shown(g)[:, chosen, first], cone, g.unit, "row of grid points")
    start = positions(g.inputs)[first]
    toward = positions(g.outputs)[:, :2].mean(axis=0) - start[:2]
    along = toward / np.linalg.norm(toward)
    patch = volar_patch(results.field_mesh, (*g.inputs, *g.outputs))
    fine = np.linspace(0, 1.05 * places[-1], 60)
    gaps = np.linalg.norm(patch.lift(start[:2] + np.outer(fine, along)) - start, axis=1)
    corners, weights = patch.weights(start[:2] + np.outer(np.interp(places, gaps, fine), along))
    field = patch.normal_field(results.wavefield).between(corners, weights)
    if not np.array_equal(g.frequency, field.frequency):
        cone = None
    return Line(
        name, field.frequency, np.array(places), field.response(first), cone, g.unit, "field between the points"
    )


def _row(outputs: tuple[Port, ...], source: Port) -> list[int]:
    """Points that share x or y with the one nearest to ``source``, on one side of it, where most are, by distance."""
    from_source = positions(outputs) - positions((source,))
    gap = np.linalg.norm(from_source, axis=1)
    near = from_source[int(np.argmin(gap))]
    sides = [
        np.flatnonzero((np.abs(from_source[:, c] - near[c]) < 1e-3) & (way * from_source[:, 1 - c] > -1e-6))
        for c in (0, 1)
        for way in (1, -1)
    ]
    best = max(sides, key=len)
    return [int(k) for k in best[np.argsort(gap[best], kind="stable")]]


@dataclass(frozen=True, eq=False)
class Travel:
    """A wavelet along a line, figure 2: per method the drive (n_t,), displacements (n_place, n_t) [m] and spectra.

    ``spectra`` (n_place, n_f) are |U| [m/Hz] at ``frequency`` (n_f,); the first place is the cone itself if
    ``has_cone``.
    """

    methods: tuple[str, ...]
    actuator: str
    distance: FloatArray
    has_cone: bool
    drive_unit: str
    time: FloatArray
    drive: tuple[FloatArray, ...]
    moved: tuple[FloatArray, ...]
    frequency: FloatArray
    spectra: tuple[FloatArray, ...]
    origin: str


def travel(results: Results) -> Travel:
    """The inverse filter aims the wavelet at the last place of the line; funneling sends the wavelet itself."""
    along = line(results, _LOCATIONS)
    cone = () if along.cone is None else (along.cone[:, None],)
    values = np.concatenate([*cone, along.values], axis=1)[:, :, None]
    labels = ["cone"] * len(cone) + [f"{1e3 * d:.0f} mm" for d in along.distance]
    outputs = tuple(Port(f"{k}: {n}", "point", (float(k), 0.0, 0.0)) for k, n in enumerate(labels))
    source = Port(along.actuator, "contact", (0.0, 0.0, 0.0))
    g = TransferMatrix(along.frequency, values, outputs, (source,), along.unit, valid=np.isfinite(values))
    far = g.outputs[-1].name
    aimed = drives(InverseFilter(zeros=(), peak=1e-6), g, far, results.wavelet)
    plain = _plain(g, results.wavelet, far)
    reached = tuple(displacements(g, d).values for d in (aimed, plain))
    keep = np.abs(results.wavelet.time) < 0.025
    spectra = tuple(np.asarray(np.abs(place(g, d.record).bins.values[:, :, 0] * d.spectrum).T) for d in (aimed, plain))
    return Travel(
        methods=("inverse filter", "funneling"),
        actuator=along.actuator,
        distance=np.r_[[0.0] if along.cone is not None else [], along.distance],
        has_cone=along.cone is not None,
        drive_unit=aimed.unit,
        time=results.wavelet.time[keep],
        drive=tuple(d.signals[0][keep] for d in (aimed, plain)),
        moved=tuple(u[:, keep] for u in reached),
        frequency=aimed.frequency,
        spectra=spectra,
        origin=along.origin,
    )


def _plain(g: TransferMatrix, wavelet: Wavelet, target: str) -> Drives:
    """The wavelet itself on the only actuator, cut to the bins of G."""

    class Itself:
        """A renderer that sends the wavelet."""

        name = "funneling"

        def aim(self, placed: Placed, target: str, wavelet: ComplexArray) -> Aim:
            """The wavelet, silent where G is unknown at the target."""
            used = known_bins(placed, [placed.row(target)])
            return Aim(np.where(used, wavelet, 0)[:, None], used)

    return drives(Itself(), g, target, wavelet)


def travel_table(data: Travel) -> Table:
    """Drive and displacements over time, method by method."""
    names = _place_names(data)
    parts = {
        method: {"time_s": data.time, f"drive_{data.drive_unit}": drive, **dict(zip(names, moved, strict=True))}
        for method, drive, moved in zip(data.methods, data.drive, data.moved, strict=True)
    }
    return stacked_rows("method", parts)


def travel_extra(data: Travel) -> dict[str, str]:
    """The spectra."""
    names = [n.replace("_m", "_m_per_Hz") for n in _place_names(data)]
    parts = {
        method: {"frequency_Hz": data.frequency, **dict(zip(names, spectra, strict=True))}
        for method, spectra in zip(data.methods, data.spectra, strict=True)
    }
    return {"spectra.csv": stacked_rows("method", parts).as_csv()}


def _place_names(data: Travel) -> list[str]:
    names = [f"u_at_{1e3 * d:.1f}mm_m" for d in data.distance]
    return ["u_of_cone_m", *names[1:]] if data.has_cone else names


@styled
def plot_travel(data: Travel, *, ax: Axes | None = None) -> FigureBase:
    """A wavelet attenuated and dispersed along a line: drive, displacement and spectrum at each place."""
    figure = panels(ax, (7.2, 1.1 + 0.62 * (len(data.distance) + 3)))
    halves: Any = figure.subfigures(1, len(data.methods))
    for m, half in enumerate(halves):
        n = len(data.distance)
        axes = half.subplots(n + 2, 1, height_ratios=[1] * (n + 1) + [2.6])
        colours = [colormaps["viridis_r"]((k + 0.6) / n) for k in range(n)]
        ms = 1e3 * data.time
        where = "wavelet asked for at the last place" if m == 0 else "wavelet sent as it is"
        half.suptitle(f"{'ab'[m]}   {data.methods[m]}: {where}", fontsize=8, fontweight="bold")
        axes[0].plot(ms, data.drive[m], color=GREY)
        axes[0].set_ylabel(f"drive\n[{data.drive_unit}]", rotation=0, ha="right", va="center")
        for k, (trace, panel) in enumerate(zip(data.moved[m], axes[1:-1], strict=True)):
            panel.plot(ms, MICRO * trace, color=colours[k])
            label = "cone" if k == 0 and data.has_cone else f"{1e3 * data.distance[k]:.0f} mm"
            panel.set_ylabel(f"{label}\n[µm]", rotation=0, ha="right", va="center")
        for panel in axes[:-1]:
            panel.set_xlim(ms[0], ms[-1])
            panel.locator_params(axis="y", nbins=3)
            panel.axvline(0, color=GREY, lw=0.5, ls=":")
            panel.tick_params(labelbottom=panel is axes[-2])
        axes[-2].set_xlabel("time [ms]")
        for spectrum, colour in zip(data.spectra[m], colours, strict=True):
            axes[-1].plot(data.frequency, 1e9 * spectrum, color=colour)
        axes[-1].set(xlabel="frequency [Hz]", ylabel="|U| [nm/Hz]", yscale="log")
    return figure


@dataclass(frozen=True, eq=False)
class Dispersion:
    """Attenuation and speed by the thesis' estimator, and the root of the layered kernel where there is one.

    ``root`` (n,) [1/m] is the complex wavenumber k, e^{-i k x}, None without layers; ``alone`` is the estimator
    applied to that wave alone, spreading in a circle, at the same distances.
    """

    fit: WaveFit
    root: ComplexArray | None
    alone: WaveFit | None
    window: tuple[float, float]
    origin: str


def dispersion(results: Results) -> Dispersion:
    """Appendix A on a run: 10 points every 2.5 mm from the first actuator, 50-500 Hz."""
    along = line(results, tuple(_STEP * (k + 1) for k in range(_POINTS)))
    if len(along.distance) < 3:
        raise NotApplicable("a wave fit needs 3 points in a row or a wavefield; this grid has neither")
    keep = (along.frequency >= 50) & (along.frequency <= 500)
    step = max(1, int(keep.sum()) // 180)
    f = along.frequency[keep][::step]
    outside = beside(along.distance, results.scenario.device.cone.radius)
    if outside.sum() < 3:
        raise NotApplicable("a wave fit needs 3 points in a row beside the cone; this grid has fewer")
    values, gap = along.values[keep][::step][:, outside], along.distance[outside]
    root = kernel_root(results.scenario, f)
    alone = None if root is None else fit_waves(f, gap, hankel2(0, root[:, None] * gap))
    return Dispersion(fit_waves(f, gap, values), root, alone, (gap[0], gap[-1]), along.origin)


def kernel_root(scenario: Scenario, frequency: FloatArray) -> ComplexArray | None:
    """The Rayleigh-like root of the scenario's layers with the membrane on them; None for a limb without layers, and
    under a patch, which has edges."""
    if not layers_of(scenario.limb):
        return None
    try:
        layers, sheet = flat_layers(scenario), flat_surface(scenario.tissues)
    except ScenarioError:
        return None
    return trace_root(lambda k, w: surface_kernel(k, w, layers, surface=sheet), layers, 2 * np.pi * frequency)


def dispersion_table(data: Dispersion) -> Table:
    """Estimator and root over frequency."""
    f = data.fit.frequency
    columns = {
        "frequency_Hz": f,
        "attenuation_estimated_per_m": data.fit.attenuation,
        "speed_estimated_m_per_s": data.fit.speed,
        "phase_misfit_rad": data.fit.phase_misfit,
    }
    if data.root is not None and data.alone is not None:
        columns["attenuation_estimated_on_root_per_m"] = data.alone.attenuation
        columns["speed_estimated_on_root_m_per_s"] = data.alone.speed
        columns["attenuation_root_per_m"] = -data.root.imag
        columns["speed_root_m_per_s"] = 2 * np.pi * f / data.root.real
    return Table(columns)


@styled
def plot_dispersion(data: Dispersion, *, ax: Axes | None = None) -> FigureBase:
    """Attenuation and phase speed over frequency, by the thesis' estimator and as the root of the layered kernel."""
    figure = panels(ax, (4.2, 4.4))
    top, bottom = figure.subplots(2, 1, sharex=True)
    first, last = (1e3 * d for d in data.window)
    _curves(top, bottom, data.fit, f"thesis' estimator, {first:.3g}–{last:.3g} mm", "#0072B2", "-")
    f, speed = data.fit.frequency, data.fit.speed
    if data.root is not None and data.alone is not None:
        _curves(top, bottom, data.alone, "same estimator, surface wave alone", "#56B4E9", "-")
        top.plot(f, -data.root.imag, color="#D55E00", ls="--", label="root of the layered kernel")
        bottom.plot(f, 2 * np.pi * f / data.root.real, color="#D55E00", ls="--")
    top.set(ylabel="attenuation δ [1/m]", ylim=(0, None), xlim=(data.fit.frequency[0], data.fit.frequency[-1]))
    good = speed[(data.fit.phase_misfit < _STRAIGHT) & (speed > 0)]
    fastest = float(min(1.3 * np.quantile(good, 0.95) + 1, 20)) if len(good) else 10.0  # not spoilt by wild estimates
    drawn = (speed > 0) & (speed < fastest)
    if not drawn.all():  # so that a curve that ends says why
        bottom.fill_between(f, 0, 1, where=~drawn, step="mid", transform=bottom.get_xaxis_transform(), color=FAINT,
                            alpha=0.4, lw=0, label="speed negative or beyond the axis")  # fmt: skip
    bottom.set(ylabel="phase speed c [m/s]", xlabel="frequency [Hz]", ylim=(0, fastest))
    top.legend()
    if bottom.get_legend_handles_labels()[0]:
        bottom.legend(loc="lower right")
    for panel, text in zip((top, bottom), "ab", strict=True):
        letter(panel, text)
    return figure


def _curves(top: Axes, bottom: Axes, fit: WaveFit, label: str, colour: str, ls: str) -> None:
    """Both estimates; the speed is faint where the phase is no straight line, so that it means little."""
    straight = fit.phase_misfit < _STRAIGHT
    top.plot(fit.frequency, fit.attenuation, color=colour, ls=ls, label=label)
    bottom.plot(fit.frequency, np.where(straight, fit.speed, np.nan), color=colour, ls=ls)
    bottom.plot(fit.frequency, np.where(straight, np.nan, fit.speed), color=colour, lw=0.6, ls=":")
    label = f"phase misfit above {_STRAIGHT:g} rad: no plane wave"
    if not straight.all() and label not in bottom.get_legend_handles_labels()[1]:  # said once, whichever curve it is
        bottom.plot([], [], color=GREY, lw=0.6, ls=":", label=label)
