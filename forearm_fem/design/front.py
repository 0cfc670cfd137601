"""Pareto front: candidates that no other beats in everything at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .candidate import Candidate


def pareto_front(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Feasible candidates with no other of at least their score, at most their actuators and at most their power, one
    of these strictly; by number of actuators, then power. Power counts where it is known (drives in volts).
    """
    feasible = [c for c in candidates if c.feasible]
    if not feasible:
        return ()
    power = [0.0 if math.isnan(c.total_power) else c.total_power for c in feasible]
    goods = np.array([(-c.score, c.actuators, p) for c, p in zip(feasible, power, strict=True)])
    kept: list[Candidate] = []
    seen: set[tuple[float, ...]] = set()
    for i, mine in enumerate(goods):
        worse = (goods <= mine).all(axis=1) & (goods < mine).any(axis=1)
        if not worse.any() and tuple(mine) not in seen:
            seen.add(tuple(mine))
            kept.append(feasible[i])
    return tuple(sorted(kept, key=lambda c: (c.actuators, c.total_power, -c.score)))
