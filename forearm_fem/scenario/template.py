"""A commented scenario to start from: every key with its default and meaning, ready to be uncommented."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from .base import Part, kinds_of
from .model import Scenario

_WIDE = 100  # characters up to which a meaning stands beside its key


def scenario_template(name: str, limb: Mapping[str, Any] | None = None) -> str:
    """Text of a TOML file that is valid as it stands, with every key but ``name`` and those of ``limb`` commented out.

    Uncommenting all keys that show a value gives the default scenario again; keys without a value are those that are
    left to the program. Not covered: shapes other than the forearm, and tables with names of the user's own, which have
    a line each.
    """
    head = [
        f"# {name}: a scenario of forearm_fem. Every key is optional: what stands behind # is its default.",
        "# SI units. `forearm-fem schema` prints the same for editors; the manual explains each key.",
        "schema_version = 2",
        f"name = {json.dumps(name)}",
    ]
    lines = [*head, *_table(Scenario(), "", ("schema_version", "name"))]
    place = lines.index("[limb]") + 1
    lines[place:place] = [f"{key} = {_toml(value)}" for key, value in (limb or {}).items()]
    return "\n".join(lines) + "\n"


def _table(part: Part, path: str, left_out: tuple[str, ...] = (), kinds: tuple[type[Part], ...] = ()) -> Iterator[str]:
    """Lines of a part's own keys, then of those that its other ``kinds`` have instead, then of the tables below it."""
    deeper = []
    for key, field in type(part).model_fields.items():
        value = getattr(part, key)
        if key in left_out:
            continue
        if isinstance(value, Part):
            limb = key == "limb"  # whose shapes have a page of their own
            deeper.append((f"{path}.{key}".lstrip("."), value, () if limb else kinds_of(field.annotation)))
            continue
        meaning = field.description or ""
        line = f"# {key} =" if value is None or value == {} else f"# {key} = {_toml(value)}"
        if len(line) + len(meaning) < _WIDE:
            yield f"{line}  # {meaning}"
        else:
            yield from (f"## {meaning}", line)
    others = {key: field for kind in kinds for key, field in kind.model_fields.items()}
    for key, field in others.items():
        if key not in type(part).model_fields and not kinds_of(field.annotation):
            yield from (f"## another kind: {field.description}", f"# {key} =")
    for name, below, other in deeper:
        yield from ("", f"[{name}]", *_table(below, name, kinds=other))


def _toml(value: Any) -> str:
    """``value`` as TOML writes it in one line."""
    if isinstance(value, BaseModel):
        return _toml({k: v for k, v in value.model_dump().items() if v is not None})
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)
