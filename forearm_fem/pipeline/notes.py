"""What a reader of the results should know of the model and of the actuator behind them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..results import SolutionRecord
from ..scenario import Scenario
from ..scenario.actuators import ACTUATORS
from ..scenario.limb import MeshLimb, SlabLimb
from .samples import sample_notes


def scene_notes(scenario: Scenario) -> tuple[str, ...]:
    """What can be said of a scenario before it is meshed or solved, but for keys that nothing reads."""
    kinds = (actuator_notes, lifted_notes, covered_notes, sample_notes)
    return tuple(note for notes in kinds for note in notes(scenario))


def model_notes(solution: SolutionRecord) -> tuple[str, ...]:
    """That the reduced model is good for frequencies of the band only, where it has unstable poles.

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


def idle_size_notes(scenario: Scenario) -> tuple[str, ...]:
    """A note on sizes that were given for a user's own mesh, which they do not change."""
    given = sorted(scenario.mesh.model_fields_set & {"size_grid", "size_far", "sublayers", "grading"})
    if not isinstance(scenario.limb, MeshLimb) or not given:
        return ()
    names = ", ".join(f"mesh.{name}" for name in given)
    return (f"{names}: your own mesh is refined under and around the contacts only, these change nothing else",)


def lifted_notes(scenario: Scenario) -> tuple[str, ...]:
    """That funneling, whose shares follow from places alone, drives actuators that do not touch the skin."""
    lifted, shared = scenario.device.out_of_contact, {"funneling", "combination"} & set(scenario.rendering.methods)
    if not lifted or not shared:
        return ()
    return (
        f"device.out_of_contact: no skin moves under {', '.join(lifted)}, but shares of "
        f"{' and '.join(sorted(shared, reverse=True))} follow from places alone and drive there all the same; judge by "
        "the inverse filter, or leave such actuators out of device.contacts",
    )


def covered_notes(scenario: Scenario) -> tuple[str, ...]:
    """That points under a cone that touches move with it, so that S towards them is no focus."""
    device = scenario.device
    feet = [c for k, c in enumerate(device.centres, start=1) if f"A{k}" not in device.out_of_contact]
    gaps = (min(math.dist(place, foot) for foot in feet) for place in scenario.grid.places)
    under = [str(i) for i, gap in enumerate(gaps, start=1) if gap <= device.cone.radius]
    if not under or not scenario.rendering.methods:
        return ()
    return (
        f"grid: {_lie(under)} under a cone, moving with it: S towards such a point is no focus on the skin, and S "
        "towards others counts it as one of them; move it (grid.pitch, grid.points), or the cones",
    )


def _lie(points: Sequence[str]) -> str:
    named = ", ".join(points[:6]) + (", ..." if len(points) > 6 else "")
    return f"point {named} lies" if len(points) == 1 else f"points {named} lie"


def actuator_notes(scenario: Scenario) -> tuple[str, ...]:
    """What a preset other than the thesis' can be used for, what its source does not say, and a band beyond its own."""
    device, sweep = scenario.device, scenario.sweep
    known = ACTUATORS[device.actuator]
    if not known.keys:
        return ()
    notes = [f"device.actuator = '{known.name}' ({known.kind}): {known.use}; not seen: {known.unseen}"]
    asked = sweep.frequencies or (sweep.f_min, sweep.f_max)
    low, high = min(asked), max(asked)
    if known.band is not None and not known.band[0] <= low <= high <= known.band[1]:
        notes.append(
            f"sweep: {low:g} to {high:g} Hz reaches beyond the {known.band[0]:g} to {known.band[1]:g} Hz of "
            f"{known.name}; set sweep.f_min and sweep.f_max within, or take what is rendered there as its wish"
        )
    return tuple(notes)
