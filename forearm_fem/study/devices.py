"""What plays at a sitting, and what is known of its latency and level; what was not measured is unknown."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from ..measurement.daq import Daq
from ..measurement.playback import Loopback
from ..measurement.virtual import VirtualDaq
from ..scenario.measurement import DaqOptions


@dataclass(frozen=True)
class BackEnd:
    """A line of ``devices.tsv``; ``latency`` [s] and ``gain`` [V/V] are NaN where unknown.

    ``latency`` is that of output and input together, so a stimulus is late by some part of it. ``full_scale`` [V] is
    the outputs': the scenario's statement, which no cable can check, but a voltmeter can.
    """

    device: str
    sample_rate: float
    latency: float = float("nan")
    latency_basis: str = "unknown"
    gain: float = float("nan")
    full_scale: float = float("nan")
    level_basis: str = "unknown"

    @property
    def row(self) -> dict[str, Any]:
        """Its columns."""
        return asdict(self)


def back_end(daq: Daq, options: DaqOptions, sample_rate: float, cable: Loopback | None) -> BackEnd:
    """What is known of ``daq``: all of a virtual one; of others what a ``cable`` showed or the scenario declares."""
    scale = options.output_range
    if isinstance(daq, VirtualDaq):
        return BackEnd(daq.name, sample_rate, daq.latency / sample_rate, "known", 1.0, scale, "known")
    if cable is not None:
        basis = "declared and checked by a cable"
        return BackEnd(daq.name, sample_rate, cable.seconds, "measured", cable.gain, scale, basis)
    latency, known = (options.latency, "declared") if options.latency else (float("nan"), "unknown")
    return BackEnd(daq.name, sample_rate, latency, known, full_scale=scale, level_basis="declared")
