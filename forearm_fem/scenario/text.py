"""Scenario as text: schema, a commented template, labels of changes, and the files that it names."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel, BeforeValidator

from ..usercode import is_code
from .base import Part, dotted, keys_of, kinds_of
from .limb import Limb, MeshLimb, SurfacesLimb
from .model import Scenario, unit_of
from .rendering import SampledWavelet


def named_files(scenario: Scenario) -> tuple[str, ...]:
    """Files that ``scenario`` names, seen from its own folder: of the limb, of the wavelet, and of the user's code."""
    wave = scenario.rendering.wavelet
    sampled = (wave.file,) if isinstance(wave, SampledWavelet) else ()
    return (*limb_files(scenario.limb), *sampled, *code_files(scenario.rendering.methods), *law_files(scenario))


def law_files(scenario: Scenario) -> tuple[str, ...]:
    """Files of the user's own tissue laws."""
    return code_files(law for override in scenario.tissues.override.values() if (law := override.law) is not None)


def code_files(names: Iterable[str]) -> tuple[str, ...]:
    """Files of the user's code among ``names``: those named in full, and those in the current folder."""
    places = (name.rpartition(":")[0] for name in names if is_code(name))
    files = (Path(place if place.endswith(".py") else place.replace(".", "/") + ".py") for place in places)
    return tuple(str(file.resolve()) for file in files if file.is_file())


def limb_files(limb: Limb) -> tuple[str, ...]:
    """Files that a ``limb`` is made of; none for a parametric one."""
    if isinstance(limb, MeshLimb):
        return (limb.file,)
    return tuple(limb.surfaces.values()) if isinstance(limb, SurfacesLimb) else ()


def contents(files: Iterable[str], base: str | Path) -> list[str]:
    """SHA-256 of each of the ``files`` seen from ``base``; "missing" for one that is not there."""
    paths = [Path(base) / file for file in files]
    return [hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "missing" for path in paths]


DOTTED = BeforeValidator(lambda values: dotted(values) if isinstance(values, Mapping) else values)


def scenario_schema() -> str:
    """JSON Schema of a scenario file, for editors."""
    return json.dumps(Scenario.model_json_schema(), indent=2)


def label_of(changes: Mapping[str, Any]) -> str:
    """Name of a folder for ``changes`` by dotted key, e.g. "spacing-40mm"; a short hash where that is too long.

    Different changes have different names: keys by their shortest ends that no other key has, values with all digits.
    """
    words = [f"{_short(key)}-{_said(value, unit_of(key))}" for key, value in sorted(changes.items())]
    label = "-".join(words)
    if len(label) <= LONGEST_LABEL and re.fullmatch(r"[A-Za-z0-9_.-]*[A-Za-z0-9_]", label):
        return label
    return hashlib.sha256(json.dumps(changes, sort_keys=True, default=str).encode()).hexdigest()[:8]


LONGEST_LABEL = 60  # characters


def _short(key: str) -> str:
    known, parts = all_keys(), key.split(".")
    ends = (".".join(parts[-n:]) for n in range(1, len(parts)))
    if key not in known:  # below a table of the user's own names
        return ".".join(parts[-2:])
    return next((end for end in ends if sum(f".{k}".endswith(f".{end}") for k in known) == 1), key)


def _said(value: Any, unit: str | None) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float) and unit in _SCALED and value:
        power = min(max(3 * math.floor(math.log10(abs(value)) / 3 + 1e-9), -9), 9)
        prefix = {-9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}[power]
        text = f"{value / 10.0**power:.15g}"
        return f"{text}{prefix}{unit}" if float(f"{text}e{power}") == value else f"{value!r}{unit}"
    if isinstance(value, int | float):
        return repr(value)
    return value if isinstance(value, str) and re.fullmatch(r"\w+", value) else "?"  # which no folder's name has


_SCALED = ("m", "Hz", "s", "Pa", "V", "W")


@cache
def all_keys() -> tuple[str, ...]:
    """Dotted keys of all kinds of a scenario; "*" stands for names of the user's own."""
    return tuple(dict.fromkeys(keys_of(Scenario.model_json_schema())))


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
