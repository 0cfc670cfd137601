"""What a hard case is and what it reports."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass


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
