"""Renderers, their targets and their wavelet."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from .base import Frequency, Part, UserCode, Within, given, idle, only_in

Method = Literal["inverse filter", "funneling", "combination"] | UserCode


_OF_INVERSION = ("zeros", "regularisation", "regularisation_value")


class RickerWavelet(Part):
    """Ricker wavelet by its peak."""

    peak: Frequency = Field(250.0, description="frequency of the spectral peak [Hz]")


class SampledWavelet(Part):
    """Wavelet from a file of samples."""

    file: str = Field(description="CSV, WAV or NPY samples at the sweep's rate, relative to the scenario")
    idle_keys: ClassVar = only_in(RickerWavelet, "rendering.wavelet.file is given; leave out either")


def _wavelet(data: Any) -> str:
    return "as samples" if given(data, "file") else "as Ricker wavelet"


Wavelet = Annotated[
    Annotated[RickerWavelet, Tag("as Ricker wavelet")] | Annotated[SampledWavelet, Tag("as samples")],
    Discriminator(_wavelet),
]


class RenderingOptions(Part):
    """Renderers to run."""

    targets: tuple[str, ...] | Literal["all"] = Field("all", description="names of grid points to aim at, or all")
    methods: tuple[Method, ...] = Field(
        ("inverse filter", "funneling", "combination"),
        description="renderers to run; your own as module:Name of a file beside the scenario",
    )
    zeros: Literal["auto", "thesis", "search"] | tuple[str, ...] = Field(
        "auto",
        description="zero points; auto: the thesis' corners for up to four actuators on a rectangular grid, else all "
        "other points",
    )
    regularisation: Literal["auto", "rcond", "tikhonov", "lcurve", "discrepancy", "noise"] = Field(
        "auto",
        description="auto: rcond for up to four actuators, else noise for the accuracy asked (0.02 of finer ones)",
    )
    regularisation_value: Annotated[float, Field(ge=0, lt=1)] = Field(
        1e-12,
        description="relative to the largest singular value; noise: the error of G that is damped for, or its "
        "measurement's where that is larger",
    )
    window: Literal["wavelet", "record"] | tuple[float, float] = Field(
        "wavelet",
        description="what S is taken over: [start, end] in s about the wavelet's centre; wavelet: from 50 ms before it "
        "to 50 ms after it; record: the whole record, as in the thesis, with which S grows",
    )
    clearance: Annotated[float, Within(1e-4, 0.1, "m", zero=True)] = Field(
        9e-3,
        description="points nearer to a cone's rim count in no mean and verdict [m]: they move with the motor, so that "
        "S there is high and no focus; in the thesis' device the nearest point is 9.5 mm away",
    )
    wavelet: Wavelet = RickerWavelet()
    amplitude: Annotated[float, Within(1e-6, 1e6, "V or 1e-6 m")] = Field(
        1.0, description="funneling: drive amplitude A in eq. 6 [V]; inverse filter: target peak [1e-6 m]"
    )

    funneling_distance: Literal["spacing", "diagonal"] | Annotated[float, Within(1e-3, 1.0, "m")] = Field(
        "spacing",
        description="D of eq. 6, 'the maximum distances between the actuators': their spacing along each axis, so that "
        "an actuator under the target plays alone; the diagonal of the four around the target; or a length [m]",
    )

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        zeros = self.zeros if isinstance(self.zeros, tuple) else ()
        targets = self.targets if isinstance(self.targets, tuple) else ()
        for what, names in (("targets", targets), ("zeros", zeros), ("methods", self.methods)):
            if twice := sorted({n for n in names if names.count(n) > 1}):
                raise ValueError(f"{what} names {', '.join(twice)} twice; name each once")
        if self.targets != "all" and not targets and self.methods:
            raise ValueError("targets is empty; name points, or set targets = 'all', or methods = [] to render nothing")
        if both := sorted(set(zeros) & set(targets)):
            raise ValueError(f"point {both[0]} is both a target and a zero point; take it out of either")
        if self.regularisation == "auto" and self.regularisation_value != 1e-12:
            raise ValueError("regularisation_value needs a regularisation by name, not 'auto'")
        return self

    @model_validator(mode="after")
    def _funneling(self) -> Self:
        known = {"inverse filter", "funneling", "combination"}
        if self.funneling_distance != "spacing" and set(self.methods) <= known - {"funneling", "combination"}:
            raise idle(["funneling_distance"], "no method of rendering.methods is funneling; leave it out, or add it")
        return self

    @model_validator(mode="after")
    def _inversion(self) -> Self:
        keys = [key for key in _OF_INVERSION if getattr(self, key) != RenderingOptions.model_fields[key].default]
        if keys and set(self.methods) == {"funneling"}:
            raise idle(keys, "no method of rendering.methods inverts G; leave it out, or add 'inverse filter'")
        return self

    @model_validator(mode="after")
    def _window_increases(self) -> Self:
        if not isinstance(self.window, str) and self.window[1] <= self.window[0]:
            raise ValueError(f"window must be [start, end] in s with start < end, got {list(self.window)}")
        return self
