"""Scenario files: TOML, ``--set``, a commented template, and one clear sentence for what is wrong."""

from __future__ import annotations

import hashlib
import json
import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel, BeforeValidator, TypeAdapter

from ..errors import ForearmError, ScenarioError
from ..usercode import is_code, with_code_beside
from .base import Part, copied, dotted, keys_of, kinds_of, put, remade, units_of
from .limb import Limb, MeshLimb, SurfacesLimb
from .model import Scenario
from .rendering import SampledWavelet

# Reading TOML files: whatever is wrong with one is a sentence.

_BACKSLASH = "within double quotes \\ begins an escape: write paths with /, or in single quotes"


def _line(file: Path, problem: Exception) -> str:
    """The line of ``file`` that a ``problem`` names; all of it where it names none."""
    lines = file.read_text(encoding="utf-8-sig").splitlines()
    named = re.search(r"at line (\d+)", str(problem))
    return "\n".join(lines) if named is None else "".join(lines[int(named[1]) - 1 : int(named[1])])


def read_toml(file: Path, missing: str, error: type[ForearmError] = ScenarioError) -> dict[str, Any]:
    """The table in ``file``, user code beside it named in full (:mod:`forearm_fem.usercode`).

    ``error`` with the sentence ``missing`` where there is no file, or with why it cannot be read.
    """
    if file.is_dir():
        raise error(f"{file}: is a folder, expected a TOML file")
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise error(f"{file}: {missing}") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise error(f"{file}: cannot be read as a text file ({problem})") from None
    except RecursionError:
        raise error(f"{file}: not valid TOML: nested too deeply") from None
    except tomllib.TOMLDecodeError as problem:
        more = f"; {_BACKSLASH}" if "\\" in _line(file, problem) else ""
        raise error(f"{file}: not valid TOML: {problem}{more}") from None
    except ValueError:  # Python reads no more
        raise error(f"{file}: a number has more than 4300 digits") from None
    beside: dict[str, Any] = with_code_beside(table, file.parent)
    return beside


# Files: scenarios that come with the program, and what a scenario names.

_PACKAGE = Path(__file__).resolve().parents[1]


def shipped_folder(kind: str) -> Path:
    """Folder of the "scenarios" or "meshes" that come with the program: inside a wheel, else beside the package."""
    inside = _PACKAGE / "_data" / kind
    return inside if inside.is_dir() else _PACKAGE.parent / kind


def shipped_scenarios() -> tuple[str, ...]:
    """Names of the scenarios that come with the program, e.g. "thesis"."""
    return tuple(sorted(file.stem for file in shipped_folder("scenarios").glob("*.toml")))


def scenario_file(given: str | Path) -> Path:
    """``given`` where it is a file or looks like one, else the file of the shipped scenario of that name."""
    file = Path(given)
    if file.is_file() or file.suffix or len(file.parts) != 1 or file.name not in shipped_scenarios():
        return file
    return shipped_folder("scenarios") / f"{file.name}.toml"


def scenario_beside(folder: Path, named: str) -> Path:
    """The scenario that a file in ``folder`` names: the file there, else the shipped scenario of that name."""
    beside = folder / named
    if beside.is_file() or named not in shipped_scenarios():
        return beside
    return shipped_folder("scenarios") / f"{named}.toml"


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


# Scenario files: TOML, ``--set``, a commented template, and one clear sentence for what is wrong.

DOTTED = BeforeValidator(lambda values: dotted(values) if isinstance(values, Mapping) else values)
_SCENARIO = TypeAdapter(Scenario)


def load_scenario(path: str | Path, *, overrides: Sequence[str] = ()) -> Scenario:
    """Scenario from a TOML file, or from one that comes with the program by its name, e.g. "thesis".

    ``overrides`` are ``key.path=value``: TOML, or a number with its unit (``device.spacing=40mm``). Keys of the file
    that they leave without effect fall away. Files that a scenario names are seen from the folder of
    :func:`scenario_file`. Raises :class:`ScenarioError` for a missing or malformed file and for unknown or impossible
    keys.
    """
    if not isinstance(path, str | Path):
        raise ScenarioError(
            f"expected a scenario's file or name, got a {type(path).__name__}; parse_scenario takes tables"
        )
    file = scenario_file(path)
    known = shipped_scenarios()
    meant = "".join(f"; did you mean {name}?" for name in get_close_matches(str(path), known, 1))
    table = read_toml(file, f"no such file{meant}; by name there are {', '.join(known)}")
    if "scenario" in table:
        raise ScenarioError(
            f"{file}: names a scenario, so it is a file for `forearm-fem design`, `campaign` or `study`; give it to "
            "that command, or give the scenario here"
        )
    return remade(_SCENARIO, table, read_overrides(overrides), str(file), "--set ")


def parse_scenario(
    data: Mapping[str, Any], *, origin: str = "scenario", changes: Mapping[str, Any] | None = None
) -> Scenario:
    """Scenario from plain data, with ``changes`` by dotted key; see :func:`load_scenario` for the errors."""
    return remade(_SCENARIO, data, changes or {}, origin)


def scenario_schema() -> str:
    """JSON Schema of a scenario file, for editors."""
    return json.dumps(Scenario.model_json_schema(), indent=2)


def read_overrides(overrides: Sequence[str], option: str = "--set") -> dict[str, Any]:
    """Values by dotted key from ``key.path=value``: TOML, ".01", a number with a unit of the key's kind, or plain text.

    ScenarioError about the ``option`` where one is none.
    """
    if isinstance(overrides, str):  # whose letters would be taken for overrides
        raise ScenarioError(f"overrides: expected a list of texts, got the text '{overrides}'; put it into brackets")
    result: dict[str, Any] = {}
    for item in overrides:
        key, separator, text = item.partition("=")
        if not separator or not key.strip():
            example = "device.spacing=40mm" if option == "--set" else "unit='mm/V'"
            raise ScenarioError(f"{option} expects key.path=value, got '{item}'; e.g. {option} \"{example}\"")
        result[key.strip()] = _value(key.strip(), text.strip())
    return result


def apply_overrides(data: Mapping[str, Any], overrides: Sequence[str], option: str = "--set") -> dict[str, Any]:
    """A copy of ``data`` with each ``key.path=value`` put in place; see :func:`read_overrides`."""
    result: dict[str, Any] = copied(data)
    for key, value in read_overrides(overrides, option).items():
        put(result, key, value, f"{option} {key}")
    return result


_PREFIX = {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6, "G": 1e9}
_QUANTITY = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zA-Zµ][a-zA-Zµ0-9/^* ]*)")


def _value(key: str, text: str) -> Any:
    """``text`` as TOML, or in SI where it is a number with a unit and the ``key`` has that unit; else as it is."""
    value, unit = _toml_value(text), unit_of(key)
    if isinstance(value, str) and unit and (found := _QUANTITY.fullmatch(text)):
        number, given = found.groups()
        for prefix, factor in _PREFIX.items():
            if given == prefix + unit and unit != "kg":
                return float(f"{float(number) * factor:.15g}")
        if unit == "kg" and given in _MASS:
            return float(f"{float(number) * _MASS[given]:.15g}")
        if unit == "rad" and given == "deg":
            return math.radians(float(number))
        example = "0.04 or 40mm" if unit == "m" else f"5 or 5{unit}"
        raise ScenarioError(f"{key}: expected a number in {unit}, e.g. {example}, got '{text}'")
    return value


_MASS = {"kg": 1.0, "g": 1e-3, "mg": 1e-6}


@cache
def _units() -> dict[str, str]:
    return dict(units_of(Scenario.model_json_schema()))


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


def unit_of(key: str) -> str | None:
    """SI unit of the number under a dotted ``key``; None where it has none."""
    return _units().get(re.sub(r"^tissues\.override\.[^.]+", "tissues.override.*", key))


def _toml_value(text: str) -> Any:
    if re.fullmatch(r"[+-]?(\d+\.|\.\d+)(e[+-]?\d+)?", text.lower()):  # ".01" and "1.", which TOML has not
        return float(text)
    try:
        read = tomllib.loads(f"value = {text}")
        return read["value"] if len(read) == 1 else text
    except (ValueError, RecursionError):  # the first is also what numbers of thousands of digits raise
        return text


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
