"""Base of all parts of a scenario: frozen, unknown keys refused, every number finite and of a plausible size."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, ClassVar, Self, Union, get_args, get_origin

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

from ..errors import ScenarioError
from ..usercode import is_code
from .changes import first_problem_of, remade

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
