"""The order of trials: seeded, balanced over blocks, and without the same target twice in a row."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Literal

import numpy as np

from ..errors import ScenarioError
from .plan import Study, Task

Phase = Literal["training", "main"]
Interval = Literal["first", "second"]
_INTERVALS: tuple[Interval, Interval] = ("first", "second")
_TRIES = 2000  # an order of 27 trials without repeats is met in one of about 20 shuffles


@dataclass(frozen=True)
class Trial:
    """One presentation: ``number`` from 1 within its task, ``block`` from 1 (0 in training), ``level`` [dB].

    ``comparison`` is the interval, "first" or "second", that holds method and level where the other holds a reference.
    """

    number: int
    phase: Phase
    block: int
    method: str
    target: str
    repetition: int
    level: float = 0.0
    comparison: Interval | None = None


def trials(study: Study, task: Task, participant: str) -> tuple[Trial, ...]:
    """All trials of a task for a participant, training first; the same for the same seed, participant and task.

    Each block holds every method at every target equally often. Raises ScenarioError where that cannot be.
    """
    if task.adaptive is not None:
        return _adaptive_trials(study, task, participant)
    rng = _generator(study, task, participant)
    per_block = task.repetitions // task.blocks
    plan: list[tuple[Phase, int, int]] = [("training", 0, r) for r in range(1, task.training + 1)]
    plan += [("main", b + 1, b * per_block + r) for b in range(task.blocks) for r in range(1, per_block + 1)]
    found: list[Trial] = []
    for phase, block, repetition in plan:
        last = found[-1].target if found else None
        for method, target in _shuffled(study, participant, rng, last):
            found.append(Trial(len(found) + 1, phase, block, method, target, repetition))
    return tuple(found)


def _shuffled(study: Study, participant: str, rng: np.random.Generator, last: str | None) -> list[tuple[str, str]]:
    """Every method at every target once, in an order that the study allows after target ``last``."""
    stimuli, rule = study.stimuli, study.order
    pairs, methods = list(product(stimuli.methods, stimuli.targets)), stimuli.methods
    # balanced: participants 1, 2, 3 ... start with another method each, every second round reversed
    digits = "".join(c for c in participant if c.isdigit())
    index = int(digits) - 1 if digits else int(hashlib.sha256(participant.encode()).hexdigest(), 16)
    turned = [methods[(index + k) % len(methods)] for k in range(len(methods))]
    rank = {m: k for k, m in enumerate(turned[::-1] if (index // len(methods)) % 2 else turned)}
    for _ in range(_TRIES):
        order = [pairs[i] for i in rng.permutation(len(pairs))]
        if rule.methods == "one after the other":
            order.sort(key=lambda pair: rank[pair[0]])
        if not rule.no_target_twice or all(a != b for a, b in pairwise([last, *(t for _, t in order)])):
            return order
    raise ScenarioError(
        f"order.no_target_twice cannot be met with {len(stimuli.targets)} target(s) and {len(stimuli.methods)} "
        "method(s); add targets or set it to false"
    )


def _adaptive_trials(study: Study, task: Task, participant: str) -> tuple[Trial, ...]:
    """Interleaved tracks, one per method and target; levels are chosen from the answers as they come."""
    assert task.adaptive is not None
    rng = _generator(study, task, participant)
    found: list[Trial] = []
    pairs = list(product(study.stimuli.methods, study.stimuli.targets))
    for repetition in range(1, task.adaptive.trials + 1):
        for i in rng.permutation(len(pairs)):
            method, target = pairs[i]
            interval = None if task.adaptive.reference is None else _INTERVALS[int(rng.integers(2))]
            found.append(Trial(len(found) + 1, "main", 1, method, target, repetition, float("nan"), interval))
    return tuple(found)


def _generator(study: Study, task: Task, participant: str) -> np.random.Generator:
    text = f"{study.name}/{task.name}/{participant}/{study.order.seed}"
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little"))
