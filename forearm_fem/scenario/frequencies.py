"""The frequencies of a sweep."""

from __future__ import annotations

import numpy as np

from ..errors import ScenarioError
from ..typing import FloatArray
from .sweep import FrequencyList, Sweep


def frequencies(sweep: Sweep) -> FloatArray:
    """Frequencies (n,) [Hz]: the scenario's own list, or the bins k / duration inside [f_min, f_max]."""
    if isinstance(sweep, FrequencyList):
        return np.array(sweep.frequencies, dtype=float)
    first = int(np.ceil(sweep.f_min * sweep.duration - 1e-9))
    last = int(np.floor(sweep.f_max * sweep.duration + 1e-9))
    if last < first:
        raise ScenarioError(
            f"sweep: no bin of width {1 / sweep.duration:g} Hz lies between {sweep.f_min:g} and {sweep.f_max:g} Hz; "
            "lengthen sweep.duration"
        )
    return np.arange(first, last + 1) / sweep.duration
