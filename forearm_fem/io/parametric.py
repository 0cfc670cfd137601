"""``parametric.nc``: reduced models for many tissues, one for each part of the band, and what they were compared with.

For each part k of the band ``high`` [Hz] is its end, ``upper-k-whole`` (term, entry) and ``functional-k-whole`` (row,
port) are as in :mod:`.reduced`, ``places-k-whole`` (row, place) read the skin around the grid's points, and the same
with ``core`` are the smaller model of its error estimate; ``share`` (port,). ``around`` (centre, 2) [m] are the middles
of the squares of side 2 ``reach`` [m] there, with ``count`` places along each side, 0 where there are none. ``trials``
and ``checks`` (trial or check, 4) hold the draw, the frequency [Hz], the estimated and the true error of each
comparison. The scenario is kept as JSON.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..ports import Port
from ..typing import FloatArray
from .dataset import labels, load, port_variables, ports_of, save, text

_CONTENT = "parametric model"


Model = tuple[FloatArray, FloatArray, FloatArray]  # matrices (n_term, r, r), functionals (r, n_port), places (r, k)
_MODELS = ("whole", "core")


@dataclass(frozen=True)
class PieceFile:
    """The models of the part of the band up to ``high`` [Hz]."""

    high: float
    whole: Model
    core: Model


@dataclass(frozen=True)
class ParametricFile:
    """Contents of the file: ``pieces`` with matrices of terms ``names``.

    ``solves`` says how many factorisations went into it; ``trials`` and ``checks`` (n, 4) are rows of draw, frequency,
    estimated and true error. ``around`` (n, 2), ``reach`` and ``count`` are those of :class:`.grid_places.GridPlaces`,
    with a count of 0 where the model reads no other places than its ports.
    """

    names: tuple[str, ...]
    pieces: tuple[PieceFile, ...]
    shares: FloatArray
    ports: tuple[Port, ...]
    scenario: dict[str, Any]
    solves: int
    trials: FloatArray
    checks: FloatArray
    around: FloatArray
    reach: float
    count: int


def write_parametric(path: str | Path, content: ParametricFile) -> None:
    """Write ``content``, whole or not at all."""
    variables: dict[str, Any] = {
        "term": (("term",), labels(content.names), {}),
        **port_variables("port", content.ports),
        "share": (("port",), content.shares, {}),
        "trials": (("trial", "of_trial"), content.trials, {}),
        "checks": (("check", "of_check"), content.checks, {}),
        "around": (("centre", "of_centre"), content.around, {"units": "m"}),
        "reach": ((), content.reach, {"units": "m"}),
        "count": ((), content.count, {}),
        "high": (("piece",), np.array([p.high for p in content.pieces]), {"units": "Hz"}),
    }
    for k, piece in enumerate(content.pieces):
        for name in _MODELS:
            matrices, functionals, places = getattr(piece, name)
            rows, columns = np.triu_indices(len(functionals))
            row, entry = f"row-{k}-{name}", f"entry-{k}-{name}"
            variables[f"upper-{k}-{name}"] = (("term", entry), matrices[:, rows, columns], {})
            variables[f"functional-{k}-{name}"] = ((row, "port"), functionals, {})
            variables[f"places-{k}-{name}"] = ((row, "place"), places, {})
    attributes = {"content": _CONTENT, "scenario": json.dumps(content.scenario), "solves": str(content.solves)}
    save(path, variables, attributes)


def read_parametric(path: str | Path) -> ParametricFile:
    """What :func:`write_parametric` wrote; DataError if the file is missing, damaged or something else."""
    return load(path, _CONTENT, _unpack)


def _unpack(dataset: xr.Dataset) -> ParametricFile:
    def numbers(name: str) -> FloatArray:
        """A variable as floating-point numbers."""
        return np.asarray(dataset[name].values, dtype=float)

    def model(k: int, name: str) -> Model:
        """Matrices, functionals and places of model ``name`` of piece k; its file holds upper triangles."""
        upper, functionals = numbers(f"upper-{k}-{name}"), numbers(f"functional-{k}-{name}")
        rows, columns = np.triu_indices(len(functionals))
        matrices = np.empty((len(upper), len(functionals), len(functionals)))
        matrices[:, rows, columns] = matrices[:, columns, rows] = upper
        return matrices, functionals, numbers(f"places-{k}-{name}")

    pieces = tuple(
        PieceFile(float(high), *(model(k, name) for name in _MODELS)) for k, high in enumerate(numbers("high"))
    )
    return ParametricFile(
        tuple(text(dataset["term"].values)), pieces, numbers("share"), ports_of(dataset, "port"),
        json.loads(dataset.attrs["scenario"]), int(dataset.attrs["solves"]), numbers("trials"), numbers("checks"),
        numbers("around"), float(dataset["reach"]), int(dataset["count"]),
    )  # fmt: skip
