"""Dotted names of the code, looked up; free of Sphinx, so that tests can look them up too."""

from __future__ import annotations

import importlib
from typing import Any


def found(name: str) -> Any:
    """The object of a dotted name; LookupError where there is none."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            thing: Any = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        for part in parts[end:]:
            fields = getattr(thing, "__dataclass_fields__", {}) | getattr(thing, "model_fields", {})
            if not hasattr(thing, part) and part not in fields:
                raise LookupError(f"{name}: nothing of that name")
            thing = getattr(thing, part, None)
        return thing
    raise LookupError(f"{name}: no such module")
