"""A study file, checked before anyone sits down, and the order of tasks and trials that follows from it.

Orders are balanced over participants by their place in the study, and seeded.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, model_validator

from ..errors import ScenarioError, first_problem
from ..scenario.base import NonNegative, Part, Positive, is_folder_name
from ..scenario.model import read_toml

Answer = Literal["one point", "several points"]
Phase = Literal["training", "main"]
Method = Literal["inverse filter", "funneling", "combination"]
_METHODS: tuple[Method, ...] = ("inverse filter", "funneling", "combination")
_LABEL = r"^[A-Za-z0-9][A-Za-z0-9-]{0,31}$"
MEASURES = {
    "error": "distance of the answer from the target (eq. 10)",
    "precision": "scatter of a participant's answers about their own mean, rms",
    "points": "points chosen",
}
_TRIES = 2000  # an order of 27 trials without repeats is met in one of about 20 shuffles
T = TypeVar("T")


def _label(name: str) -> str:
    if re.fullmatch(_LABEL, name) and is_folder_name(name):
        return name
    raise ValueError("expected at most 32 letters, digits and hyphens, the first no hyphen, and no device of Windows")


Name = Annotated[str, AfterValidator(_label), Field(json_schema_extra={"pattern": _LABEL})]


class Task(Part):
    """One kind of trial: what is asked, how often, in which blocks."""

    name: Name = Field(description="letters, digits and hyphens; becomes task-NAME in file names")
    answer: Answer = Field(default="one point", description="what the participant gives")
    repetitions: Annotated[int, Field(ge=1, le=100)] = Field(default=3, description="of each method at each target")
    blocks: Annotated[int, Field(ge=1, le=100)] = Field(
        default=3, description="with a break between; divides repetitions, so that each block holds everything equally"
    )
    training: Annotated[int, Field(ge=0, le=100)] = Field(
        default=1, description="repetitions of everything before, answered alike and left out of the analysis"
    )
    break_seconds: NonNegative = Field(default=60.0, description="least length of a break [s]")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.repetitions % self.blocks:
            raise ValueError(
                f"blocks {self.blocks} does not divide repetitions {self.repetitions}, so blocks would differ; "
                "take blocks = 1 or a divisor"
            )
        return self

    @property
    def measures(self) -> tuple[str, ...]:
        """Measures of its answers, the task's own first; one repetition has no scatter."""
        own = ("points",) if self.answer == "several points" else ()
        return (*own, "error", *(("precision",) if self.repetitions > 1 else ()))


class Order(Part):
    """Order of trials and tasks; balanced over participants by their place in the study."""

    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="with place and task: the same order")
    methods: Literal["mixed", "one after the other"] = Field(
        default="mixed",
        description="within a block; one after the other: each order of methods equally often over participants, and "
        "another one in each block and task",
    )
    tasks: Literal["fixed", "balanced"] = Field(
        default="fixed", description="fixed: as listed for everybody; balanced: over participants"
    )
    no_target_twice: bool = Field(default=True, description="in a row")


class Stimuli(Part):
    """Stimuli: methods, targets and levels."""

    methods: tuple[Method, ...] = Field(
        default=_METHODS, min_length=1, description="renderers compared; the participant never learns which"
    )
    targets: tuple[str, ...] = Field(
        default=tuple(str(k) for k in range(1, 10)), min_length=1, description="names of grid points"
    )
    levels: Literal["equal at target", "as rendered"] | dict[Method, dict[str, float]] | str = Field(
        default="equal at target",
        description="'equal at target': the same receptor-weighted level at every target; 'as rendered'; a table "
        "{method = {target = dB}} or a CSV (method, target, level_db[, participant]) of what is added to equal",
    )
    peak: Positive | None = Field(
        default=None, description="of equal levels: that of the wavelet with this peak [um]; none: rendering.amplitude"
    )
    drive: Positive | None = Field(
        default=None, description="of equal levels, instead of `peak`: the strongest drive of all stimuli [V]"
    )
    repeats: Annotated[int, Field(ge=1, le=100)] = Field(default=1, description="wavelets per stimulus")
    pause: NonNegative = Field(default=0.3, description="between wavelets [s]")
    lead: Positive = Field(default=0.05, description="of each signal kept before the wavelet's centre [s]")
    tail: Positive = Field(default=0.15, description="and after [s]")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        for what, given in (("methods", self.methods), ("targets", self.targets)):
            if len(set(given)) != len(given):
                raise ValueError(f"{what} names one twice: {', '.join(given)}")
        if self.levels == "as rendered" and (self.peak or self.drive):
            raise ValueError("levels = 'as rendered' takes neither peak nor drive; take equal levels or leave them out")
        if self.peak and self.drive:
            raise ValueError("peak and drive both say how strong equal levels are; give one")
        if isinstance(self.levels, dict):
            for method in self.methods:
                if lacking := [t for t in self.targets if t not in self.levels.get(method, {})]:
                    raise ValueError(f"levels: no dB for {method} at target {lacking[0]}; name every method and target")
        return self


class Analysis(Part):
    """Tests of the answers; chosen here, before there are any, and kept with them."""

    correction: Literal["holm", "bonferroni"] = Field(default="holm", description="within each table of comparisons")
    sphericity: Literal["Greenhouse-Geisser", "Huynh-Feldt"] = Field(
        default="Greenhouse-Geisser", description="correction of degrees of freedom"
    )
    alpha: Annotated[float, Field(gt=0, lt=0.5)] = Field(default=0.05, description="level of significance")
    measures: tuple[Literal["error", "precision", "points"], ...] = Field(
        default=(), description="tested in each task that has them; empty: all that the answers give"
    )

    @property
    def digest(self) -> str:
        """First 12 digits of its SHA-256."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:12]


class Study(Part):
    """A study: identification and confidence by default, as in de Vlam 2022, section V."""

    name: Name = Field(description="letters, digits and hyphens")
    scenario: str = Field(description="of the device: a file seen from the study file, or the name of a shipped one")
    transfer: str = Field(
        default="calibration/{participant}/transfer.nc",
        description="each participant's G, relative to the study file; {participant} is replaced",
    )
    participants: Annotated[int, Field(ge=1, le=1000)] = Field(default=20, description="planned")
    stimuli: Stimuli = Stimuli()
    order: Order = Order()
    tasks: tuple[Task, ...] = Field(
        default=(Task(name="identification"), Task(name="confidence", answer="several points")), min_length=1,
        description="run in this order, or balanced",
    )  # fmt: skip
    analysis: Analysis = Analysis()
    consent: str | None = Field(
        default=None, description="text file shown before the first sitting, to be agreed to; none: signed on paper"
    )
    beep: bool = Field(default=True, description="a short tone on the page just before each stimulus")
    language: str = Field(default="en", description="of the participant's page: en, de, nl, or a TOML file of texts")

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        names = [t.name for t in self.tasks]
        if len(set(names)) != len(names):
            raise ValueError(f"tasks has one name twice: {', '.join(names)}")
        for task in self.tasks:
            many = len(self.stimuli.methods) * (task.repetitions + task.training) > 1
            if many and self.order.no_target_twice and len(self.stimuli.targets) == 1:
                raise ValueError(
                    f"order.no_target_twice cannot be met in task {task.name} with one target; add targets or set it "
                    "to false"
                )
        return self

    def task(self, name: str) -> Task:
        """The task called ``name``; ScenarioError if there is none."""
        for task in self.tasks:
            if task.name == name:
                return task
        raise ScenarioError(f"task '{name}' is not in the study; it has {', '.join(t.name for t in self.tasks)}")

    def measures(self, task: Task) -> tuple[str, ...]:
        """Measures that the plan tests of a task."""
        return tuple(m for m in task.measures if not self.analysis.measures or m in self.analysis.measures)


def load_study(path: str | Path) -> Study:
    """The study in a TOML file; ScenarioError in one sentence for whatever is wrong with it."""
    file = Path(path)
    try:
        return Study.model_validate(read_toml(file, "no such study file; `forearm-fem study new NAME` writes one"))
    except ValidationError as problem:
        raise ScenarioError(f"{file}: {first_problem(problem, 'study')}") from None


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
