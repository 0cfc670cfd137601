"""Reading scenarios: TOML, ``--set key=value`` overrides, and one clear sentence for what is wrong."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from datetime import date, time
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..errors import ScenarioError
from .meant import key_meant
from .model import Scenario
from .shipped import scenario_file, shipped_scenarios
from .toml import read_toml

_KIND = re.compile(r"(literal|tuple|list|dict|function-[a-z]+|constrained-[a-z]+)\[")  # of a union's members
DEEPEST = 12  # levels of tables and lists; a scenario's own keys need 5


def load_scenario(path: str | Path, *, overrides: Sequence[str] = ()) -> Scenario:
    """Scenario from a TOML file, or from one that comes with the program by its name, e.g. "thesis".

    ``overrides`` are ``key.path=value`` in TOML syntax. Files that a scenario names are seen from the folder of
    :func:`scenario_file`. Raises :class:`ScenarioError` for a missing or malformed file and for unknown or impossible
    keys.
    """
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
        limb = data.get("limb")
        shaped = {"limb": {"shape": "forearm", **limb}} if isinstance(limb, dict) else {}
        return Scenario.model_validate({**data, **shaped})
    except ValidationError as problem:
        raise ScenarioError(f"{origin}: {_first_problem(problem)}") from None


def scenario_schema() -> str:
    """JSON Schema of a scenario file, for editors."""
    return json.dumps(Scenario.model_json_schema(), indent=2)


def apply_overrides(data: Mapping[str, Any], overrides: Sequence[str], option: str = "--set") -> dict[str, Any]:
    """A copy of ``data`` with each ``key.path=value`` put in place; values are TOML, ".01", or plain strings.

    ScenarioError about the ``option`` where one is none.
    """
    result: dict[str, Any] = _copied(data)
    for item in overrides:
        key, separator, text = item.partition("=")
        if not separator or not key.strip():
            example = "device.spacing=0.040" if option == "--set" else "unit='mm/V'"
            raise ScenarioError(f"{option} expects key.path=value, got '{item}'; e.g. {option} \"{example}\"")
        path = key.strip().split(".")
        if len(path) > DEEPEST:
            raise ScenarioError(f"{option} {item}: the key has {len(path)} parts, expected at most {DEEPEST}")
        _put(result, path, _copied(_toml_value(text.strip())), f"{option} {item}")
    return result


def _copied(value: Any, depth: int = 0) -> Any:
    if depth > DEEPEST:
        raise ScenarioError(f"a table or list lies more than {DEEPEST} levels deep; no key of a scenario does")
    if isinstance(value, Mapping):
        return {key: _copied(inside, depth + 1) for key, inside in value.items()}
    return [_copied(inside, depth + 1) for inside in value] if isinstance(value, list) else value


def _put(data: dict[str, Any], path: list[str], value: Any, item: str) -> None:
    for key in path[:-1]:
        data = data.setdefault(key, {})
        if not isinstance(data, dict):
            raise ScenarioError(f"{item}: '{key}' is a value, not a table, so nothing can be set below it")
    data[path[-1]] = value


def _toml_value(text: str) -> Any:
    if re.fullmatch(r"[+-]?(\d+\.|\.\d+)(e[+-]?\d+)?", text.lower()):  # ".01" and "1.", which TOML has not
        return float(text)
    try:
        read = tomllib.loads(f"value = {text}")
        return read["value"] if len(read) == 1 else text
    except (ValueError, RecursionError):  # the first is also what numbers of thousands of digits raise
        return text


def _first_problem(problem: ValidationError) -> str:
    """One sentence: key path, what was expected, what came; unknown keys first, as they cause others."""
    errors = sorted(problem.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = next((e for e in errors if _key(e["loc"]).startswith(f"{_key(errors[0]['loc'])}.")), errors[0])
    where = _key(first["loc"])
    same = [e for e in errors if _key(e["loc"]) == where]  # a key of several kinds fails once for each of them
    more = f" (and {len(errors) - len(same)} more)" if len(errors) > len(same) else ""
    if first["type"] == "extra_forbidden":
        meant = key_meant(where, Scenario.model_json_schema())
        advice = f"did you mean {meant}?" if meant else "`forearm-fem schema` lists the known ones"
        return f"{where}: unknown key; {advice}{more}"
    came = first["input"]
    shown = "" if isinstance(came, Mapping) else f", got {_shown(came)}"
    said = dict.fromkeys(_sentence(e["msg"]) for e in same)
    message = ", or ".join(m if k == 0 else m.removeprefix("input should be ") for k, m in enumerate(said))
    return f"{where}{': ' if where else ''}{message}{shown}{more}"


def _sentence(message: str) -> str:
    said = message.removeprefix("Value error, ")
    return said[0].lower() + said[1:]


def _key(place: tuple[int | str, ...]) -> str:
    """The dotted key at a validator's ``place``, without the limb's shape and what the validator calls its kinds."""
    if place[:1] == ("limb",):
        place = (*place[:1], *place[2:])
    return ".".join(str(part) for part in place if not _KIND.match(str(part)))


def _shown(value: Any) -> str:
    """What came, as TOML would have it, at most 60 characters of it."""
    text = str(value) if isinstance(value, date | time) else repr(value)
    return text if len(text) <= 60 else f"{text[:40]} ... {text[-15:]}"
