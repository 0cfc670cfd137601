"""Zero points by a search for the largest S."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations
from math import comb

import numpy as np

from ..errors import ScenarioError
from ..metrics.strength import area, plain_strength
from ..progress import Progress, tell
from ..typing import FloatArray
from .renderers import Aim
from .signals import BinnedTransfer, respond

_MOST_SETS = 200  # tried one by one
_LOUDEST, _ROUNDS = 12, 2  # of an exchange


@dataclass(frozen=True)
class SearchedZeros:
    """The set of ``size`` zero points with the largest S found; ``size`` None: as many as there are actuators, 4 at
    least.

    S (eq. 9) over the ``window`` (start, end) [s], or the whole record. Up to 200 sets are all tried (the thesis' grid
    has C(8, 4) = 70). Beyond that, points are added one at a time and then exchanged one at a time while S rises, in
    two rounds at most, each time among the 12 outputs that move most: a local best after at most 36 tries a point.
    ``progress`` counts the sets of one target. Raises ScenarioError for more zero points than outputs.
    """

    size: int | None = None
    window: tuple[float, float] | None = None
    progress: Progress | None = field(default=None, repr=False, compare=False)

    def choose(self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the best zero points."""
        return self.ranking(placed, target, aim)[0][0]

    def ranking(
        self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]
    ) -> tuple[tuple[tuple[str, ...], float], ...]:
        """The sets tried with their S, best first."""
        placed.row(target)
        others = [p.name for p in placed.outputs if p.name != target]
        size = self.size if self.size is not None else max(4, len(placed.inputs))
        size = min(size, len(others)) if self.size is None else size
        if not 0 <= size <= len(others):
            raise ScenarioError(f"{size} zero points cannot be searched among {len(others)} outputs beside the target")
        few = comb(len(others), size) <= _MOST_SETS
        trial = _Trial(placed, target, aim, self, comb(len(others), size) if few else (_ROUNDS + 1) * size * _LOUDEST)
        if few:
            for zeros in combinations(others, size):
                trial.strength(zeros)
        else:
            _exchange(trial, size, [p.name for p in placed.outputs])
        found = [(zeros, s) for zeros, s in trial.found.items() if len(zeros) == size]
        return tuple(sorted(found, key=lambda pair: -pair[1] if pair[1] == pair[1] else float("inf")))


@dataclass
class _Trial:
    """Sets tried for one target, with S and the area of every output."""

    placed: BinnedTransfer
    target: str
    aim: Callable[[tuple[str, ...]], Aim]
    rule: SearchedZeros
    most: int
    found: dict[tuple[str, ...], float] = field(default_factory=dict)
    areas: dict[tuple[str, ...], FloatArray] = field(default_factory=dict)

    def strength(self, zeros: tuple[str, ...]) -> float:
        """S with these zero points; -inf where it is no number."""
        if zeros not in self.found:
            response, time = respond(self.placed, self.aim(zeros).spectrum), self.placed.record.time
            row, window = self.placed.row(self.target), self.rule.window
            self.found[zeros] = plain_strength(response, row, time=time, window=window)
            self.areas[zeros] = area(response, time=time, window=window)
            tell(self.rule.progress, "zero points of one target", len(self.found), self.most)
        found = self.found[zeros]
        return found if found == found else float("-inf")


def _exchange(trial: _Trial, size: int, names: list[str]) -> None:
    """Zero points added one at a time, then each exchanged for a better one while S rises."""

    def best_with(rest: tuple[str, ...]) -> tuple[str, ...]:
        """The set of most S that adds one of the loudest points to ``rest``."""
        trial.strength(rest)
        loud = [names[i] for i in np.argsort(-trial.areas[rest]) if names[i] not in (trial.target, *rest)]
        # names in the order of the outputs, so that a set met again is known
        return max((tuple(sorted((*rest, n), key=names.index)) for n in loud[:_LOUDEST]), key=trial.strength)

    chosen: tuple[str, ...] = ()
    for _ in range(size):
        chosen = best_with(chosen)
    for _ in range(_ROUNDS):
        before = chosen
        for name in before:
            chosen = max(chosen, best_with(tuple(n for n in chosen if n != name)), key=trial.strength)
        if chosen == before:
            return
