"""What holds the limb and what happens at its cut ends."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .base import Part, Within


class Supports(Part):
    """Bones, the underside, and the cut ends (a slab's sides and bottom are cut ends too)."""

    bone: Literal["rigid", "elastic"] = Field("rigid", description="held still, or meshed as bone tissue")
    underside: Literal["free", "fixed", "foam"] = Field(
        "free",
        description="skin that faces down, 60 degrees to either side of straight down: free, held still, or on foam",
    )
    foam_stiffness: Annotated[float, Within(1e-6, 1e15, "N/m^3", zero=True)] = Field(
        2.0e5, description="foam spring per area [N/m^3]"
    )
    foam_damping: Annotated[float, Within(1e-6, 1e12, "N s/m^3", zero=True)] = Field(
        1.0e3, description="foam dashpot per area [N s/m^3]"
    )
    ends: Literal["absorb", "fixed", "free"] = Field("absorb", description="viscous dashpots rho c_s, clamped or free")
