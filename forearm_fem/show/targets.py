"""Figures 6 and 7: for a target, the surface at some instants and the grid points over time."""

from __future__ import annotations

from dataclasses import dataclass
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
from .style import (
    COLUMN,
    FAINT,
    GREY,
    INK,
    MICRO,
    PAGE,
    SIGNED,
    method_look,
    minus,
    round_down_125,
    sheet,
    single,
    styled,
)

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


@dataclass(frozen=True)
class _Sheet:
    """Places [mm] of a figure's axes, from its upper left; each kind of axes has one left edge for all methods."""

    wide: bool
    rows: int
    shown: int
    methods: int

    @property
    def width(self) -> int:
        """Of the figure."""
        return PAGE if self.wide else COLUMN

    @property
    def size(self) -> float:
        """Of a map, which is square."""
        return 15.5

    @property
    def bar(self) -> float:
        """Left edge of the colour bars."""
        return _LEFT + self.shown * (self.size + _GAP) + 1.0

    @property
    def tall(self) -> float:
        """Of what belongs to one method."""
        maps = _HEAD + self.rows * (self.size + 4.0)
        return maps + (6.0 if self.wide else 23.5)

    @property
    def height(self) -> float:
        """Of the figure: legend above, label of the time axis and footer below."""
        return 2.0 + self.tall * self.methods + (6.0 if self.wide else 7.5)

    def axes(self, figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
        """New axes there."""
        across, up = self.width, self.height
        return figure.add_axes((left / across, 1 - (top + height) / up, width / across, height / up))

    def write(self, figure: Figure, left: float, top: float, text: str, **look: Any) -> None:
        """``text`` there."""
        figure.text(left / self.width, 1 - top / self.height, text, va="center", **look)

    def maps(self, figure: Figure, top: float, row: int) -> list[Axes]:
        """One row of maps of the method whose band begins at ``top``."""
        at = top + _HEAD + row * (self.size + 4.0)
        return [self.axes(figure, _LEFT + k * (self.size + _GAP), at, self.size, self.size) for k in range(self.shown)]

    def traces(self, figure: Figure, top: float) -> Axes:
        """Axes over time beside the maps, or below them."""
        if self.wide:
            left = self.bar + 25.0
            return self.axes(figure, left, top + _HEAD, self.width - left - 3.0, self.tall - _HEAD - 6.0)
        below = top + _HEAD + self.rows * (self.size + 4.0) + 1.5
        return self.axes(figure, _LEFT, below, self.width - _LEFT - 3.0, 15.0)


_LEFT, _HEAD, _GAP = 11.5, 8.0, 0.8  # mm: left of maps, and of axes over time in a column; above the maps of a method


@styled
def plot_target(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """Per method: maps at some instants (interpolated, and the field itself), and the grid points over time.

    A page has six instants and the time series beside the maps, a journal's column four of them and the series below.
    Each method has a scale of its own, whose factor stands at its bar.
    """
    rows, wide = 2 if "field" in data else 1, width > COLUMN
    room = _Sheet(wide, rows, _INSTANTS if wide else 4, data.sizes["method"])
    figure = sheet(width, room.height)
    figure.set_layout_engine("none")
    most = MICRO * np.nanmax(np.abs(data.between.values), axis=(1, 2, 3), initial=0.0)
    for m, method in enumerate(data.method.values):
        top = 2.0 + m * room.tall
        factor = most[m] / most[0] if most[0] > 0 else 1.0
        room.write(figure, _LEFT, top + 2.0, str(method), color=_colour(data, m), fontweight="bold", fontsize=9)
        _maps(figure, room, top, data, m, float(most[m]), "" if abs(factor - 1) < 0.005 else f"scale\n× {factor:.2g}")
        axes = room.traces(figure, top)
        _curves(axes, data, m)
        for t in data.when.values[m][_chosen(data, m, room.shown)]:
            axes.axvline(1e3 * t, color=FAINT, lw=0.5, zorder=0)
        reach = MICRO * float(np.nanmax(np.abs(data.u.values[m]))) or 1.0
        tick = round_down_125(reach)
        axes.set(ylim=(-1.08 * reach, 1.08 * reach), yticks=(-tick, 0, tick))
        axes.tick_params(labelsize=6)
        axes.set_xlabel("time [ms]" if m == room.methods - 1 else "")
        axes.yaxis.label.set_fontsize(6.5)
        axes.yaxis.set_label_coords(-9.0 / (room.width * axes.get_position().width), 0.5)
        if m == 0:
            lines = axes.get_legend_handles_labels()
            figure.legend(*lines, loc="upper right", bbox_to_anchor=(0.985, 1 - 1.0 / room.height), ncols=2,
                          borderaxespad=0, borderpad=0)  # fmt: skip
    return figure


def _colour(data: xr.Dataset, m: int) -> str:
    return method_look(str(data.method.values[m]), list(data.method.values)).colour


def _chosen(data: xr.Dataset, m: int, count: int) -> slice:
    """Successive instants, ``count`` of them: the target's peak and the largest motion of any point among them."""
    largest = int(np.argmax(np.nanmax(np.abs(data.between.values[m]), axis=(1, 2))))
    spare = _INSTANTS - count
    first = 0 if largest == 0 else spare if largest == _INSTANTS - 1 else spare // 2
    return slice(first, first + count)


def _maps(figure: Figure, room: _Sheet, top: float, data: xr.Dataset, m: int, most: float, factor: str) -> None:
    scale, chosen = Normalize(-most or -1.0, most or 1.0), _chosen(data, m, room.shown)
    points, coils = (1e3 * data[f"{side}_place"].values[:, :2] for side in ("output", "input"))
    middle = points.mean(axis=0)
    reaches = [1.15 * np.abs(p - middle).max() for p in (points, np.concatenate([points, coils]))][2 - room.rows :]
    for row, reach in enumerate(reaches):
        panels = room.maps(figure, top, row)
        for panel, k in zip(panels, range(_INSTANTS)[chosen], strict=True):
            if row == 0:
                when = f"{1e3 * data.when.values[m, k]:+.1f} ms"
                panel.set_title("0 ms" if float(when[:-3]) == 0 else minus(when), fontsize=6.5, pad=2)
                panel.pcolormesh(1e3 * data.x, 1e3 * data.y, MICRO * data.between[m, k], cmap=SIGNED, norm=scale,
                                 shading="gouraud", rasterized=True)  # fmt: skip
            else:
                seen = Triangulation(1e3 * data.vertex_x, 1e3 * data.vertex_y, data.triangles)
                panel.tripcolor(seen, MICRO * data.field.values[m, k], cmap=SIGNED, norm=scale, shading="gouraud",
                                rasterized=True)  # fmt: skip
            panel.plot(*points.T, "o", color=INK, ms=2.2, mew=0)
            panel.plot(*points[_row(data)], "o", mfc="none", mec=INK, ms=6, mew=0.9)
            panel.plot(*coils.T, "o", mfc="none", mec=GREY, ms=5, mew=0.7)
            panel.set(aspect="equal", xticks=(), yticks=(), xlim=(middle[0] - reach, middle[0] + reach),
                      ylim=(middle[1] - reach, middle[1] + reach))  # fmt: skip
            panel.grid(False)
            panel.spines[:].set_visible(False)
        below = -1.8 / room.size
        panels[0].plot([0, _BAR / (2 * reach)], [below, below], color=INK, lw=1.5, solid_capstyle="butt", clip_on=False,
                       transform=panels[0].transAxes)  # fmt: skip
        panels[0].annotate(f"{_BAR:g} mm", (_BAR / (2 * reach), below), (3, 0), xycoords="axes fraction", va="center",
                           textcoords="offset points", fontsize=6, annotation_clip=False)  # fmt: skip
        panels[0].set_ylabel("between\npoints" if row == 0 else "skin\nitself", fontsize=7)
    side = room.axes(figure, room.bar, top + _HEAD + 1.8, 1.8, room.rows * (room.size + 4.0) - (9.5 if factor else 6.0))
    bar = figure.colorbar(ScalarMappable(scale, SIGNED), cax=side, extend="both")
    bar.ax.tick_params(labelsize=6, pad=1.5, length=2)
    bar.ax.set_yticks([t * round_down_125(most or 1.0) for t in (-1, 0, 1)])
    room.write(figure, room.bar, top + _HEAD - 1.5, "u [µm]", fontsize=6.5)
    room.write(figure, room.bar, top + _HEAD - 3.5 + room.rows * (room.size + 4.0), factor, fontsize=6.5)


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


@styled
def plot_trace(data: xr.Dataset, method: str, title: str, *, ax: Axes | None = None) -> Axes:
    """The grid points over time under one ``method``: the target solid, the others dotted."""
    axes = single(ax, (2.9, 2.2))
    m = list(data.method.values).index(method)
    _curves(axes, data, m)
    axes.set_title(title, color=_colour(data, m), fontweight="bold")
    return axes
