"""The design file: what may vary, what is to be large, and what must hold.

::

    name = "pitch"
    scenario = "thesis.toml"               # or a list of scenarios: several arms, one device
    set = { "grid.pitch" = 0.0133 }        # for every candidate
    [[variables]]                          # a range ...
    key = "device.spacing"
    low = 0.03
    high = 0.05
    [[variables]]                          # ... or choices
    key = "device.columns"
    values = [2, 3]
    [positions]                            # free places instead of rows
    count = [4, 9]
    x = [-0.03, 0.03]
    y = [-0.025, 0.025]
    mirrored = true                        # each with its images in both axes
    [objective]
    of = "mean"                            # or "least", "share" (of targets with S above 1)
    method = "inverse filter"
    targets = ["5"]
    [constraints]
    clearance = 0.009                      # [m] from a target to the nearest rim
    max_voltage = 2.5
    [search]
    candidates = 300
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from ...errors import ScenarioError, first_problem
from ...rendering.job import user_renderer
from ...rendering.limits import CLEARANCE
from ...scenario import Scenario, load_scenario, parse_scenario, scenario_beside
from ...scenario.actuators import ACTUATORS
from ...scenario.base import Name, Part, Within, dotted
from ...scenario.device import HeldHousing
from ...scenario.model import for_elements_only, read_toml
from ...scenario.rendering import Method
from ...scenario.text import DOTTED
from ...typing import BoolArray, FloatArray
from ...usercode import is_code

_HOUSING, _THESIS = "device.housing.mass", 12.5e-3  # kg of the thesis' actuator
_OBJECTIVE = {"rendering.methods": "objective.method", "rendering.targets": "objective.targets"}
_OF_ARM = (
    "device.contact_springs", "device.out_of_contact", "device.housing.strap", "device.housing.skin_share",
    "device.housing.fixed",
)  # fmt: skip
_TABLED = ("device.cone.radius", "device.cone.contact", "tissues", "limb", "sweep")
Values = dict[str, Any]
Span = tuple[float, float]


class Variable(Part):
    """One key: a range from ``low`` to ``high``, in steps where ``step`` is given, or a list of ``values``."""

    key: str = Field(description="dotted key of the scenario, e.g. device.spacing")
    low: float | None = None
    high: float | None = None
    step: Annotated[float, Within(1e-9, 1e9)] | None = None
    values: Annotated[tuple[Any, ...], Field(min_length=1, max_length=100)] | None = None

    @model_validator(mode="after")
    def _range_or_values(self) -> Self:
        if (self.values is None) == (self.low is None or self.high is None):
            raise ValueError(f"{self.key}: give low and high, or values")
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise ValueError(f"{self.key}: expected low < high, got {self.low:g} and {self.high:g}")
        return self

    @property
    def levels(self) -> tuple[Any, ...] | None:
        """The choices, of a range with steps its levels; None for a continuous one."""
        if self.values is not None:
            return self.values
        if self.step is None or self.low is None or self.high is None:
            return None
        count = int(np.floor((self.high - self.low) / self.step + 1e-9)) + 1
        return tuple(round(self.low + k * self.step, 12) for k in range(count))


class Positions(Part):
    """Free places of the contacts: ``count`` of them (least and most), anywhere in ``x`` and ``y`` [m].

    ``mirrored`` places come in fours, with their images in both axes; count is then a multiple of four, and x and y
    span one quadrant.
    """

    count: tuple[Annotated[int, Within(1, 24)], Annotated[int, Within(1, 24)]]
    x: Span
    y: Span
    mirrored: bool = False

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.count[0] > self.count[1]:
            raise ValueError(f"positions.count: expected [least, most], got {list(self.count)}")
        if self.mirrored and any(n % 4 for n in self.count):
            raise ValueError(f"positions.count: mirrored places come in fours, got {list(self.count)}")
        for axis in ("x", "y"):
            low, high = getattr(self, axis)
            if not low < high:
                raise ValueError(f"positions.{axis}: expected [low, high] in m, got [{low:g}, {high:g}]")
        return self

    @property
    def each(self) -> int:
        """Contacts that one place stands for."""
        return 4 if self.mirrored else 1


class Objective(Part):
    """Objective, to be large: S over the ``targets``, then over the scenarios."""

    of: Literal["mean", "least", "share"] = Field("mean", description="over targets; share: of those with S above 1")
    over: Literal["mean", "least"] = Field("mean", description="over the scenarios, if there are several")
    method: Method = "inverse filter"
    targets: Annotated[tuple[str, ...], Field(min_length=1)] | Literal["all"] = "all"


class Constraints(Part):
    """Constraints; a drive is meant at the amplitude that moves its target by ``target_peak``."""

    clearance: Annotated[float, Within(1e-6, 0.1, "m", zero=True)] = Field(
        CLEARANCE, description="least distance of an aimed-at point from any rim [m]: beside a motor S is no focus"
    )
    min_distance: Annotated[float, Within(1e-6, 0.3, "m", zero=True)] = Field(
        0.014, description="least distance of two contacts' centres [m]; the thesis' actuator is 14 mm across"
    )
    max_actuators: Annotated[int, Within(1, 100)] | None = None
    max_mass: Annotated[float, Within(1e-6, 10.0, "kg")] | None = Field(
        None, description="of actuators and shell [kg]: device.housing.mass, which follows the number of actuators "
        "unless set or a variable gives it",
    )  # fmt: skip
    actuator_mass: Annotated[float, Within(1e-6, 10.0, "kg")] | None = Field(
        None, description="of one actuator [kg]; left out: what its preset's source states, else the thesis' 12.5 g"
    )
    shell_mass: Annotated[float, Within(1e-6, 10.0, "kg", zero=True)] | None = Field(
        None, description="of the shell [kg]; left out: what the scenario's housing weighs beside its own actuators"
    )
    max_voltage: Annotated[float, Within(1e-9, 1e4, "V")] | None = Field(None, description="peak of any drive [V]")
    max_power: Annotated[float, Within(1e-12, 1e6, "W")] | None = Field(
        None, description="of any actuator, mean over the scenario's own record [W]"
    )
    target_peak: Annotated[float, Within(1e-9, 1e-2, "m")] = Field(1e-6, description="motion of the target [m]")


class Search(Part):
    """Length and start of the search: differential evolution over all variables, then Nelder-Mead over continuous
    ones."""

    candidates: Annotated[int, Within(1, 1_000_000)] = Field(300, description="of the global search")
    local: Annotated[int, Within(0, 100_000)] = Field(60, description="of the local search from the best")
    population: Annotated[int, Within(5, 1000)] = Field(20, description="of a generation")
    seed: Annotated[int, Within(0, 2**31 - 1)] = 0
    duration: Annotated[float, Within(0.02, 100.0, "s")] = Field(
        0.25, description="of the record while searching [s]; the confirmation takes the scenario's own"
    )


class DesignFile(Part):
    """A design file; see the module."""

    name: Name
    scenario: str | Annotated[tuple[str, ...], Field(min_length=1, max_length=100)]
    set: Annotated[Values, DOTTED] = Field(default_factory=dict)
    variables: tuple[Variable, ...] = ()
    positions: Positions | None = None
    objective: Objective = Objective()
    constraints: Constraints = Constraints()
    search: Search = Search()


@dataclass(frozen=True)
class Design:
    """A design file with its scenarios read; ``bases`` are the folders that files named in each are relative to."""

    asked: DesignFile
    bases: tuple[Path, ...]
    data: tuple[Mapping[str, Any], ...]

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Low and high ends (n,) of the search's coordinates, and which of them are whole numbers (n,)."""
        rows = list[tuple[float, float, bool]]()
        for v in self.asked.variables:
            if (levels := v.levels) is not None:
                rows.append((0.0, float(len(levels) - 1), True))
            elif v.low is not None and v.high is not None:  # as every range has
                rows.append((v.low, v.high, False))
        if (p := self.asked.positions) is not None:
            most = p.count[1] // p.each
            rows += [(p.count[0] / p.each, most, True)]
            rows += [(*axis, False) for _ in range(most) for axis in (p.x, p.y)]
        low, high, whole = (np.array(c, dtype=float) for c in zip(*rows, strict=True))
        return low, high, whole.astype(bool)

    def values(self, coordinates: FloatArray) -> Values:
        """Keys and values that the search's ``coordinates`` (n,) stand for, rounded to 1e-9."""
        found: Values = {}
        for variable, at in zip(self.asked.variables, coordinates, strict=False):
            levels = variable.levels
            found[variable.key] = round(float(at), 9) if levels is None else levels[round(at)]
        if (p := self.asked.positions) is not None:
            count, *places = coordinates[len(self.asked.variables) :]
            pairs = np.round(np.reshape(places, (-1, 2))[: round(count)], 9)
            signs = ((1, 1), (1, -1), (-1, 1), (-1, -1)) if p.mirrored else ((1, 1),)
            found["device.contacts"] = [[float(a * x), float(b * y)] for x, y in pairs for a, b in signs]
        return found

    def scenarios(self, values: Values) -> tuple[Scenario, ...]:
        """Each scenario with ``values`` in place; raises ScenarioError for what cannot be.

        Its housing weighs what its shell and its actuators do, unless the design gives ``device.housing.mass``.
        """
        aims = {"rendering.methods": [self.asked.objective.method]}
        given = {**self.asked.set, **values}
        found = list[Scenario]()
        for data in self.data:
            found.append(parse_scenario(data, changes={**dotted(given), **aims}))
        if _HOUSING in given:
            return tuple(found)
        return tuple(_weighed(s, own, self.asked.constraints) for s, own in zip(found, self._own, strict=True))

    @cached_property
    def method(self) -> str:
        """Name of the method, which a user's own class gives itself."""
        asked = self.asked.objective.method
        return user_renderer(asked, self._own[0]).name if is_code(asked) else asked

    @cached_property
    def _own(self) -> tuple[Scenario, ...]:
        """The scenarios as their files have them."""
        return tuple(parse_scenario(data) for data in self.data)


def _weighed(scenario: Scenario, own: Scenario, limits: Constraints) -> Scenario:
    """``scenario`` with the mass of its housing, by that of its file's ``own`` device."""
    shell, its = (getattr(s.device, "housing", HeldHousing()) for s in (scenario, own))
    if isinstance(shell, HeldHousing) or isinstance(its, HeldHousing):
        return scenario
    (count, each), (was, other) = (
        (len(s.device.centres), limits.actuator_mass or ACTUATORS[s.device.actuator].mass or _THESIS)
        for s in (scenario, own)
    )
    if limits.shell_mass is None and (count, each) == (was, other):
        return scenario
    bare = its.mass - was * other if limits.shell_mass is None else limits.shell_mass
    if bare < -1e-9:
        raise ScenarioError(
            f"device.housing.mass: {its.mass:g} kg is less than its {was} actuators of {other:g} kg; "
            "correct it, or give constraints.actuator_mass or constraints.shell_mass"
        )
    return scenario.changed({_HOUSING: round(bare + count * each, 9)})


def load_design(path: str | Path) -> Design:
    """Design from a TOML file, checked; raises ScenarioError in one sentence."""
    file = Path(path)
    asked = _parsed(file)
    if not asked.variables and asked.positions is None:
        raise ScenarioError(f"{file}: nothing varies; give at least one [[variables]] or [positions]")
    keys = [v.key for v in asked.variables] + (["device.contacts"] if asked.positions else [])
    if twice := sorted({k for k in keys if keys.count(k) > 1 or k in asked.set}):
        raise ScenarioError(f"{file}: {twice[0]} is given twice; name each key once, in variables or in set")
    for key in {*keys, *asked.set} & set(_OBJECTIVE):
        raise ScenarioError(f"{file}: {key}: {_OBJECTIVE[key]} alone says what is rendered; leave the key out")
    names = [asked.scenario] if isinstance(asked.scenario, str) else list(asked.scenario)
    sources = [scenario_beside(file.parent, name) for name in names]
    for source in sources:
        load_scenario(source)  # its own sentence for whatever is wrong with it
    data = tuple(read_toml(source, "no such file") for source in sources)
    for variable in asked.variables:
        if variable.levels is None and variable.key.startswith(_TABLED):
            raise ScenarioError(
                f"{file}: {variable.key}: give step or values, for each of its values takes tables of its own"
            )
    design = Design(asked, tuple(source.parent for source in sources), data)
    _check(file, design)
    return design


def _parsed(file: Path) -> DesignFile:
    try:
        return DesignFile.model_validate(read_toml(file, "no such design file"))
    except ValidationError as problem:
        first = sorted(problem.errors(), key=lambda e: e["type"] != "extra_forbidden")[0]
        key = ".".join(map(str, first["loc"]))
        if first["type"] == "extra_forbidden":
            tables: Mapping[str, type[Part]] = {
                "constraints": Constraints, "objective": Objective, "search": Search, "positions": Positions,
                "variables": Variable,
            }  # fmt: skip
            table = tables.get(str(first["loc"][0]), DesignFile) if len(first["loc"]) > 1 else DesignFile
            known = ", ".join(table.model_fields)
            raise ScenarioError(f"{file}: {key}: unknown key; known are {known}") from None
        raise ScenarioError(f"{file}: {first_problem(problem, 'design')}") from None


def _check(file: Path, design: Design) -> None:
    """Keys that exist, targets that the grid has, at a candidate in the middle of everything."""
    low, high, whole = design.bounds
    middle = np.where(whole, np.floor((low + high) / 2), (low + high) / 2)
    seen = list[Scenario]()
    for at in (middle, low, high):
        try:
            scenarios = design.scenarios(design.values(at))
        except ScenarioError as problem:
            raise ScenarioError(f"{file}: {str(problem).removeprefix('scenario: ')}") from None
        _check_alike(file, scenarios)
        seen += scenarios
    for variable in design.asked.variables:
        if for_elements_only(variable.key) or variable.key in ("name", "description", "engine"):
            raise ScenarioError(
                f"{file}: {variable.key}: no candidate changes with it, for no mesh is made for them; vary another key"
            )
    if any(s.grid.direction == "vertical" for s in scenarios):
        raise ScenarioError(f"{file}: grid.direction: candidates are judged by normal motion; set it to 'normal'")
    points = {str(k + 1) for k in range(len(scenarios[0].grid.places))}
    targets = design.asked.objective.targets
    if targets != "all" and (unknown := sorted(set(targets) - points)):
        raise ScenarioError(f"{file}: objective.targets names point {unknown[0]}, but the grid has 1..{len(points)}")
    if targets != "all" and len(set(targets)) < len(targets):
        raise ScenarioError(f"{file}: objective.targets names a point twice: {', '.join(targets)}; name each once")


def _check_alike(file: Path, scenarios: Sequence[Scenario]) -> None:
    """ScenarioError unless all arms get one device, its limits included, and the same points; how each arm touches and
    holds it may differ."""
    first, *others = (dotted({"device": s.device.model_dump(), "grid": s.grid.model_dump()}) for s in scenarios)
    for other in others:
        differ = sorted(key for key in {*first, *other} if first.get(key) != other.get(key))
        if differ := [key for key in differ if not key.startswith(_OF_ARM)]:
            raise ScenarioError(
                f"{file}: {differ[0]} is not alike in the scenarios, and one device with one grid is designed for all "
                "of them; give the key in set, or make their files agree"
            )
