"""Which renderers run on G, at which targets, with which wavelet."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .base import Part, Positive

Method = Literal["inverse filter", "funneling", "combination"]


class WaveletOptions(Part):
    """Ricker wavelet, or samples from a file."""

    peak: Positive = Field(250.0, description="frequency of the spectral peak [Hz]")
    file: str | None = Field(None, description="CSV, WAV or NPY samples at the sweep's rate, relative to the scenario")


class Rendering(Part):
    """Renderers to run."""

    targets: tuple[str, ...] | Literal["all"] = Field("all", description="names of grid points to aim at, or all")
    methods: tuple[Method, ...] = Field(("inverse filter", "funneling", "combination"), description="renderers to run")
    zeros: Literal["thesis", "search"] | tuple[str, ...] = Field("thesis", description="zero points")
    regularisation: Literal["rcond", "tikhonov", "lcurve", "discrepancy"] = Field(
        "rcond",
        description="how the inverse filter's least squares are held: cut off, damped, damped where the "
        "L-curve bends, or as the noise of a measured G asks",
    )
    regularisation_value: Annotated[float, Field(ge=0, lt=1)] = Field(
        1e-12, description="relative to the largest singular value"
    )
    wavelet: WaveletOptions = WaveletOptions()
    amplitude: Positive = Field(
        1.0, description="funneling: drive amplitude A in eq. 6 [V]; inverse filter: target peak [1e-6 m]"
    )
