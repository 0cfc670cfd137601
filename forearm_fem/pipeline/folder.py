"""The results folder: every stage writes what it made, whole or not at all, and reuses what is there."""

from __future__ import annotations

import json
import platform
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..device import close_loop, contact_state, respond
from ..errors import AccuracyWarning, DataError, ScenarioError
from ..geometry.build import limb_volume
from ..geometry.cache import cached_mesh
from ..geometry.files import write_mesh
from ..geometry.mesh import TissueMesh
from ..geometry.quality import mesh_quality
from ..io.atomic import write_text
from ..io.matlab import write_thesis_mat
from ..io.netcdf import read_compliance, read_transfer, write_transfer
from ..io.signals import stack, write_displacements, write_drives
from ..io.tables import strength_rows, write_signal_strength_csv
from ..rendering import Rendering
from ..scenario import Scenario
from ..transfer import ErrorEstimate, TransferMatrix
from ..typing import ComplexArray
from ..wavefield import Wavefield, save_wavefield
from .forecast import forecast, refuse_if_too_large
from .frequencies import frequencies
from .resources import Ledger
from .simulation import Simulation, closed, render_transfer, simulate
from .skin_model import save_skin_model
from .solved import solve
from .two_meshes import remaining_error
from .wave_report import write_wave_report

__all__ = ["Run", "run_all", "run_mesh", "run_render", "run_solve"]

Progress = Callable[[str, int, int], None]


@dataclass
class Run:
    """One run of the program into one folder: what it was asked, what it costs, what must be said."""

    scenario: Scenario
    out: Path
    base: Path
    progress: Progress | None
    ledger: Ledger
    notes: list[str]

    @classmethod
    def start(cls, scenario: Scenario, out: Path, base: Path, progress: Progress | None = None) -> Run:
        """A run with empty accounts; the folder is made when the first file is written."""
        return cls(scenario, out, base, progress, Ledger(), [])

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Account for a stage and collect its accuracy warnings as notes."""
        with self.ledger.stage(name), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", AccuracyWarning)
            yield
        self.notes += [str(w.message) for w in caught if issubclass(w.category, AccuracyWarning)]


def run_all(run: Run) -> None:
    """Everything: mesh, solve, render, figures and report."""
    transfer, coarse = _solved(run)
    from ..report import write_report  # plotting is heavy and not needed by the other stages

    if run.scenario.rendering.methods:
        _rendered(run, transfer, coarse)
    _write_run(run)
    with run.stage("report"):
        if run.scenario.rendering.methods:
            write_report(run.out)
        else:
            write_wave_report(run.scenario, transfer, run.out)
    _write_run(run)


def run_mesh(run: Run) -> TissueMesh | None:
    """Make or find the mesh and write ``mesh.vtu``; None for the layered engine, which has none."""
    if run.scenario.engine == "layered":
        return None
    with run.stage("mesh"):
        _tell(run, "mesh", 0)
        mesh = cached_mesh(run.scenario, base=run.base)
        write_mesh(mesh, run.out / "mesh.vtu")
        write_text(run.out / "scenario.json", run.scenario.model_dump_json(indent=2))
        _tell(run, "mesh", 1)
    return mesh


def run_solve(run: Run) -> TransferMatrix:
    """Compliance and G with their errors: ``transfer.nc``, ``transfer.mat``, ``wavefield.npz``, ``run.json``."""
    transfer, _ = _solved(run)
    _write_run(run)
    return transfer


def run_render(run: Run) -> Rendering:
    """Renderers on the folder's G (solved first where it is missing): drives, displacements and S."""
    if not run.scenario.rendering.methods:
        raise ScenarioError("rendering.methods is empty, so there is nothing to render; name a method or use `solve`")
    transfer, coarse = _solved(run)
    rendering = _rendered(run, transfer, coarse)
    _write_run(run)
    return rendering


def _solved(run: Run) -> tuple[TransferMatrix, TransferMatrix | None]:
    mesh = run_mesh(run)
    with run.stage("solve"):
        simulation = _simulated(run, mesh)
    with run.stage("write"):
        _write_solution(run, simulation)
    return simulation.transfer, simulation.coarse


def _simulated(run: Run, mesh: TissueMesh | None) -> Simulation:
    scenario = run.scenario
    if mesh is None:
        result = simulate(scenario, base=run.base, progress=run.progress)
    else:
        expected = forecast(scenario, base=run.base, mesh=mesh)
        refuse_if_too_large(expected, scenario)
        for sentence in expected.sentences(float(frequencies(scenario.sweep)[-1])):
            warnings.warn(sentence, AccuracyWarning, stacklevel=2)
        solved = solve(scenario, mesh, frequencies(scenario.sweep), base=run.base, progress=run.progress)
        result = closed(scenario, mesh, solved)
    run.notes += result.notes
    solver = result.solved.facts.get("solver") if result.solved is not None else None
    return replace(result, transfer=replace(result.transfer, provenance=provenance(scenario, mesh, solver)))


def provenance(scenario: Scenario, mesh: TissueMesh | None, solver: str | None) -> dict[str, Any]:
    """What a result came from: scenario, versions, direct ``solver``, mesh hash."""
    return {
        "program": f"forearm_fem {__version__}",
        "scenario": scenario.model_dump(mode="json"),
        "mesh_sha256": mesh.digest if mesh else None,
        "solver": solver,
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


def _write_solution(run: Run, simulation: Simulation) -> None:
    scenario, transfer, out = run.scenario, simulation.transfer, run.out
    write_text(out / "scenario.json", scenario.model_dump_json(indent=2))
    write_transfer(out / "transfer.nc", transfer, simulation.compliance)
    if scenario.sweep.frequencies is None:
        write_thesis_mat(out / "transfer.mat", transfer, scenario.sweep.sample_rate, scenario.sweep.duration)
    if simulation.solved is not None and simulation.solved.modes.size:
        save_wavefield(wavefield_of(simulation), out / "wavefield.npz")
    if simulation.solved is not None and simulation.solved.skin is not None:
        save_skin_model(out / "reduced.nc", replace(simulation.solved.skin, scenario=scenario))
    facts = {"facts": simulation.solved.facts if simulation.solved else {}, "mesh": _mesh_facts(run, simulation.mesh)}
    write_text(out / "solution.json", json.dumps(facts, indent=2))


def wavefield_of(simulation: Simulation) -> Wavefield:
    """The field per unit drive: modes, and their amplitudes through the contact forces of each drive."""
    solved = simulation.solved
    assert solved is not None
    device = simulation.scenario.device
    force = respond(simulation.compliance, device).force if device.drive == "voltage" else _forces(simulation)
    return Wavefield(simulation.compliance.frequency, solved.modes, solved.states @ force)


def _forces(simulation: Simulation) -> ComplexArray:
    return np.asarray(contact_state(simulation.compliance, simulation.scenario.device).force)


def _rendered(run: Run, transfer: TransferMatrix, coarse: TransferMatrix | None) -> Rendering:
    with run.stage("render"):
        rendering = render_transfer(run.scenario, transfer, base=run.base)
        _write_rendering(run, rendering, transfer)
        error = _strength_error(run, rendering, coarse)
        run.notes += rendering.exceeded
    write_text(run.out / "signal_strength_error.json", json.dumps(error, indent=2))
    return rendering


def _write_rendering(run: Run, rendering: Rendering, transfer: TransferMatrix) -> None:
    first = next(iter(rendering.values()))
    time = first.drives.time
    signals = {key: r.drives.signals for key, r in rendering.items()}
    moves = {key: r.displacements.values for key, r in rendering.items()}
    volts = transfer.unit.partition("/")[2]
    write_drives(run.out / "drives.nc", stack(signals, tuple(p.name for p in transfer.inputs), time, volts))
    write_displacements(run.out / "displacements.nc", stack(moves, tuple(p.name for p in transfer.outputs), time, "m"))
    rows = strength_rows(rendering.methods, rendering.targets, rendering.strengths)
    write_signal_strength_csv(run.out / "signal_strength.csv", rows)


def _strength_error(run: Run, rendering: Rendering, coarse: TransferMatrix | None) -> dict[str, Any]:
    """Estimated error of each S: from its change on the coarser mesh, renderers designed anew."""
    if coarse is None:
        return {}
    other = render_transfer(run.scenario, coarse, base=run.base)
    own = np.abs(rendering.strengths)
    change = remaining_error(np.abs(other.strengths - rendering.strengths) / own) * own
    return {
        m: dict(zip(rendering.targets, row.tolist(), strict=True))
        for m, row in zip(rendering.methods, change, strict=True)
    }


def _mesh_facts(run: Run, mesh: TissueMesh | None) -> dict[str, Any]:
    if mesh is None:
        return {}
    quality = mesh_quality(mesh, expected_volume=limb_volume(run.scenario))
    expected = forecast(run.scenario, base=run.base, mesh=mesh)
    return {
        "sha256": mesh.digest,
        "quality": {**asdict(replace(quality, volumes={})), "volumes": dict(quality.volumes)},
        "resolution": [asdict(r) for r in expected.resolution],
    }


def _write_run(run: Run) -> None:
    """``run.json``: the whole account; stages not run now keep their account of last time."""
    target = run.out / "run.json"
    before = _read_json(target)
    transfer = read_transfer(run.out / "transfer.nc")
    solution = _read_json(run.out / "solution.json")
    stages = {**before.get("stages", {}), **run.ledger.stages}
    account = {
        "scenario": run.scenario.model_dump(mode="json"),
        "versions": versions(),
        "program": __version__,
        "mesh": solution.get("mesh", {}),
        "solution": solution.get("facts", {}),
        "stages": {name: _first_cost(cost, before.get("stages", {}).get(name)) for name, cost in stages.items()},
        "errors": [_error_entry(e) for e in transfer.errors],
        "accuracy": accuracy_verdict(run.scenario, transfer.errors),
        "condition_number": _condition(transfer),
        "signal_strength_error": _read_json(run.out / "signal_strength_error.json"),
        "notes": list(dict.fromkeys(run.notes)),
    }
    write_text(target, json.dumps(account, indent=2))


def _first_cost(cost: dict[str, float], before: dict[str, float] | None) -> dict[str, float]:
    """What the stage cost when it was computed: a stage that only reused results keeps its older, larger account."""
    return before if before and before["seconds"] > cost["seconds"] else cost


def _error_entry(error: ErrorEstimate) -> dict[str, Any]:
    return {"source": error.source, "band": error.band, "worst": error.worst, "method": error.method}


def accuracy_verdict(scenario: Scenario, errors: tuple[ErrorEstimate, ...]) -> str:
    """One sentence: was the accuracy asked for met, by the estimates?"""
    if not errors:
        return "no error estimate was made, so the accuracy asked for cannot be confirmed"
    total = float(np.sqrt(sum(e.band**2 for e in errors)))
    met = "met" if total <= scenario.accuracy else "NOT met"
    return f"asked e_band <= {scenario.accuracy:g}, estimated {total:.2g} over all sources: {met}"


def _condition(transfer: TransferMatrix) -> dict[str, float]:
    usable = np.isfinite(transfer.values).all(axis=(1, 2))
    numbers = np.linalg.cond(transfer.values[usable])
    numbers = numbers[np.isfinite(numbers)]
    if not len(numbers):
        return {}
    return {"least": float(numbers.min()), "median": float(np.median(numbers)), "largest": float(numbers.max())}


def _read_json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def reclosed(run: Run) -> TransferMatrix:
    """G of the folder's compliance with the scenario's present device: no FE solve at all."""
    try:
        return close_loop(read_compliance(run.out / "transfer.nc"), run.scenario.device)
    except DataError:
        return run_solve(run)


def _tell(run: Run, stage: str, done: int) -> None:
    if run.progress is not None:
        run.progress(stage, done, 1)
