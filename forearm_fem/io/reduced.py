"""``reduced.nc``: the reduced model, a few megabytes that give the compliance at any frequency, for any moduli.

Variables ``upper`` (term, entry), the upper triangles of real symmetric matrices row by row; ``functional`` (row, port)
and ``share`` (port,) as in :class:`forearm_fem.fem.reduction.reduced_model.ReducedModel`; ``poles`` (mode,), ``left``
(port, mode) and ``right`` (mode, port) of :class:`forearm_fem.fem.reduction.poles.PoleResidue` where there are any.
What the terms are multiplied with follows from the scenario, kept as JSON.
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
class ReducedTerms:
    """What every file of a reduced model holds: ``matrices`` (n_term, r, r) of terms ``names``, ``functionals``
    (r, n_port), ``shares`` (n_port,), and the scenario that multiplies the terms.
    """

    names: tuple[str, ...]
    matrices: FloatArray
    functionals: FloatArray
    shares: FloatArray
    ports: tuple[Port, ...]
    scenario: dict[str, Any]


@dataclass(frozen=True)
class ReducedFile(ReducedTerms):
    """Contents of ``reduced.nc``; ``poles`` holds the arrays that ``POLES`` names, or nothing."""

    poles: dict[str, ComplexArray]


def write_reduced(path: str | Path, content: ReducedFile) -> None:
    """Write ``content``, whole or not at all."""
    poles: dict[str, Any] = {name: (POLES[name], values, {}) for name, values in content.poles.items()}
    save(path, {**term_variables(content), **poles}, {"content": _CONTENT, "scenario": json.dumps(content.scenario)})


def read_reduced(path: str | Path) -> ReducedFile:
    """What :func:`write_reduced` wrote; DataError if the file is missing, damaged or something else."""

    def unpack(dataset: xr.Dataset) -> ReducedFile:
        """Terms, and the poles where there are any."""
        poles = {name: np.asarray(dataset[name].values, dtype=complex) for name in POLES if name in dataset}
        return ReducedFile(*read_terms(dataset), poles)

    return load(path, _CONTENT, unpack)


def term_variables(content: ReducedTerms) -> dict[str, Any]:
    """Variables of a file with these terms; the scenario is an attribute."""
    rows, columns = np.triu_indices(len(content.functionals))
    return {
        "term": (("term",), labels(content.names), {}),
        **port_variables("port", content.ports),
        "upper": (("term", "entry"), content.matrices[:, rows, columns], {}),
        "functional": (("row", "port"), content.functionals, {}),
        "share": (("port",), content.shares, {}),
    }


def read_terms(
    dataset: xr.Dataset,
) -> tuple[tuple[str, ...], FloatArray, FloatArray, FloatArray, tuple[Port, ...], dict[str, Any]]:
    """The fields of :class:`ReducedTerms` in their order."""
    functional, share = (np.asarray(dataset[name].values, dtype=float) for name in ("functional", "share"))
    names, scenario = tuple(text(dataset["term"].values)), json.loads(dataset.attrs["scenario"])
    if "matrix" in dataset:  # files before version 0.4 held them whole
        matrices = np.asarray(dataset["matrix"].values, dtype=float)
    else:
        upper, size = np.asarray(dataset["upper"].values, dtype=float), dataset.sizes["row"]
        rows, columns = np.triu_indices(size)
        matrices = np.empty((len(upper), size, size))
        matrices[:, rows, columns] = matrices[:, columns, rows] = upper
    return names, matrices, functional, share, ports_of(dataset, "port"), scenario
