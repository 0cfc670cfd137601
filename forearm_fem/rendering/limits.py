"""Limits of an actuator's drives, and points that do not count because a motor stands beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..errors import ScenarioError
from ..ports import Port, distances
from ..scenario.device import Device, VoltageDevice
from ..typing import BoolArray, FloatArray
from .drives import Drives

# Clearance of points from motors: near a rim a point moves with the motor, and S there is no focus.

CLEARANCE = 9e-3
"""Least distance [m] of a counted point from a rim: the corners of the thesis' device lie 9.5 mm off theirs."""
_ROUNDED = 1e-9  # m: rounding of places


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
    return ~(rim_gaps(outputs, inputs) < clearance - _ROUNDED)


def not_counted_words(
    names: Sequence[str], outputs: Sequence[Port], inputs: Sequence[Port], clearance: float = CLEARANCE
) -> str:
    """E.g. ``points 4 and 6 are not counted: under a motor``, of those of ``outputs`` in ``names``; else empty."""
    gaps = dict(zip((p.name for p in outputs), rim_gaps(outputs, inputs), strict=True))
    under = [n for n in names if gaps[n] <= 0]
    near = [n for n in names if 0 < gaps[n] < clearance - _ROUNDED]
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
