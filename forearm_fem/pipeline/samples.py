"""Whether chosen frequencies lie close enough to fill the bins between them, told before anything is solved."""

from __future__ import annotations

import numpy as np

from ..device import close_loop
from ..engines.layered import solve_layered
from ..errors import DataError, ForearmError, ScenarioError
from ..rendering import Record, bridged, place
from ..scenario import Scenario
from ..scenario.limb import MeshLimb, SurfacesLimb
from ..scenario.sweep import FrequencyList, frequencies
from ..transfer import finite

_ON_BIN = 1e-3  # of a bin: as for G's own samples


def check_samples(scenario: Scenario) -> None:
    """Raise :class:`ScenarioError` where ``sweep.frequencies`` are too far apart to render on the bins between them.

    Judged as G itself will be, on the flat twin of the same layers and device; for the user's own limb, which has none,
    see :func:`sample_notes`.
    """
    if not _between(scenario) or isinstance(scenario.limb, MeshLimb | SurfacesLimb):
        return
    bare = scenario.changed({"tissues.patch": None})
    try:
        g = finite(close_loop(solve_layered(bare, frequencies(scenario.sweep)), scenario.device))
    except ForearmError:  # in words of its own, when it is solved
        return
    try:
        place(bridged(g).transfer, Record.of(scenario.sweep.sample_rate, scenario.sweep.duration))
    except DataError as problem:
        raise ScenarioError(
            f"sweep.frequencies: by the flat twin, {problem}; for G alone set rendering.methods = []"
        ) from None


def sample_notes(scenario: Scenario) -> tuple[str, ...]:
    """That it shows after the solve only whether the user's own limb has frequencies close enough to render on."""
    if not _between(scenario) or not isinstance(scenario.limb, MeshLimb | SurfacesLimb):
        return ()
    return (
        "sweep.frequencies: bins between them are interpolated, and after the solve only it shows whether G allows it; "
        "leave the key out for every bin, or set rendering.methods = [] for G alone",
    )


def _between(scenario: Scenario) -> bool:
    """Whether something is rendered on bins that lie between chosen frequencies."""
    sweep = scenario.sweep
    if not isinstance(sweep, FrequencyList) or not scenario.rendering.methods:
        return False
    at = np.array(sweep.frequencies) * sweep.duration
    bins = np.arange(np.ceil(at[0]), np.floor(at[-1]) + 1)
    beside = np.clip(np.searchsorted(at, bins), 1, len(at) - 1) if len(at) > 1 else np.zeros(len(bins), dtype=int)
    nearest = np.minimum(np.abs(bins - at[beside]), np.abs(bins - at[beside - 1]))
    return bool((nearest > _ON_BIN).any())
