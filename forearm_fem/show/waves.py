"""One actuator, one line on the skin: the thesis' figures 2 and A.2."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.special import hankel2

from ..engines.layered import flat_layers, flat_membrane
from ..errors import NotApplicable, ScenarioError
from ..geometry.device.layout import layers_of
from ..layered import surface_kernel
from ..layered.root import trace_root
from ..metrics import fit_waves
from ..metrics.waves import beside
from ..ports import Port, distances, positions
from ..rendering import Drives, InverseFilter, Wavelet, displacements, drives, on_record_bins
from ..rendering.renderers import Aim, known_bins
from ..rendering.signals import BinnedTransfer
from ..scenario import Scenario
from ..transfer import TransferMatrix
from ..typing import ComplexArray, FloatArray
from .data import Results
from .matrix import shown
from .motion import volar_patch
from .style import COLUMN, FAINT, GREY, MICRO, PAGE, letter, sheet, styled

_STRAIGHT = 0.5  # rad: beyond, the phase along the line is no line
_STEP, _POINTS = 2.5e-3, 10  # appendix A: 10 points every 2.5 mm
_LOCATIONS = (4e-3, 8e-3, 12e-3, 16e-3)  # figure 2: four places besides the actuator


def line(results: Results, places: tuple[float, ...]) -> xr.Dataset:
    """From the first actuator in contact towards the grid's middle at ``places`` [m], from the wavefield; without one
    the row of grid points nearest to the actuator.

    ``response`` (frequency, distance), ``cone`` (frequency), its own motion where known; attributes ``actuator`` and
    ``origin`` of the numbers.
    """
    g, first = results.transfer, results.scenario.device.first_in_contact
    cone = None if g.contacts is None else g.contacts[:, first, first]
    if not results.has_field:
        chosen = _row(g.outputs, g.inputs[first])
        frequency, gap = g.frequency, distances(g.outputs, g.inputs)[chosen, first]
        values, origin = shown(g)[:, chosen, first], "row of grid points"
    else:
        start = positions(g.inputs)[first]
        toward = positions(g.outputs)[:, :2].mean(axis=0) - start[:2]
        along = toward / np.linalg.norm(toward)
        patch = volar_patch(results.field_mesh, (*g.inputs, *g.outputs))
        fine = np.linspace(0, 1.05 * places[-1], 60)
        gaps = np.linalg.norm(patch.lift(start[:2] + np.outer(fine, along)) - start, axis=1)
        corners, weights = patch.weights(start[:2] + np.outer(np.interp(places, gaps, fine), along))
        field = patch.normal_field(results.wavefield).between(corners, weights)
        frequency, gap, values = field.frequency, np.array(places), field.response(first)
        origin = "field between the points"
        cone = cone if np.array_equal(g.frequency, frequency) else None
    unit = {"units": g.unit}
    data = xr.Dataset(
        {"response": (("frequency", "distance"), values, unit)},
        {"frequency": ("frequency", frequency, {"units": "Hz"}), "distance": ("distance", gap, {"units": "m"})},
        {"actuator": g.inputs[first].name, "origin": origin},
    )
    return data if cone is None else data.assign(cone=("frequency", cone, unit))


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


def travel(results: Results) -> xr.Dataset:
    """A wavelet along a line: the inverse filter aims it at the last place; funneling sends the wavelet itself.

    ``drive`` (method, time), ``u`` (method, place, time) [m] and ``spectrum`` |U| (method, place, frequency). The first
    place is the cone itself where its motion is known.
    """
    along = line(results, _LOCATIONS)
    cone = (along.cone.values[:, None],) if "cone" in along else ()
    values = np.concatenate([*cone, along.response.values], axis=1)[:, :, None]
    labels = ["cone"] * len(cone) + [f"{1e3 * d:.0f} mm" for d in along.distance.values]
    outputs = tuple(Port(f"{k}: {n}", "point", (float(k), 0.0, 0.0)) for k, n in enumerate(labels))
    source = Port(along.actuator, "contact", (0.0, 0.0, 0.0))
    g = TransferMatrix(along.frequency.values, values, outputs, (source,), along.response.units,
                       valid=np.isfinite(values))  # fmt: skip
    far = g.outputs[-1].name
    aimed = drives(InverseFilter(zeros=(), peak=1e-6), g, far, results.wavelet)
    both = (aimed, _plain(g, results.wavelet, far))
    keep = np.abs(results.wavelet.time) < 0.025
    moved = [displacements(g, d).values[:, keep] for d in both]
    spectra = [np.abs(on_record_bins(g, d.record).bins.values[:, :, 0] * d.spectrum).T for d in both]
    return xr.Dataset(
        {"u": (("method", "place", "time"), np.array(moved), {"units": "m"}),
         "drive": (("method", "time"), np.array([d.signals[0][keep] for d in both]), {"units": aimed.unit}),
         "spectrum": (("method", "place", "frequency"), np.array(spectra), {"units": "m_per_Hz"})},
        {"method": ["inverse filter", "funneling"], "place": labels,
         "time": ("time", results.wavelet.time[keep], {"units": "s"}),
         "frequency": ("frequency", aimed.frequency, {"units": "Hz"})},
        {"actuator": along.actuator, "origin": along.origin},
    )  # fmt: skip


def _plain(g: TransferMatrix, wavelet: Wavelet, target: str) -> Drives:
    """The wavelet itself on the only actuator, cut to the bins of G."""

    class Itself:
        """A renderer that sends the wavelet."""

        name = "funneling"

        def aim(self, placed: BinnedTransfer, target: str, wavelet: ComplexArray) -> Aim:
            """The wavelet, silent where G is unknown at the target."""
            used = known_bins(placed, [placed.row(target)])
            return Aim(np.where(used, wavelet, 0)[:, None], used)

    return drives(Itself(), g, target, wavelet)


@styled
def plot_travel(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """A wavelet attenuated and dispersed along a line: drive, displacement and spectrum at each place."""
    n, wide = data.sizes["place"], width > COLUMN
    each = 24 + 15 * (n + 3) if wide else 16 + 12 * (n + 3)
    figure = sheet(width, each if wide else each * data.sizes["method"])
    halves: Any = figure.subfigures(*((1, 2) if wide else (2, 1)))
    for m, half in enumerate(halves):
        axes = half.subplots(n + 2, 1, height_ratios=[1] * (n + 1) + [2.6])
        colours = [colormaps["viridis_r"](0.18 + 0.82 * (k + 0.5) / n) for k in range(n)]  # no yellow
        ms = 1e3 * data.time.values
        where = "wavelet asked for at the last place" if m == 0 else "wavelet sent as it is"
        half.suptitle(f"{'ab'[m]}   {data.method.values[m]}: {where}", fontsize=8, fontweight="bold")
        axes[0].plot(ms, data.drive[m], color=GREY)
        axes[0].set_ylabel(f"drive\n[{data.drive.units}]", rotation=0, ha="right", va="center")
        for k, panel in enumerate(axes[1:-1]):
            panel.plot(ms, MICRO * data.u[m, k], color=colours[k])
            panel.set_ylabel(f"{data.place.values[k]}\n[µm]", rotation=0, ha="right", va="center")
            axes[-1].plot(data.frequency, 1e9 * data.spectrum[m, k], color=colours[k])
        for panel in axes[:-1]:
            panel.set_xlim(ms[0], ms[-1])
            panel.locator_params(axis="y", nbins=3)
            panel.axvline(0, color=GREY, lw=0.5, ls=":")
            panel.tick_params(labelbottom=panel is axes[-2])
        axes[-2].set_xlabel("time [ms]")
        axes[-1].set(xlabel="frequency [Hz]", ylabel="|U| [nm/Hz]", yscale="log")
    return figure


def dispersion(results: Results) -> xr.Dataset:
    """Appendix A on a run: 10 points every 2.5 mm from the first actuator, 50-500 Hz.

    ``attenuation`` [1/m], ``speed`` [m/s] and ``misfit`` of the phase [rad] (wave, frequency) by the thesis' estimator:
    of the run's wave ("all"), and where the limb is flat layers of the "surface wave" alone, spreading in a circle,
    whose complex wavenumber ``root`` [1/m] (frequency) is the root of the layered kernel. ``first`` and ``last`` [m]
    are the window.
    """
    along = line(results, tuple(_STEP * (k + 1) for k in range(_POINTS)))
    if along.sizes["distance"] < 3:
        raise NotApplicable("a wave fit needs 3 points in a row or a wavefield; this grid has neither")
    inside = (along.frequency.values >= 50) & (along.frequency.values <= 500)
    outside = beside(along.distance.values, results.scenario.device.cone.radius)
    if outside.sum() < 3:
        raise NotApplicable("a wave fit needs 3 points in a row beside the cone; this grid has fewer")
    kept = along.isel(frequency=np.flatnonzero(inside)[:: max(1, int(inside.sum()) // 180)], distance=outside)
    f, gap = kept.frequency.values, kept.distance.values
    root = kernel_root(results.scenario, f)
    fits = [fit_waves(f, gap, kept.response.values)]
    fits += [] if root is None else [fit_waves(f, gap, hankel2(0, root[:, None] * gap))]
    units = {"attenuation": "per_m", "speed": "m_per_s", "phase_misfit": "rad"}
    data = xr.Dataset(
        {n: (("wave", "frequency"), np.array([getattr(x, n) for x in fits]), {"units": u}) for n, u in units.items()},
        {"wave": ["all", "surface wave"][: len(fits)], "frequency": ("frequency", f, {"units": "Hz"})},
        {"first": float(gap[0]), "last": float(gap[-1]), "origin": along.origin},
    )
    return data if root is None else data.assign(root=("frequency", root, {"units": "per_m"}))


def kernel_root(scenario: Scenario, frequency: FloatArray) -> ComplexArray | None:
    """The Rayleigh-like root of the scenario's layers with the membrane on them; None for a limb without layers, and
    under a patch, which has edges."""
    if not layers_of(scenario.limb):
        return None
    try:
        layers, skin = flat_layers(scenario), flat_membrane(scenario.tissues)
    except ScenarioError:
        return None
    return trace_root(lambda k, w: surface_kernel(k, w, layers, surface=skin), layers, 2 * np.pi * frequency)


@styled
def plot_dispersion(data: xr.Dataset, *, width: int = COLUMN) -> Figure:
    """Attenuation and phase speed over frequency, by the thesis' estimator and as the root of the layered kernel."""
    figure = sheet(width, 112 if width <= COLUMN else 75)
    top, bottom = figure.subplots(2, 1, sharex=True) if width <= COLUMN else figure.subplots(1, 2)
    window = f"{1e3 * data.first:.3g}–{1e3 * data.last:.3g} mm"
    _curves(top, bottom, data.isel(wave=0), f"thesis' estimator, {window}", "#0072B2")
    f, speed = data.frequency.values, data.speed.values[0]
    if "root" in data:
        _curves(top, bottom, data.isel(wave=1), "same estimator, surface wave alone", "#56B4E9")
        top.plot(f, -data.root.values.imag, color="#D55E00", ls="--", label="root of the layered kernel")
        bottom.plot(f, 2 * np.pi * f / data.root.values.real, color="#D55E00", ls="--")
    top.set(ylabel="attenuation δ [1/m]", ylim=(0, None), xlim=(f[0], f[-1]))
    good = speed[(data.phase_misfit.values[0] < _STRAIGHT) & (speed > 0)]
    fastest = float(min(1.3 * np.quantile(good, 0.95) + 1, 20)) if len(good) else 10.0  # not spoilt by wild estimates
    drawn = (speed > 0) & (speed < fastest)
    if not drawn.all():  # so that a curve that ends says why
        bottom.fill_between(f, 0, 1, where=~drawn, step="mid", transform=bottom.get_xaxis_transform(), color=FAINT,
                            alpha=0.4, lw=0, label="speed negative or beyond the axis")  # fmt: skip
    bottom.set(ylabel="phase speed c [m/s]", xlabel="frequency [Hz]", ylim=(0, fastest), xlim=(f[0], f[-1]))
    top.legend()
    if bottom.get_legend_handles_labels()[0]:
        bottom.legend()
    if width > COLUMN:
        top.set_xlabel("frequency [Hz]")
    for panel, text in zip((top, bottom), "ab", strict=True):
        letter(panel, text)
    return figure


def _curves(top: Axes, bottom: Axes, wave: xr.Dataset, label: str, colour: str) -> None:
    """Both estimates; the speed is faint where the phase is no straight line, so that it means little."""
    straight = wave.phase_misfit.values < _STRAIGHT
    top.plot(wave.frequency, wave.attenuation, color=colour, label=label)
    bottom.plot(wave.frequency, np.where(straight, wave.speed, np.nan), color=colour)
    bottom.plot(wave.frequency, np.where(straight, np.nan, wave.speed), color=colour, lw=0.6, ls=":")
    label = f"phase misfit above {_STRAIGHT:g} rad: no plane wave"
    if not straight.all() and label not in bottom.get_legend_handles_labels()[1]:  # said once, whichever curve it is
        bottom.plot([], [], color=GREY, lw=0.6, ls=":", label=label)
