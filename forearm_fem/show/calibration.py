"""Pictures of a measurement in progress: functions of data and axes, nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..store.folder import atomic_path
from ..transfer import TransferMatrix
from ..typing import FloatArray
from .style import ACTUATORS, FAINT, SIZE, arrange, decimal, letter, sign, single, styled


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
