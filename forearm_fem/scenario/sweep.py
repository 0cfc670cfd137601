"""Frequencies, solver and reduction options."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from .base import Frequency, Part, Within

MOST_BINS, MOST_SAMPLES = 50_000, 2_000_000  # of one sweep, of one record
Swept = Annotated[float, Within(1e-3, 5000.0, "Hz")]


class Sweep(Part):
    """Default: the bins of a 2 s record at 10 kHz that the thesis' 10-500 Hz sweep excites (981 bins)."""

    f_min: Frequency = Field(10.0, description="[Hz]")
    f_max: Swept = Field(500.0, description="[Hz]")
    duration: Annotated[float, Within(1e-3, 1e4, "s")] = Field(
        2.0, description="record length [s]; bins are 1/duration apart"
    )
    sample_rate: Annotated[float, Within(1, 1e7, "Hz")] = Field(10000.0, description="[Hz]")
    frequencies: Annotated[tuple[Swept, ...], Field(max_length=MOST_BINS)] | None = Field(
        None, description="own list of frequencies [Hz] instead"
    )

    @model_validator(mode="after")
    def _band(self) -> Self:
        if self.f_max <= self.f_min:
            raise ValueError(f"f_max must exceed f_min = {self.f_min:g} Hz, got {self.f_max:g} Hz")
        if self.sample_rate < 2 * self.f_max:
            raise ValueError(f"sample_rate must be at least 2 f_max = {2 * self.f_max:g} Hz")
        if self.frequencies is not None and sorted(set(self.frequencies)) != list(self.frequencies):
            raise ValueError("frequencies must increase and be distinct")
        if self.frequencies is not None and not self.frequencies:
            raise ValueError("frequencies is empty; give at least one [Hz], or leave the key out for f_min to f_max")
        if (samples := self.duration * self.sample_rate) > MOST_SAMPLES:
            raise ValueError(
                f"duration times sample_rate is {samples:.3g} samples, expected at most {MOST_SAMPLES:,}; shorten it"
            )
        if (bins := self.duration * (self.f_max - self.f_min)) > MOST_BINS:
            raise ValueError(f"f_min to f_max holds {bins:.3g} bins, expected at most {MOST_BINS:,}; shorten duration")
        return self


class SolverOptions(Part):
    """How systems are factorised and the sweep is made."""

    backend: Literal["auto", "multifrontal", "pardiso", "superlu", "cudss"] = Field(
        "auto", description="direct solver; cudss: on an NVIDIA device, with the extra 'cudss'"
    )
    precision: Literal["auto", "double", "single"] = Field(
        "auto", description="of the factors, all solves being refined; auto: single, double where that is not enough"
    )
    sweep: Literal["reduced", "direct"] = Field(
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
    memory_limit: Annotated[float, Within(1e6, 1e16, "bytes")] = Field(
        12e9, description="refuse a solve estimated above this [bytes]"
    )
    discretisation_estimate: bool = Field(True, description="solve a coarser mesh too; without it the error is unknown")
