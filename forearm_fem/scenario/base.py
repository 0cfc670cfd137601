"""Parts of a scenario: frozen, checked, changed by dotted key, and what is wrong with one in a sentence."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, time
from difflib import get_close_matches
from types import UnionType
from typing import Annotated, Any, ClassVar, Self, TypeVar, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from ..errors import ScenarioError, in_tomls_words
from ..usercode import is_code

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


# Base of all parts of a scenario: frozen, unknown keys refused, every number finite and of a plausible size.

LONGEST_TEXT = 4000  # characters of one text in a scenario


@dataclass(frozen=True)
class Within:
    """Range [low, high] of a number, with the unit that its sentence names; ``zero`` lets 0 pass besides.

    The ranges are generous: they are there for slips of the unit, for numbers that overflow and for denormals, not to
    judge a design. Text and booleans are not taken for numbers.
    """

    low: float
    high: float
    unit: str = ""
    zero: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """The number's own schema, strict, then the range."""
        number: Any = {**handler(source), "strict": True}
        return core_schema.no_info_after_validator_function(self._checked, number)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """The range as minimum and maximum."""
        unit = {"unit": self.unit} if self.unit else {}
        return {**handler(schema), "minimum": 0 if self.zero else self.low, "maximum": self.high, **unit}

    def _checked(self, value: float) -> float:
        if self.low <= value <= self.high or (self.zero and value == 0):
            return value
        raise ValueError(f"expected {'0, or ' if self.zero else ''}{self.low:g} to {self.high:g} {self.unit}".rstrip())


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(gt=0, lt=1)]
Length = Annotated[float, Within(1e-6, 2.0, "m"), Field(description="a length in metres")]
Coordinate = Annotated[float, Within(-2.0, 2.0, "m")]
Mass = Annotated[float, Within(1e-7, 1e7, "kg")]
Frequency = Annotated[float, Within(1e-3, 1e5, "Hz")]
Voltage = Annotated[float, Within(1e-9, 1e4, "V")]
_FOLDER = r"^[A-Za-z0-9_]([A-Za-z0-9_.-]{0,98}[A-Za-z0-9_-])?$"
_DEVICES = frozenset({"con", "prn", "aux", "nul", *(f"{kind}{n}" for kind in ("com", "lpt") for n in range(10))})


def is_folder_name(name: str) -> bool:
    """True if a folder may be called ``name`` on every system."""
    return bool(re.fullmatch(_FOLDER, name)) and name.partition(".")[0].lower() not in _DEVICES


def _folder_name(name: str) -> str:
    if is_folder_name(name):
        return name
    raise ValueError("expected a folder's name: at most 100 letters, digits, _ - and inner dots; no device of Windows")


Name = Annotated[str, AfterValidator(_folder_name), Field(json_schema_extra={"pattern": _FOLDER})]


def _code(text: str) -> str:
    if is_code(text):
        return text
    raise ValueError("expected one of the known names, or module:Name for a class of your own file")


UserCode = Annotated[str, AfterValidator(_code)]


def idle(keys: Iterable[str], why: str) -> PydanticCustomError:
    """Refusal of ``keys``, dotted below their table, that would have no effect; ``why`` and the cure."""
    return PydanticCustomError("idle", "no effect: {why}", {"keys": sorted(keys), "why": why})


def only_in(part: type[Part], why: str) -> dict[str, str]:
    """Keys that ``part`` itself adds to its base, each with the sentence ``why`` another kind refuses it."""
    return dict.fromkeys((key for key in part.__annotations__ if key in part.model_fields), why)


def given(data: Any, key: str) -> bool:
    """True if ``data``, a table or a part, has something under ``key``."""
    return (data.get(key) if isinstance(data, Mapping) else getattr(data, key, None)) is not None


def kinds_of(annotation: Any) -> tuple[type[Part], ...]:
    """The parts that a key of this ``annotation`` may be: several where it has kinds, none where it is a value."""
    if isinstance(annotation, type):
        return (annotation,) if issubclass(annotation, Part) else ()
    if get_origin(annotation) in (Annotated, Union, UnionType):
        return tuple(kind for inside in get_args(annotation) for kind in kinds_of(inside))
    return ()


def choice(data: Any, key: str, options: Sequence[Any]) -> Any:
    """The option that the dotted ``key`` chooses in ``data``, its table or part; the first where it is left out.

    PydanticCustomError for another value.
    """
    name = key.rpartition(".")[2]
    found = data.get(name, options[0]) if isinstance(data, Mapping) else getattr(data, name, options[0])
    if any(found is o or (isinstance(found, str) and found == o) for o in options):
        return found
    words = [str(o).lower() if isinstance(o, bool) else f"'{o}'" for o in options]
    said = f"expected {', '.join(words[:-1])} or {words[-1]}, got {found!r}"
    raise PydanticCustomError("choice", "{said}", {"key": key, "said": said})


class Part(BaseModel):
    """Base of all scenario parts; ``allow_inf_nan`` is off so that NaN never enters a solve.

    Built in Python, one raises the sentence that a file would be told, as :class:`ScenarioError`. ``idle_keys`` are
    keys of its kin that would have no effect in this kind: key -> why, and the cure.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    idle_keys: ClassVar[Mapping[str, str]] = {}

    def __init__(self, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as problem:
            name, schema = type(self).__name__, type(self).model_json_schema()
            raise ScenarioError(f"{name}: {first_problem_of(problem, schema)}") from None

    def changed(self, changes: Mapping[str, Any]) -> Self:
        """A checked copy with ``changes`` by dotted key, e.g. ``{"housing.mass": 0.1}``; None leaves a key out.

        Keys that the changes leave without effect fall away, such as ``spacing`` beside ``contacts``. ScenarioError
        for what a file would be refused.
        """
        return remade(TypeAdapter(type(self)), self.model_dump(), changes, type(self).__name__)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """:meth:`changed` under pydantic's name, so that no copy escapes the checks."""
        return self.changed(update or {})

    def copy(self, *, update: Mapping[str, Any] | None = None, **_: Any) -> Self:
        """:meth:`changed` under pydantic's older name."""
        return self.changed(update or {})

    # Tables within tables are validated by pydantic without calling this, so that it knows the whole key.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @model_validator(mode="before")
    @classmethod
    def _plain_text(cls, data: Any) -> Any:
        idle_here = cls.idle_keys.keys() - cls.model_fields.keys()
        if isinstance(data, Mapping) and (found := [key for key in data if key in idle_here]):
            why = cls.idle_keys[found[0]]
            raise idle((key for key in found if cls.idle_keys[key] == why), why)
        for key, text in _texts(data) if isinstance(data, Mapping) else ():
            if len(text) > LONGEST_TEXT:
                raise ValueError(f"{key}: expected a text of at most {LONGEST_TEXT} characters, got {len(text)}")
            path = re.match(r"^[A-Za-z]:", text)  # of Windows, whose \t and \n were no blanks
            if any(not c.isprintable() and (path or c not in "\n\t") for c in text):
                raise ValueError(
                    f"{key}: expected text without control characters; within double quotes of TOML \\ begins an "
                    "escape: write paths with /, or in single quotes"
                )
        return data


def _texts(data: Mapping[Any, Any]) -> Iterator[tuple[str, str]]:
    """Keys and texts of a table, of its lists and of the tables in it, whose own keys count as texts."""
    for key, value in data.items():
        if isinstance(value, str):
            yield str(key), value
        elif isinstance(value, list | tuple):
            yield from ((str(key), text) for text in value if isinstance(text, str))
        elif isinstance(value, Mapping):
            yield from ((str(key), name) for name in value if isinstance(name, str))
            yield from ((f"{key}.{name}", text) for name, text in value.items() if isinstance(text, str))
