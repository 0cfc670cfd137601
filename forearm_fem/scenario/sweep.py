"""Frequencies: a band or a list on a record; and how each is solved."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from ..errors import ScenarioError
from ..typing import FloatArray
from .base import Frequency, Part, Within, choice, given, idle, only_in

MOST_BINS, MOST_SAMPLES = 50_000, 2_000_000  # of one sweep, of one record
Swept = Annotated[float, Within(1e-3, 5000.0, "Hz")]


class SweepRecord(Part):
    """The record that drives and displacements fill; its bins are 1 / duration apart."""

    duration: Annotated[float, Within(1e-3, 1e4, "s")] = Field(
        2.0, description="record length [s]; bins are 1/duration apart"
    )
    sample_rate: Annotated[float, Within(1, 1e7, "Hz")] = Field(10000.0, description="[Hz]")

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest frequency asked for [Hz]."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _record(self) -> Self:
        if self.sample_rate < 2 * self.span[1]:
            raise ValueError(f"sample_rate must be at least 2 f_max = {2 * self.span[1]:g} Hz")
        if (samples := self.duration * self.sample_rate) > MOST_SAMPLES:
            raise ValueError(
                f"duration times sample_rate is {samples:.3g} samples, expected at most {MOST_SAMPLES:,}; shorten it"
            )
        return self


class Band(SweepRecord):
    """All bins of a band; default: those of a 2 s record at 10 kHz that the thesis' 10-500 Hz sweep excites (981)."""

    f_min: Frequency = Field(10.0, description="[Hz]")
    f_max: Swept = Field(500.0, description="[Hz]")

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest frequency asked for [Hz]."""
        return self.f_min, self.f_max

    @model_validator(mode="after")
    def _band(self) -> Self:
        if self.f_max <= self.f_min:
            raise ValueError(f"f_max must exceed f_min = {self.f_min:g} Hz, got {self.f_max:g} Hz")
        if (bins := self.duration * (self.f_max - self.f_min)) > MOST_BINS:
            raise ValueError(f"f_min to f_max holds {bins:.3g} bins, expected at most {MOST_BINS:,}; shorten duration")
        return self


class FrequencyList(SweepRecord):
    """A list of frequencies; what is rendered on the bins between them is interpolated."""

    frequencies: Annotated[tuple[Swept, ...], Field(min_length=1, max_length=MOST_BINS)] = Field(
        description="own list of frequencies [Hz] instead of a band"
    )
    idle_keys: ClassVar = only_in(Band, "sweep.frequencies is given; leave out either")

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest frequency asked for [Hz]."""
        return self.frequencies[0], self.frequencies[-1]

    @field_validator("frequencies", mode="before")
    @classmethod
    def _some(cls, given: Any) -> Any:
        if isinstance(given, list | tuple) and not given:
            raise ValueError("frequencies is empty; give at least one [Hz], or leave the key out for f_min to f_max")
        return given

    @field_validator("frequencies")
    @classmethod
    def _increase(cls, given: tuple[float, ...]) -> tuple[float, ...]:
        if sorted(set(given)) != list(given):
            raise ValueError("frequencies must increase and be distinct")
        return given


def _frequencies(data: Any) -> str:
    return "as list of frequencies" if given(data, "frequencies") else "as band"


Sweep = Annotated[
    Annotated[Band, Tag("as band")] | Annotated[FrequencyList, Tag("as list of frequencies")],
    Discriminator(_frequencies),
]


class SolverOptions(Part):
    """Options of the factorisation."""

    backend: Literal["auto", "multifrontal", "pardiso", "superlu", "cudss"] = Field(
        "auto", description="direct solver; cudss: on an NVIDIA device, with the extra 'cudss'"
    )
    precision: Literal["auto", "double", "single"] = Field(
        "auto", description="of the factors, all solves being refined; auto: single, double where that is not enough"
    )
    memory_limit: Annotated[float, Within(1e6, 1e16, "bytes")] = Field(
        12e9, description="refuse a solve estimated above this [bytes]"
    )
    discretisation_estimate: bool = Field(
        True, description="solve a coarser mesh, too, or the layered model of a slab; without it the error is unknown"
    )


class ReducedSolve(SolverOptions):
    """A certified reduced model gives all bins."""

    sweep: Literal["reduced"] = Field(
        "reduced",
        description="reduced: a certified reduced model gives all bins; direct: a solve per bin, to check it",
    )
    start: Literal["auto", "rate", "frequencies"] = Field(
        "auto",
        description="what the reduced model starts from; auto: derivatives about one real rate, expansion frequencies "
        "where a modulus is not Kelvin-Voigt",
    )
    rate_derivatives: Annotated[int, Within(10, 400)] = Field(
        80, description="about the rate at most; as many are made as the model needs"
    )
    expansions: Annotated[int, Within(1, 50)] = Field(
        4, description="expansion frequencies to start with, where it does not start from a rate"
    )
    derivatives: Annotated[int, Within(1, 12)] = Field(9, description="kept per expansion frequency, for contacts")
    point_derivatives: Annotated[int, Within(0, 12)] = Field(
        5, description="kept for grid points, at most as many as for contacts: the error falls with the sum of both"
    )
    max_expansions: Annotated[int, Within(1, 50)] = Field(8, description="expansion frequencies at most")

    @model_validator(mode="after")
    def _rate(self) -> Self:
        if self.start == "frequencies" and self.rate_derivatives != 80:
            raise idle(["rate_derivatives"], "solver.start = 'frequencies'; leave it out, or set start = 'auto'")
        return self


class DirectSolve(SolverOptions):
    """A solve at each frequency, to check the reduced model."""

    sweep: Literal["direct"] = Field("direct", description="a solve at each frequency")
    idle_keys: ClassVar = only_in(ReducedSolve, "solver.sweep = 'direct'; leave it out, or set sweep = 'reduced'")


def _solve(data: Any) -> str:
    return f"as {choice(data, 'solver.sweep', ('reduced', 'direct'))} solve"


Solver = Annotated[
    Annotated[ReducedSolve, Tag("as reduced solve")] | Annotated[DirectSolve, Tag("as direct solve")],
    Discriminator(_solve),
]


def frequencies(sweep: Sweep) -> FloatArray:
    """Frequencies (n,) [Hz]: the scenario's own list, or the bins k / duration inside [f_min, f_max]."""
    if isinstance(sweep, FrequencyList):
        return np.array(sweep.frequencies, dtype=float)
    first = int(np.ceil(sweep.f_min * sweep.duration - 1e-9))
    last = int(np.floor(sweep.f_max * sweep.duration + 1e-9))
    if last < first:
        raise ScenarioError(
            f"sweep: no bin of width {1 / sweep.duration:g} Hz lies between {sweep.f_min:g} and {sweep.f_max:g} Hz; "
            "lengthen sweep.duration"
        )
    return np.arange(first, last + 1) / sweep.duration
