"""One entry of G from one recording, and G from all entries."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.fft import rfftfreq

from ..errors import DataError
from ..ports import Port
from ..scenario.measurement import MeasurementOptions, to_displacement
from ..transfer import ErrorEstimate, TransferMatrix
from ..typing import BoolArray, ComplexArray, FloatArray
from .diagnostics import Finding, diagnose, off_alike
from .estimators import estimate, excited, spectra
from .recording import Recording


@dataclass(frozen=True, eq=False)
class Entry:
    """Displacement of ``output`` per volt on ``input`` at ``frequency`` (n,) [Hz], the bins of the sweep's band.

    ``value`` (n,) [m/V], NaN on bins without energy; ``deviation`` (n,) [m/V] is sqrt(E|dG|^2), NaN if
    unknown; ``coherence`` (n,) [-], NaN for a single repeat; ``valid`` (n,) may be used.
    """

    output: str
    input: str
    frequency: FloatArray
    value: ComplexArray
    deviation: FloatArray
    coherence: FloatArray
    valid: BoolArray
    findings: tuple[Finding, ...] = ()


def entry(recording: Recording, band: tuple[float, float], options: MeasurementOptions) -> Entry:
    """The entry that ``recording`` holds, on the bins inside ``band`` [Hz].

    Below the floor (``options.signal_floor`` deviations), without energy, or after an error found in the
    recording, an entry is marked in ``valid``; its value is what was measured, never filled in. Raises
    DataError where the sensor's quantity or sensitivity is not declared.
    """
    sensor = options.sensor
    if sensor.quantity is None or sensor.sensitivity is None:
        raise DataError(
            "the sensor is not declared: set measurement.sensor.quantity to displacement, velocity or acceleration "
            "and measurement.sensor.sensitivity in V per m, m/s or m/s^2"
        )
    carried = excited(recording.sent, recording.sample_rate, band, options.energy_floor)
    bins = rfftfreq(recording.n, 1 / recording.sample_rate)
    inside = (bins > 0) & (bins >= band[0] - 1e-9) & (bins <= band[1] + 1e-9)
    findings = diagnose(recording, carried, max_drift=options.max_drift)
    names, frequency = (recording.output, recording.input), bins[inside]
    if any(f.severity == "error" and f.kind in _HOPELESS for f in findings):
        empty = np.full(len(frequency), np.nan)
        return Entry(*names, frequency, empty + 0j, empty, empty, np.zeros(len(frequency), dtype=bool), findings)
    drive = np.broadcast_to(recording.sent, recording.response.shape)
    if recording.loopback is not None:
        drive = recording.loopback * options.daq.amplifier_gain
    averages = spectra(drive, recording.response, carried, recording.resolution)
    raw = estimate(options.estimator, averages, carried, options, recording.sample_rate)
    # metres per volt of the sensor, with the known delays taken out
    delay = sensor.delay + (options.daq.latency if recording.loopback is None else 0.0)
    turn, sign = np.exp(2j * np.pi * frequency * delay), -1.0 if sensor.inverted else 1.0
    factor = sign / sensor.sensitivity * turn * to_displacement(frequency, sensor.quantity)
    value = np.where(carried[inside], raw.value[inside] * factor, np.nan)
    alike = off_alike(recording, drive, carried)
    deviation = np.hypot(raw.deviation, alike)[inside] * np.abs(factor)
    spoiled = any(f.severity == "error" for f in findings)
    valid = (
        carried[inside] & raw.usable[inside] & ~_below(value, deviation, raw.coherence[inside], options) & (not spoiled)
    )
    return Entry(*names, frequency, value, deviation, raw.coherence[inside], np.asarray(valid), findings)


_HOPELESS = frozenset({"not finite", "no drive"})
_SCATTERS = 1e-12  # of an entry's power: less between the repeats is rounding of the arithmetic


def _below(value: ComplexArray, deviation: FloatArray, coherence: FloatArray, options: MeasurementOptions) -> BoolArray:
    """Under the floor, or incoherent; unknown deviation or coherence condemns nothing."""
    with np.errstate(invalid="ignore"):
        faint = np.abs(value) < options.signal_floor * deviation
        return np.asarray(faint | (coherence < options.min_coherence))


@dataclass(frozen=True, eq=False)
class Measured:
    """A measured G with what was found on the way: ``coherence`` (n_frequency, n_out, n_in), ``missing``
    entries (output, input) that were never taken, and all ``findings``."""

    transfer: TransferMatrix
    coherence: FloatArray
    missing: tuple[tuple[str, str], ...] = ()
    findings: tuple[Finding, ...] = field(default=())


def assemble(
    entries: Sequence[Entry],
    outputs: tuple[Port, ...],
    inputs: tuple[Port, ...],
    provenance: Mapping[str, Any],
) -> Measured:
    """G (n_frequency, n_out, n_in) [m/V] from its entries; those never taken are NaN, marked and listed.

    Raises DataError without entries, and for entries on different bins.
    """
    if not entries:
        raise DataError("nothing has been measured yet: there is no entry to make G of")
    frequency = entries[0].frequency
    by_name = {(e.output, e.input): e for e in entries}
    for e in entries:
        if not np.array_equal(e.frequency, frequency):
            raise DataError(f"{e.output} <- {e.input} was measured on other bins than the rest; measure it again")
    names = [(o.name, i.name) for o in outputs for i in inputs]
    shape = (len(outputs), len(inputs), len(frequency))

    def cube(pick: Any, empty: Any) -> Any:
        """Array (n, n_out, n_in) of ``pick`` of each entry; ``empty`` where one was not measured."""
        blank = np.full(len(frequency), empty)
        return np.array([pick(by_name[n]) if n in by_name else blank for n in names]).reshape(shape).transpose(2, 0, 1)

    values, valid = cube(lambda e: e.value, np.nan + 0j), cube(lambda e: e.valid, False)
    deviation = cube(lambda e: e.deviation, np.nan)
    transfer = TransferMatrix(
        frequency=frequency,
        values=values,
        outputs=outputs,
        inputs=inputs,
        unit="m/V",
        valid=valid,
        deviation=deviation,
        errors=noise_estimate(frequency, values, deviation, valid),
        provenance=dict(provenance),
    )
    missing = tuple(n for n in names if n not in by_name)
    found = tuple(f for e in entries for f in e.findings) + _copies(entries)
    return Measured(transfer, cube(lambda e: e.coherence, np.nan), missing, found)


def _copies(entries: Sequence[Entry]) -> tuple[Finding, ...]:
    """Two noisy entries equal bit for bit are one recording saved twice; without noise, symmetry can do that.

    Noise is what scatters between the repeats: what a converter rounds off alike is none. Of a single one the floor
    above the band must do, in which the two are one.
    """
    seen: dict[bytes, str] = {}
    found = []
    for e in entries:
        key, label = e.value.tobytes(), f"{e.output} <- {e.input}"
        known = np.isfinite(e.value) & (e.value != 0)
        single = np.isnan(e.coherence).all()
        noise = (e.deviation / np.maximum(np.abs(e.value), np.finfo(float).tiny)) ** 2 if single else 1 - e.coherence
        known &= np.isfinite(noise)
        if key in seen and known.any() and np.median(noise[known]) > _SCATTERS:
            why = "one of them was saved under a wrong name" + (", unless neither has any noise" if single else "")
            found.append(Finding("copy", f"{label} is identical to {seen[key]}: {why}"))
        seen.setdefault(key, label)
    return tuple(found)


def bias_said(measured: Measured) -> str:
    """Sentence on an estimator that noise makes too large in every entry alike; "" for any other.

    How much is told by the coherence: 1 / coherence for H2 over H1, its root for Hv.
    """
    how = measured.transfer.provenance.get("measurement", {})
    power = {"H2": 1.0, "Hv": 0.5}.get(how.get("estimator", ""), 0.0)
    g, used = measured.transfer, np.isfinite(measured.coherence) & (measured.coherence > 0)
    used &= True if g.valid is None else g.valid
    if not power or not used.any():
        return ""
    size = float(np.median(measured.coherence[used] ** -power)) - 1
    return (
        f"{how['estimator']} exceeds H1 by {100 * size:.2g} % in the median of the entries that may be used; the truth "
        "lies between, and that is in their deviation, but alike in all: S and a fit's scale follow it. The same "
        "command with measurement.estimator = 'H1' evaluates these recordings anew"
    )


def noise_estimate(
    frequency: FloatArray, values: ComplexArray, deviation: FloatArray, valid: BoolArray
) -> tuple[ErrorEstimate, ...]:
    """The measurement's noise as e(f) and e_band of the valid entries, one standard deviation; () if it is unknown."""
    known = valid & np.isfinite(deviation) & np.isfinite(values)
    if not known.any():
        return ()
    noise, size = np.where(known, deviation, 0), np.where(known, np.abs(values), 0)
    peak = size.max(axis=(1, 2))
    rows = peak > 0
    per_frequency = noise.max(axis=(1, 2))[rows] / peak[rows]
    band = float(np.sqrt(np.sum(noise**2) / np.sum(size**2)))
    return (
        ErrorEstimate(
            "measurement",
            band,
            "scatter between repeated sweeps, and what hum, drift and clocks may have put into each, one standard "
            "deviation; not the sensor's calibration",
            tuple(frequency[rows].tolist()),
            tuple(per_frequency.tolist()),
        ),
    )
