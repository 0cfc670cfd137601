"""What holds the limb and what happens at its cut ends."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag

from .base import Part, Within, choice, only_in


class Supports(Part):
    """Bones, the underside, and the cut ends (a slab's sides and bottom are cut ends too)."""

    bone: Literal["rigid", "elastic"] = Field("rigid", description="held still, or meshed as bone tissue")
    underside: Literal["free", "fixed", "foam"] = Field(
        "free",
        description="skin that faces down, 60 degrees to either side of straight down: free, held still, or on foam",
    )
    ends: Literal["absorb", "fixed", "free"] = Field("absorb", description="viscous dashpots rho c_s, clamped or free")


class FoamUnderside(Supports):
    """A limb that lies on foam."""

    underside: Literal["foam"] = Field("foam", description="skin that faces down lies on foam")
    foam_stiffness: Annotated[float, Within(1e-6, 1e15, "N/m^3", zero=True)] = Field(
        2.0e5, description="foam spring per area [N/m^3]"
    )
    foam_damping: Annotated[float, Within(1e-6, 1e12, "N s/m^3", zero=True)] = Field(
        1.0e3, description="foam dashpot per area [N s/m^3]"
    )


_WITHOUT_FOAM = only_in(FoamUnderside, "supports.underside is not 'foam'; leave it out, or set underside = 'foam'")


class FreeUnderside(Supports):
    """A limb whose underside touches nothing."""

    underside: Literal["free"] = Field(
        "free",
        description="skin that faces down, 60 degrees to either side of straight down: free, fixed (held still), or "
        "foam",
    )
    idle_keys: ClassVar = _WITHOUT_FOAM


class FixedUnderside(Supports):
    """A limb whose underside is held still."""

    underside: Literal["fixed"] = Field("fixed", description="skin that faces down is held still")
    idle_keys: ClassVar = _WITHOUT_FOAM


def _underside(data: Any) -> str:
    return f"as {choice(data, 'supports.underside', ('free', 'fixed', 'foam'))} underside"


AnySupports = Annotated[
    Annotated[FreeUnderside, Tag("as free underside")]
    | Annotated[FixedUnderside, Tag("as fixed underside")]
    | Annotated[FoamUnderside, Tag("as foam underside")],
    Discriminator(_underside),
]
