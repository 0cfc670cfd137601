"""``library.nc``: an arm's library as one file that can be shared, sealed with a checksum, whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import xarray as xr

from ...errors import DataError
from ...io.dataset import load, provenance_json, said_content, save
from ...layered.tables import from_arrays
from ...scenario import parse_scenario
from ..layered import flat_layers, flat_surface
from .arm import ArmLibrary
from .limb import Limb

_CONTENT = "arm's library"
_MADE = 4  # raise when what a library holds is another
_LIMBS = ("fine", "coarse", "freed")
_TABLES = "twin_"
_NUMBERS = ("width", "ratio")
_ARRAYS = {
    "centres": ("bell", "uv"),
    "sideways": ("sideways_bell", "uv"),
    "distances": ("distance",),
    "flat": ("part", "node", "integral", "distance"),
    "bins": ("bin",),
    "spread": ("part", "direction", "bin"),
    "reduction": ("frequency_and_errors", "checked"),
    "missed": ("checked", "direction", "bin"),
}


def save_library(path: str | Path, library: ArmLibrary) -> None:
    """Write the ``library``; DataError where that cannot be done."""
    variables: dict[str, Any] = {name: (dims, getattr(library, name), {}) for name, dims in _ARRAYS.items()}
    for name in _LIMBS:
        limb: Limb | None = getattr(library, name)
        if limb is not None:
            for field, dims in (("poles", ("m",)), ("left", ("load", "m")), ("right", ("m", "load"))):
                named = tuple(f"{name}_mode" if d == "m" else d for d in dims)
                variables[f"{name}_{field}"] = (named, getattr(limb, field), {})
    for name, values in library.twin.arrays().items():
        axes = tuple(f"{_TABLES}{name}_{axis}" for axis in range(values.ndim))
        variables[_TABLES + name] = (axes, values, {})
    attributes: dict[str, Any] = {
        "content": _CONTENT,
        "made": _MADE,
        "scenario": json.dumps(library.scenario.model_dump(mode="json")),
        "numbers": json.dumps({name: getattr(library, name) for name in _NUMBERS}),
        "disc": json.dumps({"radius": library.twin.radius, "contact": library.twin.contact}),
        "facts": provenance_json(library.facts),
    }
    save(path, variables, attributes)


def is_library(path: str | Path) -> bool:
    """Whether the file says of itself that it holds an arm's library; of this version or not, whole or not."""
    return said_content(path) == _CONTENT


def load_library(path: str | Path) -> ArmLibrary:
    """Read what :func:`save_library` wrote; DataError for a missing, damaged or outdated file."""
    return load(path, _CONTENT, _unpack)


def _unpack(dataset: xr.Dataset) -> ArmLibrary:
    if dataset.attrs.get("made", 1) != _MADE:
        raise DataError(
            "this library was made by another version of forearm_fem, which kept other things; make it again with "
            "`forearm-fem library`"
        )
    disc, number = (json.loads(dataset.attrs[name]) for name in ("disc", "numbers"))
    scenario = parse_scenario(json.loads(dataset.attrs["scenario"]))
    arrays = {str(k)[len(_TABLES):]: v.values for k, v in dataset.data_vars.items() if str(k).startswith(_TABLES)}
    layers, surface = flat_layers(scenario), flat_surface(scenario.tissues)
    twin = from_arrays(arrays, layers, surface, float(disc["radius"]), str(disc["contact"]))
    fine, coarse, freed = (Limb.read(dataset, name) for name in _LIMBS)
    if fine is None:
        raise ValueError("the limb itself is missing")
    return ArmLibrary(
        scenario, dataset["centres"].values, dataset["sideways"].values, float(number["width"]),
        fine, coarse, freed, float(number["ratio"]), dataset["distances"].values, dataset["flat"].values, twin,
        dataset["bins"].values, dataset["spread"].values, dataset["reduction"].values,
        dataset["missed"].values, json.loads(dataset.attrs["facts"]),
    )  # fmt: skip
