"""The interface of a data acquisition device, and the one loop that plays and records through it.

A device exchanges blocks: what is written is played on the outputs, and exactly as many samples are read
back on the inputs, on one clock. Voltages are those at the terminals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from ..errors import HardwareError
from ..progress import Progress, tell
from ..scenario.measurement import DaqOptions
from ..typing import FloatArray


@dataclass(frozen=True)
class Wiring:
    """Physical channels and rate of a session on the device.

    ``input_range`` and ``output_range`` [V] are plus and minus full scale. ``block`` samples are exchanged at a time.
    ``clock`` is what keeps outputs and inputs together: "inputs", "trigger" or a terminal (``measurement.daq.clock``).
    """

    sample_rate: float
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    input_range: float = 10.0
    output_range: float = 10.0
    block: int = 2000
    clock: str = "inputs"

    @classmethod
    def of(cls, options: DaqOptions, sample_rate: float, *beside: str) -> Self:
        """The outputs and the sensor's input of ``options``, and the inputs ``beside`` it."""
        inputs = (options.sensor, *beside)
        ranges = options.input_range, options.output_range
        return cls(sample_rate, options.outputs, inputs, *ranges, options.block, options.clock)


class Daq(Protocol):
    """A device with synchronous outputs and inputs. ``close`` must be safe at any time and leave the outputs at 0 V."""

    @property
    def name(self) -> str:
        """Model and serial number, for the record."""

    @property
    def resolution(self) -> float:
        """Step of the input converter [V]; 0 if unknown."""

    @property
    def ahead(self) -> int:
        """Samples queued before the first block is heard: the inputs lag the blocks by that many ticks, exactly."""

    def aim(self, output: str) -> None:
        """Told which point of the grid is watched next, before the session opens."""

    def open(self, wiring: Wiring) -> None:
        """Reserve the channels; nothing is played yet."""

    def exchange(self, block: FloatArray) -> FloatArray:
        """Play ``block`` (n_output, m) [V] and return the inputs (n_input, m) [V] of the same m ticks of the clock.

        What comes back belongs to the block sent ``ahead`` samples earlier; nothing may be missing between two blocks.
        """

    def close(self) -> None:
        """Silence the outputs and free the channels."""


@dataclass(frozen=True, eq=False)
class Capture:
    """``inputs`` (n_input, n) [V]; ``stopped`` tells whether an emergency stop cut the drive at ``played`` samples."""

    inputs: FloatArray
    played: int
    stopped: bool
    notes: tuple[str, ...] = ()


class OpenDevice:
    """Opens a device for a ``with`` block and silences it whatever happens."""

    def __init__(self, daq: Daq, wiring: Wiring) -> None:
        self._daq, self.wiring = daq, wiring

    def __enter__(self) -> Self:
        self._daq.open(self.wiring)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._daq.close()

    def play(
        self,
        signals: FloatArray,
        *,
        limit: float,
        fade: int,
        stop: Callable[[], bool] | None = None,
        progress: Progress | None = None,
    ) -> Capture:
        """Play ``signals`` (n_output, n) [V at the terminals] block by block and record.

        Refused with HardwareError if any sample exceeds ``limit`` [V]. When ``stop()`` turns true the drive
        is ramped to zero within ``fade`` samples of the next block and the session ends.
        """
        check_limit(signals, min(limit, self.wiring.output_range))
        ahead, size = self._daq.ahead, self.wiring.block
        queued = np.concatenate([signals, np.zeros((len(signals), ahead))], axis=1)
        got: list[FloatArray] = []
        for start in range(0, queued.shape[1], size):
            block = queued[:, start : start + size]
            stopped = stop is not None and stop()
            got.append(self._daq.exchange(faded_out(block, fade) if stopped else block))
            expected = (len(self.wiring.inputs), block.shape[1])
            if got[-1].shape != expected:
                raise HardwareError(
                    f"{self._daq.name}: asked for {expected[1]} samples on {expected[0]} channel(s), got shape "
                    f"{got[-1].shape}: samples were lost; use a larger daq.block or a lower rate"
                )
            if stopped:
                played = min(start + min(fade, block.shape[1]), signals.shape[1])
                return Capture(np.concatenate(got, axis=1)[:, ahead:], played, True)
            tell(progress, "samples played", min(start + size, queued.shape[1]), queued.shape[1])
        return Capture(np.concatenate(got, axis=1)[:, ahead:], signals.shape[1], False)


def check_limit(signals: FloatArray, limit: float) -> None:
    """HardwareError for a signal that is not finite or exceeds ``limit`` [V]; nothing is clipped silently."""
    if not np.all(np.isfinite(signals)):
        raise HardwareError("the drive holds samples that are not finite; nothing was played")
    peak = float(np.abs(signals).max(initial=0.0))
    if peak > limit * (1 + 1e-12):
        raise HardwareError(
            f"the drive reaches {peak:.4g} V, the limit is {limit:.4g} V; scale it down, nothing was played"
        )


def faded_out(block: FloatArray, fade: int) -> FloatArray:
    """``block`` (n_output, m) brought to zero by half a cosine over its first ``fade`` samples, zero after."""
    ramp = np.zeros(block.shape[1])
    length = max(1, min(fade, block.shape[1]))
    ramp[:length] = (1 + np.cos(np.pi * (np.arange(length) + 1) / length)) / 2
    return np.asarray(block * ramp)


def faded(signals: FloatArray, fade: int) -> FloatArray:
    """``signals`` (n_output, n) with half a cosine of ``fade`` samples at either end; refuses more than half of n."""
    n = signals.shape[1]
    if 2 * fade > n:
        raise HardwareError(f"a fade of {fade} samples at either end does not fit into {n} samples; shorten daq.fade")
    ramp = (1 - np.cos(np.pi * (np.arange(fade) + 0.5) / max(fade, 1))) / 2
    return np.asarray(signals * np.concatenate([ramp, np.ones(n - 2 * fade), ramp[::-1]]))
