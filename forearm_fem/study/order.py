"""The order of trials and tasks: balanced over participants by their place in the study, and seeded."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Literal, TypeVar

import numpy as np

from ..errors import ScenarioError
from .plan import Study, Task

Phase = Literal["training", "main"]
_TRIES = 2000  # an order of 27 trials without repeats is met in one of about 20 shuffles
T = TypeVar("T")


@dataclass(frozen=True)
class Trial:
    """One presentation: ``number`` from 1 within its task, ``block`` from 1 (0 in training)."""

    number: int
    phase: Phase
    block: int
    method: str
    target: str
    repetition: int


def balanced(items: tuple[T, ...], row: int) -> tuple[T, ...]:
    """Row ``row`` of a Williams square of ``items``, repeated without end.

    Over n rows (2 n for odd n) each item stands equally often at each position and follows each other one equally
    often (Williams 1949).
    """
    n = len(items)
    first = [(k + 1) // 2 if k % 2 else -(k // 2) for k in range(n)]  # 0, 1, -1, 2, -2, ...
    half, shift = divmod(row % (n if n % 2 == 0 else 2 * n), n)
    turned = tuple(items[(k + shift) % n] for k in first)
    return turned[::-1] if half else turned


def tasks_of(study: Study, place: int) -> tuple[Task, ...]:
    """The tasks in the order in which the participant of that ``place`` (from 1) does them."""
    return study.tasks if study.order.tasks == "fixed" else balanced(study.tasks, place - 1)


def trials(study: Study, task: Task, place: int) -> tuple[Trial, ...]:
    """All trials of a task for the participant of that ``place`` (from 1), training first; always the same.

    Each block holds every method at every target equally often. Raises ScenarioError where that cannot be.
    """
    text = f"{study.name}/{task.name}/{place}/{study.order.seed}"
    rng = np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little"))
    per_block = task.repetitions // task.blocks
    plan: list[tuple[Phase, int, int]] = [("training", 0, r) for r in range(1, task.training + 1)]
    plan += [("main", b + 1, b * per_block + r) for b in range(task.blocks) for r in range(1, per_block + 1)]
    begun = sum(t.blocks for t in study.tasks[: study.tasks.index(task)])  # blocks of the tasks before, as listed
    found: list[Trial] = []
    for phase, block, repetition in plan:
        last = found[-1].target if found else None
        methods = balanced(study.stimuli.methods, place - 1 + begun + max(block - 1, 0))
        for method, target in _shuffled(study, methods, rng, last):
            found.append(Trial(len(found) + 1, phase, block, method, target, repetition))
    return tuple(found)


def _shuffled(
    study: Study, methods: tuple[str, ...], rng: np.random.Generator, last: str | None
) -> list[tuple[str, str]]:
    """Every method at every target once, in an order that the study allows after target ``last``."""
    pairs, rule = list(product(methods, study.stimuli.targets)), study.order
    for _ in range(_TRIES):
        order = [pairs[i] for i in rng.permutation(len(pairs))]
        if rule.methods == "one after the other":
            order.sort(key=lambda pair: methods.index(pair[0]))
        if not rule.no_target_twice or all(a != b for a, b in pairwise([last, *(t for _, t in order)])):
            return order
    raise ScenarioError(
        f"order.no_target_twice cannot be met with {len(study.stimuli.targets)} target(s) and {len(methods)} "
        "method(s); add targets or set it to false"
    )
