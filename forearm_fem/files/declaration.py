"""Meaning of a foreign file: by its own words and names, or declared by its owner; nothing is guessed."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from pydantic import Field

from ..errors import DataError, MissingExtra
from ..ports import Port
from ..scenario.base import Part, Positive, UserCode
from ..scenario.measurement import Quantity
from ..store.folder import refuse_no_file
from ..store.text import stand_in, text_of
from ..transfer import ErrorEstimate, ErrorSource

_SNIFFED = 1 << 16  # bytes


def refuse_stand_in(file: Path) -> None:
    """DataError where ``file`` is missing, or something stands in its place: a pointer, a web page, an archive."""
    refuse_no_file(file)
    with file.open("rb") as stream:
        head = stream.read(_SNIFFED)
    if said := stand_in(head):
        raise DataError(f"{file}: {said}")


def text_in(file: Path) -> str:
    """The text in ``file``, whatever its encoding; DataError where it is none."""
    refuse_stand_in(file)
    content = file.read_bytes()
    if content[:4] == b"PK\x03\x04":
        raise DataError(f"{file}: is an archive or a spreadsheet (.xlsx) under this name; save the sheet as CSV")
    try:
        return text_of(content)
    except ValueError as problem:
        raise DataError(f"{file}: is no text ({problem}); is it really of this kind?") from None


@contextmanager
def reading(file: Path, unreadable: str) -> Iterator[None]:
    """Every failure of the block as a DataError about ``file``: what it says itself, else that it is ``unreadable``.

    Libraries fail in ways they do not list where a file is damaged. A missing file, and what stands in a file's place,
    is told before. MissingExtra passes.
    """
    refuse_stand_in(file)
    try:
        yield
    except MissingExtra:
        raise
    except DataError as problem:
        said = str(problem)
        raise DataError(said if said.startswith(str(file)) else f"{file}: {said}") from None
    except Exception as problem:
        why = " ".join(str(problem).split())[:120] or type(problem).__name__
        raise DataError(f"{file}: {unreadable.format(why=why)}") from problem


class RecognitionWarning(UserWarning):
    """Something about a file was recognised, not declared; ``what`` names it and ``chosen`` is what was taken."""

    def __init__(self, file: str, what: str, chosen: str) -> None:
        super().__init__(f"{file}: {what} recognised as {chosen}; declare it to be sure")
        self.file, self.what, self.chosen = file, what, chosen


# Meaning of a foreign file: by its own words, or declared by its owner; nothing is guessed.

Axis = Literal["frequency", "output", "input"]
Spectrum = Literal["one-sided", "two-sided"]
Sign = Literal["+iwt", "-iwt"]
Ports = tuple[tuple[Port, ...], tuple[Port, ...]]
FOI: tuple[Axis, ...] = ("frequency", "output", "input")


class PortDeclaration(Part):
    """A port of a measured G: its name and place [m]."""

    name: str
    position: tuple[float, float, float]
    radius: float = 0.0


class Declaration(Part):
    """Declaration of a file's meaning by its user. Left out: the file must say it itself, or a DataError asks."""

    reader: UserCode | None = Field(
        default=None, description="your own class that reads the file, as module:Name: a format of your own"
    )
    quantity: Quantity | None = Field(
        default=None, description="what the numerator is; not needed where the unit says it"
    )
    unit: str | None = Field(default=None, description="motion over drive as stored, e.g. mm/V, (mm/s)/V, m/s^2/N")
    arbitrary_gain: bool = Field(
        default=False, description="the scale is unknown: shapes and S are meaningful, microns are not"
    )
    spectrum: Spectrum | None = Field(
        default=None, description="two-sided: FFT order, negative frequencies in the upper half"
    )
    sign: Sign | None = Field(default=None, description="time dependence; numpy's and MATLAB's fft give +iwt")
    axes: tuple[Axis, ...] | None = Field(default=None, description="order of the array's axes")
    variable: str | None = Field(
        default=None, description="name of the array in a file of several, e.g. G, FRF.H or group/H"
    )
    imaginary_variable: str | None = Field(
        default=None, description="name of the array of imaginary parts, where they have one of their own"
    )
    frequency_variable: str | None = Field(default=None, description="name of the vector of frequencies [Hz]")
    frequency_file: str | None = Field(
        default=None, description="file of the frequencies [Hz], .npy or text, beside the array's"
    )
    valid_variable: str | None = Field(default=None, description="name of a mask of G's shape")
    sample_rate: Positive | None = Field(
        default=None, description="[Hz]; bin k lies at k sample_rate / bins (two-sided); of sweeps that do not say it"
    )
    band: tuple[Positive, Positive] | None = Field(default=None, description="keep these frequencies only [Hz]")
    outputs: tuple[PortDeclaration, ...] | None = Field(
        default=None, description="points with places, where no scenario has them"
    )
    inputs: tuple[PortDeclaration, ...] | None = Field(
        default=None, description="actuators with places, where no scenario has them"
    )
    points: dict[str, str] | None = Field(
        default=None, description="the file's node or name -> the scenario's point; others are left out"
    )
    actuators: dict[str, str] | None = Field(
        default=None, description="the file's node or name -> the scenario's actuator; others are left out"
    )
    direction: Literal[1, 2, 3] | None = Field(
        default=None, description="of the responses of a triaxial sensor: 1 = x, 2 = y, 3 = z"
    )
    estimator: Literal["H1", "H2", "Hv"] | None = Field(
        default=None, description="which of several estimates of one function is meant"
    )
    roving: Literal["hammer", "sensor"] | None = Field(
        default=None, description="hammer: drives rove over the points; G is taken by reciprocity (force drive only)"
    )
    pattern: str | None = Field(
        default=None, description="of the names of files that are joined, e.g. 'P{output}_{input}'"
    )
    drive: str | None = Field(default=None, description="channel of the drive [V], where the files are raw sweeps")
    response: str | None = Field(default=None, description="channel of the response [V] of raw sweeps")
    drive_is_measured: bool = Field(default=False, description="the drive's channel is a loopback, noise and all")
    full_scale: Positive | None = Field(default=None, description="volts at full scale of whole numbers in WAV files")
    skip: float = Field(default=0.0, ge=0, description="seconds of raw sweeps before the first whole period")


EVERY = frozenset({
    "reader", "quantity", "unit", "arbitrary_gain", "spectrum", "sign", "band", "outputs", "inputs", "points",
    "actuators", "roving",
})  # fmt: skip
"""Keys of a declaration of any file."""
SWEEPS = frozenset({"drive", "response", "drive_is_measured", "full_scale", "skip"})
"""Keys of a declaration of raw sweeps alone."""


def declare(key: str, value: str) -> str:
    """The option that declares ``key``, as it is typed."""
    return f'--declare "{key}={value}"'


@contextmanager
def declared_by(option: str) -> Iterator[None]:
    """Errors of the block name ``option`` in the place of ``--declare``."""
    try:
        yield
    except DataError as problem:
        said = str(problem)
        if option == "[declaration]":  # of a recipe: no shell's quotes, and arrays without names
            said = re.sub(r'--declare "([^"]*)"', rf"{option} \1", said)
            said = said.replace("frequency_variable or frequency_file", "frequency_file")
        raise DataError(said.replace("--declare ", f"{option} ")) from None


def arbitrary_gain(provenance: Mapping[str, Any]) -> dict[str, str]:
    """Part of ``provenance`` that says that a G's scale is unknown: ``{"gain": "arbitrary"}``, or nothing."""
    return {"gain": "arbitrary"} if provenance.get("gain") == "arbitrary" else {}


def port_from(fields: Mapping[str, Any]) -> Port:
    """A port from its fields as JSON holds them (lists for tuples)."""
    plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()}
    return Port(**plain)


# Error estimates in a text file: what each source may do to all entries; shares of pairs are netCDF's alone.

_OF_ERROR = ("source", "band", "method", "frequency", "per_frequency")


def plain_errors(errors: Iterable[ErrorEstimate]) -> list[dict[str, Any]]:
    """Each source with e_band and e(f), as JSON holds it; NaN is what could not be estimated."""
    return [{key: getattr(e, key) for key in _OF_ERROR} for e in errors]


def errors_from(fields: Sequence[Mapping[str, Any]]) -> tuple[ErrorEstimate, ...]:
    """Estimates as :func:`plain_errors` wrote them; DataError for an unknown source and for negative errors."""
    found = tuple(ErrorEstimate(e["source"], float(e["band"]), *(e[key] for key in _OF_ERROR[2:])) for e in fields)
    for e in found:
        if e.source not in get_args(ErrorSource) or np.any(np.array([e.band, *e.per_frequency]) < 0):
            raise DataError(f"errors: expected sizes from 0 by {', '.join(get_args(ErrorSource))}; export it again")
    return found
