"""A multichannel sound card as a measurement device, through the package ``sounddevice`` (extra "audio").

Outputs are named "1", "2", ... (channels of the card), inputs likewise. A card counts in full scale: ``volts_out`` and
``volts_in`` say what full scale is at the terminals; a voltmeter tells them, cards do not. Blocks are written and read
on one stream, so that both share the card's clock; what comes back lags by the card's latency, which :mod:`.loopback`
measures and takes off. Tried with a stand-in for ``sounddevice`` of known latency and gain; not yet with a card.
"""

from __future__ import annotations

import importlib
from contextlib import suppress
from typing import Any

import numpy as np

from ..errors import HardwareError, MissingExtra
from ..typing import FloatArray
from .daq import Wiring

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
