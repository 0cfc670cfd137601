"""Playing drives through a device, and its latency and gain over a cable."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq
from scipy.signal import chirp, correlate

from ..errors import DataError, HardwareError
from ..progress import Progress
from ..scenario.measurement import DaqOptions, MeasurementOptions
from ..store.text import read_json, write_json
from ..typing import FloatArray
from .daq import Daq, OpenDevice, Wiring, check_limit, faded

# Sending drive signals to the actuators, within limits.

LONGEST = 3600.0  # s played at a time: signals are held in memory whole


@dataclass(frozen=True, eq=False)
class Played:
    """``sensor`` (n,) [V] recorded meanwhile; ``peak`` (n_in,) [V at the actuators]; ``seconds`` played;
    ``stopped`` early.
    """

    sensor: FloatArray
    peak: FloatArray
    seconds: float
    stopped: bool


def play(
    daq: Daq,
    signals: FloatArray,
    sample_rate: float,
    options: DaqOptions,
    *,
    repeats: int = 1,
    pause: float = 0.0,
    stop: Callable[[], bool] | None = None,
    progress: Progress | None = None,
) -> Played:
    """Play ``signals`` (n_in, n) [V at the actuators] ``repeats`` times with ``pause`` [s] of silence between.

    Each repeat is faded in and out over ``options.fade``. HardwareError, before anything sounds, for more
    than ``options.max_voltage``, more than :data:`LONGEST` or the wrong number of signals. ``stop`` is polled per
    block; when it turns true, or on Ctrl-C, the drive is ramped down or cut, and the outputs are left at 0 V.
    """
    if signals.ndim != 2 or len(signals) != len(options.outputs):
        raise HardwareError(
            f"expected {len(options.outputs)} drive signals, one per entry of daq.outputs, got shape {signals.shape}"
        )
    check_limit(signals, options.max_voltage)
    if not (lasts := repeats * (signals.shape[1] / sample_rate + pause)) <= LONGEST:
        raise HardwareError(f"that plays for {lasts:.3g} s, expected at most {LONGEST:g} s; lower repeats or pause")
    fade = round(options.fade * sample_rate)
    silence = np.zeros((len(signals), round(pause * sample_rate)))
    once = np.concatenate([faded(signals, fade), silence], axis=1) / options.amplifier_gain
    with OpenDevice(daq, Wiring.of(options, sample_rate)) as session:
        limit = options.max_voltage / options.amplifier_gain
        whole = np.tile(once, repeats)
        whole = whole[:, : whole.shape[1] - silence.shape[1]]  # what is played is over when the last repeat is
        got = session.play(whole, limit=limit, fade=fade, stop=stop, progress=progress)
    return Played(got.inputs[0], np.abs(signals).max(axis=1), got.played / sample_rate, got.stopped)


# Latency and gain of a device: a cable from its first output to its first input, and what came back.
# The latency is that of output and input together (a round trip): a stimulus reaches the skin some time between none
# and all of it after it was sent. Gain is what the first input reads over what the first output was told, both at the
# full scales that the scenario states; it corrects G (:func:`with_latency`), but only a voltmeter tells the volts of
# either.

_FLOOR = 1e-3  # of the chirp's largest power: bins below do not carry it
_UNLIKE = 0.7  # what came back is no copy of what was sent


@dataclass(frozen=True)
class Loopback:
    """Measurement of a cable from output to input of ``device`` at ``sample_rate`` [Hz], ``taken`` at a time (UTC).

    ``latency`` [samples]; ``gain`` [V/V]; ``residual`` [-]: part of the record that is no delayed copy of the
    stimulus.
    """

    latency: float
    gain: float
    residual: float
    device: str
    sample_rate: float
    taken: str

    @property
    def seconds(self) -> float:
        """The latency [s]."""
        return self.latency / self.sample_rate


def loopback(daq: Daq, wiring: Wiring, *, level: float = 0.1, seconds: float = 1.0) -> Loopback:
    """Send a chirp of ``level`` [V] over the first output and find it on the first input.

    Raises HardwareError where nothing like the chirp comes back (no cable, or another channel).
    """
    n = round(seconds * wiring.sample_rate)
    sent = np.zeros((len(wiring.outputs), 2 * n))
    t = np.arange(n) / wiring.sample_rate
    sent[0, :n] = faded((level * chirp(t, 50.0, t[-1], 0.2 * wiring.sample_rate))[None], n // 20)[0]
    with OpenDevice(daq, wiring) as session:
        got = session.play(sent, limit=wiring.output_range, fade=64).inputs[0]
    latency, gain, residual = delay_of(sent[0], got)
    if residual > _UNLIKE:
        raise HardwareError(
            "the chirp did not come back: connect the first output to the first input with a cable, and check levels"
        )
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return Loopback(latency, gain, residual, daq.name, wiring.sample_rate, now)


def delay_of(sent: FloatArray, got: FloatArray) -> tuple[float, float, float]:
    """Delay [samples], gain and residual [-] of ``got`` (n,) as a copy of ``sent`` (n,).

    Whole samples by the cross-correlation's peak; their fraction by the slope of the cross-spectrum's phase, least
    squares weighted by its size (exact for a pure delay).
    """
    n = len(sent)
    likeness = correlate(got, sent, mode="full", method="fft")[n - 1 :]
    whole = int(np.argmax(np.abs(likeness)))
    sign = 1.0 if likeness[whole] >= 0 else -1.0
    omega = 2 * np.pi * rfftfreq(n)
    source, answer = rfft(sent), rfft(got)
    cross = sign * answer * np.conj(source) * np.exp(1j * omega * whole)
    carried = np.abs(source) ** 2 > _FLOOR * np.max(np.abs(source) ** 2, initial=0.0)
    size = np.abs(cross) * carried
    scale = float(size @ omega**2)
    fraction = -float(size @ (omega * np.angle(cross))) / scale if scale > 0 else 0.0
    copy = irfft(source * np.exp(-1j * omega * (whole + fraction)), n)
    gain = float(got @ copy / (copy @ copy)) if np.any(copy) else 0.0
    heard = float(np.linalg.norm(got))
    residual = float(np.linalg.norm(got - gain * copy)) / heard if heard > 0 else 1.0
    return whole + fraction, gain, residual


def write_loopback(path: str | Path, found: Loopback) -> None:
    """Keep ``found`` as JSON, whole or not at all."""
    write_json(path, asdict(found))


def read_loopback(path: str | Path) -> Loopback:
    """Loopback written by :func:`write_loopback`; DataError for a missing, damaged or foreign file."""
    kept = read_json(path)
    try:
        latency, gain, residual, rate = (float(kept[k]) for k in ("latency", "gain", "residual", "sample_rate"))
        found = Loopback(latency, gain, residual, str(kept["device"]), rate, str(kept["taken"]))
    except (KeyError, TypeError, ValueError):
        raise DataError(f"{path}: no record of a loopback; `forearm-fem daq loopback SCENARIO` makes one") from None
    if not (np.isfinite([latency, gain, residual, rate]).all() and gain != 0 and rate > 0):
        raise DataError(f"{path}: latency, gain and rate must be finite and not zero; measure it again")
    return found


def check_belongs(found: Loopback, daq: Daq, sample_rate: float) -> None:
    """HardwareError where ``found`` was measured on another device or at another rate."""
    if found.device != daq.name or abs(found.sample_rate / sample_rate - 1) > 1e-6:
        raise HardwareError(
            f"the loopback was measured on '{found.device[:60]}' at {found.sample_rate:g} Hz, this is "
            f"'{daq.name[:60]}' at {sample_rate:g} Hz; run `forearm-fem daq loopback` again"
        )


def with_latency(options: MeasurementOptions, found: Loopback) -> MeasurementOptions:
    """``options`` with the latency taken off G and the gain of the whole chain taken into the sensor's sensitivity.

    What the input reads over what the output was told is G times the gain, so that dividing by it leaves G.
    """
    sensor = options.sensor
    if sensor.sensitivity is not None:
        flipped = sensor.inverted != (found.gain < 0)
        sensor = sensor.changed({"sensitivity": sensor.sensitivity * abs(found.gain), "inverted": flipped})
    daq = options.daq.changed({"latency": found.seconds})
    return options.changed({"daq": daq, "sensor": sensor})
