"""What a fit looks for, and how it says what it could not find."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ...errors import ScenarioError

_MEMBER = 0.3  # of a unit vector: parameters with this share belong to a combination


@dataclass(frozen=True)
class Parameter:
    """A number to be found between ``lower`` and ``upper``, from ``start``; ``log`` fits its logarithm.

    ``stage`` orders the fit: parameters of stage 0 are fitted first, with the others at their start, then
    those of stages 0 and 1, and so on. The names "scale" and "delay" [s] are multiplied onto the model by
    :func:`fit`.
    """

    name: str
    start: float
    lower: float
    upper: float
    log: bool = False
    stage: int = 1
    unit: str = ""

    def __post_init__(self) -> None:
        if not self.lower < self.upper or not self.lower <= self.start <= self.upper:
            raise ScenarioError(
                f"{self.name}: expected lower <= start <= upper, got {self.lower:g}, {self.start:g}, {self.upper:g}"
            )
        if self.log and self.lower <= 0:
            raise ScenarioError(f"{self.name}: a logarithm needs a positive lower bound, got {self.lower:g}")

    def to_unit(self, value: float) -> float:
        """Place of ``value`` between the bounds, 0 to 1."""
        f = math.log if self.log else float
        return (f(value) - f(self.lower)) / (f(self.upper) - f(self.lower))

    def from_unit(self, place: float) -> float:
        """The value at ``place``."""
        if self.log:
            return float(self.lower * (self.upper / self.lower) ** place)
        return float(self.lower + place * (self.upper - self.lower))

    @property
    def span(self) -> float:
        """Width of the range in the coordinate that is fitted: of the logarithm, or the parameter's unit."""
        return math.log(self.upper / self.lower) if self.log else self.upper - self.lower


@dataclass(frozen=True, eq=False)
class Direction:
    """A combination of parameters that the data do not tell: ``weights`` (unit vector over the ranges) and
    its standard ``deviation`` as a share of the allowed range."""

    weights: Mapping[str, float]
    deviation: float

    @property
    def sentence(self) -> str:
        """What the data cannot tell."""
        names = [n for n, w in self.weights.items() if abs(w) >= _MEMBER]
        share = f"{100 * self.deviation:.0f} %" if self.deviation <= 1 else "more than all"
        if len(names) == 1:
            return f"the data do not determine {names[0]}: it is uncertain by {share} of its allowed range"
        sign = [f"{self.weights[n]:+.2f} {n}" for n in names]
        return (
            f"the data cannot tell {', '.join(names[:-1])} and {names[-1]} apart: along {' '.join(sign)} they are "
            f"uncertain by {share} of their allowed range"
        )
