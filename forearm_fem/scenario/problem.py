"""What is wrong with a scenario or a part of one, in a sentence."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import date, time
from typing import Any

from pydantic import ValidationError

from ..errors import in_tomls_words
from .meant import key_meant

_KIND = re.compile(r"(literal|tuple|list|dict|function-[a-z]+|constrained-[a-z]+)\[")  # of a union's members


def first_problem_of(problem: ValidationError, schema: dict[str, Any]) -> str:
    """One sentence: key path, what was expected, what came; unknown keys first, as they cause others.

    ``schema`` is the JSON Schema of what was validated, for the key that an unknown one was meant to be.
    """
    errors = sorted(problem.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = next((e for e in errors if _key(e["loc"]).startswith(f"{_key(errors[0]['loc'])}.")), errors[0])
    where = _key(first["loc"])
    same = [e for e in errors if _key(e["loc"]) == where]  # a key of several kinds fails once for each of them
    more = f" (and {len(errors) - len(same)} more)" if len(errors) > len(same) else ""
    if first["type"] == "extra_forbidden":
        meant = key_meant(where, schema)
        advice = f"did you mean {meant}?" if meant else "`forearm-fem schema` lists the known ones"
        return f"{where}: unknown key; {advice}{more}"
    came = first["input"]
    shown = "" if isinstance(came, Mapping) else f", got {_shown(came)}"
    if isinstance(came, str) and {e["type"] for e in same} <= {"tuple_type", "list_type"}:
        shown += f"; write {_as_list(came)}, in a shell between single quotes"
    said = dict.fromkeys(_sentence(e["msg"]) for e in same)
    message = ", or ".join(m if k == 0 else m.removeprefix("input should be ") for k, m in enumerate(said))
    return f"{where}{': ' if where else ''}{message}{shown}{more}"


def _sentence(message: str) -> str:
    said = in_tomls_words(message.removeprefix("Value error, "))
    return said[0].lower() + said[1:]


def _as_list(text: str) -> str:
    """What was meant by a ``text`` where a list belongs: one of a single text, or one whose quotes a shell ate."""
    return _shown_text(json.dumps([item.strip() for item in text.strip("[] ").split(",")]))


def _key(place: tuple[int | str, ...]) -> str:
    """The dotted key at a validator's ``place``, without the limb's shape and what the validator calls its kinds."""
    if place[:1] == ("limb",):
        place = (*place[:1], *place[2:])
    return ".".join(str(part) for part in place if not _KIND.match(str(part)))


def _shown(value: Any) -> str:
    """What came, as TOML would have it, at most 60 characters of it."""
    return _shown_text(str(value) if isinstance(value, date | time) else repr(value))


def _shown_text(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:40]} ... {text[-15:]}"
