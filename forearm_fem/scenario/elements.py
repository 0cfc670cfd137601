"""The finite elements of a scenario: sizes of the mesh, what holds the limb, and a library's patch of skin."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Discriminator, Field, Tag

from .base import Part, Within, choice, only_in

Element = Literal["P1", "P2", "P2/P3", "P3"]
Size = Annotated[float, Within(1e-4, 2.0, "m")]


class MeshOptions(Part):
    """Element sizes [m]; ``None`` means: chosen from the scenario's ``accuracy``."""

    size_contact: Size | None = Field(None, description="edge length under and beside contacts [m]")
    size_grid: Size | None = Field(None, description="edge length between contacts and grid points [m]")
    size_far: Size | None = Field(None, description="edge length far from all ports [m]")
    grading: Annotated[float, Within(0.01, 1.0)] = Field(0.3, description="growth of size per metre of distance")
    sublayers: dict[str, Annotated[int, Within(1, 20)]] = Field(
        default_factory=dict, description="element layers through each tissue layer, e.g. {skin = 1, fat = 2}"
    )
    element: Element | Literal["auto"] = Field(
        "auto",
        description="displacement order, pressure is one lower; P2/P3 is third order around the ports and second "
        "elsewhere; auto: P2/P3 on forearm and cylinder, and on slabs without size_grid where accuracy is 0.05 or "
        "better, cones are rigid, or a point is less than 8 mm from the rim of a disc of pressure",
    )
    min_quality: Annotated[float, Within(1e-6, 0.999)] = Field(
        0.02, description="smallest mean-ratio quality accepted (1 = regular tetrahedron)"
    )
    max_elements: Annotated[float, Within(1, 1e10)] = Field(2e6, description="refuse larger meshes than this")


class LibraryPatch(Part):
    """A rectangle of volar skin about the origin, in lengths along the skin; discs must lie on it whole."""

    length: Annotated[float, Within(0.01, 0.4, "m")] = Field(0.08, description="of the patch along the limb [m]")
    width: Annotated[float, Within(0.01, 0.4, "m")] = Field(
        0.064, description="of the patch across the limb [m]; discs stand on skin at most 60 degrees from facing up"
    )
    step: Annotated[float, Within(0.001, 0.02, "m")] = Field(
        0.004, description="between the loads that are solved for [m]; what lies between them is interpolated"
    )


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
        2.0e5,
        description="foam spring per area [N/m^3], 1e4 to 1e7; beyond, take underside = 'fixed'",
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
