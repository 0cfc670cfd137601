"""The device: voice coils with cones in one housing, or plain sources, in rows or anywhere; and the grid read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from .actuators import ACTUATORS, ActuatorName, beneath
from .base import Length, Mass, Part, Voltage, Within, choice, given, idle, only_in

MOST_ACTUATORS = 100
NEAREST = 2e-4  # [m] between two grid points: closer ones are one place, and no mesh is that fine

Place = Annotated[float, Within(-0.5, 0.5, "m")]  # in the device's own frame
Spring = Annotated[float, Within(1e-3, 1e12, "N/m")]
Gain = Annotated[float, Within(1e-3, 1e3)]


class VoiceCoil(Part):
    """Tectonic TEAX14C02-8, linear model (physics_data.md 4)."""

    resistance: Annotated[float, Within(1e-4, 1e6, "ohm")] = Field(
        7.8, description="Re [ohm], data sheet via a distributor"
    )
    inductance: Annotated[float, Within(1e-12, 1e3, "H", zero=True)] = Field(
        0.05e-3, description="Le [H]; 0.03-0.1 mH, irrelevant below 1 kHz"
    )
    force_factor: Annotated[float, Within(1e-6, 1e4, "T m")] = Field(
        2.4, description="Bl [T m], data sheet via a distributor"
    )
    moving_mass: Mass = Field(0.35e-3, description="Mms [kg]; derived, 0.2-0.6 g, low confidence")
    resonance: Annotated[float, Within(1e-2, 1e5, "Hz")] = Field(
        580.0, description="f0 of the free coil on its suspension [Hz], thesis"
    )
    quality: Annotated[float, Within(1e-3, 1e5)] = Field(3.0, description="mechanical quality factor Qms [-]; 2-6")


class ConeFace(Part):
    """Round face that touches the skin."""

    radius: Annotated[float, Within(1e-4, 0.05, "m")] = Field(
        3.5e-3, description="radius of the contact disc [m]; 14 mm face reduced fourfold in area -> 7 mm"
    )
    contact: Literal["bonded", "frictionless", "pressure"] = Field(
        "bonded", description="rigid disc bonded, rigid disc without friction, or uniform pressure"
    )


class Cone(ConeFace):
    """Rigid cone between coil and skin."""

    mass: Annotated[float, Within(1e-9, 1e3, "kg", zero=True)] = Field(0.4e-3, description="[kg]")


class Housing(Part):
    """Rigid shell shared by all actuators: heave, roll and pitch on strap and foam."""

    mass: Mass = Field(0.090, description="4 x 12.5 g + 40 g shell [kg] (physics_data.md 9)")
    gyration: Length = Field(0.030, description="radius of gyration about x and y [m]; our estimate for a 70 mm shell")
    strap_stiffness: Annotated[float, Within(1e-9, 1e12, "N/m", zero=True)] = Field(
        2000.0, description="strap and foam, total along z [N/m]; our estimate"
    )
    strap_loss: Annotated[float, Within(1e-9, 1e3, zero=True)] = Field(
        0.2, description="loss factor of strap and foam [-]; our estimate"
    )
    strap_radius: Length = Field(0.035, description="lever of the strap's rotational stiffness [m]")
    fixed: Literal[False] = Field(False, description="true holds the housing still: no mechanical cross-talk")
    skin_share: Annotated[float, Within(1e-6, 1.0, zero=True)] = Field(
        0.0, description="share of the shell's motion that the skin at the grid points follows [-]; on top of the waves"
    )


class HeldHousing(Part):
    """A shell that is held still: no mechanical cross-talk."""

    fixed: Literal[True] = Field(True, description="the housing is held still")
    skin_share: ClassVar[float] = 0.0  # of no motion
    idle_keys: ClassVar = {
        key: "device.housing.fixed holds it still; leave out either" for key in Housing.model_fields if key != "fixed"
    }


def _held(data: Any) -> str:
    return "as held housing" if choice(data, "device.housing.fixed", (False, True)) else "as housing"


AnyHousing = Annotated[
    Annotated[Housing, Tag("as housing")] | Annotated[HeldHousing, Tag("as held housing")], Discriminator(_held)
]
Count = Annotated[int, Within(1, 20)]
Drive = Literal["voltage", "force", "displacement"]


class ActuatorArray(Part):
    """Parts of any device, whatever drives it and wherever its actuators are."""

    rotation: Annotated[float, Within(-6.3, 6.3, "rad")] = Field(
        0.0, description="of the contacts and the grid points together, about z [rad]"
    )
    actuator: ActuatorName = Field(
        "TEAX14C02-8", description="a preset with sources: sets those of the keys below that are left out"
    )
    drive: Drive = Field(
        "voltage", description="what a unit drive is: 1 V at one amplifier, 1 N on one contact, or 1 m of one contact"
    )
    out_of_contact: tuple[str, ...] = Field((), description="names of actuators that do not touch, e.g. ['A1']")
    contact_springs: Annotated[dict[str, Spring], Field(max_length=100)] = Field(
        default_factory=dict,
        description="actuator -> spring between its cone and the skin [N/m], e.g. {A1 = 50.0}: partial contact; none "
        "where left out",
    )
    gains: Annotated[dict[str, Gain], Field(max_length=100)] = Field(
        default_factory=dict,
        description="actuator -> factor on its drive [-], e.g. {A1 = 0.9}: channels stronger or weaker than stated; 1 "
        "where left out",
    )
    cone: ConeFace = ConeFace()

    @model_validator(mode="after")
    def _names(self) -> Self:
        if (count := len(self.centres)) > MOST_ACTUATORS:
            raise ValueError(f"rows and columns make {count} actuators, expected at most {MOST_ACTUATORS}")
        known = {f"A{i + 1}" for i in range(count)}
        for key in ("out_of_contact", "contact_springs", "gains"):
            if unknown := set(getattr(self, key)) - known:
                raise ValueError(f"{key} names {sorted(unknown)}, known are {sorted(known)}")
        if lifted := sorted(set(self.contact_springs) & set(self.out_of_contact)):
            raise idle(
                [f"contact_springs.{name}" for name in lifted],
                f"device.out_of_contact names {', '.join(lifted)}; leave it out of either",
            )
        return self

    @property
    def centres(self) -> tuple[tuple[float, float], ...]:
        """Contact centres in the device's own frame (x, y) [m]."""
        raise NotImplementedError

    @property
    def first_in_contact(self) -> int:
        """Number, from 0, of the first actuator that touches: the source of waves where one is looked at."""
        return next(k for k in range(len(self.centres)) if f"A{k + 1}" not in self.out_of_contact)


class VoltageDevice(ActuatorArray):
    """Voice coils at amplifiers, with their cones in one housing; a unit drive is 1 V."""

    drive: Literal["voltage"] = Field(
        "voltage", description="what a unit drive is: 1 V at one amplifier; force: 1 N on one contact; displacement: 1 "
        "m of one contact",
    )  # fmt: skip
    coil: VoiceCoil = VoiceCoil()
    cone: Cone = Cone()
    housing: AnyHousing = Housing()
    max_voltage: Voltage = Field(2.5, description="per actuator [V]; 0.8 W in 7.8 ohm is 2.5 V rms")
    max_power: Annotated[float, Within(1e-12, 1e6, "W")] = Field(0.8, description="per actuator [W] (data sheet)")


def _without_coils(drive: str) -> dict[str, str]:
    why = f"device.drive = '{drive}', and they belong to voice coils; leave out either"
    return dict.fromkeys(("coil", "housing", "max_voltage", "max_power"), why)


class WeightlessFace(ConeFace):
    """Face of an actuator whose force or displacement is given, so that its cone's mass moves nothing."""

    idle_keys: ClassVar = only_in(Cone, "device.drive is not 'voltage'; leave out either")


class ForceDevice(ActuatorArray):
    """Sources of force; a unit drive is 1 N on one contact."""

    drive: Literal["force"] = Field("force", description="a unit drive is 1 N on one contact")
    cone: WeightlessFace = WeightlessFace()
    idle_keys: ClassVar = _without_coils("force")


class DisplacementDevice(ActuatorArray):
    """Sources of displacement; a unit drive is 1 m of one contact."""

    drive: Literal["displacement"] = Field("displacement", description="a unit drive is 1 m of one contact")
    cone: WeightlessFace = WeightlessFace()
    idle_keys: ClassVar = _without_coils("displacement")


class Rows(Part):
    """Contacts on the volar skin, row by row; the thesis' are (-x,-y), (-x,+y), (+x,-y), (+x,+y)."""

    rows: Count = Field(2, description="number of rows of actuators, along x")
    columns: Count | Annotated[tuple[Count, ...], Field(min_length=1)] = Field(
        2, description="actuators in a row, along y; or one number per row, each row centred: [2, 3, 2] is staggered"
    )
    spacing: Annotated[float, Within(2e-4, 0.3, "m")] = Field(
        0.045, description="distance of rows along x, and of actuators in a row unless spacing_y is given [m] (thesis "
        "III.A)",
    )  # fmt: skip
    spacing_y: Annotated[float, Within(2e-4, 0.3, "m")] | None = Field(
        None, description="distance of the actuators in a row, along y [m]; spacing unless given"
    )
    stagger: Annotated[float, Within(-1, 1)] = Field(
        0.0, description="rows are moved along y in turn by minus and plus half this share of spacing_y [-]"
    )

    @model_validator(mode="after")
    def _rows(self) -> Self:
        if isinstance(self.columns, tuple) and len(self.columns) != self.rows:
            raise ValueError(f"columns gives {len(self.columns)} rows, but rows is {self.rows}; make them agree")
        if self.spacing_y is not None and self.columns in {1, (1,) * self.rows} and not self.stagger:
            raise idle(["spacing_y"], "no row has two actuators; leave it out, or raise device.columns")
        return self

    @property
    def centres(self) -> tuple[tuple[float, float], ...]:
        """Contact centres in the device's own frame (x, y) [m]."""
        counts = self.columns if isinstance(self.columns, tuple) else (self.columns,) * self.rows
        return places_in_rows(counts, self.spacing, self.spacing_y or self.spacing, self.stagger)


class Places(Part):
    """Contacts on the volar skin, each at a place of its own."""

    contacts: Annotated[tuple[tuple[Place, Place], ...], Field(max_length=MOST_ACTUATORS)] = Field(
        description="own contact centres (x, y) [m] instead of rows"
    )

    @model_validator(mode="after")
    def _some(self) -> Self:
        if not self.contacts:
            raise ValueError("contacts is empty; give at least one (x, y) [m], or leave the key out for rows")
        return self

    @property
    def centres(self) -> tuple[tuple[float, float], ...]:
        """Contact centres in the device's own frame (x, y) [m]."""
        return self.contacts


_NO_ROWS = only_in(Rows, "device.contacts is given; leave out either")


class VoltageRows(Rows, VoltageDevice):
    """Voice coils in rows: the thesis' device."""


class VoltagePlaces(Places, VoltageDevice):
    """Voice coils, each at a place of its own."""

    idle_keys: ClassVar = _NO_ROWS


class ForceRows(Rows, ForceDevice):
    """Sources of force in rows."""

    idle_keys: ClassVar = ForceDevice.idle_keys


class ForcePlaces(Places, ForceDevice):
    """Sources of force, each at a place of its own."""

    idle_keys: ClassVar = {**ForceDevice.idle_keys, **_NO_ROWS}


class DisplacementRows(Rows, DisplacementDevice):
    """Sources of displacement in rows."""

    idle_keys: ClassVar = DisplacementDevice.idle_keys


class DisplacementPlaces(Places, DisplacementDevice):
    """Sources of displacement, each at a place of its own."""

    idle_keys: ClassVar = {**DisplacementDevice.idle_keys, **_NO_ROWS}


def _with_preset(data: Any) -> Any:
    """The actuator's own keys where they are left out, as far as they belong to what drives it."""
    preset = ACTUATORS.get(str(data.get("actuator"))) if isinstance(data, Mapping) else None
    if preset is None:
        return data
    drive = data.get("drive", preset.drive)
    return beneath({k: v for k, v in preset.keys.items() if drive == "voltage" or k in ("drive", "cone")}, data)


def _device(data: Any) -> str:
    drive = choice(data, "device.drive", ("voltage", "force", "displacement"))
    return f"as {drive} device {'at places' if given(data, 'contacts') else 'in rows'}"


Device = Annotated[
    Annotated[VoltageRows, Tag("as voltage device in rows")]
    | Annotated[VoltagePlaces, Tag("as voltage device at places")]
    | Annotated[ForceRows, Tag("as force device in rows")]
    | Annotated[ForcePlaces, Tag("as force device at places")]
    | Annotated[DisplacementRows, Tag("as displacement device in rows")]
    | Annotated[DisplacementPlaces, Tag("as displacement device at places")],
    Discriminator(_device),
    BeforeValidator(_with_preset),
]


class _Read(Part):
    """Direction of the motion read at the points of a grid."""

    direction: Literal["normal", "vertical"] = Field(
        "normal",
        description="of the motion that is read: the skin's normal at each point, or z at all of them, as a laser that "
        "keeps its direction reads a round arm",
    )


class GridRows(_Read):
    """Points on the skin whose displacement is read, numbered from 1 row by row (rows along +x)."""

    rows: Annotated[int, Within(1, 50)] = Field(3, description="number of rows, along x")
    columns: Annotated[int, Within(1, 50)] = Field(3, description="number of columns, along y")
    pitch: Annotated[float, Within(2e-4, 0.1, "m")] = Field(
        13.3e-3, description="of the rows, and of the columns unless pitch_y is given [m]; the thesis' 1.33 cm (its "
        "'4x4 cm' contradicts it)",
    )  # fmt: skip
    pitch_y: Annotated[float, Within(2e-4, 0.1, "m")] | None = Field(
        None, description="of the columns, along y [m]; pitch unless given"
    )

    @model_validator(mode="after")
    def _columns(self) -> Self:
        if self.pitch_y is not None and self.columns == 1:
            raise idle(["pitch_y"], "no row has two points; leave it out, or raise grid.columns")
        return self

    @property
    def places(self) -> tuple[tuple[float, float], ...]:
        """The points in the device's own frame (x, y) [m]."""
        return places_in_rows((self.columns,) * self.rows, self.pitch, self.pitch_y or self.pitch)


class GridPlaces(_Read):
    """Points on the skin whose displacement is read, each at a place of its own, numbered from 1."""

    points: Annotated[tuple[tuple[Place, Place], ...], Field(max_length=2500)] = Field(
        description="own points (x, y) [m] instead of rows and columns"
    )
    idle_keys: ClassVar = only_in(GridRows, "grid.points is given; leave out either")

    @model_validator(mode="after")
    def _apart(self) -> Self:
        if not self.points:
            raise ValueError("points is empty; give at least one (x, y) [m], or leave the key out for rows and columns")
        if close := _closest(self.points):
            i, j, gap = close
            raise ValueError(
                f"points {i + 1} and {j + 1} are {gap * 1e3:.3g} mm apart, expected {NEAREST * 1e3:g} mm or more; "
                "move or remove one"
            )
        return self

    @property
    def places(self) -> tuple[tuple[float, float], ...]:
        """The points in the device's own frame (x, y) [m]."""
        return self.points


def _grid(data: Any) -> str:
    return "as points" if given(data, "points") else "as rows of points"


Grid = Annotated[
    Annotated[GridRows, Tag("as rows of points")] | Annotated[GridPlaces, Tag("as points")], Discriminator(_grid)
]


def _closest(points: Sequence[tuple[float, float]]) -> tuple[int, int, float] | None:
    """Indices and distance [m] of the first two points closer than :data:`NEAREST`; None where there are none."""
    cells: dict[tuple[int, int], list[int]] = {}
    for i, (x, y) in enumerate(points):
        column, row = int(x // NEAREST), int(y // NEAREST)
        beside = [j for a in (-1, 0, 1) for b in (-1, 0, 1) for j in cells.get((column + a, row + b), ())]
        for j in beside:
            if (gap := math.dist(points[j], (x, y))) < NEAREST * (1 - 1e-9):
                return j, i, gap
        cells.setdefault((column, row), []).append(i)
    return None


def places_in_rows(
    counts: Sequence[int], along: float, across: float, stagger: float = 0.0
) -> tuple[tuple[float, float], ...]:
    """Places (x, y) [m] of rows ``along`` [m] apart in x, with ``counts`` places each, ``across`` [m] apart in y.

    Rows as a whole are centred on x = 0, each row on y = 0; then the first, third, ... move by -``stagger``/2 of
    ``across`` along y, the others by as much the other way.
    """
    first, places = (len(counts) - 1) / 2, list[tuple[float, float]]()
    for r, count in enumerate(counts):
        aside = (stagger if r % 2 else -stagger) / 2
        places += (((r - first) * along, (c - (count - 1) / 2 + aside) * across) for c in range(count))
    return tuple(places)
