"""What a case of verification is, and what it reports."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["right", "named error", "WRONG"]


@dataclass(frozen=True)
class Row:
    """One checked number: ``error`` must not exceed ``tolerance``, for the ``reason`` given.

    ``error`` is relative unless ``quantity`` says otherwise; ``seconds`` is the whole case's wall time.
    """

    case: str
    reference: str
    quantity: str
    error: float
    tolerance: float
    reason: str
    seconds: float = 0.0

    @property
    def met(self) -> bool:
        """Whether the error is a number and within its tolerance."""
        return math.isfinite(self.error) and self.error <= self.tolerance


@dataclass(frozen=True)
class HardResult:
    """One result with its true ``error`` and what is ``allowed``; an empty ``what`` takes the case's."""

    what: str
    result: str
    error: float
    allowed: float


@dataclass(frozen=True)
class HardCase:
    """A named generator of outcomes; raising a :class:`ForearmError` is an answer, too."""

    name: str
    what: str
    run: Callable[[], Iterator[HardResult]]


@dataclass(frozen=True)
class HardRow:
    """A hard case: ``what`` was run, its ``result``, the ``true_error`` where there is one, and the ``verdict``."""

    case: str
    what: str
    result: str
    true_error: str
    verdict: Verdict


def weakest(rows: Sequence[Row]) -> Row:
    """The row whose error comes nearest to, or goes furthest beyond, its tolerance."""
    return max(rows, key=lambda r: r.error / r.tolerance if math.isfinite(r.error) else math.inf)
