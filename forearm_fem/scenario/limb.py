"""The limb: its shape, also from a tape measure, its tissues, what holds it, and the sizes of its elements."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from ..errors import ScenarioError
from ..tissue import LAWS
from .base import Coordinate, Length, Part, UserCode, Within, choice, idle, only_in


class LayerThickness(Part):
    """One tissue layer under the skin's surface, listed from the outside inwards."""

    tissue: str = Field(description="name of a tissue in [tissues]")
    thickness: Length = Field(description="thickness [m], measured along the inward normal")


class Bone(Part):
    """A bone of circular section along the limb; its axis keeps its place relative to the limb's radius (taper)."""

    name: str = Field(description="for the report and for messages, e.g. radius")
    y: Coordinate = Field(description="axis offset across the limb [m]")
    depth: Length = Field(description="depth of its axis below the volar skin at the device [m]")
    diameter: Length = Field(description="[m]")


Layers = Annotated[tuple[LayerThickness, ...], Field(max_length=50)]
Bones = Annotated[tuple[Bone, ...], Field(max_length=20)]
Unit = Annotated[float, Within(1e-9, 1e3, "m per unit")]

# physics_data.md 1.3: dermis 1.0+-0.2 mm -> default 1.2 mm (section 9); skin+fat ring 3.0 mm (men).
DEFAULT_LAYERS = (
    LayerThickness(tissue="skin", thickness=1.2e-3),
    LayerThickness(tissue="fat", thickness=3.0e-3),
)
# Shah et al. 2019 (physics_data.md 1.3): 24.5/24.2/22.7/19.7/17.1 cm at 0/4/8/12/16 cm from the proximal site;
# the device sits where the circumference is 22.7 cm, x grows towards the elbow.
DEFAULT_CIRCUMFERENCE = ((-0.08, 0.171), (-0.04, 0.197), (0.0, 0.227), (0.04, 0.242), (0.08, 0.245))
# physics_data.md 1.3 [D]/[R]: diameter 14 mm, inter-axis 25-30 mm, volar cover 12-20 (radius), 15-25 mm (ulna).
DEFAULT_BONES = (
    Bone(name="radius", y=-0.014, depth=0.023, diameter=0.014),
    Bone(name="ulna", y=0.014, depth=0.027, diameter=0.014),
)


class ForearmLimb(Part):
    """Parametric segment: circumferences along the arm, elliptic sections, layers, muscle, radius and ulna."""

    shape: Literal["forearm"] = Field("forearm", description="a tapering forearm from circumferences")
    length: Length = Field(
        0.24,
        description="length of the segment kept, centred on the device [m]; where a scenario leaves it out, as long as "
        "its accuracy needs: 0.12 to 0.24, the whole forearm",
    )
    circumference: Annotated[
        tuple[tuple[Coordinate, Annotated[float, Within(1e-3, 6.0, "m")]], ...], Field(max_length=1000)
    ] = Field(DEFAULT_CIRCUMFERENCE, description="pairs (x, circumference) [m]; x = 0 under the device")
    aspect: Annotated[float, Within(0.5, 2.0)] = Field(1.0, description="width (y) over height (z) of the section")
    layers: Layers = Field(
        DEFAULT_LAYERS, description="tissue layers from the outside inwards; without any the core reaches the surface"
    )
    core: str = Field("muscle", description="tissue inside the layers")
    bones: Bones = Field(
        DEFAULT_BONES,
        description="round bones along the limb, held still unless supports.bone is elastic; [] for none",
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        xs = [x for x, _ in self.circumference]
        if len(xs) < 1 or sorted(set(xs)) != xs:
            raise ValueError("circumference needs at least one (x, circumference) pair, x increasing")
        return self


# Estimated truncation error (e_band of G) of the default forearm cut to a length [m] (decision 0016).
TRUNCATION = ((0.12, 0.040), (0.16, 0.022), (0.20, 0.014))
WHOLE_FOREARM = 0.24


def forearm_length(accuracy: float) -> float:
    """Shortest segment [m] whose truncation takes at most a quarter of ``accuracy``, else the whole forearm."""
    return next((length for length, error in TRUNCATION if error <= accuracy / 4), WHOLE_FOREARM)


class CylinderLimb(Part):
    """A straight round limb without taper; bones optional."""

    shape: Literal["cylinder"] = Field("cylinder", description="a straight round limb")
    length: Length = 0.12
    diameter: Length = 0.072
    layers: Layers = Field(
        DEFAULT_LAYERS, description="tissue layers from the outside inwards; without any the core reaches the surface"
    )
    core: str = Field("muscle", description="tissue inside the layers")
    bones: Bones = Field((), description="round bones along the limb, as for a forearm")


class SlabLimb(Part):
    """A flat block: layers on a core down to ``depth``; its sides and bottom are the truncation."""

    shape: Literal["slab"] = Field("slab", description="a flat block")
    length: Length = Field(0.12, description="extent in x [m]")
    width: Length = Field(0.09, description="extent in y [m]")
    depth: Length = Field(0.04, description="total thickness [m]")
    symmetry: tuple[Literal["x", "y"], ...] = Field(
        (), description="planes through the device centre on which only a half (or quarter) is modelled"
    )
    layers: Layers = Field(
        DEFAULT_LAYERS, description="tissue layers from the outside inwards; without any the core reaches the surface"
    )
    core: str = Field("muscle", description="tissue below the layers, down to depth")


class SurfacesLimb(Part):
    """The user's closed surfaces, one per tissue, the outer ones containing the inner ones."""

    shape: Literal["surfaces"] = Field("surfaces", description="closed surfaces from files, one per tissue")
    surfaces: dict[str, str] = Field(
        description="tissue -> STL, OBJ, PLY or VTP, relative to the scenario, from outside inwards; 'bone' is a bone"
    )
    unit: Unit = Field(1.0, description="metres per unit of the files (0.001 for millimetres)")


class MeshLimb(Part):
    """The user's tetrahedral mesh, anything meshio reads, with named or numbered regions."""

    shape: Literal["mesh"] = Field("mesh", description="a tetrahedral mesh from a file")
    file: str = Field(description="mesh file, relative to the scenario")
    regions: dict[str, str] = Field(
        description="region name or number in the file -> tissue ('bone' is a bone); '*' is all that is not named"
    )
    region_array: str | None = Field(
        default=None, description="cell data that holds the regions' numbers, where the file has several or odd names"
    )
    unit: Unit = Field(1.0, description="metres per unit of the file")


Limb = Annotated[ForearmLimb | CylinderLimb | SlabLimb | SurfacesLimb | MeshLimb, Field(discriminator="shape")]


def tissue_keys(limb: Limb) -> dict[str, str]:
    """Dotted key of the scenario -> tissue named there, for any shape."""
    layers = {f"limb.layers.{i}.tissue": layer.tissue for i, layer in enumerate(getattr(limb, "layers", ()))}
    core = {"limb.core": limb.core} if isinstance(limb, ForearmLimb | CylinderLimb | SlabLimb) else {}
    surfaces = {f"limb.surfaces.{name}": name for name in getattr(limb, "surfaces", ())}
    regions = {f"limb.regions.{key}": name for key, name in getattr(limb, "regions", {}).items()}
    return {**layers, **core, **surfaces, **regions}


def limb_tissues(limb: Limb) -> set[str]:
    """Tissues that a limb names."""
    return set(tissue_keys(limb).values())


def has_bone(limb: Limb) -> bool:
    """True if a limb has a bone."""
    return bool(getattr(limb, "bones", ())) or "bone" in limb_tissues(limb)


def layer_tissues(limb: Limb) -> set[str]:
    """Tissues of a limb's layers."""
    return {layer.tissue for layer in getattr(limb, "layers", ())}


SKIN = DEFAULT_LAYERS[0].thickness
_LEAST_FAT = 0.5e-3  # m: calipers do not resolve less
_NOMINAL = dict(DEFAULT_CIRCUMFERENCE)[0.0] / (2 * math.pi)  # radius that the default bones belong to
_COVER = sum(layer.thickness for layer in DEFAULT_LAYERS)


@dataclass(frozen=True)
class Tape:
    """Circumferences [m] at distances [m] from the proximal end (near the elbow), both measured along the arm.

    ``device`` [m] is the device's middle from that end; None: the middle of ``length``, from there to the wrist, as the
    thesis puts it. ``skinfold`` [m] is a caliper's reading, twice skin and fat: what it makes of fat is uncertain by
    x/÷ 1.6, for calipers over ultrasound read 1.35 to 3.4 from site to site (J Tech Educ Health Phys Educ 1:9, seen).
    """

    circumference: tuple[tuple[float, float], ...]
    length: float
    skinfold: float | None = None
    device: float | None = None

    def limb(self) -> dict[str, Any]:
        """Keys of ``[limb]``: circumferences about the device, layers, and bones drawn to the scale of the muscle.

        ScenarioError for places that do not increase or that the device lies beyond, for more fat than arm, and for a
        fold that is none.
        """
        if self.skinfold is not None and not 0 < self.skinfold < math.inf:
            raise ScenarioError(
                f"skinfold: expected a caliper's reading above 0 m, got {self.skinfold:g}; or leave it out"
            )
        at = self.length / 2 if self.device is None else self.device
        places = [d for d, _ in self.circumference]
        if len(places) < 2 or sorted(set(places)) != places:
            raise ScenarioError("a tape measure needs two or more distances from the elbow, each larger than the last")
        if not places[0] <= at <= places[-1]:
            raise ScenarioError(
                f"the device's middle is {at:g} m from the elbow, but circumferences are known from {places[0]:g} to "
                f"{places[-1]:g} m; measure further, or say where the device sits"
            )
        pairs = sorted((round(at - d, 6), c) for d, c in self.circumference)
        return {"circumference": pairs, "layers": self._layers(), "bones": self._bones(at)}

    def _layers(self) -> list[dict[str, Any]]:
        fat = DEFAULT_LAYERS[1].thickness if self.skinfold is None else max(self.skinfold / 2 - SKIN, _LEAST_FAT)
        return [{"tissue": "skin", "thickness": SKIN}, {"tissue": "fat", "thickness": round(fat, 6)}]

    def _bones(self, at: float) -> list[dict[str, Any]]:
        """The default bones, drawn to the scale of the muscle under the device."""
        places, girths = np.array(self.circumference, dtype=float).T
        cover = sum(layer["thickness"] for layer in self._layers())
        radius = float(np.interp(at, places, girths)) / (2 * math.pi)
        if cover >= radius:
            raise ScenarioError(
                f"skin and fat of {1e3 * cover:.3g} mm leave no muscle in an arm of {1e3 * radius:.3g} mm radius; "
                "is the skinfold in metres?"
            )
        scale = (radius - cover) / (_NOMINAL - _COVER)
        return [
            {"name": b.name, "y": round(scale * b.y, 6), "depth": round(cover + scale * (b.depth - _COVER), 6),
             "diameter": round(scale * b.diameter, 6)}
            for b in DEFAULT_BONES
        ]  # fmt: skip


def _shah(*girths: float, length: float) -> Tape:
    """An arm of Shah et al. 2019, girths [cm] every 4 cm; the device where the default forearm has it, at 8 cm."""
    return Tape(tuple((round(0.04 * k, 2), round(c / 100, 4)) for k, c in enumerate(girths)), length, device=0.08)


# Shah et al. 2019 (physics_data.md 1.3): the thinnest and the thickest of six arms, and the medians of all six.
BODIES: Mapping[str, Tape] = MappingProxyType(
    {
        "small": _shah(19.9, 18.6, 17.3, 15.2, 13.6, length=0.244),
        "median": _shah(25.25, 25.1, 22.55, 19.05, 16.85, length=0.2365),
        "large": _shah(27.9, 27.9, 26.6, 24.1, 20.3, length=0.267),
    }
)


# Tissue parameters of a scenario: a preset, and per tissue what differs from it.

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
    fibres: Annotated[float, Within(0.01, 100)] | None = Field(
        None,
        description="shear stiffness along the limb (x) over that across [-], loss alike, mu the geometric mean; 1 "
        "where left out: none; finite elements alone have fibres",
    )
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


# The finite elements of a scenario: sizes of the mesh, what holds the limb, and a library's patch of skin.

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
