"""Which key was meant by one that is unknown: the same name in another table, or a name that is spelt much alike."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from typing import Any

_ALIKE = 0.8  # of difflib's ratio: one or two letters of ten


def key_meant(key: str, schema: dict[str, Any]) -> str | None:
    """The dotted key of the JSON ``schema`` that ``key`` was most likely to be; None where none is like it."""
    known = dict.fromkeys(_keys(schema, schema.get("$defs", {})))
    table, _, name = key.rpartition(".")
    namesakes = [k for k in known if k.rpartition(".")[2] == name]
    if namesakes:
        return (get_close_matches(key, namesakes, 1, 0.0) or namesakes)[0]
    beside = {k.rpartition(".")[2]: k for k in known if k.rpartition(".")[0] == table}
    alike = get_close_matches(name, beside, 1, _ALIKE)
    return beside[alike[0]] if alike else None


def _keys(part: dict[str, Any], tables: dict[str, Any], path: str = "") -> Iterator[str]:
    """Dotted keys below ``part``, of all shapes that it may have; names in mappings are the user's own."""
    if "$ref" in part:
        yield from _keys(tables[part["$ref"].rpartition("/")[2]], tables, path)
    for one in (*part.get("oneOf", ()), *part.get("anyOf", ())):
        yield from _keys(one, tables, path)
    for name, entry in part.get("properties", {}).items():
        where = f"{path}.{name}" if path else name
        yield where
        yield from _keys(entry, tables, where)
