"""``parametric.nc``: one reduced model for many tissues, and what it was compared with.

Variables ``upper`` (term, entry), ``functional`` (row, port) and ``share`` (port,) as in :mod:`.reduced`; ``trials``
and ``checks`` (trial or check, 4) hold the draw, the frequency [Hz], the estimated and the true error of each
comparison. The scenario is kept as JSON.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from ..typing import FloatArray
from .dataset import load, save
from .reduced import ReducedTerms, read_terms, term_variables

_CONTENT = "parametric model"


@dataclass(frozen=True)
class ParametricFile(ReducedTerms):
    """Contents of the file beside those of :class:`ReducedTerms`.

    ``core`` is the size of the smaller model of the estimate, ``solves`` how many factorisations went into it;
    ``trials`` and ``checks`` (n, 4) are rows of draw, frequency, estimated and true error.
    """

    core: int
    solves: int
    trials: FloatArray
    checks: FloatArray


def write_parametric(path: str | Path, content: ParametricFile) -> None:
    """Write ``content``, whole or not at all."""
    variables = {
        **term_variables(content),
        "trials": (("trial", "of_trial"), content.trials, {}),
        "checks": (("check", "of_check"), content.checks, {}),
        "counts": (("count",), np.array([content.core, content.solves]), {}),
    }
    save(path, variables, {"content": _CONTENT, "scenario": json.dumps(content.scenario)})


def read_parametric(path: str | Path) -> ParametricFile:
    """What :func:`write_parametric` wrote; DataError if the file is missing, damaged or something else."""
    return load(path, _CONTENT, _unpack)


def _unpack(dataset: xr.Dataset) -> ParametricFile:
    core, solves = (int(n) for n in dataset["counts"].values)
    trials, checks = (np.asarray(dataset[name].values, dtype=float) for name in ("trials", "checks"))
    return ParametricFile(*read_terms(dataset), core, solves, trials, checks)
