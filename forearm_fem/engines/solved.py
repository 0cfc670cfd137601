"""Everything that needs a factorisation, kept in a cache folder so that no finished part is computed twice."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_array, eye_array, kron, vstack

from .. import __version__
from ..errors import ForearmError
from ..fem.assembly.boundary import edge_middles
from ..fem.kernels.compiled import freed_memory_kept
from ..fem.reduction.compile_ahead import start_compiling
from ..geometry.cache import cached_mesh
from ..geometry.device.place import place_ports
from ..geometry.mesh.quality import Resolution
from ..geometry.mesh.tissue_mesh import TissueMesh, skin_edges
from ..progress import Progress, tell, within
from ..results.run import SolutionRecord
from ..scenario import Scenario
from ..scenario.limb import SlabLimb
from ..scenario.shipped import contents, law_files
from ..store.record import dims
from ..store.shelf import Shelf
from ..store.text import digest_of
from ..transfer import Compliance, ErrorEstimate
from ..typing import ComplexArray, FloatArray
from ..user_cache import default_cache_dir
from .fem import FemSolution, freed_ends, other_ends, reduction_tolerance, second_compliance, solve_fem
from .forecast import forecast, refuse_if_too_large
from .second_mesh import second_mesh
from .skin_model import SkinModel


@dataclass(frozen=True, eq=False)
class Solved:
    """All compliances of a scenario on one mesh.

    ``coarse`` is on the second mesh (None where no estimate was asked or could be made); ``freed`` has free ends on
    the same mesh, ``other_ends`` other ends on the second one at a few frequencies (None where not asked). ``unknown``
    are the estimates that were not asked for or could not be made. ``modes`` (n_point, 3, r) and ``states``
    (n_frequency, r, n_contact) rebuild the wavefield at the mesh vertices per unit contact force; empty for a direct
    sweep. ``facts`` are for the record; ``skin`` is the reduced model without its modes. ``mesh`` is the one solved on,
    ``resolution`` how finely it carries the shortest waves, and ``notes`` are sentences about that.
    """

    kind: ClassVar[str] = "solution"
    version: ClassVar[int] = 2

    compliance: Compliance
    coarse: Compliance | None
    freed: Compliance | None
    modes: FloatArray = field(metadata=dims("point xyz mode", single=True))
    states: ComplexArray = field(metadata=dims("frequency mode contact", single=True))
    facts: SolutionRecord
    unknown: tuple[ErrorEstimate, ...] = ()
    skin: SkinModel | None = None
    other_ends: Compliance | None = None
    mesh: TissueMesh | None = None
    notes: tuple[str, ...] = ()
    resolution: tuple[Resolution, ...] = ()


@dataclass(frozen=True)
class FemEngine:
    """Finite elements on the scenario's ``mesh``, made where it is None; user files are seen from ``base``."""

    base: Path = Path(".")
    mesh: TissueMesh | None = None
    progress: Progress | None = None
    name: str = "fem"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: any limb; what meshing finds is raised as it is found."""
        return ""

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """See :class:`.Engine`."""
        return self.solved(scenario, frequency).compliance

    def solved(self, scenario: Scenario, frequency: FloatArray) -> Solved:
        """See :class:`.SolvingEngine`; SolverError where the solve would pass ``solver.memory_limit``."""
        mesh = self.mesh
        if mesh is None:
            start_compiling()
            mesh = cached_mesh(scenario, base=self.base)
        expected = forecast(scenario, base=self.base, mesh=mesh)
        refuse_if_too_large(expected, scenario)
        found = solve(scenario, mesh, frequency, base=self.base, progress=self.progress)
        said = expected.sentences(float(frequency[-1]))
        return replace(found, mesh=mesh, notes=said, resolution=expected.resolution)


@freed_memory_kept()
def solve(
    scenario: Scenario, mesh: TissueMesh, frequency: FloatArray, *, base: Path, progress: Progress | None = None
) -> Solved:
    """Solve what is not in the cache yet; each finished part is stored at once."""
    home, key = default_cache_dir() / "solves", solve_key(scenario, mesh, frequency)
    shelf, parts = Shelf(home / f"{key}.sqlite"), Shelf(home / f"{key}-parts.sqlite", "an expansion")
    if (main := shelf.record("main", Solved)) is None:
        tolerance = reduction_tolerance(scenario)
        solution = solve_fem(
            scenario, mesh, frequency, progress=progress, kept=parts, tolerance=tolerance, widen=True
        )
        main = _packed(scenario, solution, frequency)
        del solution  # operator and basis, gigabytes on a fine mesh, are of no use to the second one
        if shelf.keep("main", main):
            parts.remove()
    # what freed ends do not show: pressure hardly feels dashpots of shear, so that a slab's ends are as good as free
    unseen = main.freed is None or isinstance(scenario.limb, SlabLimb)
    cut = unseen and len(mesh.facets.get("end", ())) > 0
    if not scenario.solver.discretisation_estimate:
        return replace(main, unknown=_missing("solver.discretisation_estimate = false; set it to true", cut))
    try:
        second = second_mesh(scenario, mesh, base=base)
        coarse = shelf.once(
            f"second-{second.label}",
            Compliance,
            lambda: second_compliance(second, frequency, progress=within(progress, "coarser mesh")),
        )
        clamped = None
        if cut:
            tell(progress, "truncation estimate", 0, 1)
            clamped = shelf.once(f"other_ends-{second.label}", Compliance, lambda: other_ends(second, frequency))
            tell(progress, "truncation estimate", 1, 1)
    except ForearmError as problem:
        return replace(main, unknown=_missing(problem, cut))
    return replace(main, coarse=coarse, other_ends=clamped)


def _missing(why: object, cut: bool) -> tuple[ErrorEstimate, ...]:
    """Estimates that lack a second mesh: of the elements, and of the ends where the limb is ``cut``."""
    discretisation = ErrorEstimate("discretisation", np.nan, f"not estimated: {why}")
    return (discretisation, replace(discretisation, source="truncation")) if cut else (discretisation,)


def solve_key(scenario: Scenario, mesh: TissueMesh, frequency: FloatArray) -> str:
    """SHA-256 of all that the compliances depend on; coils and housing are not among them."""
    parts = {
        "version": __version__,
        "mesh": mesh.digest,
        "bends": hashlib.sha256(mesh.bends.offsets.tobytes()).hexdigest(),
        "ports": [asdict(p) for p in place_ports(scenario, mesh)],
        "tissues": scenario.tissues.model_dump(mode="json"),
        "laws": contents(law_files(scenario), "."),
        "supports": scenario.supports.model_dump(mode="json"),
        "solver": scenario.solver.model_dump(mode="json", exclude={"memory_limit", "discretisation_estimate"}),
        "element": scenario.element,
        "tolerance": reduction_tolerance(scenario),
        "frequency": hashlib.sha256(frequency.tobytes()).hexdigest(),
    }
    return digest_of(parts)[:32]


def _packed(scenario: Scenario, solution: FemSolution, frequency: FloatArray) -> Solved:
    sweep, model = solution.sweep, solution.model
    n_u, n_p = model.degrees_of_freedom
    freed = freed_ends(solution)
    facts = SolutionRecord(
        displacement_unknowns=n_u,
        pressure_unknowns=n_p,
        solver=sweep.solver,
        residual=sweep.residual,
        expansion_rate=sweep.rate,
        derivatives=sweep.derivatives,
        expansion_frequencies=tuple(sweep.expansions),
        certificates=tuple(asdict(c) for c in sweep.certificates),
        unstable_poles=sweep.unstable_poles,
        reduced_size=sweep.reduced.size if sweep.reduced else 0,
        ends_by="direct solves" if freed is None else "reduced model",
    )
    modes, states = np.zeros((0, 3, 0)), np.zeros((len(frequency), 0, 0), dtype=complex)
    skin = None
    if sweep.reduced is not None:
        wider, core = (sweep.wider, sweep.wider.low.shape[1]) if sweep.wider else (sweep.reduced, 0)
        skin = SkinModel(scenario, model.ports, wider.bare(), sweep.poles, core, solution.compliance.errors)
        contacts = solution.compliance.indices("contact")
        modes = field_modes(solution)
        states = sweep.states(frequency, contacts)
    return Solved(solution.compliance, None, freed, modes, states, facts, skin=skin)


def field_modes(solution: FemSolution) -> FloatArray:
    """Displacements of the reduced basis (n_point, 3, r) at the mesh vertices, then in the middles of the skin's edges.

    These are the points of :func:`.with_finer_skin`.
    """
    reduced, model = solution.sweep.reduced, solution.model
    assert reduced is not None
    places = edge_middles(model.space, skin_edges(model.space.mesh))
    vertices = np.zeros(len(model.space.mesh.points), dtype=np.int64)
    vertices[model.space.vertices.ravel()] = model.space.nodes[:, :4].ravel()
    chosen = csr_array(eye_array(model.space.n_nodes, format="csr"))[vertices]
    shown = kron(vstack([chosen, places]), eye_array(3), format="csr") @ model.constraints.transform
    return reduced.basis.seen_by(csr_array(shown)).reshape(-1, 3, reduced.size)
