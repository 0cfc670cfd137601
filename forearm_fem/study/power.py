"""How many participants and repetitions a study needs: whole studies drawn at random, through its own analysis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from ..errors import DataError
from ..progress import Progress, tell
from ..typing import FloatArray
from .anova import repeated_measures
from .comparisons import pairwise

_ALPHA = 0.05


@dataclass(frozen=True)
class Supposed:
    """What is supposed of the answers' errors [m], from a pilot study, a published one or simulated participants.

    ``means`` (n_target, n_method) of the population, ``between`` the standard deviation of participants' own offsets,
    ``cell`` that of their cells and ``within`` that of single trials. ``location`` and ``method`` are those of what a
    target and a method are to one participant more than to others, alike in all its cells: the scatter against which
    these two are tested.
    """

    means: FloatArray
    between: float
    cell: float
    within: float
    location: float = 0.0
    method: float = 0.0


@dataclass(frozen=True)
class Power:
    """Share of ``studies`` drawn in which an effect was significant at 5 %, with its 95 % interval (Wilson)."""

    participants: int
    repetitions: int
    share: float
    low: float
    high: float


def power_curve(
    supposed: Supposed,
    participants: Sequence[int],
    repetitions: int,
    *,
    test: str = "method",
    studies: int = 1000,
    progress: Progress | None = None,
) -> tuple[Power, ...]:
    """Power of ``test`` for each number of participants.

    ``test`` is "location", "method" or "location x method" (Greenhouse-Geisser), or "pairs": any two methods differ by
    a Bonferroni-corrected paired test. With equal ``means`` the share is the rate of false alarms.
    """
    found = []
    for done, count in enumerate(participants):
        (rng, apart), hits = (np.random.default_rng([k, count]) for k in range(2)), 0
        for _ in range(studies):  # the cell means (n_participant, n_target, n_method) of each
            own = supposed.between * rng.standard_normal((count, 1, 1))
            own = own + supposed.location * apart.standard_normal((count, supposed.means.shape[0], 1))
            own = own + supposed.method * apart.standard_normal((count, 1, supposed.means.shape[1]))
            scatter = np.hypot(supposed.cell, supposed.within / np.sqrt(repetitions))
            noise = scatter * rng.standard_normal((count, *supposed.means.shape))
            hits += _significant(np.asarray(supposed.means + own + noise), test)
        low, high = stats.binomtest(hits, studies).proportion_ci(method="wilson")
        found.append(Power(count, repetitions, hits / studies, float(low), float(high)))
        tell(progress, "power", done + 1, len(participants))
    return tuple(found)


def needed(curve: Sequence[Power], power: float = 0.8) -> int | None:
    """The least number of participants from which on the share stays at ``power``; None where it is not reached."""
    enough = None
    for point in sorted(curve, key=lambda p: -p.participants):
        if point.share < power:
            return enough
        enough = point.participants
    return enough


def supposed_from(values: FloatArray, repetitions: int, within: float) -> Supposed:
    """What a pilot's cell means ``values`` (n_participant, n_target, n_method) and trial scatter ``within`` suggest.

    Participants differ in what a target is to them, in what a method is, and in what is left of their cells: a variance
    each, from the mean squares against which the three effects are tested. The last holds within^2 / repetitions of
    trial noise, which is taken off. So is what chance has made of the effects in so few participants: each is drawn in
    by sqrt(1 - 1 / F), F its own mean square over its error's, to nothing where F is below 1. What is left is one
    pilot's guess all the same. Participants without all cells are left out; DataError for fewer than two with all.
    """
    values = _complete(values)
    n, a, b = values.shape
    own = values.mean(axis=(1, 2), keepdims=True)
    apart = values - own - values.mean(axis=0) + values.mean()
    by_target, by_method = apart.mean(axis=2, keepdims=True), apart.mean(axis=1, keepdims=True)
    rest = apart - by_target - by_method
    squares = (b * by_target**2, a - 1), (a * by_method**2, b - 1), (rest**2, (a - 1) * (b - 1))
    location, method, left = (float(np.sum(square)) / ((n - 1) * max(df, 1)) for square, df in squares)
    spread = own.var(ddof=1) - max(location - left, 0) / (a * b) - max(method - left, 0) / (a * b) - left / (a * b)
    return Supposed(
        _without_chance(values.mean(axis=0), location / n, method / n, left / n),
        float(np.sqrt(max(spread, 0.0))),
        float(np.sqrt(max(left - within**2 / repetitions, 0.0))),
        within,
        float(np.sqrt(max(location - left, 0.0) / b)),
        float(np.sqrt(max(method - left, 0.0) / a)),
    )


def untold(values: FloatArray, test: str) -> str:
    """A sentence where a pilot's cell means do not tell the effect of ``test`` from chance, else empty."""
    whole = _complete(values)
    if _significant(whole, test):
        return ""
    return (
        f"the pilot's {len(whole)} participants do not tell this effect from chance: how large it is, and so how many "
        "it takes, is a guess; the wider the pilot the better, or suppose the least effect that would matter"
    )


def _complete(values: FloatArray) -> FloatArray:
    """Participants with all cells, two or more."""
    whole = values[np.isfinite(values).all(axis=(1, 2))]
    if len(whole) < 2:
        raise DataError(f"a pilot needs two participants who answered every cell, got {len(whole)}")
    return np.asarray(whole)


def _without_chance(means: FloatArray, location: float, method: float, both: float) -> FloatArray:
    """``means`` (n_target, n_method) with each effect drawn in by what an error of that mean square makes of none."""
    grand = means.mean()
    targets, methods = (means.mean(axis=k, keepdims=True) - grand for k in (1, 0))
    a, b = (n - 1 for n in means.shape)
    parts = ((targets, a, location), (methods, b, method), (means - grand - targets - methods, a * b, both))
    out = np.full(means.shape, grand)
    for part, df, variance in parts:
        square = float(np.sum(np.broadcast_to(part, means.shape) ** 2))
        out += part * np.sqrt(max(1 - df * variance / square, 0.0) if square > 0 else 0.0)
    return out


def _significant(values: FloatArray, test: str) -> bool:
    if test == "pairs":
        names = [str(k) for k in range(values.shape[2])]
        return any(pair.p < _ALPHA for pair in pairwise(values.mean(axis=1), names))
    effects = {e.name: e for e in repeated_measures(values, ("location", "method"))}
    return effects[test].p_gg < _ALPHA
