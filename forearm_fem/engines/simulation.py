"""The whole way in memory: scenario -> engine -> compliance -> G with its errors -> drives, displacements, S."""

from __future__ import annotations

import platform
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from .. import __version__
from ..accuracy.discretisation import discretisation_of
from ..accuracy.exact import known_errors
from ..accuracy.truncation import freed_ends_error, other_ends_error
from ..device import close_loop
from ..errors import ScenarioError
from ..geometry.mesh.quality import Resolution
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..progress import Progress
from ..rendering import Rendering
from ..rendering.interval import Strength
from ..rendering.job import render_transfer
from ..scenario import Scenario
from ..scenario.model import resolve_tissues
from ..scenario.sweep import frequencies
from ..transfer import Compliance, TransferMatrix, finite
from ..typing import FloatArray
from ..usercode import is_code, named
from .fem import Solved
from .forecast import model_notes
from .layered import LayeredEngine, flat_notes

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import FigureBase

    from ..typing import ComplexArray

__all__ = ["Simulation", "render", "simulate"]


# Engine: what answers for a scenario with the compliance between its ports.


class Engine(Protocol):
    """A model of limbs: finite elements, flat layers, tables, a reduced model, a library, or the user's own."""

    @property
    def name(self) -> str:
        """For reports, e.g. "layered"."""
        ...

    def holds(self, scenario: Scenario) -> str:
        """Reason, a sentence with the remedy, that it cannot answer for ``scenario``; empty where it can.

        What shows only while it works, such as ports beside the limb, is raised there.
        """
        ...

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """Of the contacts and points of ``scenario`` at ``frequency`` (n,) [Hz], with an estimate per source of error.

        Entries between two points may be NaN: no device drives there.
        """
        ...


@runtime_checkable
class SolvingEngine(Engine, Protocol):
    """An engine that gives besides what errors by mesh and ends follow from, once the device is known."""

    def solved(self, scenario: Scenario, frequency: FloatArray) -> Solved:
        """The compliance, with those on a second mesh and with other ends."""
        ...


def engine_of(
    scenario: Scenario, *, base: Path = Path("."), mesh: TissueMesh | None = None, progress: Progress | None = None
) -> Engine:
    """The engine that the scenario names; ``mesh`` is the one that finite elements take, made where it is None.

    A class of the user's own is made by ``Class.of(scenario)`` where it has that, else by ``Class()``.
    """
    if is_code(scenario.engine):
        made = named(scenario.engine, "engine")
        found: Engine = made.of(scenario) if hasattr(made, "of") else made()
        if lacking := [what for what in ("name", "holds", "compliance") if not hasattr(found, what)]:
            raise ScenarioError(f"engine: {scenario.engine} has no {lacking[0]}; an engine has name, holds, compliance")
        return found
    if scenario.engine == "layered":
        from .layered import LayeredEngine

        return LayeredEngine(progress)
    from .fem import FemEngine

    return FemEngine(base, mesh, progress)


def refuse_unheld(engine: Engine, scenario: Scenario) -> None:
    """ScenarioError where ``engine`` cannot answer for ``scenario``."""
    if reason := engine.holds(scenario):
        raise ScenarioError(reason)


# The whole way in memory: scenario -> compliance -> G with its errors -> drives, displacements, S.

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
    exact, coarse, freed, other = (
        None if found is None else finite(close_loop(found, scenario.device))
        for found in (solved.exact, solved.coarse, solved.freed, solved.other_ends)
    )
    errors = list(solved.unknown)
    if exact is not None:
        errors += known_errors(transfer, exact, freed)
    else:
        errors += [discretisation_of(transfer, coarse, scenario)] if coarse else []
        errors += [freed_ends_error(transfer, freed)] if freed else []
        errors += [other_ends_error(transfer, coarse, other)] if coarse and other else []
    transfer = replace(transfer, errors=(*errors, *transfer.errors))
    unknown = tuple(f"the error by {e.source} is unknown: {e.method}" for e in solved.unknown)
    notes = (*solved.notes, *unknown, *model_notes(solved.facts))
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
