"""The whole way in memory: scenario -> compliance -> G with its errors -> drives, displacements, S."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..device import close_loop
from ..geometry.cache import cached_mesh
from ..geometry.mesh import TissueMesh
from ..rendering import Limits, Rendering, render_all
from ..scenario import Scenario
from ..transfer import Compliance, ErrorEstimate, TransferMatrix, relative_error
from .frequencies import frequencies
from .layered_engine import solve_layered
from .model_notes import model_notes, resolution_notes
from .renderers import renderers, wavelet
from .solved import Solved, solve
from .two_meshes import COARSER, estimated_errors

Progress = Callable[[str, int, int], None]
# Shares of a change of ends that bracket the true error of cutting the limb (docs/decisions.md).
OTHER_ENDS, _OTHER = 0.5, "absorbing ends are clamped (or the reverse), on the coarser mesh"
FREED_ENDS, _FREED = 0.5, "the absorbing ends are freed (by the reduced model)"


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated calibration.

    ``coarse`` is G on the second, coarser mesh (None where no estimate was asked): ``transfer.errors`` and the error
    of S follow from it. ``notes`` are sentences that belong in the report.
    """

    scenario: Scenario
    mesh: TissueMesh | None
    compliance: Compliance
    transfer: TransferMatrix
    coarse: TransferMatrix | None = None
    solved: Solved | None = None
    notes: tuple[str, ...] = field(default=())


def simulate(
    scenario: Scenario,
    *,
    base: str | Path = ".",
    progress: Progress | None = None,
    mesh: TissueMesh | None = None,
) -> Simulation:
    """G of ``scenario`` in m per volt (or per newton, per metre) with an error estimate per source.

    ``base`` is the folder that user files in the scenario refer to. Raises a :class:`ForearmError` for whatever cannot
    be built or solved.
    """
    frequency = frequencies(scenario.sweep)
    if scenario.engine == "layered":
        compliance = solve_layered(scenario, frequency, progress=progress)
        transfer = close_loop(compliance, scenario.device)
        return Simulation(scenario, None, compliance, transfer, notes=_flat_notes(scenario))
    mesh = mesh or cached_mesh(scenario, base=Path(base))
    result = closed(scenario, mesh, solve(scenario, mesh, frequency, base=Path(base), progress=progress))
    return replace(result, notes=(*resolution_notes(scenario, mesh), *result.notes))


def closed(scenario: Scenario, mesh: TissueMesh, solved: Solved) -> Simulation:
    """G and its errors from compliances: the device enters here, at no further FE solve."""
    transfer = close_loop(solved.compliance, scenario.device)
    coarse = close_loop(solved.coarse, scenario.device) if solved.coarse else None
    errors = [_discretisation(transfer, coarse)] if coarse else []
    if solved.other_ends:
        other = close_loop(solved.other_ends, scenario.device)
        if solved.facts.get("ends_by") == "reduced model":
            errors.append(_truncation(transfer, transfer, other, FREED_ENDS, _FREED))
        elif coarse:
            errors.append(_truncation(transfer, coarse, other, OTHER_ENDS, _OTHER))
    transfer = replace(transfer, errors=(*errors, *transfer.errors))
    notes = (*solved.problems, *model_notes(solved.facts))
    return Simulation(scenario, mesh, solved.compliance, transfer, coarse, solved, notes)


def render(simulation: Simulation, *, progress: Callable[[int, int, str], None] | None = None) -> Rendering:
    """Drives, displacements and S of the scenario's methods and targets on its G."""
    return render_transfer(simulation.scenario, simulation.transfer, progress=progress)


def render_transfer(
    scenario: Scenario,
    transfer: TransferMatrix,
    *,
    base: str | Path = ".",
    progress: Callable[[int, int, str], None] | None = None,
) -> Rendering:
    """The scenario's renderers on any G, simulated or measured."""
    wanted = scenario.rendering
    targets = [p.name for p in transfer.outputs] if wanted.targets == "all" else list(wanted.targets)
    device = scenario.device
    limits = Limits(device.max_voltage, device.max_power, device.coil.resistance) if transfer.unit == "m/V" else None
    return render_all(
        transfer, targets, renderers(wanted), wavelet(wanted, scenario.sweep, Path(base)), limits,
        progress=progress,
    )  # fmt: skip


def _discretisation(fine: TransferMatrix, coarse: TransferMatrix) -> ErrorEstimate:
    band, error = estimated_errors(coarse.values, fine.values, fine.frequency)
    return ErrorEstimate(
        "discretisation",
        band,
        f"change of G on a mesh with {COARSER:g} times larger elements over 2.6, over 7 where it is above 0.5",
        tuple(fine.frequency.tolist()),
        tuple(error.tolist()),
    )


def _truncation(
    transfer: TransferMatrix, own: TransferMatrix, other: TransferMatrix, share: float, method: str
) -> ErrorEstimate:
    """A ``share`` of the change of G when the ends are changed, tested against longer limbs and the endless twin."""
    same = own.values[np.searchsorted(own.frequency, other.frequency)]
    change = np.linalg.norm(other.values - same, axis=(1, 2)) / np.linalg.norm(same, axis=(1, 2))
    weight = np.linalg.norm(transfer.values, axis=(1, 2)) ** 2
    spread = np.interp(np.sqrt(transfer.frequency), np.sqrt(other.frequency), share * change)
    return ErrorEstimate(
        "truncation",
        float(np.sqrt(np.sum(weight * spread**2) / np.sum(weight))),
        f"{share:g} of the change of G when {method}",
        tuple(other.frequency.tolist()),
        tuple((share * relative_error(other.values, same)).tolist()),
    )


def _flat_notes(scenario: Scenario) -> tuple[str, ...]:
    notes = ["engine = layered: flat, endless layers without bones or ends"]
    if scenario.device.cone.contact != "pressure":
        notes.append(f"the {scenario.device.cone.contact} cones are replaced by uniform pressure on the same disc")
    if scenario.supports.underside != "free":
        notes.append("the support under the arm is left out")
    return tuple(notes)
