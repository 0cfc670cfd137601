"""The finite-element engine: compliance of all ports, and the two cheaper solves that tell its error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..fem.assembly.coefficients import Polynomial
from ..fem.assembly.model import ForearmModel, build_model
from ..fem.assembly.thickness import Motion
from ..fem.kernels.compiled import give_back
from ..fem.linear import pardiso
from ..fem.reduction.compile_ahead import finish_compiling
from ..fem.reduction.expansion import starts_from_rate
from ..fem.reduction.sweep import SweepResult, direct_sweep, reduced_sweep
from ..geometry.device.place import place_ports
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..ports import Port
from ..progress import Progress, tell
from ..scenario import Scenario
from ..scenario.limb import Supports
from ..scenario.sweep import ReducedSolve
from ..store.shelf import Shelf
from ..tissue import resolve_tissues
from ..transfer import Compliance, ErrorEstimate, refuse_non_finite
from ..typing import ComplexArray, FloatArray
from .second_mesh import Second

REDUCTION = 1e-4  # e(f) asked of a reduced model where no accuracy is given
TRUNCATION_PROBES, FREED_PROBES = 4, 80  # by direct solves, by the reduced model
_LARGE, _SMALL = 100_000, 30_000  # unknowns of a mesh, and of its second one, from which complex kernels pay
_OTHER_ENDS = {"absorb": "fixed", "fixed": "free", "free": "fixed"}
_FEWER_OF_RATE = 25  # not certified: e_band 0.2 % of the forearm's points, 0.6 % at a bin
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


def reduction_tolerance(scenario: Scenario) -> float:
    """The reduction may cost a hundredth of the accuracy asked for."""
    return scenario.accuracy / 100


def fem_model(
    scenario: Scenario, mesh: TissueMesh, *, supports: Supports | None = None, motion: Motion | None = None
) -> ForearmModel:
    """Operator and ports of ``scenario`` on ``mesh``; ``supports`` replaces the scenario's, ``motion`` adds terms of
    other thicknesses."""
    return build_model(
        mesh,
        place_ports(scenario, mesh),
        resolve_tissues(scenario),
        supports or scenario.supports,
        scenario.tissues.membrane,
        element=scenario.element,
        patch=scenario.tissues.patch,
        motion=motion,
    )


def masked(values: ComplexArray, ports: Sequence[Port]) -> ComplexArray:
    """Compliance with the self terms of points (infinite for a point force) set to NaN."""
    result, points = np.array(values, dtype=complex), [i for i, p in enumerate(ports) if p.kind == "point"]
    result[:, points, points] = np.nan
    return result


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
