"""G itself: size and phase of its entries, how well it can be inverted, and how far its measurement is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ..metrics import condition_number, singular_values
from ..rendering import AutoZeros, BinnedTransfer
from ..rendering.renderers import Aim
from ..rendering.signals import BinValues, Record
from ..store.folder import atomic_path
from ..transfer import TransferMatrix, entry_errors
from ..typing import ComplexArray, FloatArray
from .data import Results, places
from .style import (
    ACTUATORS,
    COLUMN,
    FAINT,
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
    """|G| of all entries over frequency [Hz] in their actuator's colour, grey dots where an entry is marked invalid,
    and in faint grey one standard deviation.
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
