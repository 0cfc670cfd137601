"""Tissue parameters of a scenario: a preset, and per tissue what differs from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from ..laws import LAWS
from .base import Length, Part, UserCode, Within, idle

Modulus = Annotated[float, Within(0.1, 1e13, "Pa")]
Viscosity = Annotated[float, Within(1e-9, 1e6, "Pa s", zero=True)]
PerLength = Annotated[float, Within(1e-9, 1e9, "N/m", zero=True)]
SheetViscosity = Annotated[float, Within(1e-12, 1e6, "N s/m", zero=True)]
Bending = Annotated[float, Within(1e-12, 1e3, "N m", zero=True)]
PerArea = Annotated[float, Within(1e-9, 1e4, "kg/m^2", zero=True)]
if TYPE_CHECKING:
    LawName = str
else:
    LawName = Literal[tuple(LAWS)]


class TissueOverride(Part):
    """Replaces single values of a preset's tissue, or defines a new tissue when complete."""

    density: Annotated[float, Within(100, 10000, "kg/m^3")] | None = Field(None, description="kg/m^3")
    mu: Modulus | None = Field(None, description="storage (shear) modulus [Pa]")
    eta: Viscosity | None = Field(None, description="shear viscosity [Pa s]")
    bulk: Modulus | Literal["incompressible"] | None = Field(None, description="bulk modulus [Pa]")
    law: LawName | UserCode | None = Field(
        None,
        description="law of the shear modulus; kelvin-voigt where left out; your own as module:Name of a file beside "
        "the scenario",
    )
    parameters: dict[str, float] = Field(default_factory=dict, description="of a law that are no keys here, in SI")
    exponent: Annotated[float, Within(0.001, 0.999)] | None = Field(None, description="springpot exponent [-]")
    mu_infinity: Modulus | None = Field(None, description="Zener high-frequency modulus [Pa]")


class Membrane(Part):
    """Thin stiff sheet on the skin (epidermis) as a surface term, not tetrahedra; pre-stress included."""

    stiffness: PerLength = Field(0.0, description="in-plane shear stiffness mu*h [N/m]; 350 kPa x 80 um = 28 N/m")
    viscosity: SheetViscosity = Field(0.0, description="in-plane eta*h [N s/m]")
    tension: PerLength = Field(0.0, description="pre-stress resultant [N/m]; 28-92 N/m (physics_data.md 2.5)")
    mass: PerArea = Field(0.0, description="mass per area [kg/m^2]; 80 um epidermis 0.088, tape 0.2-0.3")


class Patch(Part):
    """Adhesive tape on a rectangle of the skin about the origin: mass, in-plane and bending stiffness; off while all of
    these are 0."""

    length: Length = Field(0.040, description="along the limb, x [m]; the thesis' 4 x 4 cm of reflective tape")
    width: Length = Field(0.040, description="across the limb, y, seen from above [m]")
    mass: PerArea = Field(0.0, description="mass per area [kg/m^2]; tape 0.2-0.3")
    stiffness: PerLength = Field(
        0.0, description="in-plane shear stiffness mu*h = E h/3 [N/m]; E h of tape is of the order of 1e5 N/m"
    )
    viscosity: SheetViscosity = Field(0.0, description="in-plane eta*h [N s/m]")
    bending: Bending = Field(0.0, description="bending stiffness E h^3/9 [N m]; 2e-5 to 2e-3 for tape")

    @model_validator(mode="after")
    def _something(self) -> Self:
        sizes = {"length", "width"} & self.model_fields_set
        if sizes and not {"mass", "stiffness", "viscosity", "bending"} & self.model_fields_set:
            raise idle(sizes, "tissues.patch has neither mass nor stiffness; give it one, or leave the patch out")
        return self

    @property
    def is_on(self) -> bool:
        """True if there is anything on the skin."""
        return bool(self.mass or self.stiffness or self.viscosity or self.bending)


class Tissues(Part):
    """Choice of tissue parameters."""

    preset: Literal["default", "thesis", "zhang", "zener", "springpot"] = Field(
        "default",
        description="default = preset O, thesis = K (fitted to the thesis' appendix A), zhang = Z of physics_data.md "
        "9; zener and springpot have bounded damping (physics_data.md 1.4)",
    )
    override: dict[str, TissueOverride] = Field(
        default_factory=dict, description="tissue -> values that differ from the preset, or a whole new tissue"
    )
    membrane: Membrane = Membrane()
    patch: Patch = Patch()
