"""Measurement of the transfer matrix: sweep, sensor, channels, averaging and safety, and units of what is measured."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..errors import DataError
from ..typing import ComplexArray, FloatArray
from .base import Fraction, Part, Voltage, Within

Quantity = Literal["displacement", "velocity", "acceleration"]
Estimator = Literal["fourier", "H1", "H2", "Hv", "deconvolution"]
Seconds = Annotated[float, Within(-100.0, 100.0, "s")]


class SensorOptions(Part):
    """Meaning of the vibrometer's output; nothing is guessed, so both keys are needed for real hardware."""

    quantity: Quantity | None = Field(default=None, description="what the sensor's voltage is proportional to")
    sensitivity: Annotated[float, Within(1e-12, 1e12, "V per m, m/s or m/s^2")] | None = Field(
        default=None, description="V per m, per m/s or per m/s^2 (OFV-5000 at 10 mm/s/V: 100 V per m/s)"
    )
    inverted: bool = Field(default=False, description="positive voltage means motion into the skin")
    delay: Seconds = Field(default=0.0, description="delay of the sensor's own electronics [s], removed from G")


class DaqOptions(Part):
    """Channels and safety of the analogue hardware."""

    outputs: tuple[str, ...] = Field(
        default=("cDAQ1Mod1/ao0", "cDAQ1Mod1/ao1", "cDAQ1Mod1/ao2", "cDAQ1Mod1/ao3"),
        description="one per actuator, in order",
    )
    sensor: str = Field(default="cDAQ1Mod2/ai0", description="input channel of the vibrometer")
    loopback: str | None = Field(
        default=None, description="input channel wired to the drive; None: what was sent is trusted"
    )
    clock: str = Field(
        default="inputs",
        min_length=1,
        description="what keeps outputs and inputs together: 'inputs' (the input module's sample clock updates the "
        "outputs), 'trigger' (both on the chassis' timebase, the outputs started by the inputs' start trigger), or a "
        "terminal that clocks the inputs, e.g. /cDAQ1/ao/SampleClock",
    )
    input_range: Voltage = Field(default=10.0, description="full scale of the inputs, plus and minus [V]")
    output_range: Voltage = Field(default=10.0, description="full scale of the outputs, plus and minus [V]")
    amplifier_gain: Annotated[float, Within(1e-6, 1e6)] = Field(
        default=1.0, description="V at the actuator per V at the output"
    )
    latency: Seconds = Field(
        default=0.0, description="known delay from output to input [s], removed from G; 0 with a loopback"
    )
    block: Annotated[int, Within(16, 1_000_000)] = Field(default=1000, description="samples exchanged at a time")
    max_voltage: Voltage = Field(default=2.5, description="at the actuator; a drive above it is refused [V]")
    fade: Annotated[float, Within(1e-9, 100.0, "s", zero=True)] = Field(
        default=0.005, description="ramp at the start, the end and an emergency stop [s]"
    )


class RigOptions(Part):
    """Errors that a real rig adds to G; none by default. Calibrations through a virtual device have it, and predictions
    draw it."""

    noise: Annotated[float, Within(1e-12, 1.0, "m/s/sqrt(Hz)", zero=True)] = Field(
        default=0.0, description="of the vibrometer, one-sided velocity spectrum [m/s/sqrt(Hz)]"
    )
    motion: Annotated[float, Within(1e-9, 0.01, "m", zero=True)] = Field(
        default=0.0,
        description="slow motion of the arm: rms way between the ends of one record [m]; where displacement is "
        "recorded, the jump between these leaks into every bin",
    )
    gain: Annotated[float, Field(ge=0, lt=1)] = Field(
        default=0.0, description="of contact and laser from one sweep to the next, rms of ln |G|, each entry its own"
    )
    phase: Annotated[float, Within(1e-6, 3.0, "rad", zero=True)] = Field(
        default=0.0, description="the same of the phase [rad]"
    )


class MeasurementOptions(Part):
    """Calibration: an exponential sine sweep per actuator and point, repeated without a pause.

    Band, duration and rate are the scenario's ``sweep``. One period is sent first and thrown away. What
    is kept is periodic, and the division by the drive's spectrum is free of leakage.
    """

    amplitude: Voltage = Field(default=1.0, description="of the sweep at the actuator [V]")
    repeats: Annotated[int, Within(1, 1000)] = Field(
        default=4, description="periods kept; coherence and deviation need 2"
    )
    lead_in: Annotated[int, Within(0, 100)] = Field(default=1, description="periods thrown away before")
    taper: Annotated[float, Field(ge=0, le=0.25)] = Field(
        default=0.01, description="part of the sweep faded in, and out"
    )
    estimator: Estimator = Field(
        "H1",
        description="of G from drive and response: fourier is the thesis' Y/X; H1 expects noise on the "
        "response, H2 on the drive, Hv on both; deconvolution is regularised and windowed",
    )
    regularisation: Annotated[float, Field(ge=0, lt=1)] = Field(
        default=1e-6, description="deconvolution: added to |X|^2, relative to its largest value"
    )
    window: Annotated[float, Within(1e-6, 1e4, "s")] | None = Field(
        default=None, description="deconvolution: part of the impulse response kept [s]"
    )
    energy_floor: Fraction = Field(
        default=2e-2, description="bins whose drive is below this part of its largest are masked"
    )
    signal_floor: Annotated[float, Within(1e-6, 1e6)] = Field(
        default=2.0, description="entries below this many standard deviations are marked invalid"
    )
    min_coherence: Annotated[float, Field(ge=0, lt=1)] = Field(
        default=0.0, description="entries below are marked invalid"
    )
    max_drift: Annotated[float, Within(1e-9, 1e6)] = Field(
        default=0.05, description="change between the first and last repeat that is reported [-]"
    )
    sensor: SensorOptions = SensorOptions()
    rig: RigOptions = RigOptions()
    daq: DaqOptions = DaqOptions()

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.amplitude > self.daq.max_voltage:
            raise ValueError(f"amplitude {self.amplitude:g} V exceeds daq.max_voltage {self.daq.max_voltage:g} V")
        if self.estimator != "deconvolution" and self.window is not None:
            raise ValueError("window has an effect only with estimator = 'deconvolution'")
        return self


# Units of measured transfer functions, as people write them: "mm/V", "(um/s)/mV", "m/s^2/N", "g/N".

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
