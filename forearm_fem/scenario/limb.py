"""The limb: parametric forearm, slab, cylinder, the user's surfaces or mesh; and a forearm from a tape measure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..errors import ScenarioError
from .base import Coordinate, Length, Part, Within


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
