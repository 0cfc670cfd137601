"""How late and how loud a device is: a cable from its first output to its first input, and what came back.

The latency is that of output and input together (a round trip): a stimulus reaches the skin some time between none and
all of it after it was sent. Gain is what the first input reads over what the first output was told, both at the full
scales that the scenario states; it corrects G (:func:`with_latency`), but only a voltmeter tells the volts of either.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq
from scipy.signal import chirp, correlate

from ..errors import DataError, HardwareError
from ..scenario.measurement import MeasurementOptions
from ..store.text import read_json, write_json
from ..typing import FloatArray
from .daq import Daq, OpenDevice, Wiring, faded

_FLOOR = 1e-3  # of the chirp's largest power: bins below do not carry it
_UNLIKE = 0.7  # what came back is no copy of what was sent


@dataclass(frozen=True)
class Loopback:
    """What a cable shows: ``latency`` [samples], ``gain`` [V/V], ``residual`` [-], the part of what came back that is
    no delayed copy of what was sent; of ``device`` at ``sample_rate`` [Hz], ``taken`` at a time (UTC)."""

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
    """What :func:`write_loopback` wrote; DataError for a missing, damaged or foreign file."""
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
