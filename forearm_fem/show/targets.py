"""Figures 6 and 7: for a target, the surface at six instants and the grid points over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import FigureBase
from scipy.interpolate import griddata

from ..errors import DataError, NotApplicable
from ..ports import Port, positions
from ..rendering import to_spectrum
from ..results.files import Signals
from ..results.wavefield import Wavefield
from ..typing import ComplexArray, FloatArray
from .data import Results, record_of
from .device import busy
from .page import Table, stacked_rows
from .patch import VolarPatch, volar_patch
from .style import FAINT, GREY, INK, MICRO, SIGNED, figure_of, method_colour, panels, single, styled

_INSTANTS = 6
_FLAT = 1e-3  # of the grid's size: points that are no further off a line span no surface
_TIME = "time [ms]"
_MISSED = 1e-6  # of the drives' energy: rounding leaves 1e-14 beside the bins of the field
_BAR = 10.0  # mm: the scale below a map
_AROUND = 0.04  # s to either side of the focus: what a trace of a report shows
_MESH = 41  # points per side of the interpolated map


@dataclass(frozen=True, eq=False)
class Shown:
    """One method at one target.

    ``values`` (n_out, n_t) [m] at ``time`` (n_t,) [s]; ``instants`` (6,) [s]; ``between`` (6, ny, nx) [m] interpolated
    between the grid points; ``field`` (6, n_vertex) [m] the skin's own normal motion, None without a wavefield.
    """

    method: str
    time: FloatArray
    values: FloatArray
    instants: FloatArray
    between: FloatArray
    field: FloatArray | None


@dataclass(frozen=True, eq=False)
class TargetWaves:
    """A target under every method; ``x`` (nx,) and ``y`` (ny,) [m] span the interpolated maps."""

    target: str
    outputs: tuple[Port, ...]
    inputs: tuple[Port, ...]
    shown: tuple[Shown, ...]
    x: FloatArray
    y: FloatArray
    patch: VolarPatch | None

    @property
    def row(self) -> int:
        """Index of the target among the outputs."""
        return [p.name for p in self.outputs].index(self.target)


def target_waves(results: Results, target: str) -> TargetWaves:
    """Everything that figure 6 shows, for ``target``."""
    moved, g = results.displacements, results.transfer
    if target not in moved.targets:
        raise DataError(f"{results.folder}: nothing was rendered at target '{target}', only at "
                        f"{', '.join(moved.targets)}; `forearm-fem render` can")  # fmt: skip
    patch = volar_patch(results.field_mesh, (*g.inputs, *g.outputs)) if _has_waves(results, target) else None
    places = positions(g.outputs)[:, :2]
    span = np.ptp(places, axis=0)  # a line of points, or one, is given a width to be seen by
    aside = np.where(span > 0, 0.0, max(float(span.max()), 0.01) / 20)
    x, y = (np.linspace(p.min() - a, p.max() + a, _MESH) for p, a in zip(places.T, aside, strict=True))
    shown = []
    for method in moved.methods:
        values = _one(moved, method, target)
        instants = moments(moved.time, values, moved.channels.index(target))
        samples = np.searchsorted(moved.time, instants - 1e-9)
        between, field = _between(places, values[:, samples].T, x, y), None
        if patch is not None:
            spectrum = drive_series(results.drives, method, target, results.wavefield)
            field = patch.normal_field(results.wavefield).in_time(spectrum, instants)
        keep = busy(values, moved.time)
        shown.append(Shown(method, moved.time[keep], values[:, keep], instants, between, field))
    return TargetWaves(target, g.outputs, g.inputs, tuple(shown), x, y, patch)


def _one(signals: Signals, method: str, target: str) -> FloatArray:
    return np.asarray(signals.values[signals.methods.index(method), signals.targets.index(target)])


def moments(time: FloatArray, values: FloatArray, row: int) -> FloatArray:
    """Six instants [s] on samples, evenly spaced through the motion: the target's own peak is the fourth, the largest
    motion of any point is among them.

    The step is near a sixth of the span that holds 90 % of the motion, between 0.5 and 3 ms, or as large as it must be.
    """
    keep = busy(values, time, share=0.9, least=0.0)
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
    """Whether the field between the points is known on the bins of the drives towards ``target``."""
    if not results.has_field:
        return False
    try:
        drive_series(results.drives, results.drives.methods[0], target, results.wavefield)
    except NotApplicable:
        return False
    return True


def drive_series(drives: Signals, method: str, target: str, field: Wavefield, *, whole: bool = True) -> ComplexArray:
    """Fourier-series amplitudes (n_input, n_frequency) of the drives on the wavefield's bins.

    Raises NotApplicable unless these are bins of the drives, with ``whole`` all that they move anything on: the motion
    at some of them alone would be a fraction of it, and come again and again.
    """
    record = record_of(drives)
    index = np.rint(field.frequency / record.df).astype(int)
    spectrum = to_spectrum(_one(drives, method, target), record)
    off = np.abs(index * record.df - field.frequency) > 1e-3 * record.df
    inside = index[~off & (index < spectrum.shape[1])]
    left = np.delete(np.abs(spectrum) ** 2, inside, axis=1).sum()
    if off.any() or (whole and left > _MISSED * np.sum(np.abs(spectrum) ** 2)):
        raise NotApplicable(
            f"the field between the points is known at {len(index)} frequencies, and the drives lie on others between "
            "them; leave out sweep.frequencies, or `forearm-fem render` again where they are of another sweep"
        )
    return np.asarray(spectrum[:, index] * record.df)


def target_table(data: TargetWaves) -> Table:
    """Displacement of each grid point over time, method by method."""
    names = [f"u_{p.name}_m" for p in data.outputs]
    parts = {s.method: {"time_s": s.time, **dict(zip(names, s.values, strict=True))} for s in data.shown}
    return stacked_rows("method", parts)


def target_extra(data: TargetWaves) -> dict[str, str]:
    """The skin's own motion at the instants, vertex by vertex."""
    if data.patch is None:
        return {}
    at = data.patch.points
    columns: dict[str, Any] = {"x_m": at[:, 0], "y_m": at[:, 1], "z_m": at[:, 2]}
    for s in data.shown:
        for t, field in zip(s.instants, s.field if s.field is not None else (), strict=True):
            columns[f"u_{s.method}_at_{1e3 * t:.1f}ms_m"] = field
    return {"field.csv": Table(columns).as_csv()}


@styled
def plot_target(data: TargetWaves, *, ax: Axes | None = None) -> FigureBase:
    """Per method: maps at six instants (interpolated, and the field itself), and the grid points over time."""
    rows = 2 if data.patch is not None else 1
    figure = panels(ax, (10.2, 0.3 + len(data.shown) * (1.08 * rows + 0.4)))
    bands = figure.subfigures(len(data.shown), 1, squeeze=False)[:, 0]
    first = _most(data.shown[0])
    for band, shown in zip(bands, data.shown, strict=True):
        factor = _most(shown) / first if first > 0 else 1.0
        _band(band, data, shown, rows, "" if abs(factor - 1) < 0.005 else f"\nscale × {factor:.2g}")
    _same_time([a for a in figure_of(figure).axes if a.get_xlabel() == _TIME])
    return figure


def _most(shown: Shown) -> float:
    return float(np.nanmax(np.abs(shown.between), initial=0.0))


def _band(figure: FigureBase, data: TargetWaves, shown: Shown, rows: int, factor: str) -> None:
    maps, right = figure.subfigures(1, 2, width_ratios=(2.6, 1), squeeze=False)[0]
    grid = maps.subplots(rows, _INSTANTS, squeeze=False)
    most = MICRO * _most(shown)
    scale = Normalize(-most or -1.0, most or 1.0)
    places, coils = 1e3 * positions(data.outputs), 1e3 * positions(data.inputs)
    middle = places[:, :2].mean(axis=0)
    reach = 1.3 * np.abs(np.concatenate([places, coils])[:, :2] - middle).max()
    for k, t in enumerate(shown.instants):
        when = "0 ms" if abs(t) < 5e-5 else f"{1e3 * t:+.1f} ms"
        grid[0, k].set_title(when.replace("-", "\N{MINUS SIGN}"))
        grid[0, k].pcolormesh(1e3 * data.x, 1e3 * data.y, MICRO * shown.between[k], cmap=SIGNED, norm=scale,
                              shading="gouraud", rasterized=True)  # fmt: skip
        if shown.field is not None and data.patch is not None:
            grid[1, k].tripcolor(data.patch.triangulation, MICRO * shown.field[k], cmap=SIGNED, norm=scale,
                                 shading="gouraud", rasterized=True)  # fmt: skip
        for panel in grid[:, k]:
            panel.plot(places[:, 0], places[:, 1], ".", color=INK, ms=1.5)
            panel.plot(*places[data.row, :2], "o", mfc="none", mec=INK, ms=7, mew=0.9)
            panel.plot(coils[:, 0], coils[:, 1], "s", mfc="none", mec=GREY, ms=5, mew=0.6)
            panel.set(aspect="equal", xticks=(), yticks=(), xlim=(middle[0] - reach, middle[0] + reach),
                      ylim=(middle[1] - reach, middle[1] + reach))  # fmt: skip
            panel.grid(False)
            panel.spines[:].set_visible(False)
    left, (low, high) = grid[-1, 0].get_xlim()[0], grid[-1, 0].get_ylim()
    below = low - 0.09 * (high - low)
    grid[-1, 0].plot([left, left + _BAR], [below, below], color=INK, lw=2, solid_capstyle="butt", clip_on=False,
                     scalex=False, scaley=False)  # fmt: skip
    grid[-1, 0].annotate(f"{_BAR:g} mm", (left + _BAR, below), (3, 0), textcoords="offset points", va="center",
                         fontsize=6, annotation_clip=False)  # fmt: skip
    for panel, text in zip(grid[:, 0], ("interpolated", "field itself"), strict=False):
        panel.set_ylabel(text)
    bar = maps.colorbar(ScalarMappable(scale, SIGNED), ax=list(grid.ravel()), fraction=0.02, pad=0.01, extend="both",
                        shrink=0.9)  # fmt: skip
    bar.set_label(f"u [µm]{factor}", fontsize=7)  # the arrows say that the skin between may move more
    _traces(right.subplots(), data, shown)


def _curves(ax: Axes, data: TargetWaves, shown: Shown) -> None:
    for k, trace in enumerate(shown.values):
        if k != data.row:
            ax.plot(1e3 * shown.time, MICRO * trace, color=GREY, lw=0.7, ls=":")
    ax.plot([], [], color=GREY, lw=0.7, ls=":", label="the others")
    ax.plot(1e3 * shown.time, MICRO * shown.values[data.row], color=INK, label=f"target {data.target}")
    ax.set(xlabel=_TIME, ylabel="u [µm]", xlim=(1e3 * shown.time[0], 1e3 * shown.time[-1]))


def _traces(ax: Axes, data: TargetWaves, shown: Shown) -> None:
    _curves(ax, data, shown)
    for t in shown.instants:
        ax.axvline(1e3 * t, color=FAINT, lw=0.5, zorder=0)
    colour = method_colour(shown.method, [s.method for s in data.shown])
    ax.set_title(shown.method, color=colour, fontweight="bold", fontsize=9)
    ax.legend(loc="upper right", fontsize=6)


@styled
def plot_trace(data: TargetWaves, method: str, title: str, *, ax: Axes | None = None) -> Axes:
    """The grid points over time under one ``method``: the target solid, the others dotted."""
    axes = single(ax, (2.9, 2.2))
    shown = next(s for s in data.shown if s.method == method)
    _curves(axes, data, shown)
    times = np.array([(s.time[0], s.time[-1]) for s in data.shown])
    axes.set_xlim(*(1e3 * np.clip((times[:, 0].min(), times[:, 1].max()), -_AROUND, _AROUND)))
    axes.set_title(title, color=method_colour(method, [s.method for s in data.shown]), fontweight="bold")
    return axes


@styled
def plot_traces(data: TargetWaves, *, ax: Axes | None = None) -> FigureBase:
    """Only the grid points over time, one panel per method: the lower half of figures 6 and 7."""
    figure = panels(ax, (2.6 * len(data.shown), 2.4))
    axes = np.atleast_1d(figure.subplots(1, len(data.shown)))
    for panel, shown in zip(axes, data.shown, strict=True):
        _traces(panel, data, shown)
    _same_time(list(axes))
    return figure


def _same_time(axes: list[Axes]) -> None:
    """One time base for every method."""
    limits = np.array([a.get_xlim() for a in axes])
    for a in axes:
        a.set_xlim(limits[:, 0].min(), limits[:, 1].max())
