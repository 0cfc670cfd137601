"""What `forearm-fem calibrate` and `play` do, as plain functions; the command line only prints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import DataError, HardwareError, ScenarioError
from ..geometry.device.layout import layout_of
from ..io.netcdf import write_transfer
from ..io.signals import read_drives
from ..io.wav import read_wav_drives
from ..ports import Port
from ..progress import Progress, tell
from ..scenario import Scenario
from ..scenario.measurement import MeasurementOptions, SensorOptions
from ..transfer import TransferMatrix
from ..typing import FloatArray
from .calibrate import Plan, Step, assembled, calibrate
from .daq import Daq
from .entry import Measured
from .ni import NiDaq
from .play import Played, play
from .sweep import ExponentialSweep
from .virtual import VirtualDaq, VirtualOptions, VirtualSensor, noise_for

__all__ = ["CalibrationResult", "VirtualSetup", "run_calibration", "run_play"]

DaqKind = Literal["virtual", "ni"]


@dataclass(frozen=True)
class VirtualSetup:
    """The virtual device of the command line: G to play through, noise as SNR [dB], bits, latency
    [samples], seed.
    """

    transfer: TransferMatrix
    snr_db: float = 60.0
    bits: int = 16
    latency: int = 0
    seed: int = 0


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """What was measured, and the files written: ``transfer.nc``, the live figure and one recording per
    entry.
    """

    measured: Measured
    transfer_file: Path
    figure_file: Path


def run_calibration(
    scenario: Scenario,
    folder: str | Path,
    *,
    daq: DaqKind | Daq = "virtual",
    virtual: VirtualSetup | None = None,
    operator: Callable[[str], bool] | None = None,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
    figure: bool = True,
) -> CalibrationResult:
    """Calibrate ``scenario``'s device into ``folder``; running it again resumes.

    ``virtual`` is needed for daq = "virtual". After each entry ``folder/live.png`` is redrawn (unless
    ``figure`` is False); at the end ``folder/transfer.nc`` holds G. Raises ScenarioError, DataError or
    HardwareError in one sentence.
    """
    plan = calibration_plan(scenario, virtual if daq == "virtual" else None)
    device = daq if not isinstance(daq, str) else _device(daq, plan, virtual)
    target = Path(folder)

    def after(step: Step) -> None:
        if figure and not step.reused:
            from .figures import save_live  # plotting is heavy, and who asks for no picture does not need it

            now = assembled(plan, step.entries, device.name)
            save_live(target / "live.png", now.transfer, now.coherence)
        tell(progress, "measurements (saved one by one)", len(step.entries), step.total)

    measured = calibrate(plan, device, target, operator=operator, after=after, stop=stop)
    write_transfer(target / "transfer.nc", measured.transfer)
    return CalibrationResult(measured, target / "transfer.nc", target / "live.png")


def calibration_plan(scenario: Scenario, virtual: VirtualSetup | None = None) -> Plan:
    """Ports, sweep and options of ``scenario``; a virtual device brings its G's ports, and a sensor if none
    is declared.
    """
    options = scenario.measurement
    if virtual is None:
        outputs, inputs = planform_ports(scenario)
        if options.sensor.quantity is None or options.sensor.sensitivity is None:
            raise ScenarioError(
                "measurement.sensor: say what the vibrometer's voltage means before "
                "measuring: quantity = displacement, "
                "velocity or acceleration, and sensitivity in V per SI unit"
            )
        return Plan(outputs, inputs, ExponentialSweep.of(scenario), options)
    wired = tuple(f"virtual/ao{i}" for i in range(len(virtual.transfer.inputs)))
    latency = virtual.latency / scenario.sweep.sample_rate
    daq = options.daq.model_copy(update={"outputs": wired, "latency": latency})
    sensor = _declared(options.sensor)
    return Plan(
        virtual.transfer.outputs,
        virtual.transfer.inputs,
        ExponentialSweep.of(scenario),
        options.model_copy(update={"daq": daq, "sensor": sensor}),
    )


def _declared(sensor: SensorOptions) -> SensorOptions:
    if sensor.quantity is not None and sensor.sensitivity is not None:
        return sensor
    built_in = VirtualSensor()
    return SensorOptions(quantity=built_in.quantity, sensitivity=built_in.sensitivity)


def planform_ports(scenario: Scenario) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
    """Outputs and inputs seen from above (z = 0): a measured G needs names and places, not the limb's
    surface.
    """
    layout = layout_of(scenario)
    outputs = tuple(Port(str(k + 1), "point", (float(x), float(y), 0.0)) for k, (x, y) in enumerate(layout.points))
    contact = scenario.device.cone.contact
    inputs = tuple(
        Port(name, "contact", (float(x), float(y), 0.0), radius=layout.radius, contact=contact)
        for name, (x, y) in zip(layout.names, layout.contacts, strict=True)
    )
    return outputs, inputs


def _device(kind: str, plan: Plan, virtual: VirtualSetup | None) -> Daq:
    if kind == "ni":
        return NiDaq(plan.options.daq.block, input_range=plan.options.daq.input_range)
    if kind != "virtual":
        raise ScenarioError(f"--daq expects virtual or ni, got '{kind}'")
    if virtual is None:
        raise ScenarioError("a virtual calibration needs a G to play through: simulate first, or name a transfer file")
    return virtual_device(plan, virtual)


def virtual_device(plan: Plan, virtual: VirtualSetup) -> VirtualDaq:
    """A virtual device behind the plan's sweep and sensor; the noise follows from the SNR and the strongest
    response.
    """
    sweep, sensor = plan.sweep, _virtual_sensor(plan.options)
    noise = noise_for(virtual.snr_db, virtual.transfer, sweep.samples(), sweep.sample_rate, sensor)
    options = VirtualOptions(noise, virtual.bits, virtual.latency, seed=virtual.seed, sensor=sensor)
    return VirtualDaq(virtual.transfer, sweep.sample_rate, sweep.duration, options)


def _virtual_sensor(options: MeasurementOptions) -> VirtualSensor:
    assert options.sensor.quantity is not None
    assert options.sensor.sensitivity is not None
    return VirtualSensor(options.sensor.quantity, options.sensor.sensitivity)


def run_play(
    scenario: Scenario,
    drives: str | Path,
    *,
    daq: DaqKind | Daq = "virtual",
    virtual: VirtualSetup | None = None,
    method: str | None = None,
    target: str | None = None,
    scale: float = 1.0,
    repeats: int = 1,
    pause: float = 0.0,
    stop: Callable[[], bool] | None = None,
    progress: Progress | None = None,
) -> Played:
    """Send the drives of ``drives.nc`` (choosing ``method`` and ``target``) or of a WAV file, times
    ``scale``.

    Refuses what exceeds ``measurement.daq.max_voltage`` and what was sampled at another rate than the
    scenario's.
    """
    signals, rate = read_signals(drives, method, target)
    if abs(rate / scenario.sweep.sample_rate - 1) > 1e-6:
        raise HardwareError(
            f"the drives are sampled at {rate:g} Hz, the scenario's device runs at "
            f"{scenario.sweep.sample_rate:g} Hz; "
            "render them at that rate"
        )
    plan = calibration_plan(scenario, virtual if daq == "virtual" else None)
    device = daq if not isinstance(daq, str) else _device(daq, plan, virtual)
    if virtual is not None and daq == "virtual":
        device.aim(virtual.transfer.outputs[0].name)
    return play(
        device,
        scale * signals,
        rate,
        plan.options.daq,
        repeats=repeats,
        pause=pause,
        stop=stop,
        progress=progress,
    )


def read_signals(path: str | Path, method: str | None, target: str | None) -> tuple[FloatArray, float]:
    """Drive signals (n_in, n) [V] and their rate [Hz] from drives.nc or WAV; DataError if method or target
    are unclear.
    """
    file = Path(path)
    if file.suffix.lower() == ".wav":
        return read_wav_drives(file)
    stored = read_drives(file)
    if stored.unit != "V":
        raise DataError(f"{file}: drives are in {stored.unit}, only volts can be played")
    row = _choice(file, "method", method, stored.methods)
    column = _choice(file, "target", target, stored.targets)
    step = np.diff(stored.time)
    return stored.values[row, column], float(round(1 / step.mean(), 6))


def _choice(file: Path, what: str, wanted: str | None, known: tuple[str, ...]) -> int:
    if wanted is None and len(known) == 1:
        return 0
    if wanted not in known:
        raise DataError(f"{file}: choose a {what} among {', '.join(known)}" + (f", not '{wanted}'" if wanted else ""))
    return known.index(wanted)


def with_loopback(plan: Plan, channel: str) -> Plan:
    """``plan`` with the drive recorded on ``channel`` too: latency and amplifier drift then cancel."""
    daq = plan.options.daq.model_copy(update={"loopback": channel, "latency": 0.0})
    return replace(plan, options=plan.options.model_copy(update={"daq": daq}))
