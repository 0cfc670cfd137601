"""``reduced.nc``: the reduced model, a few megabytes that give the compliance at any frequency, for any moduli.

Variables ``upper`` (term, entry), the upper triangles of real symmetric matrices row by row; ``functional``
(row, port) and ``share`` (port,) as in :class:`forearm_fem.fem.reduction.reduced_model.ReducedModel`; ``poles``
(mode,), ``left`` (port, mode) and ``right`` (mode, port) of :class:`forearm_fem.fem.reduction.poles.PoleResidue` where
there are any. What the
terms are multiplied with follows from the scenario, kept as JSON.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..ports import Port
from ..typing import ComplexArray, FloatArray
from .dataset import labels, load, port_variables, ports_of, save, text

_CONTENT = "reduced model"
POLES = {"poles": ("mode",), "left": ("port", "mode"), "right": ("mode", "port")}


@dataclass(frozen=True)
class ReducedFile:
    """Contents of the file: ``matrices`` (n_term, r, r) of terms ``names``, ``functionals`` (r, n_port).

    ``poles`` holds the arrays that ``POLES`` names, or nothing.
    """

    names: tuple[str, ...]
    matrices: FloatArray
    functionals: FloatArray
    shares: FloatArray
    ports: tuple[Port, ...]
    scenario: dict[str, Any]
    poles: dict[str, ComplexArray]


def write_reduced(path: str | Path, content: ReducedFile) -> None:
    """Write ``content``, whole or not at all."""
    rows, columns = np.triu_indices(len(content.functionals))
    variables = {
        "term": (("term",), labels(content.names), {}),
        **port_variables("port", content.ports),
        "upper": (("term", "entry"), content.matrices[:, rows, columns], {}),
        "functional": (("row", "port"), content.functionals, {}),
        "share": (("port",), content.shares, {}),
        **{name: (POLES[name], values, {}) for name, values in content.poles.items()},
    }
    save(path, variables, {"content": _CONTENT, "scenario": json.dumps(content.scenario)})


def read_reduced(path: str | Path) -> ReducedFile:
    """What :func:`write_reduced` wrote; DataError if the file is missing, damaged or something else."""
    return load(path, _CONTENT, _unpack)


def _unpack(dataset: xr.Dataset) -> ReducedFile:
    return ReducedFile(
        tuple(text(dataset["term"].values)),
        _matrices(dataset),
        np.asarray(dataset["functional"].values, dtype=float),
        np.asarray(dataset["share"].values, dtype=float),
        ports_of(dataset, "port"),
        json.loads(dataset.attrs["scenario"]),
        {name: np.asarray(dataset[name].values, dtype=complex) for name in POLES if name in dataset},
    )


def _matrices(dataset: xr.Dataset) -> FloatArray:
    """Whole matrices; files before version 0.4 held them whole."""
    if "matrix" in dataset:
        return np.asarray(dataset["matrix"].values, dtype=float)
    upper, size = np.asarray(dataset["upper"].values, dtype=float), dataset.sizes["row"]
    rows, columns = np.triu_indices(size)
    matrices = np.empty((len(upper), size, size))
    matrices[:, rows, columns] = matrices[:, columns, rows] = upper
    return matrices
