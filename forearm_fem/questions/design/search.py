"""Search over candidates, and the front that nothing beats."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import differential_evolution, minimize
from scipy.stats import qmc

from ...typing import BoolArray, FloatArray
from .candidate import Candidate
from .model import Design, Values

# Pareto front: candidates that no other beats in everything at once.


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


# The search: differential evolution over everything, then Nelder-Mead over what is continuous.

Ask = Callable[[Sequence[Values]], list[Candidate]]
_STILL = 1e-4  # of each range: a local search ends there


def search(design: Design, ask: Ask) -> None:
    """Ask for candidates until the design's numbers of them are spent; the best is among those asked for.

    Storn & Price 1997 as in SciPy, whole generations at a time so that they can be computed side by side, from a Sobol
    start; then Nelder & Mead 1965 from the best, within the bounds. Both depend on their seed and on what was
    answered only, so that a search begun anew asks for the same.
    """
    low, high, whole = design.bounds
    options = design.asked.search
    if _levels(low, high, whole) <= options.candidates:
        axes = [np.arange(a, b + 1) for a, b in zip(low, high, strict=True)]
        every = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))
        ask([design.values(at) for at in every])
        return

    def many(points: FloatArray) -> list[float]:
        """Costs of candidates at ``points`` (n, variables)."""
        return [c.cost for c in ask([design.values(at) for at in points])]

    power = int(np.ceil(np.log2(max(options.population, 2))))
    start = low + (high - low) * qmc.Sobol(len(low), seed=options.seed).random_base2(power)[: options.population]
    generations = max(0, options.candidates // options.population - 1)
    found = differential_evolution(
        lambda x: many(np.asarray(x).T if np.ndim(x) > 1 else np.atleast_2d(x)),
        list(zip(low, high, strict=True)), maxiter=generations, init=start, seed=options.seed, polish=False, tol=0,
        updating="deferred", vectorized=True, integrality=whole,
    )  # fmt: skip
    free = ~whole
    if not options.local or not free.any():
        return
    span = np.where(free, high - low, 1.0)

    def one(part: FloatArray) -> float:
        """Cost where the free variables stand at ``part`` (0 to 1) of their ranges."""
        at = np.array(found.x, dtype=float)
        at[free] = low[free] + span[free] * part
        return many(at[None])[0]

    minimize(
        one, ((found.x - low) / span)[free], method="Nelder-Mead", bounds=[(0, 1)] * int(free.sum()),
        options={"maxfev": options.local, "xatol": _STILL, "fatol": 1e-6},
    )  # fmt: skip


def planned(design: Design) -> int:
    """Candidates that the search asks for at most."""
    options, (low, high, whole) = design.asked.search, design.bounds
    levels = _levels(low, high, whole)
    return int(levels) if levels <= options.candidates else options.candidates + options.local


def _levels(low: FloatArray, high: FloatArray, whole: BoolArray) -> float:
    """Combinations of choices; infinite where something is continuous."""
    return float(np.prod(np.where(whole, high - low + 1, np.inf)))
