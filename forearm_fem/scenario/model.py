"""The whole scenario: one frozen object from which everything follows."""

from __future__ import annotations

import functools
import hashlib
import json
import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ModelWrapValidatorHandler, TypeAdapter, model_validator
from pydantic_core import PydanticCustomError

from .base import Name, Part, UserCode, Within, as_given, changed_keys, idle, put, remade
from .device import Device, Grid, GridRows, VoltageRows
from .limb import (
    AnySupports,
    CylinderLimb,
    Element,
    ForearmLimb,
    FreeUnderside,
    LibraryPatch,
    Limb,
    MeshLimb,
    MeshOptions,
    SlabLimb,
    Tissues,
    forearm_length,
    has_bone,
    layer_tissues,
    limb_tissues,
)
from .measurement import MeasurementOptions
from .rendering import RenderingOptions
from .sweep import Band, ReducedSolve, Solver, Sweep

# Accuracy of a slab under pressure discs; at 0.1 second order does in half the time (decision 0002). Under rigid
# ones it pays always: rims of small cones left 5 % of their receptance to second order.
_THIRD_ORDER_PAYS = 0.05
# [m] from the rim of a disc of pressure: nearer points err alike on two meshes of second order, and as little as a
# tenth of their error was stated; 9.5 mm away no frequency stated less than 0.7 of it (decision 0015).
_BESIDE = 8e-3


_ELEMENTS_ONLY = ("mesh", "supports", "solver", "limb.length", "limb.width", "limb.depth", "limb.symmetry",
                  "limb.circumference", "limb.aspect", "limb.diameter", "limb.bones")  # fmt: skip


def for_elements_only(key: str) -> bool:
    """True if finite elements alone read the dotted ``key``: the layered model has flat, endless layers and no mesh."""
    return key != "solver.memory_limit" and any(f"{key}.".startswith(f"{part}.") for part in _ELEMENTS_ONLY)


class Scenario(Part):
    """A limb, its tissues, a device, a sweep and what to render; SI units throughout.

    Frozen: :meth:`changed` makes another one, checked like a file's. A key that would have no effect is refused.
    ``engine`` is a switch on the same scenario: what finite elements alone read stays for them, see
    :func:`.for_elements_only`.
    """

    schema_version: Literal[2] = Field(2, description="of this file's format; only 2 is known")
    name: Name = Field("scenario", description="letters, digits, dot, dash, underscore; results go to results/NAME")
    description: str = Field("", description="a sentence for the report")
    engine: Literal["fem", "layered"] | UserCode = Field(
        "fem",
        description="finite elements, or the semi-analytic layered model, which reads neither mesh nor supports; your "
        "own as module:Name of a file beside the scenario",
    )
    accuracy: Annotated[float, Within(1e-5, 0.5)] = Field(
        0.05, description="asked e_band of G; sets mesh sizes, truncation and reduction where left out"
    )
    limb: Limb = ForearmLimb()
    tissues: Tissues = Tissues()
    supports: AnySupports = FreeUnderside()
    device: Device = VoltageRows()
    grid: Grid = GridRows()
    sweep: Sweep = Band()
    mesh: MeshOptions = MeshOptions()
    solver: Solver = ReducedSolve()
    rendering: RenderingOptions = RenderingOptions()
    library: LibraryPatch = LibraryPatch()
    measurement: MeasurementOptions = MeasurementOptions()

    def changed(self, changes: Mapping[str, Any]) -> Self:
        """A checked copy with ``changes`` by dotted key: ``scenario.changed({"device.spacing": 0.04})``.

        As if the file had said so: what was left out follows anew, and None leaves a key out. Keys that the changes
        leave without effect fall away, such as ``device.spacing`` where ``device.contacts`` are set. ScenarioError for
        what a file would be refused.
        """
        table = self.model_dump(exclude_unset=True)
        for key in changes:  # an entry of a list that was left out
            before, _, _ = re.sub(r"\.\d+(?=\.|$)", "\0", key).partition("\0")
            if before != key:
                put(table, before, functools.reduce(getattr, before.split("."), self), key)
        return remade(TypeAdapter(type(self)), table, changes, "scenario")

    @property
    def digest(self) -> str:
        """SHA-256 of all keys but ``name`` and ``description``, defaults included; files count by their names."""
        keys = self.model_dump(mode="json", exclude={"name", "description"})
        return hashlib.sha256(json.dumps(keys, sort_keys=True).encode()).hexdigest()

    def changed_keys(self) -> tuple[str, ...]:
        """Dotted keys whose values are not their defaults; lists and free tables count as one key each."""
        usual = type(self)()
        forearm = type(self)(accuracy=self.accuracy).limb if isinstance(self.limb, ForearmLimb) else None
        limb = (key for key in changed_keys(self.limb, forearm, "limb.") if key != "limb.shape")
        rest = [key for key in changed_keys(self, usual) if not key.startswith("limb.")]
        return (*rest, *limb)

    @model_validator(mode="wrap")
    @classmethod
    def _settled(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Scenario with defaults filled in, which count as left out: a limb without a shape is a forearm,
        ``accuracy`` sets a length left out, an actuator brings its own keys."""
        if not isinstance(data, Mapping):
            return handler(data)
        _refuse_version(data)
        made = handler(_with_limb(data, cls.model_fields["accuracy"].default))
        as_given(made, data)
        return made

    @model_validator(mode="after")
    def _no_idle_key(self) -> Self:
        limb, usual = self.limb, MeshOptions()
        sizes = [k for k in ("size_grid", "size_far", "grading") if getattr(self.mesh, k) != getattr(usual, k)]
        if isinstance(limb, MeshLimb) and sizes:
            raise idle([f"mesh.{key}" for key in sizes], "limb.shape = 'mesh' keeps the file's elements, and refines "
                       "them only at contacts (mesh.size_contact); leave it out")  # fmt: skip
        if isinstance(limb, SlabLimb) and self.grid.direction == "vertical":
            raise idle(["grid.direction"], "a slab's normal is vertical; leave it out")
        if isinstance(limb, SlabLimb) and self.supports.underside != "free":
            raise idle(["supports.underside"], "a slab's bottom is a cut end (supports.ends); leave it out")
        tissues, layers = limb_tissues(limb), layer_tissues(limb)
        if unknown := sorted(set(self.mesh.sublayers) - layers):
            raise idle([f"mesh.sublayers.{name}" for name in unknown], "the limb has no such layer; leave it out")
        if self.supports.bone == "elastic" and not has_bone(limb):
            raise idle(["supports.bone"], "the limb has no bone; leave it out, or give it one")
        met = (tissues - {"bone"}) | ({"bone"} if self.supports.bone == "elastic" else set())
        if unknown := sorted(set(self.tissues.override) - met):
            raise idle([f"tissues.override.{name}" for name in unknown], "no wave passes through this tissue in this "
                       "limb; leave it out, or name it in a layer")  # fmt: skip
        return self

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

    @property
    def reduction_tolerance(self) -> float:
        """e(f) that a reduced model may cost [-]: a hundredth of the accuracy asked for."""
        return self.accuracy / 100

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


def _with_limb(data: Mapping[str, Any], accuracy: float) -> Mapping[str, Any]:
    limb, accuracy = data.get("limb", {}), data.get("accuracy", accuracy)
    if not isinstance(limb, Mapping):
        return data
    limb = {"shape": "forearm", **limb}
    if limb["shape"] == "forearm" and isinstance(accuracy, int | float) and 0 < accuracy < 1:  # else refused below
        limb = {"length": forearm_length(accuracy), **limb}
    return {**data, "limb": limb}


def _refuse_version(data: Mapping[str, Any]) -> None:
    """One sentence for a scenario of before version 1.0, with the keys in it that are called otherwise now."""
    if data.get("schema_version") != 1:
        return
    table = data.get("tissues")
    override = table.get("override") if isinstance(table, Mapping) else None
    laws = [f"tissues.override.{k}" for k, v in (override or {}).items() if isinstance(v, Mapping) and "model" in v]
    renamed = "".join(f"; {key}.model is called {key}.law" for key in laws)
    raise PydanticCustomError(
        "choice", "{said}",
        {"key": "schema_version", "said": "1 is the format of before version 1.0; write 2 and leave out keys without "
         f"effect, which are refused by name{renamed}"},
    )  # fmt: skip


def _holds_a_sample(window: tuple[float, float], sweep: Sweep) -> bool:
    """True if a sample k / sample_rate of the record, whose t = 0 is its middle, lies in ``window`` [s]."""
    last = math.ceil(round(sweep.duration * sweep.sample_rate) / 2) - 1
    return min(math.floor(window[1] * sweep.sample_rate + 1e-9), last) >= math.ceil(
        window[0] * sweep.sample_rate - 1e-9
    )
