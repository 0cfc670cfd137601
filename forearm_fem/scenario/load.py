"""Reading scenarios: TOML, ``--set key=value`` overrides, and one clear sentence for what is wrong."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BeforeValidator, ValidationError

from ..errors import ScenarioError
from .model import Scenario
from .problem import first_problem_of
from .shipped import scenario_file, shipped_scenarios
from .toml import read_toml

DOTTED = BeforeValidator(lambda values: dotted(values) if isinstance(values, Mapping) else values)
DEEPEST = 12  # levels of tables and lists; a scenario's own keys need 5


def load_scenario(path: str | Path, *, overrides: Sequence[str] = ()) -> Scenario:
    """Scenario from a TOML file, or from one that comes with the program by its name, e.g. "thesis".

    ``overrides`` are ``key.path=value`` in TOML syntax. Files that a scenario names are seen from the folder of
    :func:`scenario_file`. Raises :class:`ScenarioError` for a missing or malformed file and for unknown or impossible
    keys.
    """
    if not isinstance(path, str | Path):
        raise ScenarioError(
            f"expected a scenario's file or name, got a {type(path).__name__}; parse_scenario takes tables"
        )
    file = scenario_file(path)
    table = read_toml(file, f"no such file; by name there are {', '.join(shipped_scenarios())}")
    if "scenario" in table:
        raise ScenarioError(
            f"{file}: names a scenario, so it is a file for `forearm-fem design`, `campaign` or `study`; give it to "
            "that command, or give the scenario here"
        )
    return parse_scenario(apply_overrides(table, overrides), origin=str(file))


def parse_scenario(data: Mapping[str, Any], *, origin: str = "scenario") -> Scenario:
    """Scenario from plain data; see :func:`load_scenario` for the errors."""
    try:
        return Scenario.model_validate(dict(data))
    except ValidationError as problem:
        raise ScenarioError(f"{origin}: {first_problem_of(problem, Scenario.model_json_schema())}") from None


def scenario_schema() -> str:
    """JSON Schema of a scenario file, for editors."""
    return json.dumps(Scenario.model_json_schema(), indent=2)


def apply_overrides(data: Mapping[str, Any], overrides: Sequence[str], option: str = "--set") -> dict[str, Any]:
    """A copy of ``data`` with each ``key.path=value`` put in place; values are TOML, ".01", or plain strings.

    ScenarioError about the ``option`` where one is none.
    """
    if isinstance(overrides, str):  # whose letters would be taken for overrides
        raise ScenarioError(f"overrides: expected a list of texts, got the text '{overrides}'; put it into brackets")
    result: dict[str, Any] = _copied(data)
    for item in overrides:
        key, separator, text = item.partition("=")
        if not separator or not key.strip():
            example = "device.spacing=0.040" if option == "--set" else "unit='mm/V'"
            raise ScenarioError(f"{option} expects key.path=value, got '{item}'; e.g. {option} \"{example}\"")
        put(result, key.strip(), _toml_value(text.strip()), f"{option} {item}")
    return result


def put(data: dict[str, Any], key: str, value: Any, said: str) -> None:
    """Set the dotted ``key`` of ``data`` to ``value``; ScenarioError, about what was ``said``, where it cannot be."""
    path = key.split(".")
    if len(path) > DEEPEST:
        raise ScenarioError(f"{said}: the key has {len(path)} parts, expected at most {DEEPEST}")
    table = data
    for name in path[:-1]:
        table = table.setdefault(name, {})
        if not isinstance(table, dict):
            raise ScenarioError(f"{said}: '{name}' is a value, not a table, so nothing can be set below it")
    table[path[-1]] = _copied(value)


def dotted(values: Mapping[str, Any]) -> dict[str, Any]:
    """``values`` by dotted key, where tables stand among them: TOML makes those of keys without quotes, and they are
    meant to change what they name and to leave the rest of a scenario's table.

    A table that names its ``shape`` is another limb and stays whole, as do empty ones and those of names with dots.
    """
    found: dict[str, Any] = {}
    for key, value in values.items():
        whole = not isinstance(value, Mapping) or not value or "shape" in value or any("." in name for name in value)
        found |= {key: value} if whole else {f"{key}.{name}": v for name, v in dotted(value).items()}
    return found


def _copied(value: Any, depth: int = 0) -> Any:
    if depth > DEEPEST:
        raise ScenarioError(f"a table or list lies more than {DEEPEST} levels deep; no key of a scenario does")
    if isinstance(value, Mapping):
        return {key: _copied(inside, depth + 1) for key, inside in value.items()}
    return [_copied(inside, depth + 1) for inside in value] if isinstance(value, list) else value


def _toml_value(text: str) -> Any:
    if re.fullmatch(r"[+-]?(\d+\.|\.\d+)(e[+-]?\d+)?", text.lower()):  # ".01" and "1.", which TOML has not
        return float(text)
    try:
        read = tomllib.loads(f"value = {text}")
        return read["value"] if len(read) == 1 else text
    except (ValueError, RecursionError):  # the first is also what numbers of thousands of digits raise
        return text
