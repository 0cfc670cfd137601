"""A device without hardware: plays through a known G, with the faults that real ones have.

The filter is the impulse response of G on the bins of one record, run as a streaming convolution. Driven
periodically it reproduces G on these bins to rounding from the second period on, so whatever error an
estimate has comes from the noise, the converter and the estimator.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ..errors import DataError, HardwareError
from ..rendering.signals import Record, on_record_bins
from ..scenario.measurement import Quantity, RigOptions, to_displacement
from ..transfer import TransferMatrix
from ..typing import FloatArray
from .chain import Disturbance, with_entry_errors
from .daq import Wiring

_ENTRIES = 0x6761696E  # random numbers of entries' gains, apart from those of the noise


@dataclass(frozen=True)
class VirtualSensor:
    """A vibrometer: ``sensitivity`` V per m, m/s or m/s^2 of ``quantity``, clipping at ``saturation`` [V].

    It comes ``delay`` [s] late, and with the other sign where it is ``inverted``.
    """

    quantity: Quantity = "velocity"
    sensitivity: float = 200.0
    saturation: float = float("inf")
    delay: float = 0.0
    inverted: bool = False


@dataclass(frozen=True)
class Faults:
    """Faults of a virtual device.

    ``drop`` (sample, count): a buffer comes late by ``count`` samples.
    ``dead_inputs``: actuators that do not move.
    ``drift``: relative change of the response per second.
    ``moved_at``, ``moved_gain``: sample from which the response is so many times as large.
    ``fail_at``: sample at which the driver raises.
    ``nan_at``: sample that is not a number.
    """

    drop: tuple[int, int] | None = None
    dead_inputs: tuple[int, ...] = ()
    drift: float = 0.0
    moved_at: int | None = None
    moved_gain: float = 0.7
    fail_at: int | None = None
    nan_at: int | None = None
    blind: bool = False


@dataclass(frozen=True)
class VirtualOptions:
    """Noise, converter, amplifier and latency of a virtual device.

    ``noise`` [V rms] is white and added before the converter; :func:`noise_for` finds it for a signal-to-noise ratio.
    ``rig`` is what the arm and the vibrometer add in front of the sensor's output, and to each entry of G.
    ``bits`` 0 = no quantisation. ``latency`` [samples] delays the inputs, ``ahead`` is the driver's queue.
    ``amplifier_gain`` lies between the outputs and the actuators.
    """

    noise: float = 0.0
    bits: int = 16
    latency: int = 0
    ahead: int = 0
    seed: int = 0
    amplifier_gain: float = 1.0
    sensor: VirtualSensor = VirtualSensor()
    rig: RigOptions = field(default_factory=RigOptions)
    faults: Faults = Faults()


class VirtualDaq:
    """Implements :class:`~forearm_fem.measurement.daq.Daq` on a TransferMatrix in m/V; the last input, if two are
    wired, is a loopback of the driven output. Seeded per point watched: the same calls give the same samples."""

    def __init__(self, transfer: TransferMatrix, sample_rate: float, duration: float, options: VirtualOptions) -> None:
        if transfer.unit != "m/V":
            raise DataError(f"a virtual device needs a G in m/V, got {transfer.unit}; use device.drive = 'voltage'")
        self._options = options
        self._record = Record.of(sample_rate, duration)
        self._outputs = tuple(p.name for p in transfer.outputs)
        swept = with_entry_errors(transfer, options.rig, np.random.default_rng([options.seed, _ENTRIES]))
        self._kernel = _kernels(swept, self._record, options)
        self._range, self._point = 10.0, 0
        self._driven: int | None = None
        self._times: dict[tuple[int, int], int] = {}
        self._tail = self._cable = np.zeros(0)
        self._history = np.zeros((1, 0))
        self._rng = np.random.default_rng(options.seed)
        self._moving: Disturbance | None = None
        self._tick = 0
        self._late = np.zeros((1, 0))
        self._wiring: Wiring | None = None

    @property
    def name(self) -> str:
        """Name for the record."""
        o = self._options
        return f"virtual ({o.bits} bits, noise {o.noise:.3g} V rms, seed {o.seed})"

    @property
    def resolution(self) -> float:
        """Step of the input converter [V]."""
        return 0.0 if self._options.bits == 0 else 2 * self._range / 2**self._options.bits

    @property
    def latency(self) -> int:
        """Delay of the sensor [samples]."""
        return self._options.latency

    @property
    def ahead(self) -> int:
        """Samples queued in the driver."""
        return self._options.ahead

    def aim(self, output: str) -> None:
        """Watch the point called ``output``."""
        if output not in self._outputs:
            raise HardwareError(f"the virtual device has no point '{output}'; it has {', '.join(self._outputs)}")
        self._point = self._outputs.index(output)

    def open(self, wiring: Wiring) -> None:
        """Reserve; HardwareError for a rate or a number of outputs that G was not prepared for."""
        if wiring.sample_rate != self._record.sample_rate or len(wiring.outputs) != self._kernel.shape[1]:
            raise HardwareError(
                f"the virtual device has {self._kernel.shape[1]} outputs at {self._record.sample_rate:g} Hz, asked for "
                f"{len(wiring.outputs)} at {wiring.sample_rate:g} Hz"
            )
        self._wiring, self._range = wiring, wiring.input_range
        self._rng = np.random.default_rng([self._options.seed, self._point, 0])
        self._driven = self._moving = None
        self._tick = 0
        self._late = np.zeros((len(wiring.inputs), 0))
        self._tail = np.zeros(self._record.n - 1)
        self._cable = np.zeros(self._options.latency)
        self._history = np.zeros((len(wiring.inputs), self._options.ahead))

    def exchange(self, block: FloatArray) -> FloatArray:
        """The inputs (n_input, m) [V] while ``block`` (n_output, m) [V] enters the queue."""
        if self._wiring is None:
            raise HardwareError("the virtual device is not open; open it before playing")
        fail = self._options.faults.fail_at
        if fail is not None and self._tick + block.shape[1] > fail:
            raise HardwareError("the device stopped answering (simulated); check its USB cable and power")
        m = block.shape[1]
        # what a cable from the driven output brings back: as late as the sensor, by the same inputs
        cable = np.concatenate([self._cable, block[np.argmax(np.abs(block).max(axis=1))]])
        self._cable = cable[m:]
        self._note_driven(block)
        rows = [self._sensor(block), cable[:m]][: len(self._wiring.inputs)]
        noisy = np.stack(rows) + self._options.noise * self._rng.standard_normal((len(rows), m))
        clipped = np.clip(noisy, -self._range, self._range)
        volts = clipped if self._options.bits == 0 else np.round(clipped / self.resolution) * self.resolution
        if (broken := self._options.faults.nan_at) is not None:
            volts = np.where(self._tick + np.arange(m) == broken, np.nan, volts)
        queue = np.concatenate([self._history, self._late_by_drop(volts)], axis=1)
        self._tick += m
        self._history = queue[:, m:]
        return queue[:, :m]

    def _note_driven(self, block: FloatArray) -> None:
        """Noise of a pair's own from the first sound on: the same whatever was measured before, by this process or by
        one that was interrupted, and another each time."""
        if self._driven is not None or not block.any():
            return
        self._driven = int(np.argmax(np.abs(block).max(axis=1)))
        pair = self._point, self._driven
        times = self._times[pair] = self._times.get(pair, -1) + 1
        pairs = self._kernel.shape[:2]
        turn = (times * pairs[0] + self._point) * pairs[1] + self._driven
        self._rng = np.random.default_rng([self._options.seed, self._point, turn])
        rig, record = self._options.rig, self._record
        if rig.noise or rig.motion:
            quantity = self._options.sensor.quantity
            self._moving = Disturbance(rig, quantity, record.sample_rate, record.n / record.sample_rate, self._rng)

    def close(self) -> None:
        """Nothing to silence."""
        self._wiring = None

    def _sensor(self, block: FloatArray) -> FloatArray:
        """The vibrometer's volts (m,): streaming convolution by overlap and add, then drift and saturation."""
        m, n = block.shape[1], self._record.n
        length = next_fast_len(m + n - 1, real=True)
        kernels = self._options.amplifier_gain * rfft(self._kernel[self._point], length)
        whole = irfft(np.sum(rfft(block, length) * kernels, axis=0), length)[: m + n - 1]
        whole = whole + np.concatenate([self._tail, np.zeros(m)])
        self._tail = whole[m:]
        faults, tick = self._options.faults, self._tick + np.arange(m)
        moved = np.zeros(m, dtype=bool) if faults.moved_at is None else tick >= faults.moved_at
        gain = (1 + faults.drift * tick / self._record.sample_rate) * np.where(moved, faults.moved_gain, 1.0)
        sensor = self._options.sensor
        played = whole[:m] * (gain * (not faults.blind))
        if self._moving is not None:
            played = played + (-1 if sensor.inverted else 1) * sensor.sensitivity * self._moving.block(m)
        return np.asarray(np.clip(played, -sensor.saturation, sensor.saturation))

    def _late_by_drop(self, volts: FloatArray) -> FloatArray:
        """From the lost buffer on, everything comes ``count`` samples late, with the last one repeated meanwhile."""
        drop, first = self._options.faults.drop, self._tick
        m = volts.shape[1]
        if drop is not None and first <= drop[0] < first + m:
            at = drop[0] - first
            held = np.repeat(volts[:, at : at + 1], drop[1], axis=1)
            volts = np.concatenate([volts[:, :at], held, volts[:, at:]], axis=1)
        elif self._late.shape[1]:
            volts = np.concatenate([self._late, volts], axis=1)
        self._late = volts[:, m:]
        return volts[:, :m]


def _kernels(transfer: TransferMatrix, record: Record, options: VirtualOptions) -> FloatArray:
    """Impulse responses (n_out, n_in, n) [V/V] of sensor after G on the record's bins, circular, delayed by
    the latency.
    """
    placed = on_record_bins(transfer, record)
    full = np.zeros((record.n // 2 + 1, *placed.bins.values.shape[1:]), dtype=complex)
    full[placed.bins.index] = np.where(placed.bins.valid, placed.bins.values, 0)
    full[:, :, list(options.faults.dead_inputs)] = 0
    f = np.maximum(record.frequency, record.df)
    sensor, late = options.sensor, options.latency / record.sample_rate + options.sensor.delay
    volts = (-1 if sensor.inverted else 1) * sensor.sensitivity / to_displacement(f, sensor.quantity)  # per metre
    volts = volts * np.exp(-2j * np.pi * record.frequency * late)
    sensed = full * volts[:, None, None]
    return np.ascontiguousarray(irfft(sensed, record.n, axis=0).transpose(1, 2, 0))


def noise_for(
    snr_db: float, transfer: TransferMatrix, drive: FloatArray, sample_rate: float, sensor: VirtualSensor
) -> float:
    """Noise [V rms per sample] that puts the strongest entry's response to one period ``drive`` (n,) [V] at
    ``snr_db`` [dB], rms over rms of the whole record."""
    record = Record(sample_rate, len(drive))
    kernels = _kernels(transfer, record, VirtualOptions(sensor=sensor))
    responses = irfft(rfft(kernels, axis=2) * rfft(drive), record.n, axis=2)
    return float(np.sqrt(np.mean(responses**2, axis=2)).max() * 10 ** (-snr_db / 20))
