"""``parametric.nc``: one reduced model for many tissues, and what it was compared with.

Variables ``upper`` (term, entry), ``functional`` (row, port) and ``share`` (port,) as in :mod:`.reduced`; ``trials``
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


@dataclass(frozen=True)
class ParametricFile:
    """Contents of the file: ``matrices`` (n_term, r, r) of terms ``names``, ``functionals`` (r, n_port).

    ``core`` is the size of the smaller model of the estimate, ``solves`` how many factorisations went into it;
    ``trials`` and ``checks`` (n, 4) are rows of draw, frequency, estimated and true error.
    """

    names: tuple[str, ...]
    matrices: FloatArray
    functionals: FloatArray
    shares: FloatArray
    ports: tuple[Port, ...]
    scenario: dict[str, Any]
    core: int
    solves: int
    trials: FloatArray
    checks: FloatArray


def write_parametric(path: str | Path, content: ParametricFile) -> None:
    """Write ``content``, whole or not at all."""
    rows, columns = np.triu_indices(len(content.functionals))
    variables = {
        "term": (("term",), labels(content.names), {}),
        **port_variables("port", content.ports),
        "upper": (("term", "entry"), content.matrices[:, rows, columns], {}),
        "functional": (("row", "port"), content.functionals, {}),
        "share": (("port",), content.shares, {}),
        "trials": (("trial", "of_trial"), content.trials, {}),
        "checks": (("check", "of_check"), content.checks, {}),
        "counts": (("count",), np.array([content.core, content.solves]), {}),
    }
    save(path, variables, {"content": _CONTENT, "scenario": json.dumps(content.scenario)})


def read_parametric(path: str | Path) -> ParametricFile:
    """What :func:`write_parametric` wrote; DataError if the file is missing, damaged or something else."""
    return load(path, _CONTENT, _unpack)


def _unpack(dataset: xr.Dataset) -> ParametricFile:
    def numbers(name: str) -> FloatArray:
        return np.asarray(dataset[name].values, dtype=float)

    upper, size = numbers("upper"), dataset.sizes["row"]
    rows, columns = np.triu_indices(size)
    matrices = np.empty((len(upper), size, size))
    matrices[:, rows, columns] = matrices[:, columns, rows] = upper
    core, solves = (int(n) for n in dataset["counts"].values)
    return ParametricFile(
        tuple(text(dataset["term"].values)), matrices, numbers("functional"), numbers("share"),
        ports_of(dataset, "port"), json.loads(dataset.attrs["scenario"]), core, solves,
        numbers("trials"), numbers("checks"),
    )  # fmt: skip
