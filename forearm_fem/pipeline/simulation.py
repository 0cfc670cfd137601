"""The whole way in memory: scenario -> compliance -> G with its errors -> drives, displacements, S."""

from __future__ import annotations

import platform
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from .. import __version__
from ..device import close_loop
from ..errors import ScenarioError
from ..fem.reduction.compile_ahead import start_compiling
from ..geometry.cache import cached_mesh
from ..geometry.mesh.quality import Resolution
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..progress import Progress
from ..rendering import Rendering
from ..rendering.interval import StrengthAccount
from ..rendering.job import RenderJob, render_transfer
from ..scenario import Scenario
from ..scenario.frequencies import frequencies
from ..tissue import resolve_tissues
from ..transfer import Compliance, ErrorEstimate, TransferMatrix, finite, relative_error_at
from ..typing import FloatArray
from .dispersion import Lags
from .forecast import forecast, refuse_if_too_large
from .layered_engine import flat_notes, solve_layered
from .notes import idle_size_notes, model_notes, near_disc_notes
from .solved import Solved, solve
from .two_meshes import change_around, judged, over_pairs

# Shares of a change of ends that bracket the true error of cutting the limb (docs/decisions/0016).
OTHER_ENDS, _OTHER = 0.5, "the ends are clamped (where they are clamped: freed), on the coarser mesh"
FREED_ENDS, _FREED = 0.5, "the absorbing ends are freed (by the reduced model)"


@dataclass(frozen=True, eq=False)
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


class AnswersForArm(Protocol):
    """What stands in place of a solve: an arm's library."""

    def solved(self, scenario: Scenario) -> Solved:
        """Compliance of the scenario's contacts and points, with what its errors follow from."""
        ...


def simulate(
    scenario: Scenario,
    *,
    base: str | Path = ".",
    progress: Progress | None = None,
    mesh: TissueMesh | None = None,
    library: AnswersForArm | None = None,
) -> Simulation:
    """G of ``scenario`` in m per volt (or per newton, per metre) with an error estimate per source.

    A ``library`` of the scenario's arm takes the place of mesh and solve (:mod:`forearm_fem.library`).
    ``base`` is the folder that user files in the scenario refer to, also the wavelet's that :func:`render` reads.
    Raises a :class:`ForearmError` for whatever cannot be built or solved.
    """
    if not isinstance(scenario, Scenario):
        raise ScenarioError(f"expected a Scenario, got {scenario!r}; read it first: load_scenario(NAME_OR_FILE)")
    frequency = frequencies(scenario.sweep)
    resolve_tissues(scenario)  # what they lack is said before anything is meshed
    if library is not None:
        found = with_device(scenario, None, library.solved(scenario))
    elif scenario.engine == "layered":
        compliance = solve_layered(scenario, frequency, progress=progress)
        transfer = finite(close_loop(compliance, scenario.device))
        found = Simulation(scenario, None, compliance, transfer, notes=flat_notes(compliance))
    else:
        if mesh is None:
            start_compiling()
            mesh = cached_mesh(scenario, base=Path(base))
        expected = forecast(scenario, base=Path(base), mesh=mesh)
        refuse_if_too_large(expected, scenario)
        result = with_device(scenario, mesh, solve(scenario, mesh, frequency, base=Path(base), progress=progress))
        notes = *expected.sentences(float(frequency[-1])), *result.notes
        found = replace(result, notes=notes, resolution=expected.resolution)
    said = {**found.transfer.provenance, **provenance(found)}
    return replace(found, transfer=replace(found.transfer, provenance=said), base=Path(base))


def provenance(found: Simulation) -> dict[str, Any]:
    """What a G came from: scenario, versions, direct solver, mesh hash."""
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
    errors = [*solved.unknown, *([_discretisation(transfer, coarse, scenario, mesh)] if coarse else [])]
    truncations = []
    if solved.freed:
        freed = finite(close_loop(solved.freed, scenario.device))
        truncations.append(_truncation(transfer, transfer, freed, FREED_ENDS, _FREED))
    if solved.other_ends and coarse:
        other = finite(close_loop(solved.other_ends, scenario.device))
        truncations.append(_truncation(transfer, coarse, other, OTHER_ENDS, _OTHER))
    if truncations and all(e.source != "truncation" for e in solved.unknown):  # half a reading is none
        errors.append(_either(truncations))
    transfer = replace(transfer, errors=(*errors, *transfer.errors))
    unknown = tuple(f"the error by {e.source} is unknown: {e.method}" for e in solved.unknown)
    near = near_disc_notes(scenario) if mesh is not None else ()
    notes = (*unknown, *model_notes(solved.facts), *near, *idle_size_notes(scenario))
    return Simulation(scenario, mesh, solved.compliance, transfer, coarse, solved, notes)


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
) -> StrengthAccount:
    """Intervals and companions of every S of ``rendering``, which :func:`render_transfer` made of ``transfer``."""
    return RenderJob.of(scenario, transfer, base=base).account(transfer, rendering)


def _discretisation(
    fine: TransferMatrix, coarse: TransferMatrix, scenario: Scenario, mesh: TissueMesh | None
) -> ErrorEstimate:
    ratio, lag = float(coarse.provenance["ratio"]), np.zeros(fine.values.shape)
    coarser = lag
    if mesh is not None:
        lags = Lags.of(scenario, mesh, fine.outputs, fine.inputs)
        lag, coarser = (lags.phases(scenario, fine.frequency, scale) for scale in (1.0, max(ratio, 1.0)))
    found = judged(coarse.values, fine.values, fine.frequency, ratio, lag, coarser)
    pairs = over_pairs(found.error, coarse.values, fine.values, fine.frequency)
    pairs = np.maximum(pairs, found.unseen / np.abs(fine.values).max(axis=(1, 2), keepdims=True))
    lost = fine.frequency[found.unseen.any(axis=(1, 2))]
    blind = f"; from {lost[0]:g} Hz on at least the lag of waves too short for the elements" if len(lost) else ""
    if mesh is None:
        blind = "; waves too short for both meshes are not looked for, as a library has no mesh"
    return ErrorEstimate(
        "discretisation",
        found.band,
        f"change of G on a second mesh, nodes {ratio:.2g} times as far apart, over |{ratio:.2g}^p - 1|; order p is "
        f"1.85 where that is below 0.115 ({found.order.min():.3g} where waves are latest), 3 above 0.117{blind}",
        tuple(fine.frequency.tolist()),
        tuple(found.error.tolist()),
        pairs,
    )


def _either(estimates: list[ErrorEstimate]) -> ErrorEstimate:
    """The largest of ``estimates``, freed ends first, at each frequency: with ends that reflect a share r of -1
    (clamped) to 1 (free), and E what comes back from free ones, they err by |r| E and change by (1 - r) E when freed,
    (1 + r) E when clamped. Half of the larger change is (1 + |r|) E / 2 >= |r| E, half of either alone may be zero.

    Nor is less stated than at any higher frequency: E decays with frequency, but where waves are longer than the slab
    both changes may pass through small values.
    """
    if len(estimates) == 1:
        return estimates[0]
    freed, clamped = estimates
    frequency = np.unique(np.concatenate([e.frequency for e in estimates]))
    larger = np.maximum(relative_error_at(freed, frequency), _between(clamped, freed, frequency))
    error = np.maximum.accumulate(larger[::-1])[::-1]
    method = "at each frequency the larger of " + " and ".join(e.method for e in estimates) + ", there or higher up"
    return ErrorEstimate(
        "truncation", max(e.band for e in estimates), method, tuple(frequency.tolist()), tuple(error.tolist())
    )


def _between(few: ErrorEstimate, many: ErrorEstimate, frequency: FloatArray) -> FloatArray:
    """e(f) (n,) of ``few`` at ``frequency`` (n,) [Hz], between its own ones in proportion to ``many``.

    What comes back from ends decays by orders of magnitude between the few frequencies that clamped ends are solved
    at, and E is common to both. A straight line, which overstates there, is never exceeded: where freed ends change
    nothing, there is no proportion.
    """
    straight, at = relative_error_at(few, frequency), np.asarray(few.frequency)
    own, other = relative_error_at(few, at), relative_error_at(many, at)
    if not (own * other > 0).all():
        return straight
    share = np.exp(np.interp(np.sqrt(frequency), np.sqrt(at), np.log(own / other)))
    return np.asarray(np.minimum(straight, share * relative_error_at(many, frequency)))


def _truncation(
    transfer: TransferMatrix, own: TransferMatrix, other: TransferMatrix, share: float, method: str
) -> ErrorEstimate:
    """A ``share`` of the change of G when the ends are changed, tested against longer limbs and the endless twin.

    Waves from the ends cancel at some frequencies by chance, so e(f) listens to its neighbours as two meshes' does.
    Waves that reach the ends are long, so all pairs err about alike and are not told apart. The truth lies between
    two G that err by as much either way, and what is stated is relative to it: where ends make most of G, clamped ones
    leave nothing of it, and half of that change would be half of G at most.
    """
    same = own.values[np.searchsorted(own.frequency, other.frequency)]
    size = np.linalg.norm(same, axis=(1, 2))
    between = np.clip(np.linalg.norm(same + other.values, axis=(1, 2)) / 2, size / 2, size)
    shares = share * size / between
    change = np.linalg.norm(other.values - same, axis=(1, 2)) / size
    weight = np.linalg.norm(transfer.values, axis=(1, 2)) ** 2
    spread = np.interp(np.sqrt(transfer.frequency), np.sqrt(other.frequency), shares * change)
    return ErrorEstimate(
        "truncation",
        float(np.sqrt(np.sum(weight * spread**2) / np.sum(weight))),
        f"{share:g} of the change of G when {method}, over what lies between the two where that is less",
        tuple(other.frequency.tolist()),
        tuple((shares * change_around(other.values, same, other.frequency)).tolist()),
    )
