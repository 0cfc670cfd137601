"""``library.nc``: an arm's library as one file that can be shared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from ...layered.tables import from_arrays
from ...scenario import parse_scenario
from ...store.record import dims, load, said_content, save
from ...typing import ComplexArray, FloatArray
from ..layered import flat_layers, flat_surface
from .arm import ArmLibrary
from .limb import Limb


@dataclass(frozen=True, eq=False)
class LibraryFile:
    """Contents of the file; fields are those of :class:`.arm.ArmLibrary`, with the arrays of its layered model."""

    kind: ClassVar[str] = "arm's library"
    version: ClassVar[int] = 1

    scenario: dict[str, Any]
    centres: FloatArray = field(metadata=dims("bell uv", units="m"))
    sideways: FloatArray = field(metadata=dims("sideways_bell uv", units="m"))
    width: float
    fine: Limb
    coarse: Limb | None
    freed: Limb | None
    ratio: float
    distances: FloatArray = field(metadata=dims("distance", units="m"))
    flat: ComplexArray = field(metadata=dims("part node integral distance"))
    twin: Mapping[str, Any] = field(metadata=dims("*"))
    radius: float
    contact: str
    bins: FloatArray = field(metadata=dims("bin", units="m"))
    spread: FloatArray = field(metadata=dims("part direction bin"))
    reduction: FloatArray = field(metadata=dims("frequency_and_errors checked"))
    missed: FloatArray = field(metadata=dims("checked direction bin"))
    facts: Mapping[str, Any]


def save_library(path: str | Path, library: ArmLibrary) -> None:
    """Write the ``library``; DataError where that cannot be done."""
    x, twin = library, library.twin
    save(path, LibraryFile(
        x.scenario.model_dump(mode="json"), x.centres, x.sideways, x.width, x.fine, x.coarse, x.freed, x.ratio,
        x.distances, x.flat, twin.arrays(), twin.radius, twin.contact, x.bins, x.spread, x.reduction, x.missed, x.facts,
    ))  # fmt: skip


def is_library(path: str | Path) -> bool:
    """Whether the file says of itself that it holds an arm's library; of this version or not, whole or not."""
    return said_content(path) == LibraryFile.kind


def load_library(path: str | Path) -> ArmLibrary:
    """Read what :func:`save_library` wrote; DataError for a missing, damaged or outdated file."""
    x = load(path, LibraryFile)
    scenario = parse_scenario(x.scenario, origin=str(path))
    twin = from_arrays(x.twin, flat_layers(scenario), flat_surface(scenario.tissues), x.radius, x.contact)
    return ArmLibrary(
        scenario, x.centres, x.sideways, x.width, x.fine, x.coarse, x.freed, x.ratio, x.distances, x.flat, twin, x.bins,
        x.spread, x.reduction, x.missed, x.facts,
    )  # fmt: skip
