"""The finite-element engine: compliance of all ports, cheaper solves that tell its error, and what is kept of them."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_array, eye_array, kron, vstack

from .. import __version__
from ..accuracy.discretisation import COARSER
from ..errors import ForearmError, MeshError
from ..fem.assembly.boundary import edge_middles
from ..fem.assembly.coefficients import Polynomial
from ..fem.assembly.model import ForearmModel, build_model
from ..fem.assembly.thickness import Motion
from ..fem.kernels.compiled import freed_memory_kept, give_back
from ..fem.linear import pardiso
from ..fem.reduction.compile_ahead import finish_compiling, start_compiling
from ..fem.reduction.expansion import starts_from_rate
from ..fem.reduction.sweep import SweepResult, direct_sweep, reduced_sweep
from ..geometry.build import cached_mesh
from ..geometry.device.layout import RIGID
from ..geometry.device.place import place_ports
from ..geometry.mesh.quality import Resolution
from ..geometry.mesh.refinement import rim_edges
from ..geometry.mesh.tissue_mesh import TissueMesh, skin_edges
from ..progress import Progress, tell, within
from ..results.run import SolutionRecord
from ..scenario import Scenario
from ..scenario.limb import MeshLimb, SlabLimb
from ..scenario.model import resolve_tissues
from ..scenario.sweep import ReducedSolve
from ..scenario.text import contents, law_files
from ..store.folder import default_cache_dir
from ..store.record import dims
from ..store.shelf import Shelf
from ..store.text import digest_of
from ..transfer import Compliance, ErrorEstimate, masked, refuse_non_finite
from ..typing import ComplexArray, FloatArray
from .forecast import forecast, refuse_if_too_large
from .layered import solve_layered
from .skin_model import SkinModel

# Others where the first cannot be made; a finer one last, as it costs more than the main solve.
_RATIOS = (COARSER, 1.7, 1.3, 0.8)
# On a user's mesh, which has one size, the order changes instead: nodes are h/order apart.
_OTHER_ORDER = {"P1": ("P2", 1 / 2), "P2": ("P3", 2 / 3), "P3": ("P2", 3 / 2)}


@dataclass(frozen=True)
class Second:
    """A mesh with the scenario (its element pair) to solve on it; its nodes are ``ratio`` times as far apart."""

    scenario: Scenario
    mesh: TissueMesh
    ratio: float

    @property
    def label(self) -> str:
        """Name under which results on it are kept."""
        return f"{self.ratio:.3f}-{self.scenario.element.replace('/', '')}-{self.mesh.digest[:12]}"


def second_mesh(scenario: Scenario, mesh: TissueMesh, *, base: Path) -> Second:
    """The second mesh: sizes 1.4 times as large, or what else can be made.

    A user's ``mesh`` is kept and its element pair changed. Raises :class:`MeshError` saying why there is none.
    """
    if isinstance(scenario.limb, MeshLimb):
        if scenario.element not in _OTHER_ORDER:
            raise MeshError(
                "a mesh of your own has one size, so that its error is estimated with another order, and of element "
                f"pair {scenario.element} neither second nor third order is one; set mesh.element to P2 or P3"
            )
        element, ratio = _OTHER_ORDER[scenario.element]
        return Second(scenario.changed({"mesh.element": element}), mesh, ratio)
    first: ForearmError | None = None
    for ratio in _RATIOS:
        try:
            other = cached_mesh(scenario, base=base, scale=ratio)
        except ForearmError as problem:
            first = first or problem
            continue
        if _differs(scenario, mesh, other, ratio):
            return Second(scenario, other, ratio)
    reason = first or "rims come out as fine on all of them; set mesh.size_contact smaller"
    raise MeshError(f"no second mesh could be made: {reason}")


def _differs(scenario: Scenario, mesh: TissueMesh, other: TissueMesh, ratio: float) -> bool:
    """True if all rims of rigid contacts differ by 0.4 of what ``ratio`` asks for at least: bisection halves edges."""
    if scenario.device.cone.contact not in RIGID:
        return True
    names = [name.removeprefix("contact ") for name in mesh.facets if name.startswith("contact ")]
    found = np.array([_rim_edge(other, name) / _rim_edge(mesh, name) for name in names])
    return bool(np.all((found - 1) * np.sign(ratio - 1) >= 0.4 * abs(ratio - 1)))


def _rim_edge(mesh: TissueMesh, name: str) -> float:
    """Mean length [m] of the edges of a contact's rim."""
    ends = mesh.points[rim_edges(mesh, name)]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())


# The finite-element engine: compliance of all ports, and the two cheaper solves that tell its error.

REDUCTION = 1e-4  # e(f) asked of a reduced model where no accuracy is given
TRUNCATION_PROBES, FREED_PROBES = 4, 80  # by direct solves, by the reduced model
_LARGE, _SMALL = 100_000, 30_000  # unknowns of a mesh, and of its second one, from which complex kernels pay
_OTHER_ENDS = {"absorb": "fixed", "fixed": "free", "free": "fixed"}
_FEWER_OF_RATE = 24  # not certified: e_band 0.1 % of the forearm's points, 0.2 % at a bin
_FEWER = {"expansions": 3, "derivatives": 8, "point_derivatives": 1}  # the same where moduli are not Kelvin-Voigt


@dataclass(frozen=True)
class FemSolution:
    """Compliance, the sweep it came from, and what the error estimates need."""

    compliance: Compliance
    sweep: SweepResult
    model: ForearmModel


def solve_fem(
    scenario: Scenario,
    mesh: TissueMesh,
    frequency: FloatArray,
    *,
    progress: Progress | None = None,
    kept: Shelf | None = None,
    tolerance: float | None = REDUCTION,
    widen: bool = False,
) -> FemSolution:
    """Compliance of all ports of ``scenario`` on ``mesh`` at ``frequency`` (n,) [Hz].

    ``tolerance`` is e(f) asked of the reduced model, None for an uncertified one; its expansions are ``kept``.
    ``widen`` adds directions for other tissues.
    """
    tell(progress, "assembly", 0, 1)
    give_back()  # what an earlier solve left
    model = fem_model(scenario, mesh)
    tell(progress, "assembly", 1, 1)
    solver = scenario.solver
    small = solver if isinstance(solver, ReducedSolve) and len(frequency) > solver.expansions else None
    seldom = small is not None and model.operator.n < _LARGE and starts_from_rate(model, small)
    finish_compiling(progress, complex_ones=not (seldom and pardiso.mkl_library() is not None))
    give_back()  # element matrices and matrices before constraints are gone: more than the operator itself
    if small is not None:
        result = reduced_sweep(model, frequency, small, tolerance=tolerance, progress=progress, kept=kept, widen=widen)
    else:
        result = direct_sweep(model, frequency, solver, progress=progress)
    compliance = Compliance(frequency, masked(result.values, model.ports), model.ports, _errors(result))
    refuse_non_finite("the compliance", frequency, compliance.values[:, :, compliance.indices("contact")])
    return FemSolution(compliance, result, model)


def fem_model(scenario: Scenario, mesh: TissueMesh, *, motion: Motion | None = None) -> ForearmModel:
    """Operator and ports of ``scenario`` on ``mesh``; ``motion`` adds terms of other thicknesses."""
    return build_model(
        mesh,
        place_ports(scenario, mesh),
        resolve_tissues(scenario),
        scenario.supports,
        scenario.tissues.membrane,
        element=scenario.element,
        patch=scenario.tissues.patch,
        motion=motion,
    )


def endless(scenario: Scenario, frequency: FloatArray) -> Compliance | None:
    """Compliance of a slab's layers without end, by the layered model; None of other limbs, and where that lacks
    something or is not known well enough to tell the error asked for."""
    if not isinstance(scenario.limb, SlabLimb):
        return None
    try:
        found = solve_layered(scenario, frequency)
    except ForearmError:
        return None
    return found if max(e.worst for e in found.errors) < scenario.accuracy / 4 else None


def second_compliance(second: Second, frequency: FloatArray, *, progress: Progress | None = None) -> Compliance:
    """Compliance on the second mesh, less certain than the first one's; its provenance holds the ``ratio``."""
    scenario = second.scenario
    if isinstance(solver := scenario.solver, ReducedSolve):
        rougher = _FEWER if solver.start == "frequencies" else {**_FEWER, "rate_derivatives": _FEWER_OF_RATE}
        scenario = scenario.changed({f"solver.{key}": value for key, value in rougher.items()})
    found = solve_fem(scenario, second.mesh, frequency, progress=progress, tolerance=None).compliance
    return replace(found, provenance={"ratio": second.ratio})


def freed_ends(solution: FemSolution) -> Compliance | None:
    """Compliance with free ends instead of absorbing ones at some bins, from the reduced model: no factorisation.

    Its difference from the scenario's own ends shows how much of the answer comes back from them. None where nothing
    absorbs or the sweep was direct.
    """
    reduced, own = solution.sweep.reduced, solution.compliance
    names = [] if reduced is None else [n for n in reduced.names if n.startswith("dashpots")]
    if reduced is None or not names:
        return None
    some = own.frequency[truncation_probes(len(own.frequency), FREED_PROBES)]
    values = reduced.changed(dict.fromkeys(names, Polynomial())).compliance(some)
    return Compliance(some, masked(values, own.ports), own.ports)


def other_ends(second: Second, frequency: FloatArray) -> Compliance:
    """Compliance on the second mesh with another kind of ends at some of the frequencies, where the mesh has cut ends.

    Absorbing ends are clamped, for what :func:`freed_ends` cannot do: direct solves at a few. Clamped ends are freed
    and free ones clamped, as these err by as much the other way: all but certain, at as many as freed ends are.
    """
    scenario = second.scenario.changed({"supports.ends": _OTHER_ENDS[second.scenario.supports.ends]})
    n = len(frequency)
    if second.scenario.supports.ends != "absorb":
        some = frequency[truncation_probes(n, FREED_PROBES)]
        return second_compliance(Second(scenario, second.mesh, second.ratio), some)
    probes = frequency[truncation_probes(n)]
    model, options = fem_model(scenario, second.mesh), scenario.solver
    if model.operator.n < _SMALL and options.backend == "auto" and pardiso.mkl_library() is not None:
        options = options.changed({"backend": "pardiso"})  # needs no kernels that a first run compiles
    values = direct_sweep(model, probes, options).values
    return Compliance(probes, masked(values, model.ports), model.ports)


def truncation_probes(n: int, count: int = TRUNCATION_PROBES) -> list[int]:
    """Indices of ``count`` of ``n`` frequencies, closer together at the low end where waves reach the ends."""
    places = np.linspace(0, 1, min(count, n)) ** 2
    return sorted({round(float(p) * (n - 1)) for p in places})


def _errors(result: SweepResult) -> tuple[ErrorEstimate, ...]:
    kinds = {c.by for c in result.certificates}
    how = "adjoint-weighted residual |x_i . r_j| of the solves used"
    if "elimination" in kinds:
        how = f"the larger of {how}, and eight times what a certificate's elimination makes of known solutions"
    solve = ErrorEstimate("linear solve", result.solve_error, how)
    if not result.certificates:
        return (solve,)
    text = ", ".join(f"{c.frequency:g} Hz ({c.error:.1e})" for c in result.certificates)
    found = "true error" if kinds != {"residual"} else "twice what a richer space finds of the error"
    against = ", against direct solves not used before" if kinds != {"residual"} else ", by its residual"
    where = f"{found} where one derivative changes the model most{against}: {text}"
    return solve, ErrorEstimate("reduction", result.reduction_error, where)


# Everything that needs a factorisation, kept in a cache folder so that no finished part is computed twice.

@dataclass(frozen=True, eq=False)
class Solved:
    """All compliances of a scenario on one mesh.

    ``exact`` is the layered model's of a slab, ``coarse`` on the second mesh of other limbs (None where no estimate
    was asked or could be made). ``freed`` has free ends on the same mesh, ``other_ends`` other ends on the second one
    at a few frequencies (None where not asked). ``unknown`` are the estimates that were not asked for or could not be
    made.

    ``modes`` (n_point, 3, r) and ``states`` (n_frequency, r, n_contact) rebuild the wavefield at the mesh vertices per
    unit contact force; empty for a direct sweep. ``facts`` are for the record. ``skin`` is the reduced model without
    its modes. ``mesh`` is the one solved on, ``resolution`` how finely it carries the shortest waves. ``notes`` are
    sentences about that.
    """

    kind: ClassVar[str] = "solution"
    version: ClassVar[int] = 3

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
    exact: Compliance | None = None


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
        said = expected.sentences(float(frequency[-1])) if found.exact is None else expected.doubts
        return replace(found, mesh=mesh, notes=said, resolution=expected.resolution)


@freed_memory_kept()
def solve(
    scenario: Scenario, mesh: TissueMesh, frequency: FloatArray, *, base: Path, progress: Progress | None = None
) -> Solved:
    """Solve what is not in the cache yet; each finished part is stored at once."""
    home, key = default_cache_dir() / "solves", solve_key(scenario, mesh, frequency)
    shelf, parts = Shelf(home / f"{key}.sqlite"), Shelf(home / f"{key}-parts.sqlite", "an expansion")
    if (main := shelf.record("main", Solved)) is None:
        tolerance = scenario.reduction_tolerance
        solution = solve_fem(
            scenario, mesh, frequency, progress=progress, kept=parts, tolerance=tolerance, widen=True
        )
        main = _packed(scenario, solution, frequency)
        del solution  # operator and basis, gigabytes on a fine mesh, are of no use to the second one
        if shelf.keep("main", main):
            parts.remove()
    cut = main.freed is None and len(mesh.facets.get("end", ())) > 0
    if not scenario.solver.discretisation_estimate:
        return replace(main, unknown=_missing("solver.discretisation_estimate = false; set it to true", cut))
    if (exact := endless(scenario, frequency)) is not None:
        return replace(main, exact=exact)
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
        "tolerance": scenario.reduction_tolerance,
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
        states = sweep.states(frequency, contacts).astype(np.complex64, order="C")  # as kept: the same bits
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
