"""Levels from answers, one track per method and target: QUEST+ (Watson 2017, package ``questplus``) or a staircase.

A detection track looks for the level that is felt; a strength track for the one that feels as strong as the reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..errors import optional
from .order import Trial
from .plan import Adaptive, Task

_SETTLING = 2  # reversals of a staircase that are left out of its mean
_FEWEST = 4  # reversals kept, for a mean with a deviation


@dataclass(frozen=True)
class Threshold:
    """Level [dB] and its standard ``deviation`` after so many ``trials``; NaN where they are too few to tell."""

    method: str
    target: str
    level: float
    deviation: float
    trials: int


class _Levels(Protocol):
    def next(self) -> float: ...
    def update(self, level: float, yes: bool) -> None: ...
    def estimate(self) -> tuple[float, float, int]: ...


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
            found.append(Threshold(method, target, level, deviation, trials))
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
        return float(self._quest.next_stim["intensity"])

    def update(self, level: float, yes: bool) -> None:
        self._quest.update(stim={"intensity": level}, outcome={"response": "Yes" if yes else "No"})

    def estimate(self) -> tuple[float, float, int]:
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
        self._last, self._count = 0, 0

    def next(self) -> float:
        return self._level

    def update(self, level: float, yes: bool) -> None:
        self._count += 1
        self._run = self._run + 1 if yes else 0
        step = -1 if self._run == self._options.down else 0 if yes else 1
        if step == 0:
            return
        if self._last and step != self._last:
            self._turns.append(level)
        self._last, self._run = step, 0
        self._level = min(max(level + step * self._options.step, self._options.low), self._options.high)

    def estimate(self) -> tuple[float, float, int]:
        """Mean of the levels at reversals, an even number of them, and its standard error."""
        kept = self._turns[_SETTLING + (len(self._turns) - _SETTLING) % 2 :]
        if len(kept) < _FEWEST:
            return float("nan"), float("nan"), self._count
        return float(np.mean(kept)), float(np.std(kept, ddof=1) / np.sqrt(len(kept))), self._count
