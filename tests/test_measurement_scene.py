"""A small scene that the measurement tests share: damped waves from four actuators to nine points, 2 kHz,
0.5 s.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from forearm_fem.errors import DataError
from forearm_fem.measurement.calibrate import Plan, _entry, _store, assembled
from forearm_fem.measurement.diagnostics import Finding
from forearm_fem.measurement.entry import Measured
from forearm_fem.measurement.estimators import ExponentialSweep
from forearm_fem.measurement.virtual import VirtualDaq, VirtualOptions, VirtualSensor
from forearm_fem.ports import Port, distances
from forearm_fem.scenario.measurement import DaqOptions, MeasurementOptions, SensorOptions
from forearm_fem.transfer import TransferMatrix

RATE, DURATION = 2000.0, 0.5
SWEEP = ExponentialSweep(10.0, 500.0, DURATION, RATE)
SENSOR = VirtualSensor("velocity", 200.0)
OUTPUTS = tuple(
    Port(str(3 * r + c + 1), "point", (13.3e-3 * (r - 1), 13.3e-3 * (c - 1), 0.0)) for r in range(3) for c in range(3)
)
INPUTS = tuple(
    Port(f"A{2 * r + c + 1}", "contact", (45e-3 * (r - 0.5), 45e-3 * (c - 0.5), 0.0), radius=3.5e-3)
    for r in range(2)
    for c in range(2)
)


def wave_matrix(frequency=None, *, speed: float = 3.0, stretch: float = 1.0) -> TransferMatrix:
    """exp(-i k d) through a resonance at 300 Hz, about 10 um/V; not a solution of anything, but shaped like
    one.
    """
    f = np.arange(10.0, 500.5, 2.0) if frequency is None else np.asarray(frequency, dtype=float)
    w = 2 * np.pi * f
    k = w / speed - 1j * (40 + w / 20)
    resonance = 1 / (1 - (f / 300) ** 2 + 1j * f / 600)
    values = 1e-5 * resonance[:, None, None] * np.exp(-1j * k[:, None, None] * stretch * distances(OUTPUTS, INPUTS))
    return TransferMatrix(f, values, OUTPUTS, INPUTS)


def part(transfer: TransferMatrix, n_out: int, n_in: int) -> TransferMatrix:
    """The first outputs and inputs only."""
    return TransferMatrix(
        transfer.frequency,
        transfer.values[:, :n_out, :n_in],
        transfer.outputs[:n_out],
        transfer.inputs[:n_in],
    )


def options(n_in: int = 4, **changes: object) -> MeasurementOptions:
    """Measurement options for ``n_in`` virtual actuators; DaqOptions fields go by their own names."""
    daq = {k: changes.pop(k) for k in list(changes) if k in DaqOptions.model_fields}
    wired = tuple(f"ao{i}" for i in range(n_in))
    return MeasurementOptions(
        sensor=SensorOptions(quantity="velocity", sensitivity=200.0),
        daq=DaqOptions(outputs=wired, block=250, **daq),
        **changes,
    )


def plan_for(transfer: TransferMatrix, **changes: object) -> Plan:
    """Plan to measure all of ``transfer``."""
    return Plan(transfer.outputs, transfer.inputs, SWEEP, options(len(transfer.inputs), **changes))


def device_for(transfer: TransferMatrix, **changes: object) -> VirtualDaq:
    """A virtual device playing through ``transfer``."""
    return VirtualDaq(transfer, RATE, DURATION, VirtualOptions(**{"sensor": SENSOR, **changes}))


def collected(plan: Plan, folder: Path) -> Measured:
    """G of what ``folder`` holds, without a device; damaged recordings are findings."""
    store = _store(plan, folder)
    entries, damaged = [], []
    for o, i in plan.entries:
        try:
            recording = store.get(plan.outputs[o].name, plan.inputs[i].name)
        except DataError as problem:
            damaged.append(Finding("damaged", str(problem)))
            continue
        if recording is not None:
            entries.append(_entry(plan, recording))
    if not entries and damaged:
        raise DataError(damaged[0].sentence)
    measured = assembled(plan, entries, "recordings")
    return replace(measured, findings=(*measured.findings, *damaged))


def test_scene_is_strongest_where_an_actuator_is_nearest():
    size = np.abs(wave_matrix().values).mean(axis=0)
    assert size.argmax(axis=0).tolist() == [0, 2, 6, 8]
