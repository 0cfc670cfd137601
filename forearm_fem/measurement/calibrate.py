"""The calibration: outputs x inputs measurements, each saved as it is taken, resumed where it stopped."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError, HardwareError
from ..ports import Port
from ..scenario.measurement import MeasurementOptions
from ..store.text import digest_of
from .daq import Daq, OpenDevice, Wiring
from .entry import Entry, Measured, assemble, entry
from .estimators import ExponentialSweep
from .recording import Folder, Recording


@dataclass(frozen=True)
class Step:
    """After each entry: all ``entries`` so far, the last one just handled, of ``total``; ``reused`` if on disk."""

    entries: tuple[Entry, ...]
    total: int
    reused: bool

    @property
    def last(self) -> Entry:
        """The entry just handled."""
        return self.entries[-1]


@dataclass(frozen=True)
class Plan:
    """Plan of a measurement: ports, sweep and options.

    ``inputs``: actuators in the order of the outputs' wiring.
    ``latency_basis``: source of the device's latency.
    ``simulated``: parameters of a virtual device, which no hardware could say of itself.
    """

    outputs: tuple[Port, ...]
    inputs: tuple[Port, ...]
    sweep: ExponentialSweep
    options: MeasurementOptions
    latency_basis: str = "unknown"
    simulated: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        wired = self.options.daq.outputs
        if len(wired) != len(self.inputs):
            raise DataError(
                f"measurement.daq.outputs names {len(wired)} channels for {len(self.inputs)} actuators; name one each"
            )

    @property
    def wiring(self) -> Wiring:
        """Channels of the device."""
        loopback = self.options.daq.loopback
        return Wiring.of(self.options.daq, self.sweep.sample_rate, *(() if loopback is None else (loopback,)))

    @property
    def description(self) -> dict[str, Any]:
        """Everything that a recording depends on; what only changes its evaluation is left out."""
        daq, how = self.options.daq, self.options
        simulated = {} if self.simulated is None else {"simulated": self.simulated}
        return simulated | {
            "sweep": vars(self.sweep),
            "repeats": how.repeats,
            "lead_in": how.lead_in,
            "outputs": [[p.name, *p.position] for p in self.outputs],
            "inputs": [[p.name, *p.position] for p in self.inputs],
            "channels": [*daq.outputs, daq.sensor, daq.loopback],
            "ranges": [daq.input_range, daq.output_range],
            "amplifier_gain": daq.amplifier_gain,
        }

    @property
    def entries(self) -> tuple[tuple[int, int], ...]:
        """(output, input) in the order of measuring: all actuators at one point, for moving the laser takes longest."""
        return tuple((o, i) for o in range(len(self.outputs)) for i in range(len(self.inputs)))


def calibrate(
    plan: Plan,
    daq: Daq,
    folder: str | Path,
    *,
    operator: Callable[[str], bool] | None = None,
    after: Callable[[Step], None] | None = None,
    stop: Callable[[], bool] | None = None,
    retries: int = 1,
) -> Measured:
    """Measure what is missing in ``folder`` and return G of all that is there.

    ``operator`` is told, once per point that still needs measuring, where to aim the laser, and answers
    whether to go on. Recordings that are damaged, or unusable by :func:`diagnose`, are taken again,
    ``retries`` times; what is unusable then stays marked. ``stop`` is polled per block; HardwareError
    follows a stop, with everything taken so far saved. Calling again resumes.
    """
    store = _store(plan, folder)
    entries, aimed = list[Entry](), None
    for o, i in plan.entries:
        try:
            kept = store.get(plan.outputs[o].name, plan.inputs[i].name)
        except DataError:  # damaged: it is measured again
            kept = None
        if kept is not None:
            entries.append(_entry(plan, kept))
        else:
            if aimed != o:
                port = plan.outputs[o]
                x, y = (1e3 * c for c in port.position[:2])
                told = f"aim the laser at point {port.name} (x = {x:.1f} mm, y = {y:.1f} mm)"
                if operator is not None and not operator(told):
                    raise HardwareError(
                        f"stopped by the operator before point {port.name}; run the same command to go on"
                    )
                daq.aim(port.name)
                aimed = o
            entries.append(_measure(plan, daq, store, (o, i), stop, retries))
        if after is not None:
            after(Step(tuple(entries), len(plan.entries), kept is not None))
    return assembled(plan, entries, daq.name)


def _store(plan: Plan, folder: str | Path) -> Folder:
    store = Folder(Path(folder), digest_of(plan.description)[:16])
    store.begin({"plan": plan.description})
    return store


def _measure(
    plan: Plan, daq: Daq, store: Folder, place: tuple[int, int], stop: Callable[[], bool] | None, retries: int
) -> Entry:
    for attempt in range(retries + 1):
        recording = record(plan, daq, place, stop=stop)
        store.put(recording)
        result = _entry(plan, recording)
        if attempt == retries or not any(f.severity == "error" or f.kind == "moved" for f in result.findings):
            break
    return result


def record(plan: Plan, daq: Daq, place: tuple[int, int], *, stop: Callable[[], bool] | None = None) -> Recording:
    """Play the sweeps on one actuator and keep the periods after the lead-in; ``place`` is (output, input)."""
    options, sweep = plan.options, plan.sweep
    train = sweep.train(options.lead_in + options.repeats)
    terminals = np.zeros((len(plan.inputs), train.size))
    terminals[place[1]] = train / options.daq.amplifier_gain
    fade = round(options.daq.fade * sweep.sample_rate)
    with OpenDevice(daq, plan.wiring) as session:
        limit = options.daq.max_voltage / options.daq.amplifier_gain
        capture = session.play(terminals, limit=limit, fade=fade, stop=stop)
    if capture.stopped:
        raise HardwareError(
            "emergency stop: the drive was faded out; entries already measured are saved, run again to go on"
        )
    kept = capture.inputs[:, options.lead_in * sweep.n :].reshape(len(capture.inputs), options.repeats, sweep.n)
    return Recording(
        plan.outputs[place[0]].name,
        plan.inputs[place[1]].name,
        sweep.sample_rate,
        sweep.samples(),
        kept[0],
        kept[1] if len(kept) > 1 else None,
        options.daq.input_range,
        daq.resolution,
        capture.notes,
        {"device": daq.name},
    )


def _entry(plan: Plan, recording: Recording) -> Entry:
    return entry(recording, (plan.sweep.f_min, plan.sweep.f_max), plan.options)


def assembled(plan: Plan, entries: Sequence[Entry], device: str) -> Measured:
    """G of ``entries`` with where it came from."""
    provenance = {
        "source": "measured",
        "device": device,
        "setup": digest_of(plan.description)[:16],
        "measurement": plan.options.model_dump(mode="json"),
        "sweep": vars(plan.sweep),
        "latency_basis": plan.latency_basis,
    }
    return assemble(entries, plan.outputs, plan.inputs, provenance)
