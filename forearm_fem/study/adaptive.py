"""Detection thresholds by QUEST+ (Watson 2017), one track per method and target, through the package ``questplus``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import MissingExtra
from .order import Trial
from .plan import Adaptive, Task


@dataclass(frozen=True)
class Threshold:
    """Level [dB] at which a stimulus is felt: posterior mean and standard deviation over so many ``trials``."""

    method: str
    target: str
    level: float
    deviation: float
    trials: int


class Track:
    """Tracks of a task; built anew from the answers on disk, so that a session goes on as if it had not stopped."""

    def __init__(self, options: Adaptive) -> None:
        self._options = options
        self._tracks: dict[tuple[str, str], Any] = {}

    @classmethod
    def of(cls, task: Task, answered: Sequence[dict[str, str]]) -> Track | None:
        """The tracks after what was ``answered`` already; None for a task without levels."""
        if task.adaptive is None:
            return None
        track = cls(task.adaptive)
        for row in answered:
            track._update((row["method"], row["target"]), float(row["level"]), row["response"] == "yes")
        return track

    def next(self, trial: Trial) -> float:
        """The level [dB] that tells most about the trial's threshold."""
        return float(self._of((trial.method, trial.target)).next_stim["intensity"])

    def update(self, trial: Trial, level: float, felt: bool) -> None:
        """Take an answer into account."""
        self._update((trial.method, trial.target), level, felt)

    def thresholds(self) -> tuple[Threshold, ...]:
        """Posterior mean and deviation of every track that has an answer."""
        found = []
        for (method, target), quest in self._tracks.items():
            density = quest.marginal_posterior["threshold"]
            levels = np.asarray(quest.param_domain["threshold"], dtype=float)
            mean = float(np.sum(density * levels))
            spread = float(np.sqrt(np.sum(density * (levels - mean) ** 2)))
            found.append(Threshold(method, target, mean, spread, len(quest.resp_history)))
        return tuple(found)

    def _update(self, key: tuple[str, str], level: float, felt: bool) -> None:
        self._of(key).update(stim={"intensity": level}, outcome={"response": "Yes" if felt else "No"})

    def _of(self, key: tuple[str, str]) -> Any:
        if key not in self._tracks:
            self._tracks[key] = _quest(self._options)
        return self._tracks[key]


def _quest(options: Adaptive) -> Any:
    try:
        from questplus import QuestPlus
    except ImportError:
        raise MissingExtra("questplus", "study", "adaptive thresholds") from None
    levels = np.arange(options.low, options.high + options.step / 2, options.step)
    return QuestPlus(
        stim_domain={"intensity": levels},
        param_domain={"threshold": levels, "slope": options.slope, "lower_asymptote": options.guess,
                      "lapse_rate": options.lapse},
        outcome_domain={"response": ["Yes", "No"]},
        func="weibull", stim_scale="dB", stim_selection_method="min_entropy", param_estimation_method="mean",
    )  # fmt: skip
