"""Changing tables by dotted key, and making a checked part of what comes out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from ..errors import ScenarioError
from .problem import first_problem_of, idle_keys_of

DEEPEST = 12  # levels of tables and lists; a scenario's own keys need 5
T = TypeVar("T")


def remade(kind: TypeAdapter[T], data: Mapping[str, Any], changes: Mapping[str, Any], origin: str, said: str = "") -> T:
    """A checked part from ``data`` with ``changes`` by dotted key; None leaves a key out.

    Keys of ``data`` that the changes leave without effect fall away: ``spacing`` where ``contacts`` are set. Keys among
    the changes never do. ``said`` stands before a key that cannot be set.
    """
    table: dict[str, Any] = copied(data)
    for key, value in changes.items():
        put(table, key, value, f"{said}{key}")
    while True:
        try:
            return kind.validate_python(table)
        except ValidationError as problem:
            left = [k for k in idle_keys_of(problem) if not any(_overlap(k, asked) for asked in changes)]
            if not (left and changes):
                raise ScenarioError(f"{origin}: {first_problem_of(problem, kind.json_schema())}") from None
            for key in left:
                put(table, key, None, key)


def _overlap(key: str, other: str) -> bool:
    """Whether one of two dotted keys is the other, or lies below it."""
    return f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.")


def put(data: dict[str, Any], key: str, value: Any, said: str) -> None:
    """Set the dotted ``key`` of ``data`` to ``value``; ScenarioError, about what was ``said``, where it cannot be.

    None takes the key out. A number in the key is an index into a list.
    """
    path = key.split(".")
    if len(path) > DEEPEST:
        raise ScenarioError(f"{said}: the key has {len(path)} parts, expected at most {DEEPEST}")
    table: Any = data
    for name in path[:-1]:
        at: Any = _index(table, name, said) if isinstance(table, list) else name
        below = table[at] if isinstance(table, list) else table.setdefault(name, {})
        if isinstance(below, BaseModel | tuple):
            below = copied(below.model_dump(exclude_unset=True) if isinstance(below, BaseModel) else below)
        table[at], table = below, below
        if not isinstance(table, dict | list):
            raise ScenarioError(f"{said}: '{name}' is a value, not a table, so nothing can be set below it")
    if isinstance(table, list):
        table[_index(table, path[-1], said)] = copied(value)
    elif value is None:
        table.pop(path[-1], None)
    else:
        table[path[-1]] = copied(value)


def _index(values: list[Any], name: str, said: str) -> int:
    if name.isdecimal() and int(name) < len(values):
        return int(name)
    raise ScenarioError(f"{said}: expected a place in a list of {len(values)}, 0 to {len(values) - 1}, got '{name}'")


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


def copied(value: Any, depth: int = 0) -> Any:
    """Tables and lists of ``value`` anew; ScenarioError where they lie deeper than any scenario's."""
    if depth > DEEPEST:
        raise ScenarioError(f"a table or list lies more than {DEEPEST} levels deep; no key of a scenario does")
    if isinstance(value, BaseModel):  # all that it says, defaults included
        return copied(value.model_dump(), depth)
    if isinstance(value, Mapping):
        return {key: copied(inside, depth + 1) for key, inside in value.items()}
    return [copied(inside, depth + 1) for inside in value] if isinstance(value, list | tuple) else value


def as_given(made: BaseModel, given: Mapping[str, Any]) -> None:
    """Forget keys set in ``made`` that are not among the ``given``: an actuator's preset, a limb's length."""
    for name in set(made.model_fields_set):
        below = getattr(made, name)
        if name not in given:
            made.model_fields_set.discard(name)
        elif isinstance(below, BaseModel) and isinstance(given[name], Mapping):
            as_given(below, given[name])


def changed_keys(part: BaseModel, usual: BaseModel | None, path: str = "") -> Iterator[str]:
    """Dotted keys of ``part`` whose values are not those of ``usual``, None: of its kind; a list counts as one key."""
    for name, field in type(part).model_fields.items():
        value = getattr(part, name)
        other = field.get_default(call_default_factory=True) if usual is None else getattr(usual, name, None)
        if isinstance(value, BaseModel):
            yield from changed_keys(value, other, f"{path}{name}.")
        elif value != other:
            yield f"{path}{name}"
