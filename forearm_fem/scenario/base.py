"""What every part of a scenario shares: frozen, unknown keys refused, every number finite and of a plausible size."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from ..errors import ScenarioError
from ..usercode import is_code
from .problem import first_problem_of

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
        return {**handler(schema), "minimum": 0 if self.zero else self.low, "maximum": self.high}

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
    """Whether a folder may be called ``name`` on every system."""
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


class Part(BaseModel):
    """Base of all scenario parts; ``allow_inf_nan`` is off so that NaN never enters a solve.

    Built in Python, one raises the sentence that a file would be told, as :class:`ScenarioError`.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as problem:
            name, schema = type(self).__name__, type(self).model_json_schema()
            raise ScenarioError(f"{name}: {first_problem_of(problem, schema)}") from None

    # Tables within tables are validated by pydantic without calling this, so that it knows the whole key.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @model_validator(mode="before")
    @classmethod
    def _plain_text(cls, data: Any) -> Any:
        for key, text in _texts(data) if isinstance(data, Mapping) else ():
            if len(text) > LONGEST_TEXT:
                raise ValueError(f"{key}: expected a text of at most {LONGEST_TEXT} characters, got {len(text)}")
            if any(not c.isprintable() and c not in "\n\t" for c in text):
                raise ValueError(f"{key}: expected text without control characters; retype it")
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
