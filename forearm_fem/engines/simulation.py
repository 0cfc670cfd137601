"""The whole way in memory: scenario -> compliance -> G with its errors -> drives, displacements, S."""

from __future__ import annotations

import platform
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..accuracy.discretisation import discretisation_of
from ..accuracy.truncation import combined_truncation_error, freed_ends_error, other_ends_error
from ..device import close_loop
from ..errors import ScenarioError
from ..geometry.mesh.quality import Resolution
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..progress import Progress
from ..rendering import Rendering
from ..rendering.interval import Strength
from ..rendering.job import RenderJob, render_transfer
from ..scenario import Scenario
from ..scenario.sweep import frequencies
from ..tissue import resolve_tissues
from ..transfer import Compliance, TransferMatrix, finite
from .engine import Engine, SolvingEngine, engine_of, refuse_unheld
from .layered import LayeredEngine, flat_notes
from .notes import model_notes, near_disc_notes
from .solved import Solved

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import FigureBase

    from ..typing import ComplexArray

__all__ = ["Simulation", "render", "simulate"]


@dataclass(frozen=True, eq=False, repr=False)
class Simulation:
    """A simulated calibration.

    ``coarse`` is G on the second mesh (None where no estimate was asked or could be made): ``transfer.errors`` and the
    error of S follow from it. ``notes`` are sentences that belong in the report. ``base`` is the folder that files in
    the scenario are seen from. ``resolution`` is how finely the mesh carries the shortest waves, by tissue.
    """

    scenario: Scenario
    mesh: TissueMesh | None
    compliance: Compliance
    transfer: TransferMatrix
    coarse: TransferMatrix | None = None
    solved: Solved | None = None
    notes: tuple[str, ...] = field(default=())
    base: Path = Path(".")
    resolution: tuple[Resolution, ...] = ()

    def __repr__(self) -> str:
        return f"<Simulation of '{self.scenario.name}': {self.transfer!r}>"

    def _repr_html_(self) -> str:
        return self.transfer._repr_html_()

    @cached_property
    def rendering(self) -> Rendering:
        """Drives, displacements and S of the scenario's methods and targets."""
        return render(self)

    @property
    def strength(self) -> Strength:
        """S with its interval."""
        return self.rendering.strength

    def sel(self, output: str, input: str) -> ComplexArray:
        """G (n_frequency,) of one point by one actuator, e.g. ``sel("5", "A1")``."""
        return self.transfer.sel(output, input)

    def to_xarray(self) -> xr.DataArray:
        """G (frequency, output, input)."""
        return self.transfer.to_xarray()

    def plot(self) -> FigureBase:
        """Size and phase of each entry of G, within its stated error."""
        return self.transfer.plot()

    def save(self, path: str | Path) -> None:
        """Write G: see :meth:`.TransferMatrix.save`."""
        self.transfer.save(path)


def simulate(
    scenario: Scenario,
    *,
    base: str | Path = ".",
    progress: Progress | None = None,
    mesh: TissueMesh | None = None,
    engine: Engine | None = None,
) -> Simulation:
    """G of ``scenario`` in m per volt (or per newton, per metre) with an error estimate per source.

    An ``engine``, such as the arm's library (:mod:`forearm_fem.engines.library`), takes the place of the one that the
    scenario names. ``mesh`` is what finite elements are to use. ``base`` is the folder that user files in the scenario
    refer to, also the wavelet's that :func:`render` reads. Raises a :class:`ForearmError` for whatever cannot be built
    or solved.
    """
    if not isinstance(scenario, Scenario):
        raise ScenarioError(f"expected a Scenario, got {scenario!r}; read it first: load_scenario(NAME_OR_FILE)")
    frequency = frequencies(scenario.sweep)
    resolve_tissues(scenario)  # what they lack is said before anything is meshed
    engine = engine or engine_of(scenario, base=Path(base), mesh=mesh, progress=progress)
    refuse_unheld(engine, scenario)
    if isinstance(engine, SolvingEngine):
        solved = engine.solved(scenario, frequency)
        found = with_device(scenario, solved.mesh, solved)
    else:
        compliance = engine.compliance(scenario, frequency)
        notes = flat_notes(compliance) if isinstance(engine, LayeredEngine) else (f"engine: {engine.name}",)
        transfer = finite(close_loop(compliance, scenario.device))
        found = Simulation(scenario, None, compliance, transfer, notes=notes)
    said = {**found.transfer.provenance, **provenance(found)}
    return replace(found, transfer=replace(found.transfer, provenance=said), base=Path(base))


def provenance(found: Simulation) -> dict[str, Any]:
    """Provenance of a G: scenario, versions, direct solver, mesh hash."""
    return {
        "program": f"forearm_fem {__version__}",
        "scenario": found.scenario.model_dump(mode="json"),
        "mesh_sha256": found.mesh.digest if found.mesh else None,
        "solver": found.solved.facts.solver if found.solved else None,
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the libraries that make the numbers."""
    found = {"python": platform.python_version()}
    for name in ("numpy", "scipy", "scikit-fem", "pytetwild", "meshio", "trimesh", "pyvista", "numba", "mkl"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def with_device(scenario: Scenario, mesh: TissueMesh | None, solved: Solved) -> Simulation:
    """G and its errors from compliances: the device enters here, at no further FE solve."""
    transfer = finite(close_loop(solved.compliance, scenario.device))
    coarse = finite(close_loop(solved.coarse, scenario.device)) if solved.coarse else None
    errors = [*solved.unknown, *([discretisation_of(transfer, coarse, scenario)] if coarse else [])]
    truncations = []
    if solved.freed:
        freed = finite(close_loop(solved.freed, scenario.device))
        truncations.append(freed_ends_error(transfer, freed))
    if solved.other_ends and coarse:
        other = finite(close_loop(solved.other_ends, scenario.device))
        truncations.append(other_ends_error(transfer, coarse, other))
    if truncations and all(e.source != "truncation" for e in solved.unknown):  # half a reading is none
        errors.append(combined_truncation_error(truncations))
    transfer = replace(transfer, errors=(*errors, *transfer.errors))
    unknown = tuple(f"the error by {e.source} is unknown: {e.method}" for e in solved.unknown)
    near = near_disc_notes(scenario) if mesh is not None else ()
    notes = (*solved.notes, *unknown, *model_notes(solved.facts), *near)
    return Simulation(scenario, mesh, solved.compliance, transfer, coarse, solved, notes, resolution=solved.resolution)


def render(simulation: Simulation, *, progress: Progress | None = None) -> Rendering:
    """Drives, displacements and S of the scenario's methods and targets on its G.

    Errors as of :func:`render_transfer`.
    """
    if not isinstance(simulation, Simulation):
        raise ScenarioError(
            f"expected what simulate() gives, got a {type(simulation).__name__}; of a G alone: "
            "render_transfer(SCENARIO, G), or forearm_fem.rendering.render_all(G)"
        )
    return render_transfer(simulation.scenario, simulation.transfer, base=simulation.base, progress=progress)


def account_of(
    scenario: Scenario, transfer: TransferMatrix, rendering: Rendering, *, base: str | Path = "."
) -> Strength:
    """Intervals and companions of every S of ``rendering``, which :func:`render_transfer` made of ``transfer``."""
    return RenderJob.of(scenario, transfer, base=base).account(transfer, rendering)
