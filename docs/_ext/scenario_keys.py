"""The directive ``scenario-keys``: every key of a scenario from its JSON Schema, one table per part of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

from forearm_fem.scenario import scenario_schema

_LOG = logging.getLogger(__name__)
_COLUMNS = (("key", 22), ("type and range", 22), ("default", 14), ("meaning", 42))


@dataclass(frozen=True)
class Key:
    """One key of a scenario: its path, what it takes, what it is where left out, and what it means."""

    path: str
    takes: str
    default: str
    meaning: str


@dataclass(frozen=True)
class Table:
    """One part of a scenario: the path of its table, its sentence, and the keys that hold a value."""

    path: str
    meaning: str
    keys: tuple[Key, ...]


def tables() -> Iterator[Table]:
    """Every part of a scenario, the file's top level first; alternatives of [limb] one after another."""
    schema = json.loads(scenario_schema())
    yield from _walk(schema, schema["$defs"], "")


def _walk(part: dict[str, Any], known: dict[str, Any], path: str) -> Iterator[Table]:
    values, deeper = [], []
    for name, entry in part["properties"].items():
        where = f"{path}.{name}" if path else name
        parts = list(_parts(entry, known))
        deeper += [(where + suffix, one) for suffix, one in parts]
        if not parts or _of_many(entry):
            values.append(Key(where, _takes(entry, known), _default(entry, name in part.get("required", ())),
                              entry.get("description", "")))  # fmt: skip
    yield Table(path, part.get("description", ""), tuple(values))
    for where, one in deeper:
        yield from _walk(one, known, where)


def _all_kinds(kinds: list[dict[str, Any]]) -> dict[str, Any]:
    """One part with the keys of all its ``kinds``; a value that tells them apart has all their values."""
    keys: dict[str, Any] = {}
    for kind in kinds:
        for name, entry in kind["properties"].items():
            before = keys.get(name, entry)
            told = [e["const"] for e in (before, entry) if "const" in e]
            values = list(dict.fromkeys([*before.get("enum", ()), *told]))
            keys[name] = {**before, "enum": values} if told and len(values) > 1 else before
            if "enum" in keys[name]:
                keys[name].pop("const", None)
    said = " ".join(kind.get("description", "").partition("\n")[0] for kind in kinds)
    note = "Kinds, told apart by their keys; one that would have no effect beside others is refused in a sentence."
    return {"properties": keys, "description": f"{note} {said}", "required": []}


def _of_many(entry: dict[str, Any]) -> bool:
    return entry.get("type") in ("array", "object")


def _parts(entry: dict[str, Any], known: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Tables below a key: itself, the alternatives it may be, the items of a list, the values of a mapping."""
    if "discriminator" in entry:
        for one in entry["oneOf"]:
            found = known[one["$ref"].rpartition("/")[2]]
            shape = found["properties"][entry["discriminator"]["propertyName"]]["const"]
            yield f" (shape = {shape!r})".replace("'", '"'), found
    elif "$ref" in entry:
        found = known[entry["$ref"].rpartition("/")[2]]
        if "properties" in found:
            yield "", found
    elif "oneOf" in entry:
        kinds = [known[one["$ref"].rpartition("/")[2]] for one in entry["oneOf"]]
        if all("properties" in kind for kind in kinds):
            yield "", _all_kinds(kinds)
    elif isinstance(entry.get("items"), dict):
        yield from ((f"[ ]{s}", p) for s, p in _parts(entry["items"], known))
    elif isinstance(entry.get("additionalProperties"), dict):
        yield from ((f".NAME{s}", p) for s, p in _parts(entry["additionalProperties"], known))


def _takes(entry: dict[str, Any], known: dict[str, Any]) -> str:
    if "const" in entry:
        return json.dumps(entry["const"])
    if "enum" in entry:
        return ", ".join(json.dumps(v) for v in entry["enum"])
    if "$ref" in entry:
        found = known[entry["$ref"].rpartition("/")[2]]
        return "a table" if "properties" in found else _takes(found, known)
    if "anyOf" in entry or "oneOf" in entry:
        kinds = [_takes(one, known) for one in entry.get("anyOf", entry.get("oneOf")) if one.get("type") != "null"]
        return " or ".join(dict.fromkeys(kinds))
    if entry.get("type") == "array":
        items = entry.get("prefixItems") or [entry.get("items", {})]
        inside = ", ".join(_takes(i, known) for i in items)
        return f"({inside})" if "prefixItems" in entry else f"list of {inside}"
    if entry.get("type") == "object":
        values = entry.get("additionalProperties")
        return f"table of {_takes(values, known)}" if isinstance(values, dict) else "a table"
    return entry.get("type", "anything") + _range(entry)


def _range(entry: dict[str, Any]) -> str:
    signs = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    bounds = [f"{sign} {entry[name]:g}" for name, sign in signs.items() if name in entry]
    return " " + ", ".join(bounds) if bounds else ""


def _default(entry: dict[str, Any], required: bool) -> str:
    if required:
        return "required"
    value = entry.get("default")
    if value is None:
        return "none"
    text = json.dumps(value)
    return text if len(text) < 60 else "see below" if isinstance(value, list) else "a table"


class ScenarioKeys(SphinxDirective):
    """Sections with a table each."""

    def run(self) -> list[nodes.Node]:
        """One section per part; a key without a description is a warning, so an error of the build."""
        made: list[nodes.Node] = []
        for table in tables():
            if not table.keys:
                continue
            for key in table.keys:
                if not key.meaning:
                    _LOG.warning("scenario key %s has no description", key.path, location=self.get_location())
            made.append(self._section(table))
        return made

    def _section(self, table: Table) -> nodes.section:
        title = f"[{table.path}]" if table.path else "Top level"
        section = nodes.section(ids=[nodes.make_id(f"keys-{table.path or 'top'}")])
        section += nodes.title("", title)
        self.state.document.note_implicit_target(section, section)
        if table.meaning:
            section += nodes.paragraph("", " ".join(table.meaning.replace("``", "").split()))
        section += _table([(k.path.rpartition(".")[2], k.takes, k.default, k.meaning) for k in table.keys])
        return section


def _table(rows: list[tuple[str, str, str, str]]) -> nodes.table:
    group = nodes.tgroup(cols=len(_COLUMNS))
    group += [nodes.colspec(colwidth=width) for _, width in _COLUMNS]
    group += nodes.thead("", _row([nodes.paragraph("", name) for name, _ in _COLUMNS]))
    body = nodes.tbody()
    for key, takes, default, meaning in rows:
        cells = [nodes.literal("", key), nodes.inline("", takes), nodes.literal("", default), nodes.inline("", meaning)]
        body += _row([nodes.paragraph("", "", cell) for cell in cells])
    group += body
    return nodes.table("", group)


def _row(cells: list[nodes.paragraph]) -> nodes.row:
    return nodes.row("", *(nodes.entry("", cell) for cell in cells))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("scenario-keys", ScenarioKeys)
    return {"parallel_read_safe": True}
