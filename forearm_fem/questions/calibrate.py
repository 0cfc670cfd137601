"""Work of `forearm-fem calibrate` and `play`, as plain functions; the command line only prints."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..errors import AccuracyWarning, DataError, HardwareError, ScenarioError
from ..files.wav import read_wav_drives
from ..geometry.device.layout import planform_ports
from ..measurement.calibrate import Plan, Step, assembled, calibrate
from ..measurement.daq import Daq, Wiring
from ..measurement.entry import Measured
from ..measurement.estimators import ExponentialSweep
from ..measurement.ni import NiDaq
from ..measurement.playback import Loopback, Played, check_belongs, loopback, play, with_latency
from ..measurement.sound import SoundCard
from ..measurement.virtual import VirtualDaq, VirtualOptions, VirtualSensor, noise_for
from ..notebook import Manners
from ..progress import Progress, tell
from ..results.files import read_drives, refuse_other_g, write_transfer
from ..scenario import Scenario
from ..scenario.measurement import DaqOptions
from ..store.folder import check_kind
from ..transfer import TransferMatrix
from ..typing import ComplexArray, FloatArray

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = ["CalibrationResult", "VirtualSetup", "hardware", "run_calibration", "run_loopback", "run_play", "wired"]

DaqKind = Literal["virtual", "ni", "sound"]
_PAUSE = 3.0  # s between two drawings of live.png: a virtual device measures faster than it is drawn
_APART = 1e-3  # [m] between places of one name from which they are two
_MOST_SNR = 300  # dB: double precision holds no more


@dataclass(frozen=True)
class VirtualSetup:
    """The virtual device of the command line: G to play through, noise as SNR [dB], infinite for none, bits, latency
    [samples], seed. ScenarioError for an SNR that no sensor has.
    """

    transfer: TransferMatrix
    snr_db: float = 60.0
    bits: int = 16
    latency: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what would be recorded for minutes and be no measurement."""
        if not (-_MOST_SNR <= self.snr_db <= _MOST_SNR or self.snr_db == math.inf):
            raise ScenarioError(f"--snr: expected at most {_MOST_SNR} dB either way, or inf, got {self.snr_db}")
        if self.seed < 0:
            raise ScenarioError(f"--seed: expected 0 or more, got {self.seed}")

    @property
    def description(self) -> dict[str, Any]:
        """Keys that recordings through it depend on; of G a size per entry, whose digits hold between machines."""
        parts = np.nan_to_num(self.transfer.values.real + self.transfer.values.imag)  # not of its conjugate
        sizes = [f"{size:.4e}" for size in np.linalg.norm(parts, axis=0).ravel()]
        return {"snr": str(self.snr_db), "bits": self.bits, "latency": self.latency, "seed": self.seed, "g": sizes}


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult(Manners):
    """Measured G, and the files written: ``transfer.nc``, the live figure and one recording per entry."""

    measured: Measured
    transfer_file: Path
    figure_file: Path

    @property
    def line(self) -> str:
        """Ports of G, and the share of it that may be used."""
        g = self.measured.transfer
        usable = np.isfinite(g.values) if g.valid is None else g.valid
        return f"{repr(g)[1:-1]}; {100 * usable.mean():.0f} % of the entries may be used"

    @property
    def rows(self) -> list[list[str]]:
        """Findings on the way."""
        return [["finding"], *([finding.sentence] for finding in self.measured.findings)]

    def sel(self, output: str, input: str) -> ComplexArray:
        """G (n_frequency,) of one point by one actuator."""
        return self.measured.transfer.sel(output, input)

    def to_xarray(self) -> xr.Dataset:
        """G and its coherence."""
        g = self.measured.transfer.to_xarray()
        return g.to_dataset().assign(coherence=(g.dims, self.measured.coherence))

    def plot(self) -> Figure:
        """Entries with their scatter, coherence, and what was measured."""
        from ..show.calibration import live

        return live(self.measured.transfer, self.measured.coherence)

    def save(self, path: str | Path) -> None:
        """Write G in the format of the path's ending: .nc, .csv or .mat."""
        self.measured.transfer.save(path)


def run_calibration(
    scenario: Scenario,
    folder: str | Path,
    *,
    daq: DaqKind | Daq = "virtual",
    card: str | None = None,
    virtual: VirtualSetup | None = None,
    cable: Loopback | None = None,
    operator: Callable[[str], bool] | None = None,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
    figure: bool = True,
) -> CalibrationResult:
    """Calibrate ``scenario``'s device into ``folder``; running it again resumes.

    ``virtual`` is needed for daq = "virtual"; ``card`` names a sound card, and ``cable`` is the loopback whose latency
    and gain are taken off G: a sound card needs it, or a loopback channel. ``folder/live.png`` follows, redrawn
    every few seconds (unless ``figure`` is False); at the end ``folder/transfer.nc`` holds G. Raises ScenarioError,
    DataError or HardwareError in one sentence.
    """
    plan = calibration_plan(scenario, virtual if daq == "virtual" else None, kind=daq)
    if virtual is not None and daq == "virtual":
        _warn_of_other_ports(scenario, virtual.transfer)
    device = daq if not isinstance(daq, str) else _device(daq, plan, virtual, card)
    plan = _timed(plan, daq, device, cable)
    target = Path(folder)
    refuse_other_g(target / "transfer.nc", measured=True)
    check_kind(target, "calibration")

    drawn = -_PAUSE

    def after(step: Step) -> None:
        """Draw what is known by now, and tell how far it is."""
        nonlocal drawn
        due = len(step.entries) == step.total or time.monotonic() - drawn >= _PAUSE
        if figure and due and not step.reused:
            from ..show.calibration import save_live

            now = assembled(plan, step.entries, device.name)
            save_live(target / "live.png", now.transfer, now.coherence)
            drawn = time.monotonic()
        tell(progress, "measurements (saved one by one)", len(step.entries), step.total)

    measured = calibrate(plan, device, target, operator=operator, after=after, stop=stop)
    write_transfer(target / "transfer.nc", measured.transfer)
    return CalibrationResult(measured, target / "transfer.nc", target / "live.png")


def _warn_of_other_ports(scenario: Scenario, g: TransferMatrix) -> None:
    """A warning (AccuracyWarning) where the G to play through has other points or actuators than the scenario."""
    asked, given = planform_ports(scenario), (g.outputs, g.inputs)
    along = [[{p.name: p.position[0] for p in ports} for ports in pair] for pair in (asked, given)]  # x bends nowhere
    if any(a.keys() != b.keys() or max(abs(a[n] - b[n]) for n in a) > _APART for a, b in zip(*along, strict=True)):
        counts = [f"{len(outputs)} points and {len(inputs)} actuators" for outputs, inputs in (given, asked)]
        warnings.warn(
            f"the G to play through has {counts[0]}, the scenario {counts[1]}, or they lie elsewhere: those of G are "
            "measured",
            AccuracyWarning, stacklevel=3,
        )  # fmt: skip


def _timed(plan: Plan, kind: DaqKind | Daq, device: Daq, cable: Loopback | None) -> Plan:
    """``plan`` with what is known of the device's latency, and on what ground; HardwareError for a sound card of which
    nothing is known."""
    daq = plan.options.daq
    if kind == "virtual":
        return replace(plan, latency_basis="known")
    if daq.loopback is not None:
        return replace(plan, latency_basis="measured with every recording")
    if cable is not None:
        check_belongs(cable, device, plan.sweep.sample_rate)
        basis = f"measured by a cable, {cable.taken}"
        return replace(plan, options=with_latency(plan.options, cable), latency_basis=basis)
    if daq.latency:
        return replace(plan, latency_basis="declared")
    if kind == "sound":
        raise HardwareError(
            "a sound card's latency is unknown, and G would turn with it; measure it with a cable (`forearm-fem "
            "loopback SCENARIO --daq sound`) and give --loopback FILE, or wire measurement.daq.loopback"
        )
    return plan


def run_loopback(scenario: Scenario, *, daq: Literal["ni", "sound"] | Daq, card: str | None = None) -> Loopback:
    """Latency and gain of a device whose first output is wired to its first input (the sensor's).

    Raises HardwareError in one sentence, also where the cable is missing.
    """
    options = scenario.measurement.daq
    if isinstance(daq, str):
        options = wired(options, len(options.outputs), daq)
    device = hardware(daq, options, card) if isinstance(daq, str) else daq
    level = min(0.1, options.max_voltage / options.amplifier_gain, options.output_range)
    return loopback(device, Wiring.of(options, scenario.sweep.sample_rate), level=level)


def wired(options: DaqOptions, count: int, kind: DaqKind | Daq) -> DaqOptions:
    """``options`` with channels as ``kind`` numbers them: a sound card's are "1", "2", ... unless the scenario says so.

    HardwareError unless there is a channel for each of ``count`` actuators.
    """
    if kind == "sound" and not all(c.isdigit() for c in options.outputs):
        names = {"outputs": tuple(str(i + 1) for i in range(count)), "sensor": "1"}
        options = options.changed(names if options.loopback is None else names | {"loopback": "2"})
    if len(options.outputs) != count:
        raise HardwareError(f"measurement.daq.outputs names {len(options.outputs)} channels, G has {count} actuators")
    return options


def hardware(kind: Literal["ni", "sound"], options: DaqOptions, card: str | None = None) -> Daq:
    """The device of a kind; ``card`` is a sound card's name or number (None: the system's default)."""
    if kind not in ("ni", "sound"):
        raise ScenarioError(f"--daq expects virtual, ni or sound, got '{kind}'")
    if kind == "ni":
        return NiDaq(options.block, input_range=options.input_range)
    chosen = int(card) if card is not None and card.isdigit() else card
    return SoundCard(options.block, chosen, volts_out=options.output_range, volts_in=options.input_range)


def calibration_plan(scenario: Scenario, virtual: VirtualSetup | None = None, *, kind: DaqKind | Daq = "ni") -> Plan:
    """Ports, sweep and options of ``scenario``; a virtual device brings its G's ports, and a sensor if none
    is declared; a sound card (``kind``) numbers its channels.
    """
    options = scenario.measurement
    if virtual is None:
        outputs, inputs = planform_ports(scenario)
        if options.sensor.quantity is None or options.sensor.sensitivity is None:
            raise ScenarioError(
                "measurement.sensor: say what the vibrometer's voltage means before measuring: quantity = "
                "displacement, velocity or acceleration, and sensitivity in V per SI unit"
            )
        channels = wired(options.daq, len(inputs), kind)
        options = options.changed({"daq": channels})
        return Plan(outputs, inputs, ExponentialSweep.of(scenario), options)
    names = tuple(f"virtual/ao{i}" for i in range(len(virtual.transfer.inputs)))
    latency = virtual.latency / scenario.sweep.sample_rate
    daq = options.daq.changed({"outputs": names, "latency": latency})
    sensor, built_in = options.sensor, VirtualSensor()
    if sensor.quantity is None or sensor.sensitivity is None:
        sensor = sensor.changed({"quantity": built_in.quantity, "sensitivity": built_in.sensitivity})
    return Plan(
        virtual.transfer.outputs,
        virtual.transfer.inputs,
        ExponentialSweep.of(scenario),
        options.changed({"daq": daq, "sensor": sensor}),
        simulated={**virtual.description, "sensor": sensor.model_dump(mode="json"), "rig": options.rig.model_dump()},
    )


def _device(kind: DaqKind, plan: Plan, virtual: VirtualSetup | None, card: str | None = None) -> Daq:
    if kind != "virtual":
        return hardware(kind, plan.options.daq, card)
    if virtual is None:
        raise ScenarioError("a virtual calibration needs a G to play through: simulate first, or name a transfer file")
    return virtual_device(plan, virtual)


def virtual_device(plan: Plan, virtual: VirtualSetup) -> VirtualDaq:
    """A virtual device behind the plan's sweep, amplifier and sensor, which are what the plan takes them for; the SNR
    and the strongest response give the noise."""
    sweep, how = plan.sweep, plan.options.sensor
    assert how.quantity is not None
    assert how.sensitivity is not None
    sensor = VirtualSensor(how.quantity, how.sensitivity, delay=how.delay, inverted=how.inverted)
    noise = noise_for(virtual.snr_db, virtual.transfer, sweep.samples(), sweep.sample_rate, sensor)
    gain = plan.options.daq.amplifier_gain
    options = VirtualOptions(
        noise, virtual.bits, virtual.latency, seed=virtual.seed, amplifier_gain=gain, sensor=sensor,
        rig=plan.options.rig,
    )  # fmt: skip
    return VirtualDaq(virtual.transfer, sweep.sample_rate, sweep.duration, options)


def run_play(
    scenario: Scenario,
    drives: str | Path,
    *,
    daq: DaqKind | Daq = "virtual",
    card: str | None = None,
    virtual: VirtualSetup | None = None,
    method: str | None = None,
    target: str | None = None,
    full_scale: float | None = None,
    scale: float = 1.0,
    repeats: int = 1,
    pause: float = 0.0,
    stop: Callable[[], bool] | None = None,
    progress: Progress | None = None,
) -> Played:
    """Send the drives of ``drives.nc`` (choosing ``method`` and ``target``) or of a WAV file, times ``scale``.

    ``full_scale`` [V] is what integer samples of a WAV file count in. Refuses what exceeds
    ``measurement.daq.max_voltage`` and what was sampled at another rate than the scenario's.
    """
    signals, rate = read_signals(drives, method, target, full_scale)
    if abs(rate / scenario.sweep.sample_rate - 1) > 1e-6:
        raise HardwareError(
            f"the drives are sampled at {rate:g} Hz, the scenario's device runs at {scenario.sweep.sample_rate:g} Hz; "
            "render them at that rate"
        )
    plan = calibration_plan(scenario, virtual if daq == "virtual" else None, kind=daq)
    device = daq if not isinstance(daq, str) else _device(daq, plan, virtual, card)
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


def read_signals(
    path: str | Path, method: str | None, target: str | None, full_scale: float | None = None
) -> tuple[FloatArray, float]:
    """Drive signals (n_in, n) [V] and their rate [Hz] from drives.nc or WAV; DataError if method or target is open, or
    what is given has no effect."""
    file = Path(path)
    if file.suffix.lower() == ".wav":
        if method is not None or target is not None:
            raise DataError(f"{file}: a WAV file holds drives for one target, so --method and --target have no effect")
        return read_wav_drives(file, full_scale=full_scale)
    if full_scale is not None:
        raise DataError(f"{file}: drives.nc is in volts, so that --full-scale has no effect; leave it out")
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
