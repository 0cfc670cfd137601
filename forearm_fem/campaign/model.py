"""The campaign file: a base scenario, and which of its keys vary how.

::

    name = "spacings"
    scenario = "thesis.toml"          # relative to this file
    stage = "render"                  # or "solve", "run" (with figures and report)
    set = { accuracy = 0.1 }          # for every member
    [grid]                            # every combination
    "device.spacing" = [0.035, 0.045]
    "tissues.preset" = ["default", "thesis"]
    [[members]]                       # single variants, beside the grid
    name = "wide"
    set = { "device.spacing" = 0.06 }
    [draw]                            # log-normal draws with the spreads of the preset's tissues
    count = 20
    seed = 1
    parameters = ["skin.mu", "fat.mu", "muscle.eta"]
"""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from ..errors import ScenarioError, first_problem
from ..scenario import Scenario, load_scenario, scenario_beside
from ..scenario.base import Name, Part
from ..scenario.changes import dotted
from ..scenario.limb import tissue_keys
from ..scenario.load import DOTTED
from ..scenario.toml import read_toml
from ..tissue import PRESETS, KelvinVoigt, Sourced, resolve_tissues

_LONGEST_NAME = 100  # letters that a folder's name may have
Values = dict[str, Any]
Settings = Annotated[Values, DOTTED]


class MemberTable(Part):
    """A single variant."""

    name: Name
    set: Settings = Field(default_factory=dict)


class DrawTable(Part):
    """Random tissues: each parameter is the scenario's value times spread^z, z standard normal, all independent, with
    the spreads of its preset."""

    count: Annotated[int, Field(ge=1, le=100_000)]
    seed: int = 0
    parameters: tuple[str, ...] | None = Field(None, description="tissue.key; default: mu and eta of all soft tissues")


class CampaignFile(Part):
    """A campaign file; see the module."""

    name: Name
    scenario: str = Field(description="scenario file, relative to the campaign file")
    stage: Literal["solve", "render", "run"] = "render"
    set: Settings = Field(default_factory=dict, description="overrides for every member")
    grid: Annotated[dict[str, Annotated[list[Any], Field(min_length=1)]], DOTTED] = Field(default_factory=dict)
    members: tuple[MemberTable, ...] = ()
    draw: DrawTable | None = None


@dataclass(frozen=True)
class Member:
    """A variant: its ``values`` by dotted key, and the scenario they give."""

    name: str
    values: Mapping[str, Any]
    scenario: Scenario


@dataclass(frozen=True)
class Campaign:
    """All members; ``base`` is the folder that files named in the scenario are relative to."""

    name: str
    stage: Literal["solve", "render", "run"]
    base: Path
    members: tuple[Member, ...]


def load_campaign(path: str | Path) -> Campaign:
    """Campaign from a TOML file, every member's scenario checked; raises ScenarioError in one sentence."""
    file = Path(path)
    try:
        asked = CampaignFile.model_validate(read_toml(file, "no such campaign file"))
    except ValidationError as problem:
        known = ", ".join(CampaignFile.model_fields)
        raise ScenarioError(f"{file}: {first_problem(problem, 'campaign')}; known keys are {known}") from None
    if "name" in {*asked.set, *asked.grid, *(key for member in asked.members for key in member.set)}:
        raise ScenarioError(f"{file}: name: a scenario is called by its member; leave the key out of set and grid")
    if twice := sorted(set(asked.set) & set(asked.grid)):
        raise ScenarioError(f"{file}: {twice[0]} is given twice, in set and in grid; name each key once")
    source = scenario_beside(file.parent, asked.scenario)
    preset = load_scenario(source, overrides=[_override(*item) for item in asked.set.items()])
    variants = list(_variants(asked, preset))
    names = [name for name, _ in variants]
    if twice := sorted({n for n in names if names.count(n) > 1}):
        raise ScenarioError(f"{file}: members are called {', '.join(twice)} twice; give each its own name")
    members = []
    for name, values in variants:
        merged = {**asked.set, **dotted(values), "name": name}
        try:
            scenario = load_scenario(source, overrides=[_override(*item) for item in merged.items()])
        except ScenarioError as problem:
            raise ScenarioError(f"member {name}: {problem}") from None
        members.append(Member(name, values, scenario))
    return Campaign(asked.name, asked.stage, source.parent, tuple(members))


def _variants(asked: CampaignFile, preset: Scenario) -> Iterator[tuple[str, Values]]:
    keys = list(asked.grid)
    for combination in itertools.product(*asked.grid.values()) if keys else ():
        values = dict(zip(keys, combination, strict=True))
        yield grid_name(values), values
    for member in asked.members:
        yield member.name, dict(member.set)
    if asked.draw is not None:
        width = len(str(asked.draw.count - 1))
        for k, values in enumerate(draws(preset, asked.draw)):
            yield f"draw-{k:0{width}d}", values
    if not keys and not asked.members and asked.draw is None:
        yield asked.name, {}


def grid_name(values: Mapping[str, Any]) -> str:
    """A folder name that says what varies: last part of each key and its value; a long one is cut and marked."""
    plain = {key: f"{value:.12g}" if isinstance(value, float) else value for key, value in values.items()}
    parts = [f"{key.rpartition('.')[2]}-{value}" for key, value in plain.items()]
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", "_".join(parts)).strip("-.")
    if len(name) <= _LONGEST_NAME:
        return name
    mark = hashlib.sha256("_".join(parts).encode()).hexdigest()[:8]
    return f"{name[: _LONGEST_NAME - 9].rstrip('-.')}-{mark}"


def draws(scenario: Scenario, table: DrawTable) -> Iterator[Values]:
    """Overrides of each draw; draw k is the same however many are asked for (one generator, row by row).

    Raises :class:`ScenarioError` for what no spread is known of, such as the laws of bounded damping, whose parameters
    go together.
    """
    known = _drawable(scenario)
    wanted = table.parameters or tuple(k for k in known if k.endswith((".mu", ".eta")))
    if bad := [k for k in wanted if k not in known]:
        raise ScenarioError(
            f"draw.parameters: no spread is known of '{bad[0]}'; known are {', '.join(known) or 'none'}"
        )
    if not table.parameters and (joint := _drawn_jointly(scenario)):
        raise ScenarioError(
            f"draw: {joint[0]} has a law whose parameters go together, so that they are not drawn one by one; take "
            "`forearm-fem predict`, which draws them jointly, or name draw.parameters of other tissues"
        )
    spread = {key: known[key] for key in wanted}
    random = np.random.default_rng(table.seed)
    for _ in range(table.count):
        z = random.standard_normal(len(spread))
        yield {f"tissues.override.{key}": s.draw(float(v)) for (key, s), v in zip(spread.items(), z, strict=True)}


def _drawable(scenario: Scenario) -> dict[str, Sourced]:
    """What may be drawn, about the scenario's own value, by "tissue.key": of tissues with Kelvin-Voigt's law that the
    preset has a spread of."""
    tissues, found = resolve_tissues(scenario), dict[str, Sourced]()
    for name, record in PRESETS[scenario.tissues.preset].items():
        modulus = tissues[name].modulus
        if record.model != "kelvin-voigt" or not isinstance(modulus, KelvinVoigt):
            continue
        own = {"density": tissues[name].density, "mu": modulus.mu, "eta": modulus.eta}
        for key, sourced in record.parameters.items():
            if sourced.spread > 1:
                found[f"{name}.{key}"] = replace(sourced, value=own[key])
    return found


def _drawn_jointly(scenario: Scenario) -> list[str]:
    """Soft tissues of the limb with another law than Kelvin-Voigt's."""
    tissues = resolve_tissues(scenario)
    met = dict.fromkeys(tissue_keys(scenario.limb).values())
    return [n for n in met if n != "bone" and not isinstance(tissues[n].modulus, KelvinVoigt)]


def _override(key: str, value: Any) -> str:
    return f"{key}={_toml(value)}"


def _toml(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, Mapping):
        return "{" + ", ".join(f'"{k}" = {_toml(v)}' for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return repr(value)
