"""G itself: size and phase of its entries, how well it can be inverted, and one G against another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import FigureBase

from ..metrics import condition_number, singular_values
from ..metrics.common_ground import CommonGround, common_ground
from ..ports import distances
from ..rendering import AutoZeros, Placed
from ..rendering.drives import Aim
from ..rendering.spectrum import BinValues, Record
from ..transfer import TransferMatrix, entry_errors
from ..typing import ComplexArray, FloatArray
from .data import Results
from .page import Table
from .style import FAINT, GREY, MICRO, NEARNESS, decimal, letter, micro, panels, styled


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


def transfer_table(transfer: TransferMatrix) -> Table:
    """|G|, what it is stated to be off by (NaN where unknown), and phase [rad] of each entry over frequency."""
    columns: dict[str, FloatArray] = {"frequency_Hz": transfer.frequency}
    values, off = shown(transfer), entry_errors(transfer)
    for o, out in enumerate(transfer.outputs):
        for i, source in enumerate(transfer.inputs):
            entry = values[:, o, i]
            columns[f"abs_G_{out.name}_{source.name}_{transfer.unit}"] = np.abs(entry)
            columns[f"off_G_{out.name}_{source.name}_{transfer.unit}"] = off[:, o, i]
            columns[f"phase_G_{out.name}_{source.name}_rad"] = np.angle(entry)
    return Table(columns)


@styled
def plot_transfer(data: TransferMatrix, *, ax: Axes | None = None) -> FigureBase:
    """|G| and unwrapped phase of every grid point, one column per actuator, coloured by distance to it.

    Entries lie in the band that they are stated to be known to; where that reaches zero they are pale.
    """
    figure = panels(ax, (1.9 * len(data.inputs) + 0.6, 3.9))
    grid = figure.subplots(2, len(data.inputs), sharex=True, sharey="row", squeeze=False)
    gap = distances(data.outputs, data.inputs) * 1e3
    scale = Normalize(float(gap.min()), float(gap.max()))
    values, off = shown(data), entry_errors(data)
    for i, source in enumerate(data.inputs):
        foot = MICRO * np.nanmin(np.abs(values[:, :, i]), initial=np.inf)
        for o in np.argsort(-gap[:, i]):  # far points first, so that near ones lie on top
            entry, colour = values[:, o, i], NEARNESS(scale(gap[o, i]))
            size, error = MICRO * np.abs(entry), MICRO * off[:, o, i]
            known = ~(error >= size)  # where nothing is stated, nothing is doubted
            low, high = np.maximum(size - error, foot), size + error
            grid[0, i].fill_between(data.frequency, low, high, where=known, color=colour, alpha=0.2, lw=0)
            grid[0, i].plot(data.frequency, size, color=colour, alpha=0.35, lw=0.8)
            grid[0, i].plot(data.frequency, np.where(known, size, np.nan), color=colour)
            grid[1, i].plot(data.frequency, unwrapped(entry), color=colour)
        grid[0, i].set_title(f"actuator {source.name}")
        grid[1, i].set_xlabel("frequency [Hz]")
    grid[0, 0].set(ylabel=f"|G| [{micro(data.unit)}]", yscale="log")
    grid[1, 0].set_ylabel("phase [cycles]")
    bar = figure.colorbar(ScalarMappable(scale, NEARNESS), ax=list(grid.ravel()), fraction=0.03, pad=0.01)
    bar.set_label("distance to the actuator [mm]")
    return figure


@dataclass(frozen=True, eq=False)
class Conditioning:
    """``singular`` (n, r) of the whole G; ``condition`` (n,) of G and ``control`` (n_target, n) of the rows
    that the inverse filter controls, for each of ``targets`` [-]."""

    frequency: FloatArray
    unit: str
    singular: FloatArray
    condition: FloatArray
    targets: tuple[str, ...]
    control: FloatArray


def conditioning(results: Results) -> Conditioning:
    """Singular values and condition numbers of a run's G, and of the rows that its renderers inverted; where no zero
    points are on record (folders before 0.14, nothing rendered) of the default ones."""
    on_record = results.account.signal_strength.zeros
    held = next((found for m in ("inverse filter", "combination") if (found := on_record.get(m))), None)
    return conditioning_of(results.transfer, held)


def conditioning_of(transfer: TransferMatrix, zeros: Mapping[str, Sequence[str]] | None = None) -> Conditioning:
    """The same for any G, with the zero points ``zeros`` of each target; None: every output with its default ones,
    none where the grid is no rectangle."""
    values = shown(transfer)
    names = [p.name for p in transfer.outputs]
    held = {t: zero_points(transfer, t) for t in names} if zeros is None else zeros
    rows = {t: [names.index(n) for n in (t, *others)] for t, others in held.items()}
    rows = {t: r for t, r in rows.items() if len(r) > 1}
    control = np.array([condition_number(values[:, r]) for r in rows.values()]).reshape(len(rows), len(values))
    return Conditioning(
        transfer.frequency,
        transfer.unit,
        singular_values(values),
        condition_number(values),
        tuple(rows),
        control,
    )


def zero_points(transfer: TransferMatrix, target: str) -> tuple[str, ...]:
    """The default zero points for ``target``: the thesis' for up to four actuators on a rectangular grid, else all."""
    bins = BinValues(Record(1.0, 4), np.array([1]), transfer.values[:1], np.ones(transfer.values[:1].shape, bool))
    placed = Placed(bins, transfer.outputs, transfer.inputs, transfer.unit, np.full(1, np.nan))
    return AutoZeros().choose(placed, target, _unused)


def _unused(names: tuple[str, ...]) -> Aim:
    raise AssertionError(f"the corner rule does not try drives, asked for {names}")


def conditioning_table(data: Conditioning) -> Table:
    """Everything over frequency."""
    singular = {f"s{k + 1}_{data.unit}": data.singular[:, k] for k in range(data.singular.shape[1])}
    control = {f"condition_target_{t}": c for t, c in zip(data.targets, data.control, strict=True)}
    return Table({"frequency_Hz": data.frequency, **singular, "condition_G": data.condition, **control})


@styled
def plot_conditioning(data: Conditioning, *, ax: Axes | None = None) -> FigureBase:
    """Singular values of G, and condition numbers of G and of the rows an inverse filter controls."""
    figure = panels(ax, (7.0, 2.8))
    left, right = figure.subplots(1, 2)
    for k, line in enumerate(data.singular.T):
        left.plot(data.frequency, MICRO * line, label=f"$s_{k + 1}$")
    left.set(yscale="log", xlabel="frequency [Hz]", ylabel=f"singular values of G [{micro(data.unit)}]")
    left.legend(ncols=2)
    decimal(left.yaxis)
    for k, line in enumerate(data.control):
        label = f"controlled rows, each target ({len(data.targets)})" if k == 0 else None
        right.plot(data.frequency, line, color=FAINT, lw=0.7, label=label)
    if "5" in data.targets:
        line = data.control[data.targets.index("5")]
        right.plot(data.frequency, line, color="#D55E00", label="controlled rows, target 5")
    right.plot(data.frequency, data.condition, color="#0072B2", label="all of G")
    right.set(yscale="log", xlabel="frequency [Hz]", ylabel="condition number [-]")
    right.legend()
    decimal(right.yaxis)
    for panel, text in zip((left, right), "ab", strict=True):
        letter(panel, text)
    return figure


@dataclass(frozen=True, eq=False)
class Versus:
    """Two transfer matrices on common frequencies, and what they are called."""

    names: tuple[str, str]
    ground: CommonGround

    @property
    def error(self) -> FloatArray:
        """|dG| over the largest |G| of the second at that frequency, (n, n_out, n_in) [-]."""
        g = self.ground
        size = np.fmax.reduce(np.where(g.valid, np.abs(g.b), np.nan), axis=(1, 2), keepdims=True)  # NaN: a missing bin
        return np.where(g.valid, np.abs(g.a - g.b) / size, np.nan)


def versus(results: Results) -> Versus:
    """A run's G and the measured one kept beside it."""
    return Versus(("simulated", "measured"), common_ground(results.transfer, results.measured))


def versus_of(a: TransferMatrix, b: TransferMatrix, names: tuple[str, str] = ("A", "B")) -> Versus:
    """Any two transfer matrices; raises as :func:`forearm_fem.metrics.common_ground.common_ground`."""
    return Versus(names, common_ground(a, b))


def versus_table(data: Versus) -> Table:
    """|G| of both and their relative difference, entry by entry; NaN where one is unknown."""
    g = data.ground
    first, second = (np.where(g.valid | (each != 0), np.abs(each), np.nan) for each in (g.a, g.b))
    columns: dict[str, FloatArray] = {"frequency_Hz": g.frequency}
    error = data.error
    for o, out in enumerate(g.outputs):
        for i, source in enumerate(g.inputs):
            tag = f"{out.name}_{source.name}"
            columns[f"abs_{data.names[0]}_{tag}_{g.unit}"] = first[:, o, i]
            columns[f"abs_{data.names[1]}_{tag}_{g.unit}"] = second[:, o, i]
            columns[f"difference_{tag}"] = error[:, o, i]
    return Table(columns)


@styled
def plot_versus(data: Versus, *, ax: Axes | None = None) -> FigureBase:
    """|G|, phase and e(f) of two matrices per actuator: nearest, middle and farthest point."""
    g = data.ground
    figure = panels(ax, (1.9 * len(g.inputs) + 0.4, 5.0))
    grid = figure.subplots(3, len(g.inputs), sharex=True, sharey="row", squeeze=False)
    for i, source in enumerate(g.inputs):
        _overlay(grid[:, i], data, i)
        grid[0, i].set_title(f"actuator {source.name}")
        grid[2, i].set_xlabel("frequency [Hz]")
    grid[0, 0].set(ylabel=f"|G| [{micro(g.unit)}]", yscale="log")
    grid[1, 0].set_ylabel("phase [cycles]")
    scale = "log" if np.any(data.error > 0) else "linear"
    grid[2, 0].set(ylabel="|ΔG| / max |G| [-]", yscale=scale)
    handles = [
        grid[0, 0].plot([], [], color=GREY, ls=s, label=n)[0] for n, s in zip(data.names, ("-", ":"), strict=True)
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=2)
    return figure


def _overlay(column: FloatArray, data: Versus, i: int) -> None:
    g, error = data.ground, data.error
    order = np.argsort(distances(g.outputs, (g.inputs[i],))[:, 0], kind="stable")
    some = [int(order[k]) for k in sorted({0, len(order) // 2, len(order) - 1})]  # nearest, middle and farthest
    for o, colour in zip(some, ("#0072B2", "#E69F00", "#CC79A7"), strict=False):
        for values, line, label in ((g.a, "-", f"point {g.outputs[o].name}"), (g.b, ":", None)):
            entry = np.where(g.valid[:, o, i], values[:, o, i], np.nan + 0j)
            column[0].plot(g.frequency, MICRO * np.abs(entry), ls=line, color=colour, label=label)
            column[1].plot(g.frequency, unwrapped(entry), ls=line, color=colour)
        column[2].plot(g.frequency, error[:, o, i], color=colour)
    column[0].legend()
