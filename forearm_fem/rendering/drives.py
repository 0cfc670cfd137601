"""Drives: what goes to the amplifiers, and the displacements that follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from ..errors import ScenarioError
from ..ports import Port
from ..transfer import TransferMatrix
from ..typing import BoolArray, ComplexArray, FloatArray
from .inversion import Inversion
from .spectrum import BinnedTransfer, Record, on_record_bins, respond, to_time
from .wavelet import Wavelet


@dataclass(frozen=True, eq=False)
class Aim:
    """A renderer's answer: ``spectrum`` (n_bins, n_in) [unit/Hz], the bins it ``used`` (n_bins,) and how."""

    spectrum: ComplexArray
    used: BoolArray
    zeros: tuple[str, ...] = ()
    inversion: Inversion | None = None


class Renderer(Protocol):
    """Turns G, a target and a wavelet into drive spectra; options live in its constructor."""

    @property
    def name(self) -> str:
        """Name under which results are filed."""

    def aim(self, placed: BinnedTransfer, target: str, wavelet: ComplexArray) -> Aim:
        """Drive spectra towards output ``target`` for the wavelet's spectrum (n_bins,) [1/Hz] on the same bins."""


@dataclass(frozen=True, eq=False)
class Drives:
    """Signals for the actuators.

    ``signals`` (n_in, n_t) in ``unit`` (V for a G in m/V) at ``time`` (n_t,) [s]; ``spectrum`` (n_bins, n_in)
    [unit/Hz] at ``frequency`` (n_bins,) [Hz], one-sided. ``lost`` [-] is the fraction of the wavelet's energy
    on bins where G is unknown, which are not driven. ``zeros`` names the zero points, ``inversion`` reports
    the inverse filter.
    """

    method: str
    target: str
    inputs: tuple[Port, ...]
    unit: str
    record: Record
    frequency: FloatArray
    spectrum: ComplexArray
    lost: float
    zeros: tuple[str, ...] = ()
    inversion: Inversion | None = None
    provenance: Mapping[str, object] = field(default_factory=dict)

    @property
    def time(self) -> FloatArray:
        """Time of the samples (n_t,) [s]; t = 0 is the wavelet's centre."""
        return self.record.time

    @cached_property
    def signals(self) -> FloatArray:
        """Signals (n_in, n_t) in ``unit``, worked out where they are asked for: S needs none."""
        return to_time(self.spectrum, np.rint(self.frequency / self.record.df).astype(int), self.record)


@dataclass(frozen=True, eq=False)
class Displacements:
    """Displacements ``values`` (n_out, n_t) [m] of the outputs at ``time`` (n_t,) [s].

    ``lost`` (n_out,) [-] is the fraction of the drive's energy on bins where G to that output is unknown;
    these bins are missing from its row. Where more than half is missing the row is NaN.
    """

    method: str
    target: str
    outputs: tuple[Port, ...]
    record: Record
    values: FloatArray
    lost: FloatArray

    @property
    def time(self) -> FloatArray:
        """Time of the samples (n_t,) [s]."""
        return self.record.time

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(p.name for p in self.outputs)

    @property
    def target_index(self) -> int:
        """Row of the target."""
        return self.names.index(self.target)


def drives(renderer: Renderer, transfer: TransferMatrix | BinnedTransfer, target: str, wavelet: Wavelet) -> Drives:
    """The drives with which ``renderer`` aims ``wavelet`` at output ``target``.

    ``transfer`` is G (n_frequency, n_out, n_in), or G already placed on the wavelet's bins (:func:`on_record_bins`,
    worth it for many targets). Only bins where G is known are driven; ``Drives.lost`` says what that costs. Raises
    ScenarioError for an unknown target, DataError for a G that cannot be used, GeometryError where the renderer needs a
    rectangle.
    """
    if not hasattr(renderer, "aim"):
        raise ScenarioError(f"expected a renderer such as Funneling(), got {str(renderer)[:60]!r}")
    placed = _placed(transfer, wavelet.record)
    spectrum = wavelet.spectrum
    aim = renderer.aim(placed, target, spectrum[placed.bins.index])
    energy = wavelet.energy
    return Drives(
        method=renderer.name,
        target=target,
        inputs=placed.inputs,
        unit=placed.unit.rpartition("/")[2],
        record=wavelet.record,
        frequency=placed.bins.frequency,
        spectrum=aim.spectrum,
        lost=float(np.clip(1 - energy[placed.bins.index[aim.used]].sum() / energy.sum(), 0, 1)),
        zeros=aim.zeros,
        inversion=aim.inversion,
        provenance={"wavelet": wavelet.name, "renderer": repr(renderer)},
    )


def _placed(transfer: TransferMatrix | BinnedTransfer, record: Record) -> BinnedTransfer:
    if isinstance(transfer, TransferMatrix):
        return on_record_bins(transfer, record)
    if transfer.record != record:
        raise ScenarioError(f"G is placed on the bins of {transfer.record}, the signal has {record}")
    return transfer


def displacements(transfer: TransferMatrix | BinnedTransfer, drives: Drives) -> Displacements:
    """Displacements of all outputs of ``transfer`` under ``drives``: U = G S (eq. 3), back in time.

    G may be another one than the drives were made for (a perturbed or a measured one): bins of the drive where it is
    unknown count as lost. Raises ScenarioError if the inputs differ in number, DataError if G cannot be used.
    """
    placed = _placed(transfer, drives.record)
    if len(placed.inputs) != len(drives.inputs):
        raise ScenarioError(f"G has {len(placed.inputs)} inputs, the drives {len(drives.inputs)}")
    own = np.rint(drives.frequency / drives.record.df).astype(int)
    spectrum, outside = drives.spectrum, 0.0
    if not np.array_equal(placed.bins.index, own):  # the spectra on G's bins, and the drive's energy on other bins
        _, here, there = np.intersect1d(placed.bins.index, own, return_indices=True)
        spectrum = np.zeros((len(placed.bins.index), len(drives.inputs)), dtype=complex)
        spectrum[here] = drives.spectrum[there]
        outside = float(np.sum(np.abs(drives.spectrum) ** 2)) - float(np.sum(np.abs(spectrum) ** 2))
    values = respond(placed, spectrum)
    lost = _unanswered(placed, spectrum, outside)
    values[lost > 0.5] = np.nan
    return Displacements(drives.method, drives.target, placed.outputs, drives.record, values, lost)


def _unanswered(placed: BinnedTransfer, spectrum: ComplexArray, outside: float) -> FloatArray:
    """Share (n_out,) of the drive's energy on bins where G to an output is unknown or that G has not."""
    if outside == 0 and placed.bins.valid.all():
        return np.zeros(len(placed.outputs))
    energy = np.abs(spectrum) ** 2
    missing = (~placed.bins.valid & (energy[:, None, :] > 0)).any(axis=2)
    total = energy.sum() + outside
    if total == 0:
        return np.zeros(len(placed.outputs))
    return np.asarray((energy.sum(axis=1) @ missing + max(outside, 0.0)) / total)
