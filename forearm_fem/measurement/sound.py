"""A multichannel sound card as a measurement device, through the package ``sounddevice`` (extra "audio").

Outputs are named "1", "2", ... (channels of the card), inputs likewise. A card counts in full scale: ``volts_out`` and
``volts_in`` say what full scale is at the terminals; they must be measured (:func:`loopback`), as cards do not tell.
Blocks are written and read on one stream, so that both share the card's clock; what comes back lags by the card's
latency, which the loopback measures and the scenario's ``measurement.daq.latency`` then takes off.
Tried with a stand-in for ``sounddevice`` of known latency and gain; not yet with a card.
"""

from __future__ import annotations

import importlib
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import chirp, correlate

from ..errors import HardwareError, MissingExtra
from ..typing import FloatArray
from .daq import Daq, Session, Wiring, faded

_QUEUED = 2  # silent blocks ahead of the signal, so that a slow computer does not interrupt it


class SoundCard:
    """Implements :class:`~forearm_fem.measurement.daq.Daq` with ``sounddevice``; ``module`` stands in for it in tests.

    ``device`` is the card's name or number for the package (None: the system's default). ``volts_out`` [V] and
    ``volts_in`` [V] are at full scale.
    """

    def __init__(
        self, block: int, device: str | int | None = None, *, volts_out: float = 1.0, volts_in: float = 1.0,
        module: Any = None,
    ) -> None:  # fmt: skip
        self._module = module or _sounddevice()
        self._block, self._device, self._out, self._in = block, device, volts_out, volts_in
        self._stream: Any = None
        self._wiring: Wiring | None = None
        self.interruptions = 0

    @property
    def name(self) -> str:
        """Name of the card, for the record."""
        with suppress(Exception):
            return f"sound card {self._module.query_devices(self._device)['name']}"
        return "sound card (not found)"

    @property
    def resolution(self) -> float:
        """Step of 24 bits over the input's full scale [V]."""
        return 2 * self._in / 2.0**24

    @property
    def ahead(self) -> int:
        """Two blocks of silence go before the signal."""
        return _QUEUED * self._block

    def aim(self, output: str) -> None:
        """The operator aims the laser; nothing to do here."""

    def open(self, wiring: Wiring) -> None:
        """Open one stream for both directions and queue the silence; HardwareError in one sentence."""
        self._wiring = wiring
        channels = _number(wiring.inputs, "daq.sensor"), _number(wiring.outputs, "daq.outputs")
        try:
            self._module.check_output_settings(self._device, channels[1], "float32", samplerate=wiring.sample_rate)
            self._stream = self._module.Stream(
                samplerate=wiring.sample_rate, blocksize=0, device=self._device, channels=channels, dtype="float32",
                latency="high",
            )  # fmt: skip
            self._stream.start()
            self._stream.write(np.zeros((self.ahead, channels[1]), dtype=np.float32))
            self.interruptions = 0
        except Exception as problem:
            self.close()
            raise HardwareError(
                f"sound card: it cannot play {channels[1]} and record {channels[0]} channel(s) at "
                f"{wiring.sample_rate:g} Hz ({' '.join(str(problem).split())[:120]}); check daq.outputs, daq.sensor "
                "and sweep.sample_rate"
            ) from problem

    def exchange(self, block: FloatArray) -> FloatArray:
        """Play ``block`` (n_output, m) [V]; the inputs (n_input, m) [V] of the m ticks that have passed meanwhile.

        HardwareError where the card lost samples: what was recorded then does not belong to what was played.
        """
        if self._stream is None or self._wiring is None:
            raise HardwareError("the sound card is not open; open it before playing")
        if np.abs(block).max(initial=0.0) > self._out:
            raise HardwareError(
                f"the drive exceeds the card's full scale of {self._out:g} V; lower it or raise volts_out"
            )
        highest = max(int(c) for c in self._wiring.outputs)
        frames = np.zeros((block.shape[1], highest), dtype=np.float32)
        frames[:, [int(c) - 1 for c in self._wiring.outputs]] = block.T / self._out
        try:
            lost = self._stream.write(frames)
            got, overflowed = self._stream.read(block.shape[1])
        except Exception as problem:
            raise HardwareError(
                f"sound card: it stopped answering ({' '.join(str(problem).split())[:120]})"
            ) from problem
        if lost or overflowed:
            self.interruptions += 1
            raise HardwareError(
                "sound card: samples were lost because the computer was too slow; use a larger daq.block"
            )
        return np.asarray(got, dtype=float)[:, [int(c) - 1 for c in self._wiring.inputs]].T * self._in

    def close(self) -> None:
        """Stop at once and free the card. Never raises."""
        if self._stream is not None:
            with suppress(Exception):
                self._stream.abort()
            with suppress(Exception):
                self._stream.close()
        self._stream = self._wiring = None


@dataclass(frozen=True)
class Loopback:
    """What a cable from output to input shows: ``latency`` [samples], ``gain`` [V/V], ``residual`` [-], the part of
    what came back that is no delayed copy of what was sent."""

    latency: float
    gain: float
    residual: float


def loopback(daq: Daq, wiring: Wiring, *, level: float = 0.1, seconds: float = 1.0) -> Loopback:
    """Send a chirp of ``level`` [V] over the first output and find it on the first input.

    The latency is that of the cross-correlation's peak, its fraction by a parabola through three samples. Raises
    HardwareError where nothing like the chirp comes back (no cable, or another channel).
    """
    n = round(seconds * wiring.sample_rate)
    sent = np.zeros((len(wiring.outputs), 2 * n))
    t = np.arange(n) / wiring.sample_rate
    wave = level * chirp(t, 50.0, t[-1], 0.2 * wiring.sample_rate)
    sent[0, :n] = faded(wave[None], n // 20)[0]
    with Session(daq, wiring) as session:
        got = session.play(sent, limit=wiring.output_range, fade=64).inputs[0]
    likeness = correlate(got, sent[0], mode="full", method="fft")[2 * n - 1 :]
    k = int(np.argmax(np.abs(likeness)))
    shift = np.roll(sent[0], k)
    gain = float(got @ shift / (shift @ shift))
    heard = float(np.linalg.norm(got))
    residual = float(np.linalg.norm(got - gain * shift)) / heard if heard > 0 else 1.0
    if residual > 0.7:
        raise HardwareError(
            "the chirp did not come back: connect the first output to the first input with a cable, and check levels"
        )
    return Loopback(k + _vertex(np.abs(likeness), k), gain, residual)


def _vertex(values: FloatArray, k: int) -> float:
    """Where between samples a parabola through k - 1, k, k + 1 is highest [samples from k]."""
    if not 0 < k < len(values) - 1:
        return 0.0
    a, b, c = values[k - 1 : k + 2]
    return float((a - c) / (2 * (a - 2 * b + c))) if a - 2 * b + c < 0 else 0.0


def _number(channels: tuple[str, ...], key: str) -> int:
    if not all(c.isdigit() and int(c) > 0 for c in channels):
        raise HardwareError(f"{key}: a sound card's channels are numbers from '1', got {', '.join(channels)}")
    return max(int(c) for c in channels)


def _sounddevice() -> Any:
    try:
        return importlib.import_module("sounddevice")
    except ImportError:
        raise MissingExtra("sounddevice", "audio", "playing through a sound card") from None
    except OSError:
        raise HardwareError(
            "the package sounddevice finds no PortAudio library; install it (Debian: libportaudio2)"
        ) from None
