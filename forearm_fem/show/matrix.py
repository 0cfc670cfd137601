"""G: its entries, its inversion, its measurement's distance; and waves along a line (figures 2 and A.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.special import hankel2

from ..engines.layered import flat_layers, flat_membrane
from ..errors import NotApplicable, ScenarioError
from ..geometry.device.layout import layers_of
from ..layered import surface_kernel
from ..layered.root import trace_root
from ..metrics import condition_number, fit_waves, singular_values
from ..metrics.waves import beside
from ..ports import Port, distances, positions
from ..rendering import AutoZeros, BinnedTransfer, Drives, InverseFilter, Wavelet, displacements, drives, on_record_bins
from ..rendering.renderers import Aim, known_bins
from ..rendering.signals import BinValues, Record
from ..scenario import Scenario
from ..store.folder import atomic_path
from ..transfer import TransferMatrix, entry_errors
from ..typing import ComplexArray, FloatArray
from .data import Results, places
from .motion import volar_patch
from .style import (
    ACTUATORS,
    COLUMN,
    FAINT,
    GREY,
    MICRO,
    NEARNESS,
    PAGE,
    SIZE,
    arrange,
    decimal,
    letter,
    micro,
    sheet,
    sign,
    single,
    styled,
)


def shown(transfer: TransferMatrix) -> ComplexArray:
    """Values (n, n_out, n_in) with NaN where they may not be used."""
    values = transfer.values
    return values if transfer.valid is None else np.where(transfer.valid, values, np.nan + 0j)


def unwrapped(values: ComplexArray) -> FloatArray:
    """Phase [cycles] along the first axis, unwrapped; NaN stays NaN."""
    phase = np.angle(values)
    known = np.isfinite(phase)
    filled = np.where(known, phase, 0.0)
    return np.where(known, np.unwrap(filled, axis=0), np.nan) / (2 * np.pi)


def transfer_of(g: TransferMatrix) -> xr.Dataset:
    """G (frequency, output, input): ``size``, ``error`` that it is stated to be off by (NaN where unknown), and
    ``phase`` [rad]."""
    values, dims, unit = shown(g), ("frequency", "output", "input"), {"units": g.unit}
    return xr.Dataset(
        {"size": (dims, np.abs(values), unit), "error": (dims, entry_errors(g), unit),
         "phase": (dims, np.angle(values), {"units": "rad"})},
        {"frequency": ("frequency", g.frequency, {"units": "Hz"}), **places(g.outputs, g.inputs)},
    )  # fmt: skip


@styled
def plot_transfer(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """|G| and unwrapped phase of every grid point, one column per actuator, coloured by distance to it.

    Entries lie in the band that they are stated to be known to; where that reaches zero they are pale. A journal's
    column holds two actuators beside each other.
    """
    n = data.sizes["input"]
    beside = min(n, 2 if width <= COLUMN else 6)
    rows = -(-n // beside)
    figure = sheet(width, rows * (96 if width > COLUMN else 78) + 6)
    axes = figure.subplots(2 * rows, beside, sharex=True, squeeze=False)
    apart = data.output_place.values[:, None] - data.input_place.values[None]
    gap = 1e3 * np.linalg.norm(apart, axis=2)
    scale = Normalize(float(gap.min()), float(gap.max()))
    sizes, errors = MICRO * data["size"].values, MICRO * data.error.values
    unknown = "" if np.isfinite(errors).any() else ", error unknown"
    cycles = unwrapped(data["size"].values * np.exp(1j * data.phase.values))
    for i in range(n):
        top, bottom = axes[2 * (i // beside), i % beside], axes[2 * (i // beside) + 1, i % beside]
        foot = np.nanmin(sizes[:, :, i], initial=np.inf)
        for o in np.argsort(-gap[:, i]):  # far points first, so that near ones lie on top
            size, error, colour = sizes[:, o, i], errors[:, o, i], NEARNESS(scale(gap[o, i]))
            known = ~(error >= size)  # where nothing is stated, nothing is doubted
            low, high = np.maximum(size - error, foot), size + error
            top.fill_between(data.frequency, low, high, where=known, color=colour, alpha=0.2, lw=0)
            top.plot(data.frequency, size, color=colour, alpha=0.35, lw=0.8)
            top.plot(data.frequency, np.where(known, size, np.nan), color=colour)
            bottom.plot(data.frequency, cycles[:, o, i], color=colour)
        top.set(title=f"actuator {data.input.values[i]}{unknown}", yscale="log")
        if i % beside == 0:
            top.set_ylabel(f"|G| [{micro(data['size'].units)}]")
            bottom.set_ylabel("phase [cycles]")
        if i + beside >= n:
            bottom.set_xlabel("frequency [Hz]")
            bottom.tick_params(labelbottom=True)
    for k in (0, 1):
        _alike(list(axes[k::2].ravel()[:n]))
    for panel in (axes[1::2].ravel()[n:], axes[0::2].ravel()[n:]):
        for empty in panel:
            empty.axis("off")
    place = {"location": "bottom", "fraction": 0.02} if width <= COLUMN else {"fraction": 0.03}
    bar = figure.colorbar(ScalarMappable(scale, NEARNESS), ax=list(axes.ravel()), pad=0.01, **place)
    bar.set_label("distance to the actuator [mm]")
    return figure


def _alike(axes: list[object]) -> None:
    """One scale for all ``axes``."""
    limits = np.array([ax.get_ylim() for ax in axes])  # type: ignore[attr-defined]
    for ax in axes:
        ax.set_ylim(limits[:, 0].min(), limits[:, 1].max())  # type: ignore[attr-defined]


def conditioning(results: Results) -> xr.Dataset:
    """Singular values and condition numbers of a run's G, and of the rows that its renderers inverted; where no zero
    points are on record (nothing rendered) of the default ones."""
    on_record = results.account.signal_strength.zeros
    held = next((found for m in ("inverse filter", "combination") if (found := on_record.get(m))), None)
    return conditioning_of(results.transfer, held)


def conditioning_of(transfer: TransferMatrix, zeros: Mapping[str, Sequence[str]] | None = None) -> xr.Dataset:
    """``singular`` (frequency, order) of G, ``condition`` (frequency), and ``control`` (target, frequency) of the rows
    that the inverse filter controls.

    ``zeros`` are the zero points of each target; None: every output with its default ones, none where the grid is no
    rectangle.
    """
    values = shown(transfer)
    names = [p.name for p in transfer.outputs]
    held = {t: zero_points(transfer, t) for t in names} if zeros is None else zeros
    rows = {t: [names.index(n) for n in (t, *others)] for t, others in held.items()}
    rows = {t: r for t, r in rows.items() if len(r) > 1}
    control = np.array([condition_number(values[:, r]) for r in rows.values()]).reshape(len(rows), len(values))
    singular = singular_values(values)
    return xr.Dataset(
        {"singular": (("frequency", "order"), singular, {"units": transfer.unit}),
         "condition": ("frequency", condition_number(values)), "control": (("target", "frequency"), control)},
        {"frequency": ("frequency", transfer.frequency, {"units": "Hz"}), "target": list(rows),
         "order": np.arange(1, singular.shape[1] + 1)},
    )  # fmt: skip


def zero_points(transfer: TransferMatrix, target: str) -> tuple[str, ...]:
    """The default zero points for ``target``: the thesis' for up to four actuators on a rectangular grid, else all."""
    bins = BinValues(Record(1.0, 4), np.array([1]), transfer.values[:1], np.ones(transfer.values[:1].shape, bool))
    placed = BinnedTransfer(bins, transfer.outputs, transfer.inputs, transfer.unit, np.full(1, np.nan))
    return AutoZeros().choose(placed, target, _unused)


def _unused(names: tuple[str, ...]) -> Aim:
    raise AssertionError(f"the corner rule does not try drives, asked for {names}")


@styled
def plot_conditioning(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """Singular values of G, and condition numbers of G and of the rows an inverse filter controls."""
    wide = width > COLUMN
    figure = sheet(width, 70 if wide else 125)
    left, right = figure.subplots(1, 2) if wide else figure.subplots(2, 1)
    for k, line in zip(data.order.values, data.singular.values.T, strict=True):
        left.plot(data.frequency, MICRO * line, label=f"$s_{k}$")
    left.set(yscale="log", xlabel="frequency [Hz]", ylabel=f"singular values of G [{micro(data.singular.units)}]")
    left.legend(ncols=2)
    decimal(left.yaxis)
    targets = list(data.target.values)
    for k, line in enumerate(data.control.values):
        label = f"controlled rows, each target ({len(targets)})" if k == 0 else None
        right.plot(data.frequency, line, color=FAINT, lw=0.7, label=label)
    if "5" in targets:
        line = data.control.values[targets.index("5")]
        right.plot(data.frequency, line, color="#D55E00", label="controlled rows, target 5")
    right.plot(data.frequency, data.condition, color="#0072B2", label="all of G")
    right.set(yscale="log", xlabel="frequency [Hz]", ylabel="condition number [-]")
    right.legend()
    decimal(right.yaxis)
    for panel, text in zip((left, right), "ab", strict=True):
        letter(panel, text)
    return figure


@styled
def plot_entries(transfer: TransferMatrix, *, ax: Axes | None = None) -> Axes:
    """|G| of all entries over frequency [Hz] in their actuator's colour.

    Grey dots are entries marked invalid, faint grey is one standard deviation.
    """
    ax = single(ax)
    size = np.abs(transfer.values)
    size = np.where(size > 0, size, np.nan)  # a dead channel has no logarithm
    valid = np.isfinite(size) if transfer.valid is None else transfer.valid
    for k, port in enumerate(transfer.inputs):
        colour = ACTUATORS[k % len(ACTUATORS)]
        lines = ax.loglog(transfer.frequency, np.where(valid, size, np.nan)[:, :, k], color=colour, lw=0.7)
        lines[0].set_label(port.name)
        ax.loglog(transfer.frequency, np.where(valid, np.nan, size)[:, :, k], ".", ms=1, color=FAINT, zorder=1)
    if transfer.deviation is not None:
        noise = np.where(transfer.deviation > 0, transfer.deviation, np.nan).reshape(len(size), -1)
        ax.loglog(transfer.frequency, noise, lw=0.4, color=FAINT, zorder=0)
    ax.set(xlabel="frequency [Hz]", ylabel=f"|G| [{transfer.unit}]", title="entries measured")
    ax.legend(ncols=2)
    decimal(ax.xaxis)
    return ax


@styled
def plot_coherence(frequency: FloatArray, coherence: FloatArray, *, ax: Axes | None = None) -> Axes:
    """Coherence (n_frequency, n_out, n_in) [-] of all entries, in their actuator's colour."""
    ax = single(ax)
    for k in range(coherence.shape[2]):
        ax.semilogx(frequency, coherence[:, :, k], lw=0.7, color=ACTUATORS[k % len(ACTUATORS)])
    ax.set(xlabel="frequency [Hz]", ylabel="coherence", ylim=(0, 1.02), title="coherence")
    decimal(ax.xaxis)
    return ax


@styled
def plot_done(valid: FloatArray, outputs: tuple[str, ...], inputs: tuple[str, ...], *, ax: Axes | None = None) -> Axes:
    """Share (n_out, n_in) [-] of usable bins per entry; a cross where nothing was measured yet (NaN)."""
    ax = single(ax)
    image = ax.imshow(valid, vmin=0, vmax=1, cmap=SIZE, aspect="auto")
    for o, i in np.argwhere(np.isnan(valid)):
        ax.text(i, o, "\N{MULTIPLICATION SIGN}", ha="center", va="center", color=FAINT)
    ax.set_xticks(range(len(inputs)), inputs)
    ax.set_yticks(range(len(outputs)), outputs)
    ax.tick_params(length=0)
    ax.grid(False)
    ax.set(xlabel="actuator", ylabel="point", title="share of usable bins")
    ax.figure.colorbar(image, ax=ax, ticks=(0, 0.5, 1))
    return ax


@styled
def save_live(path: str | Path, transfer: TransferMatrix, coherence: FloatArray) -> None:
    """The state of a calibration as one picture, replaced in one step so that a viewer never sees half of it."""
    with atomic_path(path) as beside:
        live(transfer, coherence).savefig(beside, dpi=200)


@styled
def live(transfer: TransferMatrix, coherence: FloatArray) -> Figure:
    """The state of a calibration."""
    figure = Figure(figsize=(7.0, 2.5), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    finite = np.isfinite(transfer.values)
    if finite.any():
        plot_entries(transfer, ax=left)
    if np.isfinite(coherence).any():
        plot_coherence(transfer.frequency, coherence, ax=middle)
    else:
        middle.set_axis_off()
    valid = finite if transfer.valid is None else transfer.valid
    share = np.where(finite.any(axis=0), valid.mean(axis=0), np.nan)
    plot_done(share, tuple(p.name for p in transfer.outputs), tuple(p.name for p in transfer.inputs), ax=right)
    for ax, text in zip((left, middle, right), "abc", strict=True):
        letter(ax, text)
    done = int(finite.any(axis=0).sum())
    sign(figure, f"{done} of {share.size} entries measured; grey: one standard deviation, and bins marked invalid")
    arrange(figure)
    return figure

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
