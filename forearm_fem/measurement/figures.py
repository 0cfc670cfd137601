"""Pictures of a measurement in progress: functions of data and axes, nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..io.atomic import atomic_path
from ..transfer import TransferMatrix
from ..typing import FloatArray


def plot_entries(transfer: TransferMatrix, *, ax: Axes | None = None) -> Axes:
    """|G| of all entries over frequency [Hz], dots where an entry is marked invalid, grey: one standard
    deviation.
    """
    ax = _axes(ax)
    size = np.abs(transfer.values).reshape(len(transfer.frequency), -1)
    valid = np.isfinite(size) if transfer.valid is None else transfer.valid.reshape(size.shape)
    ax.loglog(transfer.frequency, np.where(valid, size, np.nan), lw=0.8)
    ax.loglog(transfer.frequency, np.where(valid, np.nan, size), ".", ms=1, color="0.7")
    if transfer.deviation is not None:
        ax.loglog(transfer.frequency, transfer.deviation.reshape(size.shape), lw=0.4, color="0.8", zorder=0)
    ax.set(xlabel="frequency [Hz]", ylabel=f"|G| [{transfer.unit}]")
    return ax


def plot_coherence(frequency: FloatArray, coherence: FloatArray, *, ax: Axes | None = None) -> Axes:
    """Coherence (n_frequency, n_out, n_in) [-] of all entries."""
    ax = _axes(ax)
    ax.semilogx(frequency, coherence.reshape(len(frequency), -1), lw=0.8)
    ax.set(xlabel="frequency [Hz]", ylabel="coherence [-]", ylim=(0, 1.02))
    return ax


def plot_done(valid: FloatArray, outputs: tuple[str, ...], inputs: tuple[str, ...], *, ax: Axes | None = None) -> Axes:
    """Share (n_out, n_in) [-] of usable bins per entry; white where nothing was measured yet (NaN)."""
    ax = _axes(ax)
    image = ax.imshow(valid, vmin=0, vmax=1, aspect="auto")
    ax.set_xticks(range(len(inputs)), inputs)
    ax.set_yticks(range(len(outputs)), outputs)
    ax.set(xlabel="actuator", ylabel="point", title="usable bins")
    ax.figure.colorbar(image, ax=ax)
    return ax


def save_live(path: str | Path, transfer: TransferMatrix, coherence: FloatArray) -> None:
    """The state of a calibration as one picture, replaced in one step so that a viewer never sees half of
    it.
    """
    figure = Figure(figsize=(11, 3.5), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    finite = np.isfinite(transfer.values)
    if finite.any():
        plot_entries(transfer, ax=left)
    if np.isfinite(coherence).any():
        plot_coherence(transfer.frequency, coherence, ax=middle)
    valid = finite if transfer.valid is None else transfer.valid
    share = np.where(finite.any(axis=0), valid.mean(axis=0), np.nan)
    plot_done(share, tuple(p.name for p in transfer.outputs), tuple(p.name for p in transfer.inputs), ax=right)
    with atomic_path(path) as beside:
        figure.savefig(beside, dpi=90)


def _axes(ax: Any) -> Axes:
    return Figure(layout="constrained").add_subplot() if ax is None else ax
