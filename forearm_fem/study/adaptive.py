"""Levels from answers, one track per method and target: QUEST+ (Watson 2017, package ``questplus``) or a staircase.

A detection track looks for the level that is felt; a strength track for the one that feels as strong as the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, Protocol

import numpy as np
from scipy.special import ndtr, ndtri

from ..errors import optional
from .order import Trial
from .plan import Adaptive, Task

_SETTLING = 2  # reversals of a staircase that are left out of its mean
_FEWEST = 4  # reversals kept, for a mean with a deviation
_HELD = 10  # trials in a row at an end of the levels: it holds the track, though nothing reversed
_SIMULATED = 200  # tracks: what they scatter by is known to 5 %


@dataclass(frozen=True)
class Threshold:
    """Level [dB] and its standard ``deviation`` after so many ``trials``; NaN where these do not tell it.

    That is after too few, and where all that is known is that the level lies beyond an end of those played: ``beyond``
    then says which, "below" or "above". Tracks beyond are no part of a mean, which leans away from that end without
    them.
    """

    method: str
    target: str
    level: float
    deviation: float
    trials: int
    beyond: Literal["", "below", "above"] = ""


class _Levels(Protocol):
    def next(self) -> float:
        """The level [dB] to present."""
        ...

    def update(self, level: float, yes: bool) -> None:
        """What was answered at ``level``."""
        ...

    def estimate(self) -> tuple[float, float, int]:
        """Threshold and its standard deviation [dB], NaN while unknown, and the trials so far."""
        ...

    @property
    def beyond(self) -> Literal["", "below", "above"]:
        """Whether the threshold lies outside the levels, and on which side."""
        ...


class Track:
    """Tracks of a task; built anew from the answers on disk, so that a session goes on as if it had not stopped."""

    def __init__(self, options: Adaptive) -> None:
        self._options = options
        self._tracks: dict[tuple[str, str], _Levels] = {}

    @classmethod
    def of(cls, task: Task, answered: Sequence[dict[str, str]]) -> Track | None:
        """The tracks after what was ``answered`` already; None for a task without levels."""
        if task.adaptive is None:
            return None
        track = cls(task.adaptive)
        for row in answered:
            yes = row["response"] == (row["comparison"] if task.answer == "first or second" else "yes")
            track._of((row["method"], row["target"])).update(float(row["level"]), yes)
        return track

    def next(self, trial: Trial) -> float:
        """The level [dB] to be played in a trial."""
        return self._of((trial.method, trial.target)).next()

    def update(self, trial: Trial, level: float, yes: bool) -> None:
        """Take an answer into account: felt, or felt stronger than the reference."""
        self._of((trial.method, trial.target)).update(level, yes)

    def thresholds(self) -> tuple[Threshold, ...]:
        """What every track that has an answer says."""
        found = []
        for (method, target), track in self._tracks.items():
            level, deviation, trials = track.estimate()
            if track.beyond:
                level = deviation = float("nan")
            found.append(Threshold(method, target, level, deviation, trials, track.beyond))
        return tuple(found)

    def _of(self, key: tuple[str, str]) -> _Levels:
        if key not in self._tracks:
            self._tracks[key] = _Quest(self._options) if self._options.rule == "QUEST+" else _Staircase(self._options)
        return self._tracks[key]


class _Quest:
    """Posterior mean and deviation of a threshold (Weibull) or of equal strength (normal)."""

    def __init__(self, options: Adaptive) -> None:
        quest = optional("questplus", "study", "adaptive thresholds")
        levels = np.arange(options.low, options.high + options.step / 2, options.step)
        self._levels = len(levels)
        lapse: dict[str, Any] = {"lapse_rate": options.lapse}
        if options.reference is None:
            self._name = "threshold"
            how: dict[str, Any] = {"func": "weibull", "stim_scale": "dB"}
            domain = {"threshold": levels, "slope": options.slope, "lower_asymptote": options.guess, **lapse}
        else:
            self._name = "mean"
            how = {"func": "norm_cdf", "stim_scale": "linear"}
            domain = {"mean": levels, "sd": options.spread, "lower_asymptote": options.lapse, **lapse}
        self._quest: Any = quest.QuestPlus(
            stim_domain={"intensity": levels}, param_domain=domain, outcome_domain={"response": ["Yes", "No"]},
            stim_selection_method="min_entropy", param_estimation_method="mean", **how,
        )  # fmt: skip

    def next(self) -> float:
        """The level [dB] to present."""
        return float(self._quest.next_stim["intensity"])

    def update(self, level: float, yes: bool) -> None:
        """What was answered at ``level``."""
        self._quest.update(stim={"intensity": level}, outcome={"response": "Yes" if yes else "No"})

    @property
    def beyond(self) -> Literal["", "below", "above"]:
        """Which end of the levels is the likeliest, so that nothing is known but that the level is there or further."""
        likeliest = int(np.argmax(self._quest.marginal_posterior[self._name]))
        return "below" if likeliest == 0 else "above" if likeliest == self._levels - 1 else ""

    def estimate(self) -> tuple[float, float, int]:
        """Mean and standard deviation of the posterior [dB], and trials so far."""
        density = self._quest.marginal_posterior[self._name]
        levels = np.asarray(self._quest.param_domain[self._name], dtype=float)
        mean = float(np.sum(density * levels))
        spread = float(np.sqrt(np.sum(density * (levels - mean) ** 2)))
        return mean, spread, len(self._quest.resp_history)


class _Staircase:
    """Up one step after a no, down one after ``down`` yes in a row (Levitt 1971); from the highest level on."""

    def __init__(self, options: Adaptive) -> None:
        self._options, self._level, self._run = options, options.high, 0
        self._turns: list[float] = []
        self._last, self._count, self._held = 0, 0, 0

    def next(self) -> float:
        """The level [dB] to present."""
        return self._level

    def update(self, level: float, yes: bool) -> None:
        """What was answered at ``level``: up after a no, down after as many yes as the plan asks for."""
        self._count += 1
        self._held = self._held + 1 if level in (self._options.low, self._options.high) else 0
        self._run = self._run + 1 if yes else 0
        step = -1 if self._run == self._options.down else 0 if yes else 1
        if step == 0:
            return
        if self._last and step != self._last:
            self._turns.append(level)
        self._last, self._run = step, 0
        self._level = min(max(level + step * self._options.step, self._options.low), self._options.high)

    @property
    def kept(self) -> list[float]:
        """Levels [dB] at reversals but for the first ones, an even number of them."""
        return self._turns[_SETTLING + (len(self._turns) - _SETTLING) % 2 :]

    @property
    def beyond(self) -> Literal["", "below", "above"]:
        """At which end of the levels half of the reversals are, or the track stays without any: that end holds it, and
        not the participant."""
        kept = np.array(self.kept)
        if self._held >= _HELD:
            return "above" if self._level == self._options.high else "below"
        at_end = [len(kept) > 0 and 2 * np.count_nonzero(kept == end) >= len(kept)
                  for end in (self._options.low, self._options.high)]  # fmt: skip
        return "below" if at_end[0] else "above" if at_end[1] else ""

    def estimate(self) -> tuple[float, float, int]:
        """Mean of the levels at reversals, and what it scatters by over tracks; NaN for a track that has not settled.

        Neighbouring reversals are alike where steps are fine, so that their own scatter tells too little. The deviation
        is that of simulated tracks of as many trials, by the curve that the options assume about the level found. A
        track that ends further from its mean than any of them was still on its way.
        """
        if len(self.kept) < _FEWEST:
            return float("nan"), float("nan"), self._count
        level = float(np.mean(self.kept))
        deviation, furthest = _scatter(self._options, round(8 * level / self._options.step), self._count)
        if abs(self._level - level) > furthest:
            level = deviation = float("nan")
        return level, deviation, self._count


@lru_cache(maxsize=4096)
def _scatter(options: Adaptive, eighths: int, trials: int) -> tuple[float, float]:
    """Standard deviation [dB] of the level that simulated tracks of so many ``trials`` find, and how far from its own
    the furthest ended, where the level is ``eighths`` of a step; NaN and infinite where they find none."""
    answer, rng = _felt_at(options, eighths * options.step / 8), np.random.default_rng(0)
    found = list[tuple[float, float]]()
    for _ in range(_SIMULATED):
        track = _Staircase(options)
        for chance in rng.random(trials):
            level = track.next()
            track.update(level, bool(chance < answer(level)))
        if len(track.kept) >= _FEWEST:
            mean = float(np.mean(track.kept))
            found.append((mean, abs(track.next() - mean)))
    if len(found) < _FEWEST:
        return float("nan"), float("inf")
    means, ends = np.array(found).T
    return float(means.std(ddof=1)), float(ends.max())


def _felt_at(options: Adaptive, level: float) -> Callable[[float], float]:
    """Chance of a yes at any level [dB] by the curve assumed, which a staircase would follow to ``level``."""
    settled = 0.5 ** (1 / options.down)
    if options.reference is None:
        low, room = options.guess, 1 - options.guess - options.lapse
        share = min(max((settled - low) / room, 1e-3), 1 - 1e-3)
        threshold = level - 20 / options.slope * np.log10(-np.log1p(-share))
        return lambda at: float(low + room * -np.expm1(-(10 ** (options.slope * (at - threshold) / 20))))
    low, room = options.lapse, 1 - 2 * options.lapse
    middle = level - options.spread * float(ndtri(min(max((settled - low) / room, 1e-3), 1 - 1e-3)))
    return lambda at: float(low + room * ndtr((at - middle) / options.spread))
