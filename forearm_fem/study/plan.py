"""A study file: tasks, stimuli, order and participants, checked before anyone sits down."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from ..errors import ScenarioError, first_problem
from ..scenario.base import NonNegative, Part, Positive, is_folder_name
from ..scenario.toml import read_toml

Answer = Literal["one point", "several points", "drawing", "yes or no", "first or second"]
Method = Literal["inverse filter", "funneling", "combination"]
_METHODS: tuple[Method, ...] = ("inverse filter", "funneling", "combination")
_LABEL = r"^[A-Za-z0-9][A-Za-z0-9-]{0,31}$"


def _label(name: str) -> str:
    if re.fullmatch(_LABEL, name) and is_folder_name(name):
        return name
    raise ValueError("expected at most 32 letters, digits and hyphens, the first no hyphen, and no device of Windows")


Name = Annotated[str, AfterValidator(_label), Field(json_schema_extra={"pattern": _LABEL})]


class Level(Part):
    """How strong stimuli are."""

    rule: Literal["as rendered", "target peak", "drive peak"] = Field(
        default="as rendered",
        description="as the scenario's renderers make them, or scaled so that the target's or the strongest drive's "
        "peak is `value`",
    )
    value: Positive | None = Field(default=None, description="peak at the target [um] or of a drive [V]")

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.rule == "as rendered") != (self.value is None):
            raise ValueError("rule 'as rendered' takes no value; 'target peak' [um] and 'drive peak' [V] need one")
        return self


class Adaptive(Part):
    """Levels chosen from the answers: of the least that is felt, or of the one that feels as strong as a reference."""

    rule: Literal["QUEST+", "staircase"] = Field(
        default="QUEST+", description="QUEST+: the level that tells most; staircase: up after no, down after `down` yes"
    )
    reference: Method | None = Field(
        default=None,
        description="for answer = 'first or second': each trial plays this method too, at the same target and 0 dB, "
        "and asks which felt stronger",
    )
    low: float = Field(default=-40.0, description="lowest level [dB re the stimulus' own level]")
    high: float = Field(default=0.0, description="highest level [dB]")
    step: Positive = Field(default=2.0, description="between levels [dB]")
    down: Annotated[int, Field(ge=1, le=4)] = Field(
        default=2,
        description="staircase: yes in a row before the level falls; 1, 2, 3 settle at 50, 71, 79 % (Levitt 1971)",
    )
    slope: Positive = Field(default=3.5, description="Weibull slope assumed")
    spread: Positive = Field(
        default=3.0, description="standard deviation assumed of which feels stronger [dB], for 'first or second'"
    )
    lapse: Annotated[float, Field(ge=0, lt=0.5)] = Field(default=0.02, description="share of answers without regard")
    guess: Annotated[float, Field(ge=0, lt=1)] = Field(default=0.05, description="share of yes without a stimulus")
    trials: Annotated[int, Field(ge=5, le=500)] = Field(default=40, description="per method and target")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.high - self.low < 2 * self.step:
            raise ValueError(
                f"low {self.low:g} to high {self.high:g} dB holds fewer than three levels {self.step:g} dB apart"
            )
        return self


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
    answer_seconds: Positive | None = Field(
        default=None, description="an answer later than this is recorded and marked late [s]; none: no limit"
    )
    adaptive: Adaptive | None = Field(
        default=None, description="for answers 'yes or no' (detection) and 'first or second' (strength): levels"
    )

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.repetitions % self.blocks:
            raise ValueError(
                f"blocks {self.blocks} does not divide repetitions {self.repetitions}, so blocks would differ; "
                "take blocks = 1 or a divisor"
            )
        levels = self.answer in ("yes or no", "first or second")
        if levels != (self.adaptive is not None):
            raise ValueError(
                "answers 'yes or no' and 'first or second' and a table `adaptive` go together; give both or neither"
            )
        if self.adaptive is not None and (self.answer == "first or second") != (self.adaptive.reference is not None):
            raise ValueError("answer 'first or second' and adaptive.reference go together; give both or neither")
        return self


class Order(Part):
    """How trials are shuffled."""

    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="with the participant and task: the same order")
    methods: Literal["mixed", "one after the other"] = Field(
        default="mixed", description="within a block; one after the other: their order balanced over participants"
    )
    no_target_twice: bool = Field(default=True, description="in a row")


class Stimuli(Part):
    """What is rendered."""

    methods: tuple[Method, ...] = Field(
        default=_METHODS, min_length=1, description="renderers compared; the participant never learns which"
    )
    targets: tuple[str, ...] = Field(
        default=tuple(str(k) for k in range(1, 10)), min_length=1, description="names of grid points"
    )
    level: Level = Level()
    repeats: Annotated[int, Field(ge=1, le=100)] = Field(default=1, description="wavelets per stimulus")
    pause: NonNegative = Field(default=0.3, description="between wavelets, and between two that are compared [s]")
    lead: Positive = Field(default=0.05, description="of each signal kept before the wavelet's centre [s]")
    tail: Positive = Field(default=0.15, description="and after [s]")

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        for what, given in (("methods", self.methods), ("targets", self.targets)):
            if len(set(given)) != len(given):
                raise ValueError(f"{what} names one twice: {', '.join(given)}")
        return self


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
        description="in the order in which they are run",
    )  # fmt: skip
    beep: bool = Field(default=True, description="a short tone on the page just before each stimulus")
    language: str = Field(default="en", description="of the participant's page: en, de, nl, or a TOML file of texts")

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        names = [t.name for t in self.tasks]
        if len(set(names)) != len(names):
            raise ValueError(f"tasks has one name twice: {', '.join(names)}")
        for task in self.tasks:
            many = len(self.stimuli.methods) * (task.repetitions + task.training) > 1
            if task.adaptive is None and many and self.order.no_target_twice and len(self.stimuli.targets) == 1:
                raise ValueError(
                    f"order.no_target_twice cannot be met in task {task.name} with one target; add targets or set it "
                    "to false"
                )
            if task.adaptive and task.adaptive.reference not in (None, *self.stimuli.methods):
                raise ValueError(f"adaptive.reference '{task.adaptive.reference}' is not among stimuli.methods")
        return self

    def task(self, name: str) -> Task:
        """The task called ``name``; ScenarioError if there is none."""
        for task in self.tasks:
            if task.name == name:
                return task
        raise ScenarioError(f"task '{name}' is not in the study; it has {', '.join(t.name for t in self.tasks)}")


def load_study(path: str | Path) -> Study:
    """The study in a TOML file; ScenarioError in one sentence for whatever is wrong with it."""
    file = Path(path)
    try:
        return Study.model_validate(read_toml(file, "no such study file; `forearm-fem study new NAME` writes one"))
    except ValidationError as problem:
        raise ScenarioError(f"{file}: {first_problem(problem, 'study')}") from None
