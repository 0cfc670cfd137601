"""The whole scenario: one frozen object from which everything follows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from .base import Name, Part, Within
from .device import Device, Grid
from .library import LibraryPatch
from .limb import CylinderLimb, ForearmLimb, Limb, SlabLimb, forearm_length
from .measurement import MeasurementOptions
from .mesh import Element, MeshOptions
from .rendering import RenderingOptions
from .supports import Supports
from .sweep import SolverOptions, Sweep
from .tissues import Tissues

# Accuracy of a slab under pressure discs; at 0.1 second order does in half the time (docs/decisions/0002). Under rigid
# ones it pays always: rims of small cones left 5 % of their receptance to second order (docs/decisions/0026).
_THIRD_ORDER_PAYS = 0.05
# [m] from the rim of a disc of pressure: nearer points err alike on two meshes of second order, and as little as a
# tenth of their error was stated; 9.5 mm away no frequency stated less than 0.7 of it (docs/decisions/0035).
_BESIDE = 8e-3


class Scenario(Part):
    """A limb, its tissues, a device, a sweep and what to render; SI units throughout.

    Frozen: ``parse_scenario({**scenario.model_dump(), "accuracy": 0.1})`` is another one, checked like a file's. What
    it inherits from pydantic is not: ``model_copy(update=...)`` checks nothing, ``model_validate`` raises an error of
    pydantic's in place of :class:`.ScenarioError`.
    """

    schema_version: Literal[1] = Field(1, description="of this file's format; only 1 is known")
    name: Name = Field("scenario", description="letters, digits, dot, dash, underscore; results go to results/NAME")
    description: str = Field("", description="a sentence for the report")
    engine: Literal["fem", "layered"] = Field("fem", description="finite elements, or the semi-analytic flat twin")
    accuracy: Annotated[float, Within(1e-5, 0.5)] = Field(
        0.05, description="asked e_band of G; sets mesh sizes, truncation and reduction where left out"
    )
    limb: Limb = ForearmLimb()
    tissues: Tissues = Tissues()
    supports: Supports = Supports()
    device: Device = Device()
    grid: Grid = Grid()
    sweep: Sweep = Sweep()
    mesh: MeshOptions = MeshOptions()
    solver: SolverOptions = SolverOptions()
    rendering: RenderingOptions = RenderingOptions()
    library: LibraryPatch = LibraryPatch()
    measurement: MeasurementOptions = MeasurementOptions()

    @model_validator(mode="before")
    @classmethod
    def _forearm_as_long_as_needed(cls, data: Any) -> Any:
        """A limb without a shape is a forearm; ``accuracy`` sets the length of one that leaves it out."""
        limb = data.get("limb", {}) if isinstance(data, Mapping) else None
        if not isinstance(limb, Mapping):
            return data
        data = {**data, "limb": {"shape": "forearm", **limb}}
        if data["limb"]["shape"] != "forearm" or "length" in limb:
            return data
        accuracy = data.get("accuracy", cls.model_fields["accuracy"].default)
        if not isinstance(accuracy, int | float) or not 0 < accuracy < 1:
            return data  # refused below, with its own sentence
        return {**data, "limb": {**data["limb"], "length": forearm_length(accuracy)}}

    @property
    def element(self) -> Element:
        """The element pair: that of ``mesh``, or what suits the limb."""
        if self.mesh.element != "auto":
            return self.mesh.element
        if isinstance(self.limb, SlabLimb):  # sizes given were given for P2
            asks = self.accuracy <= _THIRD_ORDER_PAYS or self.device.cone.contact != "pressure" or self.beside_discs
            return "P2/P3" if self.mesh.size_grid is None and asks else "P2"
        return "P2/P3" if isinstance(self.limb, ForearmLimb | CylinderLimb) else "P2"

    @property
    def beside_discs(self) -> tuple[str, ...]:
        """Names of the points less than 8 mm from the rim of a disc of pressure; none under rigid cones."""
        device = self.device
        if device.cone.contact != "pressure":
            return ()
        reach = device.cone.radius + _BESIDE
        gaps = (min(math.dist(place, centre) for centre in device.centres) for place in self.grid.places)
        return tuple(str(i) for i, gap in enumerate(gaps, start=1) if gap < reach)

    @model_validator(mode="after")
    def _targets_exist(self) -> Self:
        names = {str(i + 1) for i in range(len(self.grid.places))}
        wanted = set() if self.rendering.targets == "all" else set(self.rendering.targets)
        zeros = self.rendering.zeros if isinstance(self.rendering.zeros, tuple) else ()
        if unknown := (wanted | set(zeros)) - names:
            raise ValueError(f"rendering names the points {sorted(unknown)}, but the grid has 1..{len(names)}")
        holding = {"inverse filter", "combination"} & set(self.rendering.methods)
        if self.rendering.targets == "all" and zeros and holding:
            raise ValueError(
                f"rendering.zeros names point {zeros[0]}, but targets = 'all' aims at it, too; name the targets"
            )
        window, half = self.rendering.window, self.sweep.duration / 2
        if not isinstance(window, str) and not (-half <= window[0] and window[1] <= half):
            raise ValueError(f"rendering.window {list(window)} s reaches beyond the record of {-half:g} to {half:g} s")
        if not isinstance(window, str) and not _holds_a_sample(window, self.sweep):
            raise ValueError(
                f"rendering.window {list(window)} s holds no sample of {self.sweep.sample_rate:g} Hz; widen it"
            )
        return self

    @model_validator(mode="after")
    def _something_moves(self) -> Self:
        if len(set(self.device.out_of_contact)) == len(self.device.centres):
            raise ValueError("device.out_of_contact names every actuator: nothing would move; leave one in contact")
        return self


def _holds_a_sample(window: tuple[float, float], sweep: Sweep) -> bool:
    """Whether a sample k / sample_rate of the record, whose t = 0 is its middle, lies in ``window`` [s]."""
    last = math.ceil(round(sweep.duration * sweep.sample_rate) / 2) - 1
    return min(math.floor(window[1] * sweep.sample_rate + 1e-9), last) >= math.ceil(
        window[0] * sweep.sample_rate - 1e-9
    )
