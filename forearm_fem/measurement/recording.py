"""What one measurement leaves behind, in volts as taken: nothing is converted before it is saved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..errors import DataError
from ..store.record import dims
from ..typing import FloatArray


@dataclass(frozen=True, eq=False)
class Recording:
    """One actuator driven, one point watched.

    ``sent`` (n,) [V at the actuator] is one period of the drive. ``response`` (n_repeat, n) [V at the input] and, where
    a loopback was wired, ``loopback`` (n_repeat, n) [V at the input] are the periods kept. ``full_scale`` [V] and
    ``resolution`` [V per step, 0 = unknown] are the input's. ``notes`` are what the hardware said.
    """

    output: str
    input: str
    sample_rate: float
    sent: FloatArray = field(metadata=dims("sample", units="V"))
    response: FloatArray = field(metadata=dims("repeat sample", units="V"))
    loopback: FloatArray | None = field(default=None, metadata=dims("repeat sample", units="V"))
    full_scale: float = float("inf")
    resolution: float = 0.0
    notes: tuple[str, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, array in (("response", self.response), ("loopback", self.loopback)):
            if array is not None and (array.ndim != 2 or array.shape[1] != self.sent.size):
                raise DataError(
                    f"{self.output} <- {self.input}: {name} has shape {array.shape}, expected (repeats, "
                    f"{self.sent.size}); record whole periods of the sweep"
                )
        if self.response.shape[0] < 1:
            raise DataError(f"{self.output} <- {self.input}: no period was recorded; record at least one")

    @property
    def n(self) -> int:
        """Samples in a period."""
        return int(self.sent.size)

    @property
    def label(self) -> str:
        """Names for messages: output <- input."""
        return f"{self.output} <- {self.input}"
