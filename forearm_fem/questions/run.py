"""The results folder: every stage writes what it made, whole or not at all, and reuses what is there."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..accuracy.estimates import accuracy_verdict
from ..device import contact_state
from ..device.loop import carries_points
from ..engines.forecast import Ledger, check_samples, refuse_if_signals_too_large, scene_notes
from ..engines.simulation import Engine, Simulation, simulate, versions
from ..errors import AccuracyWarning, DataError, ScenarioError
from ..fem.reduction.compile_ahead import start_compiling
from ..files.mat import write_thesis_mat
from ..geometry.build import cached_mesh, limb_volume
from ..geometry.device.place import check_places
from ..geometry.mesh.files import write_mesh
from ..geometry.mesh.quality import mesh_quality
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..ports import is_thesis_grid, positions
from ..progress import Progress, tell, within
from ..rendering import Rendering
from ..rendering.interval import Strength, finer_than_known
from ..rendering.job import RenderJob, check_servable, wavelet
from ..rendering.limits import counted_points
from ..results.files import (
    Wavefield,
    read_transfer,
    refuse_other_g,
    stack,
    strength_rows,
    write_displacements,
    write_drives,
    write_signal_strength_csv,
    write_transfer,
)
from ..results.run import (
    ErrorRecord,
    MeshRecord,
    QualityRecord,
    ResolutionRecord,
    RunRecord,
    SolutionRecord,
    StageCost,
    StrengthRecord,
    condition_of,
    read_run,
    write_run,
)
from ..scenario import Scenario
from ..scenario.rendering import SampledWavelet
from ..scenario.sweep import Band
from ..store.folder import atomic_path, check_kind, set_kind
from ..store.record import save
from ..store.text import read_json, write_json
from ..transfer import TransferMatrix

__all__ = ["Run", "check_rendering", "run_all", "run_given", "run_mesh", "run_render", "run_solve"]

_DERIVED = (
    "transfer.mat", "wavefield.nc", "reduced.nc", "drives.nc", "displacements.nc", "signal_strength.csv",
    "signal_strength.json", "report.md", "report.html", "waves.csv",
)  # fmt: skip
_WITHOUT_SHARE = (
    "device.housing.skin_share: pictures, films and wavefield.nc leave out what the skin follows of the housing; G, "
    "drives, displacements and S hold it"
)


@dataclass
class Run:
    """One run of the program into one folder.

    scenario, out, base : what was asked, where it goes, where files in the scenario are seen from
    ledger, notes : what it costs, what must be said
    engine : answers in place of the scenario's
    transfer, simulation : G, and what it was solved with (None: a G that was there before)
    mesh, solution : on record of the solve
    rendering, account : drives and displacements; S with its intervals
    known : what the folder holds by now, as its reader has it (:class:`.Results`)
    """

    scenario: Scenario
    out: Path
    base: Path
    progress: Progress | None
    ledger: Ledger
    notes: list[str]
    engine: Engine | None = None
    transfer: TransferMatrix | None = None
    simulation: Simulation | None = None
    mesh: MeshRecord = field(default_factory=MeshRecord)
    solution: SolutionRecord = field(default_factory=SolutionRecord)
    rendering: Rendering | None = None
    account: Strength | None = None
    record: RunRecord | None = None
    known: dict[str, Any] = field(default_factory=dict)
    asked: str = ""  # the scenario as a command names it, with what it sets

    @classmethod
    def start(cls, scenario: Scenario, out: Path, base: Path, progress: Progress | None = None) -> Run:
        """A run with empty accounts; the folder is made when the first file is written.

        Keys that have no effect are its first notes; ScenarioError where a tissue is not whole.
        """
        return cls(scenario, out, base, progress, Ledger(), [*scene_notes(scenario)])

    @classmethod
    def given(cls, scenario: Scenario, out: Path, base: Path, progress: Progress | None = None) -> Run:
        """A run of a G that is there: nothing is solved, so that nothing is said of the limb."""
        return cls(scenario, out, base, progress, Ledger(), [])

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Tell and account for a stage, and collect its accuracy warnings as notes."""
        tell(self.progress, name, 0, 1)
        with self.ledger.stage(name), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", AccuracyWarning)
            yield
        tell(self.progress, name, 1, 1)
        self.notes += [str(w.message) for w in caught if issubclass(w.category, AccuracyWarning)]


def run_all(run: Run) -> None:
    """Everything: mesh, solve, render, figures and report."""
    check_rendering(run.scenario, run.base)
    transfer = _solved(run, beside=_load_pictures)
    if run.scenario.rendering.methods:
        _rendered(run, transfer)
    _write_run(run)
    with run.stage("report"):
        if run.scenario.rendering.methods:
            _reported(run)
        else:
            from ..show.report import write_wave_report

            write_wave_report(run.scenario, transfer, run.out, notes=run.notes)
    _write_run(run)


def run_given(run: Run, transfer: TransferMatrix) -> Rendering:
    """A G that is there, measured or simulated: drives, displacements, S with its intervals, figures and report."""
    check_kind(run.out, "run")
    refuse_other_g(run.out / "transfer.nc", measured="scenario" not in transfer.provenance)
    rendering = _rendered(run, transfer, _keep_given)
    _write_run(run)
    with run.stage("report"):
        _reported(run)
    _write_run(run)
    return rendering


def _keep_given(run: Run, transfer: TransferMatrix) -> None:
    """G and scenario of a run that solves nothing."""
    run.transfer = transfer
    _remove_older(run)
    set_kind(run.out, "run")
    write_json(run.out / "scenario.json", run.scenario.model_dump(mode="json"))
    write_transfer(run.out / "transfer.nc", transfer)
    run.known |= {"transfer": transfer, "_compliance": None}


def _load_pictures() -> None:
    """What pictures need, a second of imports; what cannot be loaded is said when the report is made."""
    with suppress(Exception):
        from ..show.report import load_pictures

        load_pictures()


def _reported(run: Run) -> None:
    from ..show.data import Results
    from ..show.report import write_report

    gc.freeze()  # else all that was imported is gone through again and again: an eighth of the report's time
    write_report(Results.holding(run.out, scenario=run.scenario, run=run.record, **run.known))


def check_rendering(scenario: Scenario, base: Path) -> None:
    """Check of renderers and their files, such as a wavelet's, before minutes of solving."""
    check_places(scenario)
    check_servable(scenario)
    refuse_if_signals_too_large(scenario)
    wavelet(scenario.rendering, scenario.sweep, base)
    check_samples(scenario)


def run_mesh(run: Run) -> TissueMesh | None:
    """Make or find the mesh and write ``mesh.vtu``; None for the layered engine and a library, which need none."""
    check_kind(run.out, "run")
    if run.scenario.engine != "fem" or run.engine is not None:
        return None
    start_compiling()
    with run.stage("mesh"):
        mesh = cached_mesh(run.scenario, base=run.base, progress=within(run.progress, "mesh"))
        set_kind(run.out, "run")
        write_mesh(mesh, run.out / "mesh.vtu")
        write_json(run.out / "scenario.json", run.scenario.model_dump(mode="json"))
    return mesh


def run_solve(run: Run) -> TransferMatrix:
    """Compliance and G with their errors: ``transfer.nc``, ``transfer.mat``, ``wavefield.nc``, ``run.json``."""
    transfer = _solved(run)
    _write_run(run)
    return transfer


def run_render(run: Run) -> Rendering:
    """Renderers on the folder's G (solved first where it is missing): drives, displacements and S."""
    if not run.scenario.rendering.methods:
        raise ScenarioError("rendering.methods is empty, so there is nothing to render; name a method or use `solve`")
    check_rendering(run.scenario, run.base)
    rendering = _rendered(run, _solved(run))
    _write_run(run)
    return rendering


def _solved(run: Run, beside: Callable[[], None] = lambda: None) -> TransferMatrix:
    """G of the run; a thread does what is asked ``beside`` its solve, most of which leaves Python's lock."""
    refuse_other_g(run.out / "transfer.nc", measured=False)
    mesh = run_mesh(run)
    with run.stage("solve"), ThreadPoolExecutor(1) as thread:
        thread.submit(beside)
        found = simulate(run.scenario, base=run.base, progress=run.progress, mesh=mesh, engine=run.engine)
        run.simulation, run.transfer = found, found.transfer
        run.notes += found.notes
    with run.stage("write"):
        _write_solution(run, found)
    return found.transfer


def _write_solution(run: Run, simulation: Simulation) -> None:
    scenario, transfer, out = run.scenario, simulation.transfer, run.out
    _remove_older(run)
    set_kind(out, "run")
    write_json(out / "scenario.json", scenario.model_dump(mode="json"))
    write_transfer(out / "transfer.nc", transfer, simulation.compliance)
    if isinstance(scenario.sweep, Band):
        write_thesis_mat(out / "transfer.mat", transfer, scenario.sweep.sample_rate, scenario.sweep.duration)
    run.known |= {"transfer": transfer, "_compliance": simulation.compliance}
    if simulation.solved is not None and simulation.solved.modes.size:
        run.known["wavefield"] = field_of_run = wavefield_of(simulation)
        save(out / "wavefield.nc", field_of_run)
        if carries_points(scenario.device):
            run.notes.append(_WITHOUT_SHARE)
    if simulation.solved is not None and simulation.solved.skin is not None:
        skin, of_g = simulation.solved.skin, ("discretisation", "truncation")
        errors = (*simulation.compliance.errors, *(e for e in transfer.errors if e.source in of_g))
        save(out / "reduced.nc", replace(skin, scenario=scenario, errors=errors))
    if simulation.solved is not None:
        run.solution = simulation.solved.facts
    if (mesh := simulation.mesh) is not None:
        quality = mesh_quality(mesh, expected_volume=limb_volume(scenario))
        run.known["mesh"] = mesh
        run.mesh = MeshRecord(
            sha256=mesh.digest,
            quality=QualityRecord(**{**asdict(replace(quality, volumes={})), "volumes": dict(quality.volumes)}),
            resolution=tuple(ResolutionRecord(**asdict(r)) for r in simulation.resolution),
        )
    parts = {"facts": run.solution, "mesh": run.mesh}
    write_json(out / "solution.json", {name: part.model_dump(mode="json") for name, part in parts.items()})


def _remove_older(run: Run) -> None:
    """Take files of another scenario, which this one may not replace, out of the folder; a note says which."""
    try:
        before = read_transfer(run.out / "transfer.nc").provenance.get("scenario")
    except DataError:
        return
    if before == run.scenario.model_dump(mode="json"):
        return
    stale = [n for n in _DERIVED if (run.out / n).is_file()]
    stale += ["mesh.vtu"] if run.scenario.engine != "fem" and (run.out / "mesh.vtu").is_file() else []
    if (figures := run.out / "figures").is_dir():
        from ..show import kinds

        drawn = (p for p in figures.iterdir() if p.stem.startswith(("target-", *kinds())))  # nobody else's
        stale += sorted(f"figures/{p.name}" for p in drawn)
    for name in (*stale, *(f"{n}.sha256" for n in stale)):
        (run.out / name).unlink(missing_ok=True)
    if stale:
        run.notes.append(f"{run.out}: {', '.join(stale)} belonged to another scenario and were removed")


def wavefield_of(simulation: Simulation) -> Wavefield:
    """The field per unit drive: modes, and their amplitudes through the contact forces of each drive.

    What the skin follows of the housing (``device.housing.skin_share``) is told at the grid points only.
    """
    solved = simulation.solved
    assert solved is not None
    force = contact_state(simulation.compliance, simulation.scenario.device).force
    return Wavefield(simulation.compliance.frequency, solved.modes, solved.states @ force)


def _rendered(
    run: Run, transfer: TransferMatrix, keep: Callable[[Run, TransferMatrix], None] = lambda run, transfer: None
) -> Rendering:
    """S of the run's renderers on G, written; ``keep`` writes what else goes with them, once they have worked."""
    with run.stage("render"):
        job = RenderJob.of(run.scenario, transfer, base=run.base, progress=run.progress)
        job.warn()
        rendering = job.play(transfer, progress=run.progress)
        account = rendering.strength
        keep(run, transfer)
        run.rendering, run.account = rendering, account
        time = next(iter(rendering.values())).drives.time
        signals = {key: r.drives.signals for key, r in rendering.items()}
        moves = {key: r.displacements.values for key, r in rendering.items()}
        sent = stack(signals, tuple(p.name for p in transfer.inputs), time, transfer.unit.partition("/")[2])
        moved = stack(moves, tuple(p.name for p in transfer.outputs), time, "m")
        sent, moved = (
            replace(made, positions=positions(ports), provenance=transfer.provenance)
            for made, ports in ((sent, transfer.inputs), (moved, transfer.outputs))
        )
        write_drives(run.out / "drives.nc", sent)
        write_displacements(run.out / "displacements.nc", moved)
        rows = strength_rows(
            account.methods, account.targets, account.value, (account.low, account.high), account.record,
            account.window, grouped=is_thesis_grid(transfer.outputs),
        )  # fmt: skip
        write_signal_strength_csv(run.out / "signal_strength.csv", rows)
        run.known |= {"drives": sent, "displacements": moved, "strengths": rows}
        if isinstance(shape := run.scenario.rendering.wavelet, SampledWavelet):  # for figures made elsewhere
            with atomic_path(run.out / f"wavelet{Path(shape.file).suffix}") as beside:
                beside.write_bytes((run.base / shape.file).read_bytes())
        said = (
            *unknown_strengths(rendering), *rendering.exceeded, rendering.bridged.sentence, account.unknown,
            finer_than_known(account, transfer.errors),
        )  # fmt: skip
        run.notes += [s for s in said if s]
    write_json(run.out / "signal_strength.json", _strengths_record(run))
    return rendering


def _strengths_record(run: Run) -> dict[str, Any]:
    """S of the run, and which targets lie under or beside a motor."""
    assert run.account is not None
    assert run.transfer is not None
    g, lifted = run.transfer, run.scenario.device.out_of_contact
    touching, clearance = [p for p in g.inputs if p.name not in lifted], run.scenario.rendering.clearance
    counted = counted_points(g.outputs, touching, clearance)
    beside = [p.name for p, counts in zip(g.outputs, counted, strict=True) if not counts]
    return {**run.account.as_json(), "not_counted": [t for t in run.account.targets if t in beside]}


def unknown_strengths(rendering: Rendering) -> tuple[str, ...]:
    """A sentence per method whose S is not known at some targets."""
    missing = {
        m: [t for t, s in zip(rendering.targets, row, strict=True) if not np.isfinite(s)]
        for m, row in zip(rendering.methods, rendering.strengths, strict=True)
    }
    return tuple(
        f"S of {method} is unknown at {', '.join(targets)}: nothing moves there, or nothing else does"
        for method, targets in missing.items()
        if targets
    )


def _write_run(run: Run) -> None:
    """``run.json``: the whole account; stages not run now keep their account of last time."""
    assert run.transfer is not None
    target, transfer = run.out / "run.json", run.transfer
    stages = dict(run.record.stages) if run.record is not None else _earlier_stages(target)
    for name, cost in run.ledger.stages.items():
        # what it cost when it was computed: a stage that only reused results keeps its older, larger account
        if name not in stages or cost.seconds >= stages[name].seconds:
            stages[name] = cost
    strength = _strengths_record(run) if run.account else _read_json(run.out / "signal_strength.json")
    run.record = RunRecord(
        scenario=run.scenario.model_dump(mode="json"),
        versions=versions(),
        program=__version__,
        mesh=run.mesh,
        solution=run.solution,
        stages=stages,
        errors=tuple(ErrorRecord.of(e) for e in transfer.errors),
        accuracy=accuracy_verdict(run.scenario, transfer.errors),
        condition_number=condition_of(transfer),
        signal_strength=StrengthRecord.model_validate(strength),
        notes=tuple(dict.fromkeys(run.notes)),
        asked=run.asked,
    )
    write_run(target, run.record)


def _earlier_stages(file: Path) -> dict[str, StageCost]:
    """Costs of the stages of an earlier run into the same folder."""
    try:
        return dict(read_run(file).stages)
    except DataError:
        return {}


def _read_json(path: Path) -> dict[str, Any]:
    try:
        return read_json(path)
    except DataError:
        return {}
