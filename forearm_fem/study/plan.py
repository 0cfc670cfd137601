"""A study file: tasks, stimuli, order, analysis and participants, checked before anyone sits down."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from ..errors import ScenarioError, first_problem
from ..scenario.base import NonNegative, Part, Positive, is_folder_name
from ..scenario.shipped import read_toml

Answer = Literal["one point", "several points", "drawing"]
Method = Literal["inverse filter", "funneling", "combination"]
_METHODS: tuple[Method, ...] = ("inverse filter", "funneling", "combination")
_LABEL = r"^[A-Za-z0-9][A-Za-z0-9-]{0,31}$"
MEASURES = {
    "error": "distance of the answer from the target (eq. 10)",
    "precision": "scatter of a participant's answers about their own mean, rms",
    "points": "points chosen",
    "response_area": "area drawn",
}
_OF_ANSWER: dict[Answer, tuple[str, ...]] = {
    "one point": ("error", "precision"), "several points": ("points", "error", "precision"),
    "drawing": ("response_area", "error", "precision"),
}  # fmt: skip


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
    answer_seconds: Positive | None = Field(
        default=None, description="an answer later than this is recorded and marked late [s]; none: no limit"
    )

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
        return tuple(m for m in _OF_ANSWER[self.answer] if m != "precision" or self.repetitions > 1)


class Order(Part):
    """How trials and tasks are ordered; balanced over participants by their place in the study."""

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
    """What is rendered, and how strong."""

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
    """How answers are tested; chosen here, before there are any, and kept with them."""

    correction: Literal["holm", "bonferroni"] = Field(default="holm", description="within each table of comparisons")
    sphericity: Literal["Greenhouse-Geisser", "Huynh-Feldt"] = Field(
        default="Greenhouse-Geisser", description="correction of degrees of freedom"
    )
    alpha: Annotated[float, Field(gt=0, lt=0.5)] = Field(default=0.05, description="level of significance")
    measures: tuple[Literal["error", "precision", "points", "response_area"], ...] = Field(
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
