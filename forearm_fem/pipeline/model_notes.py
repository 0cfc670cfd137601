"""What a reader of the results should know of the finite-element model behind them."""

from __future__ import annotations

from ..geometry.mesh.tissue_mesh import TissueMesh
from ..results import SolutionRecord
from ..scenario import Scenario
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
