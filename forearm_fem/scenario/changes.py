"""Tables of a scenario: changed by dotted key, checked, and what is wrong with one in a sentence."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from datetime import date, time
from difflib import get_close_matches
from typing import Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from ..errors import ScenarioError, in_tomls_words

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
    """True if one of two dotted keys is the other, or lies below it."""
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


_ALIKE = 0.8  # of difflib's ratio: one or two letters of ten
_KIND = re.compile(r"as |(literal|tuple|list|dict|function-[a-z]+|constrained-[a-z]+)\[")  # of a union's members


def first_problem_of(problem: ValidationError, schema: dict[str, Any]) -> str:
    """One sentence: key path, what was expected, what came; unknown keys first, as they cause others.

    ``schema`` is the JSON Schema of what was validated, for the key that an unknown one was meant to be.
    """
    errors = sorted(problem.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = next((e for e in errors if _key(e["loc"]).startswith(f"{_key(errors[0]['loc'])}.")), errors[0])
    where = _key(first["loc"])
    if first["type"] == "choice":
        return f"{first['ctx']['key']}: {first['msg']}"
    if first["type"] == "idle":
        return f"{', '.join(_idle_keys(first))}: {first['msg']}"
    same = [e for e in errors if _key(e["loc"]) == where]  # a key of several kinds fails once for each of them
    more = f" (and {len(errors) - len(same)} more)" if len(errors) > len(same) else ""
    if first["type"] == "extra_forbidden":
        meant = key_meant(where, schema)
        if meant == where:  # known, and yet not here: of another shape, as when --set changes the shape alone
            return f"{where}: has no meaning where limb.shape is '{first['loc'][1]}'; leave it out{more}"
        advice = f"did you mean {meant}?" if meant else "`forearm-fem schema` lists the known ones"
        return f"{where}: unknown key; {advice}{more}"
    came = first["input"]
    as_toml = str(came) if isinstance(came, date | time) else repr(came)
    shown = "" if isinstance(came, Mapping) else f", got {_shortened(as_toml)}"
    if isinstance(came, str) and {e["type"] for e in same} <= {"tuple_type", "list_type"}:
        # what was meant: a list of a single text, or one whose quotes a shell ate
        listed = json.dumps([item.strip() for item in came.strip("[] ").split(",")])
        shown += f"; write {_shortened(listed)}, in a shell between single quotes"
    words = (in_tomls_words(e["msg"].removeprefix("Value error, ")) for e in same)
    said = dict.fromkeys(w[0].lower() + w[1:] for w in words)
    message = ", or ".join(m if k == 0 else m.removeprefix("input should be ") for k, m in enumerate(said))
    return f"{where}{': ' if where else ''}{message}{shown}{more}"


def idle_keys_of(problem: ValidationError) -> list[str]:
    """Dotted keys that were refused for having no effect."""
    return [key for error in problem.errors() if error["type"] == "idle" for key in _idle_keys(error)]


def _idle_keys(error: Mapping[str, Any]) -> list[str]:
    table = _key(error["loc"])
    return [f"{table}.{key}" if table else key for key in error["ctx"]["keys"]]


def _key(place: tuple[int | str, ...]) -> str:
    """The dotted key at a validator's ``place``, without the limb's shape and what the validator calls its kinds."""
    if place[:1] == ("limb",):
        place = (*place[:1], *place[2:])
    return ".".join(str(part) for part in place if not _KIND.match(str(part)))


def _shortened(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:40]} ... {text[-15:]}"


def key_meant(key: str, schema: dict[str, Any]) -> str | None:
    """The dotted key of the JSON ``schema`` that ``key`` was most likely to be; None where none is like it."""
    known = dict.fromkeys(keys_of(schema))
    table, _, name = key.rpartition(".")
    if table.startswith("tissues.override.") and name == "model":  # so called before version 1.0
        return f"{table}.law"
    namesakes = [k for k in known if k.rpartition(".")[2] == name]
    if namesakes:
        return (get_close_matches(key, namesakes, 1, 0.0) or namesakes)[0]
    beside = {k.rpartition(".")[2]: k for k in known if k.rpartition(".")[0] == table}
    alike = get_close_matches(name, beside, 1, _ALIKE)
    if not alike and table == "tissues":  # a tissue's values, written one table too high
        return f"tissues.override.{name}"
    return beside[alike[0]] if alike else None


def units_of(
    part: Mapping[str, Any], tables: Mapping[str, Any] | None = None, path: str = ""
) -> Iterator[tuple[str, str]]:
    """Dotted keys of numbers below a JSON schema and their units; "*" stands for names of the user's own."""
    tables = part.get("$defs", {}) if tables is None else tables
    if "unit" in part:
        yield path, part["unit"]
    if "$ref" in part:
        yield from units_of(tables[part["$ref"].rpartition("/")[2]], tables, path)
    for one in (*part.get("oneOf", ()), *part.get("anyOf", ()), *part.get("allOf", ())):
        yield from units_of(one, tables, path)
    for name, entry in part.get("properties", {}).items():
        yield from units_of(entry, tables, f"{path}.{name}" if path else name)
    if isinstance(part.get("additionalProperties"), dict):
        yield from units_of(part["additionalProperties"], tables, f"{path}.*")


def keys_of(part: Mapping[str, Any], tables: Mapping[str, Any] | None = None, path: str = "") -> Iterator[str]:
    """Dotted keys below ``part``, of all shapes that it may have; names in mappings are the user's own."""
    tables = part.get("$defs", {}) if tables is None else tables
    if "$ref" in part:
        yield from keys_of(tables[part["$ref"].rpartition("/")[2]], tables, path)
    for one in (*part.get("oneOf", ()), *part.get("anyOf", ())):
        yield from keys_of(one, tables, path)
    for name, entry in part.get("properties", {}).items():
        where = f"{path}.{name}" if path else name
        yield where
        yield from keys_of(entry, tables, where)
