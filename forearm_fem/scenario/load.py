"""Reading scenarios: TOML, ``--set key=value`` overrides, and one clear sentence for what is wrong."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from datetime import date, time
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..errors import ScenarioError
from .model import Scenario

DEEPEST = 12  # levels of tables and lists; a scenario's own keys need 5


def load_scenario(path: str | Path, *, overrides: Sequence[str] = ()) -> Scenario:
    """Scenario from a TOML file, with ``key.path=value`` overrides in TOML syntax.

    Raises :class:`ScenarioError` for a missing or malformed file and for unknown or impossible keys.
    """
    file = Path(path)
    return parse_scenario(apply_overrides(_read_toml(file), overrides), origin=str(file))


def parse_scenario(data: Mapping[str, Any], *, origin: str = "scenario") -> Scenario:
    """Scenario from plain data; see :func:`load_scenario` for the errors."""
    try:
        return Scenario.model_validate(_with_default_shape(data))
    except ValidationError as problem:
        raise ScenarioError(f"{origin}: {_first_problem(problem)}") from None


def scenario_schema() -> str:
    """JSON Schema of a scenario file, for editors."""
    return json.dumps(Scenario.model_json_schema(), indent=2)


def apply_overrides(data: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """A copy of ``data`` with each ``key.path=value`` put in place; values are TOML, else plain strings."""
    result: dict[str, Any] = _copied(data)
    for item in overrides:
        key, separator, text = item.partition("=")
        if not separator or not key.strip():
            raise ScenarioError(f"--set expects key.path=value, got '{item}'; e.g. --set device.spacing=0.040")
        path = key.strip().split(".")
        if len(path) > DEEPEST:
            raise ScenarioError(f"--set {item}: the key has {len(path)} parts, expected at most {DEEPEST}")
        _put(result, path, _copied(_toml_value(text.strip())), item)
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
            raise ScenarioError(f"--set {item}: '{key}' is a value, not a table, so nothing can be set below it")
    data[path[-1]] = value


def _toml_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):  # the first is also what numbers of thousands of digits raise
        return text


def _read_toml(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ScenarioError(f"{file}: no such file; name a scenario such as scenarios/thesis.toml") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise ScenarioError(f"{file}: cannot be read as a text file ({problem})") from None
    except RecursionError:
        raise ScenarioError(f"{file}: not valid TOML: nested too deeply") from None
    except tomllib.TOMLDecodeError as problem:
        raise ScenarioError(f"{file}: not valid TOML: {problem}") from None
    except ValueError:  # Python reads no more
        raise ScenarioError(f"{file}: a number has more than 4300 digits") from None


def _with_default_shape(data: Mapping[str, Any]) -> dict[str, Any]:
    """A [limb] table without a shape is a forearm."""
    limb = data.get("limb")
    return {**data, "limb": {"shape": "forearm", **limb}} if isinstance(limb, dict) else dict(data)


def _first_problem(problem: ValidationError) -> str:
    """One sentence: key path, what was expected, what came; unknown keys first, as they cause others."""
    errors = sorted(problem.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = errors[0]
    where = ".".join(str(p) for p in first["loc"] if p not in _UNION_TAGS)
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    if first["type"] == "extra_forbidden":
        return f"{where}: unknown key; `forearm-fem schema` lists the known ones{more}"
    came = first["input"]
    shown = "" if isinstance(came, Mapping) else f", got {_shown(came)}"
    message = first["msg"].removeprefix("Value error, ")
    return f"{where}{': ' if where else ''}{message[0].lower() + message[1:]}{shown}{more}"


def _shown(value: Any) -> str:
    """What came, as TOML would have it, at most 60 characters of it."""
    text = str(value) if isinstance(value, date | time) else repr(value)
    return text if len(text) <= 60 else f"{text[:40]} ... {text[-15:]}"


_UNION_TAGS = frozenset({"forearm", "slab", "cylinder", "surfaces", "mesh_limb"})
