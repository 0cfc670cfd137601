"""Figures 6 and 7: for a target, the surface at six instants and the grid points over time."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from scipy.interpolate import griddata

from ..errors import DataError, NotApplicable
from ..ports import positions
from ..rendering import to_spectrum
from ..results.files import Signals, Wavefield
from ..typing import ComplexArray, FloatArray
from .data import Results, places, record_of
from .device import active_span
from .patch import volar_patch
from .style import COLUMN, FAINT, GREY, INK, MICRO, PAGE, SIGNED, method_colour, sheet, single, styled

_INSTANTS = 6
_FLAT = 1e-3  # of the grid's size: points that are no further off a line span no surface
_MISSED = 1e-6  # of the drives' energy: rounding leaves 1e-14 beside the bins of the field
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
    values = np.array([_one(moved, m, target) for m in moved.methods])
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


def _one(signals: Signals, method: str, target: str) -> FloatArray:
    return np.asarray(signals.values[signals.methods.index(method), signals.targets.index(target)])


def moments(time: FloatArray, values: FloatArray, row: int) -> FloatArray:
    """Six instants [s] on samples, evenly spaced through the motion: the target's own peak is the fourth, the largest
    motion of any point is among them.

    The step is near a sixth of the span that holds 90 % of the motion, between 0.5 and 3 ms, or as large as it must be.
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


@styled
def plot_target(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """Per method: maps at six instants (interpolated, and the field itself), and the grid points over time.

    A page has the time series beside the maps, a journal's column below them. Each method has a scale of its own, whose
    factor stands at its bar.
    """
    rows, wide = 2 if "field" in data else 1, width > COLUMN
    tall = 8 + (19 if wide else 12.5) * rows if wide else 8 + 13.5 * rows + 26
    figure = sheet(width, 5 + tall * data.sizes["method"])
    bands = figure.subfigures(data.sizes["method"], 1, squeeze=False)[:, 0]
    most = MICRO * np.nanmax(np.abs(data.between.values), axis=(1, 2, 3), initial=0.0)
    for m, band in enumerate(bands):
        factor = most[m] / most[0] if most[0] > 0 else 1.0
        said = "" if abs(factor - 1) < 0.005 else f" × {factor:.2g}"
        shape: dict[str, Any] = {"width_ratios": (2.6, 1)} if wide else {"height_ratios": (8 + 13.5 * rows, 26)}
        maps, traces = band.subfigures(*((1, 2) if wide else (2, 1)), squeeze=False, **shape).ravel()
        _maps(maps, data, m, float(most[m]), said, rows, wide)
        _traces(traces.subplots(), data, m, titled=wide)
        if not wide:
            maps.suptitle(data.method.values[m], color=_colour(data, m), fontweight="bold", fontsize=8)
    return figure


def _colour(data: xr.Dataset, m: int) -> str:
    return method_colour(str(data.method.values[m]), list(data.method.values))


def _maps(figure: Any, data: xr.Dataset, m: int, most: float, factor: str, rows: int, wide: bool) -> None:
    grid = figure.subplots(rows, _INSTANTS, squeeze=False)
    scale = Normalize(-most or -1.0, most or 1.0)
    points, coils = (1e3 * data[f"{side}_place"].values[:, :2] for side in ("output", "input"))
    middle = points.mean(axis=0)
    reach = 1.3 * np.abs(np.concatenate([points, coils]) - middle).max()
    for k, t in enumerate(data.when.values[m]):
        when = "0" if abs(t) < 5e-5 else f"{1e3 * t:+.1f}"
        when += " ms" if wide or k == 0 else ""  # a column has no room for more
        grid[0, k].set_title(when.replace("-", "\N{MINUS SIGN}"), fontsize=7 if wide else 6)
        grid[0, k].pcolormesh(1e3 * data.x, 1e3 * data.y, MICRO * data.between[m, k], cmap=SIGNED, norm=scale,
                              shading="gouraud", rasterized=True)  # fmt: skip
        if "field" in data:
            seen = Triangulation(1e3 * data.vertex_x, 1e3 * data.vertex_y, data.triangles)
            grid[1, k].tripcolor(seen, MICRO * data.field.values[m, k], cmap=SIGNED, norm=scale, shading="gouraud",
                                 rasterized=True)  # fmt: skip
        for panel in grid[:, k]:
            panel.plot(*points.T, ".", color=INK, ms=1.5)
            panel.plot(*points[_row(data)], "o", mfc="none", mec=INK, ms=7 if wide else 4, mew=0.9)
            panel.plot(*coils.T, "o", mfc="none", mec=GREY, ms=5 if wide else 3, mew=0.6)
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
    for panel, text in zip(grid[:, 0], ("interpolated", "field itself") if wide else ("points", "skin"), strict=False):
        panel.set_ylabel(text, fontsize=7)
    bar = figure.colorbar(ScalarMappable(scale, SIGNED), ax=list(grid.ravel()), fraction=0.02, pad=0.01, extend="both",
                          shrink=0.9)  # fmt: skip
    bar.set_label(f"u [µm]{chr(10) if factor else ''}{'scale' if factor else ''}{factor}", fontsize=7)


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


def _traces(ax: Axes, data: xr.Dataset, m: int, *, titled: bool) -> None:
    _curves(ax, data, m)
    for t in data.when.values[m]:
        ax.axvline(1e3 * t, color=FAINT, lw=0.5, zorder=0)
    if titled:
        ax.set_title(data.method.values[m], color=_colour(data, m), fontweight="bold", fontsize=9)
        ax.set_xlabel("time [ms]; target solid", fontsize=7)
    else:  # outside, so that no curve yields to it
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, fontsize=6, ncols=2)


@styled
def plot_trace(data: xr.Dataset, method: str, title: str, *, ax: Axes | None = None) -> Axes:
    """The grid points over time under one ``method``: the target solid, the others dotted."""
    axes = single(ax, (2.9, 2.2))
    m = list(data.method.values).index(method)
    _curves(axes, data, m)
    axes.set_title(title, color=_colour(data, m), fontweight="bold")
    return axes
