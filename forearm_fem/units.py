"""Units of measured transfer functions, as people write them: "mm/V", "(um/s)/mV", "m/s^2/N", "g/N"."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from .errors import DataError
from .scenario.measurement import Quantity
from .typing import ComplexArray, FloatArray

_PREFIX: Mapping[str, float] = MappingProxyType(
    {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3}
)
_PER_TIME: Mapping[str, Quantity] = MappingProxyType({"": "displacement", "/s": "velocity", "/s^2": "acceleration"})
_POWERS: Mapping[Quantity, int] = MappingProxyType({"displacement": 0, "velocity": 1, "acceleration": 2})
_G = 9.80665  # standard gravity [m/s^2]
_SHAPE = re.compile(r"^(?:([nuµμmck]?)m((?:/s(?:\^2)?)?)|([mu]?)g)/([numkµμ]?)([VN]|m)$")


def to_displacement(frequency: FloatArray, quantity: Quantity) -> ComplexArray:
    """1 / (i omega)^p (n,): from velocity (p = 1) or acceleration (p = 2) to displacement, e^{+i omega t}."""
    return np.asarray((2j * np.pi * frequency) ** -float(_POWERS[quantity]))


@dataclass(frozen=True)
class Unit:
    """``factor`` turns the unit into SI; ``quantity`` is its numerator; ``si`` is the displacement unit:
    m/V, m/N or m/m.
    """

    factor: float
    quantity: Quantity
    si: str


def parse_unit(text: str) -> Unit:
    """The unit ``text``; DataError, with examples, if it is not a motion over a drive."""
    plain = re.sub(r"[()\[\]\s]", "", text).replace("s²", "s^2").replace("s2", "s^2").replace("/s/s", "/s^2")
    plain = plain.replace("*", "")
    match = _SHAPE.match(plain)
    if match is None:
        raise DataError(f"unit '{text}' is not a motion over a drive; write e.g. m/V, mm/V, (mm/s)/V, m/s^2/N or g/N")
    prefix, per_time, gravity, drive_prefix, drive = match.groups()
    below = _PREFIX[drive_prefix or ""]
    if prefix is None:
        return Unit(_PREFIX[gravity] * _G / below, "acceleration", f"m/{drive}")
    return Unit(_PREFIX[prefix] / below, _PER_TIME[per_time], f"m/{drive}")
