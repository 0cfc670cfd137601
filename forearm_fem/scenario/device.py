"""The device: four voice coils with cones in one housing, or plain sources; and the grid of points read."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from .base import Length, NonNegative, Part, Positive


class VoiceCoil(Part):
    """Tectonic TEAX14C02-8, linear model (physics_data.md 4)."""

    resistance: Positive = Field(7.8, description="Re [ohm], data sheet via a distributor")
    inductance: NonNegative = Field(0.05e-3, description="Le [H]; 0.03-0.1 mH, irrelevant below 1 kHz")
    force_factor: Positive = Field(2.4, description="Bl [T m], data sheet via a distributor")
    moving_mass: Positive = Field(0.35e-3, description="Mms [kg]; derived, 0.2-0.6 g, low confidence")
    resonance: Positive = Field(580.0, description="f0 of the free coil on its suspension [Hz], thesis")
    quality: Positive = Field(3.0, description="mechanical quality factor Qms [-]; 2-6")


class Cone(Part):
    """Rigid cone between coil and skin."""

    mass: NonNegative = Field(0.4e-3, description="[kg]")
    radius: Annotated[float, Field(gt=0, le=0.05)] = Field(
        3.5e-3, description="radius of the contact disc [m]; 14 mm face reduced fourfold in area -> 7 mm"
    )
    contact: Literal["bonded", "frictionless", "pressure"] = Field(
        "bonded", description="rigid disc bonded, rigid disc without friction, or uniform pressure"
    )


class Housing(Part):
    """Rigid shell shared by all actuators: heave, roll and pitch on strap and foam."""

    mass: Positive = Field(0.090, description="4 x 12.5 g + 40 g shell [kg] (physics_data.md 9)")
    gyration: Length = Field(0.030, description="radius of gyration about x and y [m]; our estimate for a 70 mm shell")
    strap_stiffness: NonNegative = Field(2000.0, description="strap and foam, total along z [N/m]; our estimate")
    strap_loss: NonNegative = Field(0.2, description="loss factor of strap and foam [-]; our estimate")
    strap_radius: Length = Field(0.035, description="lever of the strap's rotational stiffness [m]")
    fixed: bool = Field(False, description="hold the housing still: no mechanical cross-talk")


class Device(Part):
    """Contacts on the volar skin, row by row: (-x,-y), (-x,+y), (+x,-y), (+x,+y)."""

    spacing: Annotated[float, Field(gt=0, le=0.3)] = Field(0.045, description="centre distance [m] (thesis III.A)")
    contacts: tuple[tuple[float, float], ...] | None = Field(
        None, description="own contact centres (x, y) [m] instead of the 2x2 array"
    )
    rotation: float = Field(0.0, description="of the whole device about z [rad]")
    drive: Literal["voltage", "force", "displacement"] = Field(
        "voltage", description="what a unit drive is: 1 V at one amplifier, 1 N on one contact, or 1 m of one contact"
    )
    out_of_contact: tuple[str, ...] = Field((), description="names of actuators that do not touch, e.g. ['A1']")
    coil: VoiceCoil = VoiceCoil()
    cone: Cone = Cone()
    housing: Housing = Housing()
    max_voltage: Positive = Field(2.5, description="per actuator [V]; 0.8 W in 7.8 ohm is 2.5 V rms")
    max_power: Positive = Field(0.8, description="per actuator [W] (data sheet)")

    @model_validator(mode="after")
    def _names(self) -> Self:
        known = {f"A{i + 1}" for i in range(len(self.centres))}
        if unknown := set(self.out_of_contact) - known:
            raise ValueError(f"out_of_contact names {sorted(unknown)}, known are {sorted(known)}")
        return self

    @property
    def centres(self) -> tuple[tuple[float, float], ...]:
        """Contact centres in the device's own frame (x, y) [m]."""
        half = self.spacing / 2
        return self.contacts or ((-half, -half), (-half, half), (half, -half), (half, half))


class Grid(Part):
    """Points on the skin whose normal displacement is read, numbered from 1 row by row (rows along +x)."""

    rows: Annotated[int, Field(ge=1, le=50)] = Field(3, description="number of rows, along x")
    columns: Annotated[int, Field(ge=1, le=50)] = Field(3, description="number of columns, along y")
    pitch: Annotated[float, Field(gt=0, le=0.1)] = Field(
        13.3e-3, description="[m]; the thesis' 1.33 cm (its '4x4 cm' contradicts it)"
    )
    points: tuple[tuple[float, float], ...] | None = Field(None, description="own points (x, y) [m] instead")

    @property
    def places(self) -> tuple[tuple[float, float], ...]:
        """The points in the device's own frame (x, y) [m]."""
        if self.points is not None:
            return self.points
        x0, y0 = (self.rows - 1) / 2, (self.columns - 1) / 2
        return tuple(
            ((r - x0) * self.pitch, (c - y0) * self.pitch) for r in range(self.rows) for c in range(self.columns)
        )
