"""Pareto front: candidates that no other beats in everything at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .candidate import Candidate


def pareto_front(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Feasible candidates with no other of at least their score, at most their actuators and at most their power, one
    of these strictly; by number of actuators, then power. Power is unknown of drives that are no voltages: such a
    candidate is compared with its like alone, by score and actuators.
    """
    feasible = [c for c in candidates if c.feasible]
    kept: list[Candidate] = []
    for unknown in (False, True):
        alike = [c for c in feasible if math.isnan(c.total_power) == unknown]
        goods = np.array([(-c.score, c.actuators, _power(c)) for c in alike]).reshape(-1, 3)
        seen: set[tuple[float, ...]] = set()  # of equals the first is kept
        for mine, candidate in zip(goods, alike, strict=True):
            worse = (goods <= mine).all(axis=1) & (goods < mine).any(axis=1)
            if not worse.any() and tuple(mine) not in seen:
                seen.add(tuple(mine))
                kept.append(candidate)
    return tuple(sorted(kept, key=lambda c: (c.actuators, _power(c), -c.score)))


def _power(candidate: Candidate) -> float:
    return math.inf if math.isnan(candidate.total_power) else candidate.total_power
