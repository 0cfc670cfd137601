"""Manners of results in a notebook: a line, a table, labelled arrays, a picture, a file.

The facade of the program: the one module that rooms above and below may import, and that loads them when asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .errors import DataError

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import FigureBase

    from .rendering.interval import Rendering, Strength
    from .transfer import Compliance, TransferMatrix


def html(title: str, rows: Sequence[Sequence[object]], header: Sequence[str] = ()) -> str:
    """A small table below a ``title``."""
    head = "".join(f"<th>{escape(str(cell))}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<b>{escape(title)}</b><table>{f'<tr>{head}</tr>' if head else ''}{body}</table>"


class Manners:
    """Base of an answer: a line, and a table in a notebook, from its ``line`` and its ``rows``, of which the first is
    the head. Each answer adds ``to_xarray``, ``plot``, ``save``, and ``sel`` where parts have names."""

    @property
    def line(self) -> str:
        """The answer in a line."""
        raise NotImplementedError

    @property
    def rows(self) -> Sequence[Sequence[object]]:
        """Head and rows of its table."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.line}>"

    def _repr_html_(self) -> str:
        head, *rows = self.rows
        return html(self.line, rows, [str(cell) for cell in head])


def place(names: Sequence[str], name: str, what: str) -> int:
    """Position of ``name`` among ``names``; DataError that lists them where it is none."""
    if str(name) not in names:
        raise DataError(f"no {what} is called {name!r}; there are {', '.join(names)}")
    return list(names).index(str(name))


def line_of_g(g: TransferMatrix) -> str:
    """E.g. ``<TransferMatrix 981 frequencies, 10 to 500 Hz; 9 points, 4 actuators; m/V; error 2.1 %>``."""
    from .transfer import error_words

    n, o, i = g.values.shape
    return (
        f"<TransferMatrix {n} frequencies, {g.frequency[0]:g} to {g.frequency[-1]:g} Hz; {o} points, {i} actuators; "
        f"{g.unit}; {error_words(g.errors)}>"
    )


def html_of_g(g: TransferMatrix) -> str:
    """Size of G and its errors."""
    from .transfer import size_words

    errors = [(e.source, size_words(e.band, ".2g"), size_words(e.worst, ".2g")) for e in g.errors]
    return html(line_of_g(g)[1:-1], errors, ("source of error", "e_band", "worst e(f)") if errors else ())


def xarray_of_g(g: TransferMatrix | Compliance) -> xr.DataArray:
    """G (frequency, output, input), or a compliance between its ports, with names, units and errors by source."""
    import xarray as xr

    from .transfer import total_error

    outputs, inputs = (getattr(g, side, getattr(g, "ports", ())) for side in ("outputs", "inputs"))
    coordinates = {
        "frequency": ("frequency", g.frequency, {"units": "Hz"}),
        "output": [p.name for p in outputs], "input": [p.name for p in inputs],
    }  # fmt: skip
    stated = {"error": total_error(g.errors), **{f"error by {e.source}": e.band for e in g.errors}}
    said = {"units": getattr(g, "unit", "m/N"), **stated}
    return xr.DataArray(g.values, coordinates, ("frequency", "output", "input"), "G", said)


def plot_of_g(g: TransferMatrix) -> FigureBase:
    """Size and phase of each entry, within its stated error."""
    from .show.matrix import plot_transfer, transfer_of

    return plot_transfer(transfer_of(g))


def save_g(g: TransferMatrix, path: str | Path) -> None:
    """Write G in the format of the path's ending."""
    from .files.read import save  # every format, which few need

    save(path, g)


def save_s(s: Strength, path: str | Path) -> None:
    """Write ``signal_strength.csv``, as a run does."""
    from .results.files import strength_rows, write_signal_strength_csv

    rows = strength_rows(s.methods, s.targets, s.value, (s.low, s.high), s.record, s.window, grouped=False)
    write_signal_strength_csv(path, rows)


def line_of_s(s: Strength) -> str:
    """E.g. ``<Strength at 9 targets; in the mean funneling 2.43; numerics 3.8 % either way at most>``, of targets that
    count."""
    from .transfer import percent

    kept = np.isfinite(s.value) if s.counted is None else np.isfinite(s.value) & s.counted
    means = ", ".join(
        f"{m} {row[k].mean():.3g}" if k.any() else f"{m} unknown"
        for m, row, k in zip(s.methods, s.value, kept, strict=True)
    )
    lost = "" if s.counted is None or s.counted.all() else f", {np.count_nonzero(~s.counted)} beside a motor left out"
    off = np.log(np.divide(s.high, s.low, out=np.full(s.low.shape, np.nan), where=s.low > 0))[kept] / 2
    off = off[np.isfinite(off)]
    interval = f"numerics {percent(float(off.max()))} either way at most" if len(off) else "interval unknown"
    return f"<Strength at {len(s.targets)} targets{lost}; in the mean {means}; {interval}>"


def html_of_s(s: Strength) -> str:
    """S of every target and method with its interval."""
    counted = np.ones(len(s.targets), bool) if s.counted is None else s.counted
    rows = [
        (t if counts else f"({t}: beside a motor)",
         *(f"{s.value[m, k]:.3g} ({s.low[m, k]:.3g} to {s.high[m, k]:.3g})" for m in range(len(s.methods))))
        for k, (t, counts) in enumerate(zip(s.targets, counted, strict=True))
    ]  # fmt: skip
    return html(s.unknown or "S, and its interval by the errors stated for G", rows, ("target", *s.methods))


def xarray_of_s(s: Strength) -> xr.Dataset:
    """S with its interval and companions by renderer and target; "method" is what xarray's own ``sel`` calls its way of
    filling gaps."""
    import xarray as xr

    columns = ("value", "low", "high", "record", "edges", "holes")
    arrays = {c: (("renderer", "target"), getattr(s, c)) for c in columns}
    return xr.Dataset(arrays, {"renderer": list(s.methods), "target": list(s.targets)})


def plot_of_s(s: Strength) -> FigureBase:
    """S by target with its interval; above the line S > 1 motion is focused."""
    from matplotlib.figure import Figure

    from .show.style import method_look

    figure = Figure(figsize=(5.0, 3.0), layout="constrained")
    axes, at = figure.add_subplot(), np.arange(len(s.targets))
    for m, method in enumerate(s.methods):
        aside = at + 0.15 * (m - (len(s.methods) - 1) / 2)
        off = np.abs(np.stack([s.value[m] - s.low[m], s.high[m] - s.value[m]]))
        colour, marker, _ = method_look(method, s.methods)
        axes.errorbar(aside, s.value[m], yerr=np.nan_to_num(off), fmt=marker, color=colour, label=method)
    axes.axhline(1.0, color="0.6", linewidth=0.8)
    axes.set_xticks(at, s.targets)
    axes.set_xlabel("target")
    axes.set_ylabel("signal strength S")
    axes.legend()
    if not np.isfinite(s.low).any():
        axes.set_title("interval unknown")
    return figure


def xarray_of_rendering(r: Rendering) -> xr.Dataset:
    """Drives (renderer, target, actuator, time) and displacements (renderer, target, point, time) [m]."""
    import xarray as xr

    first = next(iter(r.values()))
    drives, moved = (
        np.array([[getattr(getattr(r[m, t], part), what) for t in r.targets] for m in r.methods])
        for part, what in (("drives", "signals"), ("displacements", "values"))
    )
    sides = ("renderer", "target")
    return xr.Dataset(
        {"drives": ((*sides, "actuator", "time"), drives, {"units": first.drives.unit}),
         "displacements": ((*sides, "point", "time"), moved, {"units": "m"})},
        {"renderer": list(r.methods), "target": list(r.targets), "time": first.drives.time,
         "actuator": [p.name for p in first.drives.inputs], "point": list(first.displacements.names)},
    )  # fmt: skip
