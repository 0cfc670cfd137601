"""Sending drive signals to the actuators, within limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import HardwareError
from ..progress import Progress
from ..scenario.measurement import DaqOptions
from ..typing import FloatArray
from .daq import Daq, OpenDevice, Wiring, check_limit, faded

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
