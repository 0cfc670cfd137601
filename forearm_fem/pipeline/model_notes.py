"""What a reader of the results should know of the finite-element model behind them."""

from __future__ import annotations

import numpy as np

from ..geometry.mesh.tissue_mesh import TissueMesh
from ..results import SolutionRecord
from ..scenario import Scenario
from ..scenario.limb import MeshLimb, SlabLimb, SurfacesLimb
from .forecast import forecast
from .frequencies import frequencies


def resolution_notes(scenario: Scenario, mesh: TissueMesh) -> tuple[str, ...]:
    """A sentence for each tissue whose waves the mesh carries with too few nodes."""
    return forecast(scenario, mesh=mesh).sentences(float(frequencies(scenario.sweep)[-1]))


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
    named = ", ".join(near[:6]) + (", ..." if len(near) > 6 else "")
    return (
        f"points {named} lie within 8 mm of the rim of a disc of pressure on second-order elements, where as little as "
        "a tenth of the error was stated; mesh.element = 'P2/P3' errs a tenth there, at two to four times the unknowns",
    )


def end_notes(scenario: Scenario, mesh: TissueMesh) -> tuple[str, ...]:
    """A sentence on the ends of a user's limb that are not cut: waves turn back there, and no estimate says so."""
    if not isinstance(scenario.limb, MeshLimb | SurfacesLimb):
        return ()
    x = mesh.points[:, 0]
    at = mesh.points[mesh.facets.get("end", np.zeros((0, 3), dtype=np.int64))][:, 0, 0]
    middle = (x.min() + x.max()) / 2
    missing = [side for side, found in (("smallest", at < middle), ("largest", at > middle)) if not found.any()]
    if not missing:
        return ()
    return (
        f"the limb has no cut end at its {' and its '.join(missing)} x, so waves turn back there as at a free end; if "
        "the arm goes on, cut its surface or mesh with a plane across x, flat to a thousandth of its length",
    )
