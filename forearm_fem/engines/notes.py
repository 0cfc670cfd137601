"""Notes of a run: sentences that belong in its report."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..device import close_loop
from ..errors import DataError, ForearmError, ScenarioError
from ..rendering import Record, bridged, on_record_bins
from ..results.run import SolutionRecord
from ..scenario import Scenario
from ..scenario.actuators import ACTUATORS
from ..scenario.limb import MeshLimb, SlabLimb, SurfacesLimb
from ..scenario.model import for_elements_only
from ..scenario.sweep import FrequencyList, frequencies
from ..transfer import finite
from .layered import solve_layered

# Spacing of chosen frequencies, close enough or not to fill the bins between them, before anything is solved.

_ON_BIN = 1e-3  # of a bin: as for G's own samples


def check_samples(scenario: Scenario) -> None:
    """Raise :class:`ScenarioError` where ``sweep.frequencies`` are too far apart to render on the bins between them.

    Judged as G itself will be, on the layered model of the same layers and device; for the user's own limb, which has
    none, see :func:`sample_notes`.
    """
    if not _between(scenario) or isinstance(scenario.limb, MeshLimb | SurfacesLimb):
        return
    bare = scenario.changed({"tissues.patch": None})
    try:
        g = finite(close_loop(solve_layered(bare, frequencies(scenario.sweep)), scenario.device))
    except ForearmError:  # in words of its own, when it is solved
        return
    try:
        on_record_bins(bridged(g).transfer, Record.of(scenario.sweep.sample_rate, scenario.sweep.duration))
    except DataError as problem:
        raise ScenarioError(
            f"sweep.frequencies: by the layered model, {problem}; for G alone set rendering.methods = []"
        ) from None


def sample_notes(scenario: Scenario) -> tuple[str, ...]:
    """Note that only the solve tells whether the user's own limb has frequencies close enough to render on."""
    if not _between(scenario) or not isinstance(scenario.limb, MeshLimb | SurfacesLimb):
        return ()
    return (
        "sweep.frequencies: bins between them are interpolated, and after the solve only it shows whether G allows it; "
        "leave the key out for every bin, or set rendering.methods = [] for G alone",
    )


def _between(scenario: Scenario) -> bool:
    """True if something is rendered on bins that lie between chosen frequencies."""
    sweep = scenario.sweep
    if not isinstance(sweep, FrequencyList) or not scenario.rendering.methods:
        return False
    at = np.array(sweep.frequencies) * sweep.duration
    bins = np.arange(np.ceil(at[0]), np.floor(at[-1]) + 1)
    beside = np.clip(np.searchsorted(at, bins), 1, len(at) - 1) if len(at) > 1 else np.zeros(len(bins), dtype=int)
    nearest = np.minimum(np.abs(bins - at[beside]), np.abs(bins - at[beside - 1]))
    return bool((nearest > _ON_BIN).any())


# Remarks on the model and the actuator for a reader of the results.


def scene_notes(scenario: Scenario) -> tuple[str, ...]:
    """Notes on a scenario before it is meshed or solved."""
    kinds = (engine_notes, actuator_notes, lifted_notes, covered_notes, sample_notes)
    return tuple(note for notes in kinds for note in notes(scenario))


def model_notes(solution: SolutionRecord) -> tuple[str, ...]:
    """Note that a reduced model with unstable poles is good for frequencies of the band only.

    That takes incompressible tissue and single precision; outside the band such a model refuses (:mod:`.skin_model`).
    """
    if not solution.unstable_poles:
        return ()
    return (
        f"the reduced model has {solution.unstable_poles} unstable poles far outside the band: use it (reduced.nc) at "
        "frequencies of the band only, not beyond and not in time; solver.precision = 'double' makes one without",
    )


def near_disc_notes(scenario: Scenario) -> tuple[str, ...]:
    """A sentence on points so near a disc of pressure that second-order elements err alike on both meshes."""
    near = scenario.beside_discs if isinstance(scenario.limb, SlabLimb) and scenario.element == "P2" else ()
    if not near:
        return ()
    return (
        f"{_lie(near)} within 8 mm of the rim of a disc of pressure on second-order elements, where as little as "
        "a tenth of the error was stated; mesh.element = 'P2/P3' errs a tenth there, at two to four times the unknowns",
    )


def engine_notes(scenario: Scenario) -> tuple[str, ...]:
    """Keys that the layered model leaves to finite elements."""
    kept = [key for key in scenario.changed_keys() if for_elements_only(key)] if scenario.engine == "layered" else []
    if not kept:
        return ()
    return (f"{', '.join(kept)}: for finite elements; engine = 'layered' has flat, endless layers and no mesh",)


def lifted_notes(scenario: Scenario) -> tuple[str, ...]:
    """Note that funneling drives actuators that do not touch the skin: its shares follow from places alone."""
    lifted, shared = scenario.device.out_of_contact, {"funneling", "combination"} & set(scenario.rendering.methods)
    if not lifted or not shared:
        return ()
    return (
        f"device.out_of_contact: no skin moves under {', '.join(lifted)}, but shares of "
        f"{' and '.join(sorted(shared, reverse=True))} follow from places alone and drive there all the same; judge by "
        "the inverse filter, or leave such actuators out of device.contacts",
    )


def covered_notes(scenario: Scenario) -> tuple[str, ...]:
    """Points that move with a cone that touches: under it, or nearer to its rim than ``rendering.clearance``."""
    device = scenario.device
    feet = [c for k, c in enumerate(device.centres, start=1) if f"A{k}" not in device.out_of_contact]
    gaps = (min(math.dist(place, foot) for foot in feet) for place in scenario.grid.places)
    clear = device.cone.radius + scenario.rendering.clearance * (1 - 1e-9)
    under = [str(i) for i, gap in enumerate(gaps, start=1) if gap < clear]
    if not under or not scenario.rendering.methods:
        return ()
    return (
        f"grid: {_lie(under)} under a cone or within {1e3 * scenario.rendering.clearance:g} mm of its rim "
        "(rendering.clearance), moving with the motor: S there is no focus; judge by the other points, or move it "
        "(grid.pitch, grid.points) or the cones",
    )


def _lie(points: Sequence[str]) -> str:
    named = ", ".join(points[:6]) + (", ..." if len(points) > 6 else "")
    return f"point {named} lies" if len(points) == 1 else f"points {named} lie"


def actuator_notes(scenario: Scenario) -> tuple[str, ...]:
    """Notes on an actuator preset other than the thesis': its use, gaps of its source, and a band beyond its own."""
    device, sweep = scenario.device, scenario.sweep
    known = ACTUATORS[device.actuator]
    if not known.keys:
        return ()
    notes = [f"device.actuator = '{known.name}' ({known.kind}): {known.use}; not seen: {known.unseen}"]
    asked = sweep.span
    low, high = min(asked), max(asked)
    if known.band is not None and not known.band[0] <= low <= high <= known.band[1]:
        notes.append(
            f"sweep: {low:g} to {high:g} Hz reaches beyond the {known.band[0]:g} to {known.band[1]:g} Hz of "
            f"{known.name}; set sweep.f_min and sweep.f_max within, or take what is rendered there as its wish"
        )
    return tuple(notes)
