"""Drives: what goes to the amplifiers, their limits, and the displacements that follow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..errors import ScenarioError
from ..ports import Port, distances
from ..scenario.device import Device, VoltageDevice
from ..transfer import TransferMatrix
from ..typing import BoolArray, ComplexArray, FloatArray
from .signals import BinnedTransfer, Record, Wavelet, on_record_bins, respond, to_time

if TYPE_CHECKING:
    from .inverse_filter import Inversion


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


# Limits of drives, and points that do not count because a motor stands beside them.

# Clearance of points from motors: near a rim a point moves with the motor, and S there is no focus.

CLEARANCE = 9e-3
"""Least distance [m] of a counted point from a rim: the corners of the thesis' device lie 9.5 mm off theirs."""
_SLACK = 1e-9  # m: rounding of places


def rim_gaps(outputs: Sequence[Port], inputs: Sequence[Port]) -> FloatArray:
    """Distance (n_out,) [m] of each output from the nearest rim, negative under a cone; NaN where places are unknown.

    ``inputs`` are the contacts that touch the skin; inf where there are none.
    """
    if not inputs:
        return np.full(len(outputs), np.inf)
    gaps = distances(tuple(outputs), tuple(inputs)) - np.array([p.radius for p in inputs])
    return np.asarray(np.where(np.isnan(gaps).any(axis=1), np.nan, gaps.min(axis=1)))


def counted_points(outputs: Sequence[Port], inputs: Sequence[Port], clearance: float = CLEARANCE) -> BoolArray:
    """True where S towards each output (n_out,) counts: none under a cone or within ``clearance`` [m] of a rim does.

    Points whose places are unknown count.
    """
    return ~(rim_gaps(outputs, inputs) < clearance - _SLACK)


def not_counted_words(
    names: Sequence[str], outputs: Sequence[Port], inputs: Sequence[Port], clearance: float = CLEARANCE
) -> str:
    """E.g. ``points 4 and 6 are not counted: under a motor``, of those of ``outputs`` in ``names``; else empty."""
    gaps = dict(zip((p.name for p in outputs), rim_gaps(outputs, inputs), strict=True))
    under = [n for n in names if gaps[n] <= 0]
    near = [n for n in names if 0 < gaps[n] < clearance - _SLACK]
    told = [(under, "under a motor"), (near, f"within {1e3 * clearance:g} mm of a motor's rim")]
    parts = [f"{_listed(group)} not counted: {why}" for group, why in told if group]
    return "; ".join(parts)


def _listed(names: Sequence[str]) -> str:
    if len(names) == 1:
        return f"point {names[0]} is"
    return f"points {', '.join(names[:-1])} and {names[-1]} are"


# Limits of an actuator.

_ILL = 10.0  # times a limit: no amplitude is that far off
_DAMPED = "rendering.regularisation = 'tikhonov' with regularisation_value = 0.05"  # 'auto' damps no thesis' device


@dataclass(frozen=True)
class Limits:
    """Per actuator: peak ``voltage`` [V] and mean ``power`` [W] in the coil's ``resistance`` [ohm].

    The power is V^2 / resistance averaged over ``window`` [s], the loudest one of the record, or over the
    whole record if None. Back-EMF and inductance are ignored: both lower the current, so the power is an
    upper bound. Defaults: TEAX14C02-8, 0.8 W (a continuous rating) and 7.8 ohm; 2.5 V rms gives 0.8 W. ScenarioError
    for one that is not positive.
    """

    voltage: float = 2.5
    power: float = 0.8
    resistance: float = 7.8
    window: float | None = None

    def __post_init__(self) -> None:
        for name in ("voltage", "power", "resistance", "window"):
            value = getattr(self, name)
            if not (name == "window" and value is None) and not 0 < value < np.inf:
                raise ScenarioError(f"an actuator's limits: expected a positive {name}, got {value}")


def limits_of(device: Device) -> Limits | None:
    """Limits of a device's actuators; None where a unit drive is no voltage."""
    if not isinstance(device, VoltageDevice):
        return None
    return Limits(device.max_voltage, device.max_power, device.coil.resistance)


@dataclass(frozen=True, eq=False)
class DriveReport:
    """``peak`` and ``rms`` (n_in,) in the drive's unit, ``power`` (n_in,) [W], NaN for drives that are no voltages.

    ``exceeded`` has a sentence per limit exceeded; ``checked`` is False for drives that are no voltages.
    """

    peak: FloatArray
    rms: FloatArray
    power: FloatArray
    exceeded: tuple[str, ...]
    checked: bool


def check(drives: Drives, limits: Limits | None = None) -> DriveReport:
    """Peak, rms and power of each actuator against ``limits``; raises ScenarioError for a bad averaging window."""
    limits = limits or Limits()
    squares = drives.signals**2
    peak, loudest = np.abs(drives.signals).max(axis=1), np.mean(squares, axis=1)
    rms = np.sqrt(loudest)
    if drives.unit != "V":
        return DriveReport(peak, rms, np.full(len(peak), np.nan), (), False)
    if limits.window is not None:
        samples = round(limits.window * drives.record.sample_rate)
        if not 1 <= samples <= drives.record.n:
            raise ScenarioError(f"the power's window of {limits.window:g} s must hold 1 to {drives.record.n} samples")
        loudest = np.maximum(uniform_filter1d(squares, samples, axis=1, mode="wrap"), 0).max(axis=1)
    power = loudest / limits.resistance
    over = [
        f"{p.name}: {v:.3g} V peak, limit {limits.voltage:g} V"
        for p, v in zip(drives.inputs, peak, strict=True)
        if v > limits.voltage
    ]
    over += [
        f"{p.name}: {w:.3g} W in {limits.resistance:g} ohm, limit {limits.power:g} W"
        for p, w in zip(drives.inputs, power, strict=True)
        if w > limits.power
    ]
    return DriveReport(peak, rms, power, tuple(over), True)


def beyond_limits(
    methods: Sequence[str],
    targets: Sequence[str],
    channels: Sequence[str],
    peak: FloatArray,
    power: FloatArray,
    limits: Limits,
) -> tuple[str, ...]:
    """A sentence per method and limit exceeded by ``peak`` [V] or ``power`` [W] (n_method, n_target, n_channel).

    The remedy is `rendering.amplitude`, in which everything is linear; an inverse filter beyond 10 times a limit is
    badly conditioned, and is told so.
    """
    found = []
    for m, method in enumerate(methods):
        both = (peak[m], limits.voltage, "V", "peak"), (power[m], limits.power, "W", "power")
        for values, most, unit, what in both:
            t, k = divmod(int(np.argmax(values)), values.shape[1])
            excess = float(values[t, k] / most)
            if excess <= 1:
                continue
            share = 1 / (excess if what == "peak" else np.sqrt(excess))
            remedy = f"rendering.amplitude times {np.floor(100 * share) / 100 or share:.2g} is within, and S stays"
            if excess > _ILL and method != "funneling":
                remedy += f", or {_DAMPED} damps what G hardly knows"
            found.append(
                f"{method}: {np.count_nonzero(values > most)} of {values.size} drives exceed {most:g} {unit} {what}, "
                f"most of all {values[t, k]:.3g} {unit} at {channels[k]} towards {targets[t]}; {remedy}"
            )
    return tuple(found)
