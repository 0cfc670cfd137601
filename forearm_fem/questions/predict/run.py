"""Prediction of S for people: a question, its draws on this machine or a Dask scheduler, resumable, and the answer."""

from __future__ import annotations

import time
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from ... import __version__
from ...device import close_loop
from ...engines.forecast import check_samples
from ...engines.layered import LayeredArm
from ...engines.simulation import simulate
from ...errors import AccuracyWarning, ForearmError, ReductionError, ScenarioError
from ...fem.kernels.compiled import freed_memory_kept
from ...geometry.device.layout import planform_ports
from ...measurement.chain import reported
from ...notebook import Manners, place
from ...ports import is_thesis_grid
from ...progress import Progress, tell, within
from ...rendering.interval import Strength, interval
from ...rendering.job import RenderJob, check_servable, wavelet
from ...rendering.limits import counted_points
from ...results.draws import DRAWS_FILE, KEPT, READINGS, DrawsFile, Outcome
from ...results.files import TransferFile
from ...scenario import Scenario
from ...scenario.model import resolve_tissues
from ...scenario.sweep import frequencies
from ...scenario.text import code_files, contents, named_files
from ...store.folder import check_kind, set_kind
from ...store.record import save
from ...store.shelf import WORK, Shelf
from ...store.text import digest_of
from ...store.work import LOST, done_once, light_workers, spread
from ...tissue import LAWS as BUILT_IN
from ...tissue import REFERENCE
from ...transfer import UNITS, ErrorEstimate, finite, total_error
from ...typing import FloatArray
from ...usercode import is_code, with_code_beside
from .arm import ArmModel, arm_model
from .draws import (
    FASCIA,
    LAWS,
    SOFT,
    Draw,
    draw_inputs,
    expanded,
    has_fascia,
    idle_inputs,
    is_bare,
    load_priors,
    measured_of,
    scenario_of,
    soft_tissues,
)
from .statistics import Draws, draws_of

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import FigureBase


_MOST = 1.0  # e_band: nothing is known of a G that may be wrong by as much as it is
_DRAWS = 6  # of an arm's errors, for the interval of its S; all targets of a method are pooled


def outcome_of(draw: Draw, scene: Scenario, held: Collection[str], job: RenderJob, arm: ArmModel) -> Outcome:
    """S of ``draw`` of the ``scene``, whose inputs ``held`` keep its values, by the renderers of ``job``.

    Raises the :class:`ForearmError` of an arm that cannot be, or whose error is too large to say.
    """
    began = time.perf_counter()
    held = {*held, *arm.held}
    scenario = scenario_of(draw, scene, held)
    values = {name: value for name, value in draw.values.items() if name not in held}
    seen, at = measured_of(replace(draw, values=values), scenario), frequencies(scenario.sweep)
    answer, met = arm.answers(scenario, seen, at) if seen.grid != scenario.grid else (arm.answer(scenario, at), None)
    true, *others = (
        job.on_nominal_ports(finite(close_loop(c, scenario.device))) for c in (answer.compliance, *answer.others)
    )
    if not total_error(true.errors) < _MOST:
        raise ReductionError(f"G of the arm may be wrong by as much as it is: e_band is {_MOST:g} or more, or unknown")
    under = true if met is None else job.on_nominal_ports(finite(close_loop(met, seen.device)))
    measured = reported(under, seen, draw.generator("rig"))
    found = job.strengths(measured, true, measured, windows=(job.window, "record"))
    noise = tuple(e for e in true.errors if e.source not in answer.shown)
    spread = interval(true, noise, job.targets, job.span, job.methods, job.wavelet, draws=_DRAWS, others=others)
    return Outcome(
        draw.number, draw.law, found.reshape(len(READINGS), *found.shape[2:]), drivers_of(draw, scenario, held),
        total_error(true.errors), time.perf_counter() - began, spread=spread,
        transfer=true.values.astype(np.complex64) if draw.number < KEPT else None,
    )  # fmt: skip


def drivers_of(draw: Draw, scenario: Scenario, held: Collection[str]) -> dict[str, float]:
    """Candidate drivers of S: inputs, and of each drawn tissue its size |mu*| [Pa] and loss tangent at 150 Hz.

    Nothing of a tissue or layer that the limb has not, or of a part that the drive leaves out: chance would make
    it a driver.
    """
    tissue_input = {f"{t}." for t in SOFT}
    own, layers = soft_tissues(scenario), {layer.tissue for layer in getattr(scenario.limb, "layers", ())}
    absent = {f"{t} thickness" for t in SOFT if t not in layers} | idle_inputs(scenario)
    found = {
        name: value
        for name, value in draw.values.items()
        if name not in held and name not in absent and not any(name.startswith(t) for t in tissue_input)
    }
    if "tissue" not in held:
        for name, tissue in resolve_tissues(scenario).items():
            if name in own:
                modulus = complex(tissue.modulus.at(2 * np.pi * REFERENCE))
                found |= {f"{name} stiffness": abs(modulus), f"{name} loss": modulus.imag / modulus.real}
    return found


DRAWS = 200
POOL = 200  # draws that a model of finite elements is made from: the first ones, however many are asked for


@dataclass(frozen=True)
class Question:
    """Question of a prediction: plain data, so that it travels to any process that sees ``base``.

    ``laws`` are those drawn from, ``held`` names or groups of inputs (priors.toml) that keep the scenario's values.
    With ``layered`` arms are drawn on the layered model, whatever solves the scene.
    """

    scenario: Scenario
    base: Path
    seed: int = 0
    laws: tuple[str, ...] = LAWS
    held: tuple[str, ...] = ()
    layered: bool = False

    def __post_init__(self) -> None:
        """Laws of one's own are files beside the scenario."""
        object.__setattr__(self, "laws", tuple(with_code_beside(list(self.laws), self.base)))

    @property
    def digest(self) -> str:
        """SHA-256 of all that a draw depends on but its number."""
        priors = load_priors()
        content = [__version__, self.scenario.model_dump(mode="json", exclude={"name", "description"}), self.seed,
                   sorted(self.laws), sorted(self.held), self.layered, repr(priors.inputs), repr(priors.laws),
                   [{law: j.mean.tolist() for law, j in part.items()} for part in (priors.joint, priors.bare)],
                   contents((*named_files(self.scenario), *code_files(self.laws)), self.base)]  # fmt: skip
        return digest_of(content)


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(Manners):
    """S of the scene itself with its numerical interval (``nominal``), and what arms do to it (``draws``).

    left_out, unknown : properties that the arms' model has not, and errors of it that are in no band
    held : inputs that kept the scenario's values
    reused, seconds : draws that were there before, and the time that this call took
    """

    question: Question
    nominal: Strength
    draws: Draws
    model: str
    left_out: str
    held: tuple[str, ...]
    reused: int
    seconds: float
    unknown: str = ""

    @property
    def line(self) -> str:
        """S of each method over arms, in the mean of the targets: median, and 5 to 95 %."""
        means = self.draws.reading("played").mean(axis=2)
        found = (np.quantile(column, (0.05, 0.5, 0.95)) for column in means.T)
        said = (f"{m} {b:.3g} ({a:.3g} to {c:.3g})" for m, (a, b, c) in zip(self.draws.methods, found, strict=True))
        return f"S over {len(means)} arms: {', '.join(said)}"

    @property
    def rows(self) -> list[list[str]]:
        """5, 50 and 95 % of S over arms at each target."""
        bands = np.quantile(self.draws.reading("played"), (0.05, 0.5, 0.95), axis=0)
        cells = np.moveaxis(bands, 0, -1)
        return [["target", *self.draws.methods],
                *([t, *(f"{b:.3g} ({a:.3g} to {c:.3g})" for a, b, c in cells[:, k])]
                  for k, t in enumerate(self.draws.targets))]  # fmt: skip

    def sel(self, method: str, target: str) -> FloatArray:
        """S (n_draw,) of the arms by one method at one target."""
        m, t = place(self.draws.methods, method, "method"), place(self.draws.targets, target, "target")
        return np.asarray(self.draws.reading("played")[:, m, t])

    def to_xarray(self) -> xr.Dataset:
        """S of every arm by reading, renderer and target, and the inputs that it hangs on."""
        import xarray as xr

        d = self.draws
        return xr.Dataset(
            {"S": (("draw", "reading", "renderer", "target"), d.strengths), "drivers": (("draw", "driver"), d.drivers)},
            {"reading": list(READINGS), "renderer": list(d.methods), "target": list(d.targets),
             "driver": list(d.names), "law": ("draw", list(d.laws))},
        )  # fmt: skip

    def plot(self) -> FigureBase:
        """S of arms at every target beside that of the scene itself."""
        from ...show.prediction import plot_bands
        from .statistics import summary

        return plot_bands(summary(self, sobol=False))

    def save(self, folder: str | Path, *, sobol: bool = True, progress: Progress | None = None) -> tuple[Path, Path]:
        """Write page, pictures and ``prediction.json`` into ``folder``; with ``sobol`` indices where SALib is there."""
        from ...show.prediction import write_prediction
        from .statistics import summary, write_summary

        tell(progress, "report", 0, 1)
        content = summary(self, sobol)
        write_summary(folder, content)
        files = write_prediction(folder, content)
        tell(progress, "report", 1, 1)
        return files


Plain = tuple[str, str, int, tuple[str, ...], tuple[str, ...], bool]  # a question that any process can take


@dataclass(frozen=True)
class Job:
    """One draw of a question, which is prepared once a process."""

    question: Plain
    number: int


def predict(
    question: Question,
    folder: str | Path,
    *,
    draws: int = DRAWS,
    resume: bool = True,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> Prediction:
    """S of ``draws`` arms, in ``folder/draws.nc``; each is on a shelf once it is done, where another call finds it.

    With ``resume`` draws of the same question found there are taken, also those of a call for fewer or more; otherwise
    all are made anew. ``workers`` processes of this machine (1: this one) or those of the Dask scheduler at the address
    ``scheduler`` share the work; results do not depend on them. Raises ScenarioError for unknown laws or inputs,
    DataError where too few draws give S.
    """
    began = time.monotonic()
    check_question(question)
    check_kind(folder, "prediction")
    out = Path(folder)
    plain = _plain(question)
    prepared = _prepared(plain, progress)  # an arm that cannot be is said before minutes of solving
    _, renderers, arm = prepared
    shelf, digest = Shelf(out / WORK, "finished draws"), question.digest
    jobs = {f"draw-{n}-{digest[:32]}": Job(plain, n) for n in range(draws)}
    scene = f"scene-{digest[:32]}"
    if not resume:
        shelf.drop(scene, *jobs)
    tell(progress, "the scene itself", 0, 1)
    nominal, errors = _nominal(question, shelf, scene, progress)
    set_kind(out, "prediction")
    known = set(shelf.known())
    reused = sum(key in known for key in jobs)
    count = workers or min(max(1, draws - reused), light_workers())
    many = spread(count, scheduler, "a prediction on several processes", asked=workers is not None)
    made = done_once(
        shelf, jobs, work if many else lambda job: drawn(*prepared, job.number).as_parts(),
        run=many, tell=lambda done, total: tell(progress, "draws", done, total),
    )  # fmt: skip
    kept = dict[int, Outcome]()
    for key, parts in made:
        kept[jobs[key].number] = _outcome(jobs[key].number, parts, renderers)
    frequency, unit = frequencies(question.scenario.sweep), UNITS[question.scenario.device.drive]
    of = renderers.names, renderers.targets
    save(out / DRAWS_FILE, DrawsFile.of(list(kept.values()), *of, digest, frequency, unit))
    grid = is_thesis_grid(renderers.ports[0])
    points, motors = planform_ports(question.scenario)
    touching = [p for p in motors if p.name not in question.scenario.device.out_of_contact]
    least = question.scenario.rendering.clearance
    clear = dict(zip((p.name for p in points), counted_points(points, touching, least), strict=True))
    counted = tuple(t for t in renderers.targets if clear[t])
    found = draws_of([kept[n] for n in range(draws)], *of, grid, counted)
    held = tuple(sorted({*question.held, *arm.held}))
    return Prediction(
        question, nominal, found, arm.name, arm.left_out, held, reused, time.monotonic() - began, _unknown(arm, errors),
    )  # fmt: skip


def check_question(question: Question) -> None:
    """ScenarioError for laws, inputs or groups that are not known and a scene that nothing renders on; DataError for a
    wavelet's file that cannot be read.
    """
    wavelet(question.scenario.rendering, question.scenario.sweep, question.base)
    priors = load_priors()
    groups = {p.group for p in priors.inputs.values()}
    if bad := sorted(set(question.held) - groups - (set(priors.inputs) - {"law"})):
        raise ScenarioError(
            f"--hold: no input or group is called '{bad[0]}'; groups are {', '.join(sorted(groups))}, single inputs "
            "stand in questions/predict/priors.toml"
        )
    if bad := sorted(x for x in set(question.laws) - set(BUILT_IN) if not is_code(x)):
        raise ScenarioError(
            f"--law: no law is called '{bad[0]}'; known are {', '.join(LAWS)}, or your own as module:Name"
        )
    for law in question.laws:
        priors.tissue_inputs(law)
    if not question.laws:
        raise ScenarioError(f"--law: expected at least one of {', '.join(LAWS)}")
    if not hasattr(question.scenario.limb, "layers"):
        raise ScenarioError(
            f"limb.shape: '{question.scenario.limb.shape}' has no layers to draw arms from; give the limb as a "
            "forearm, cylinder or slab"
        )
    if not question.scenario.rendering.methods:
        raise ScenarioError("rendering.methods is empty, so there is no S to predict; name a method")
    check_servable(question.scenario)
    check_samples(question.scenario)
    if question.scenario.rendering.zeros == "search":
        raise ScenarioError(
            "rendering.zeros: a search for zero points in each draw takes days; set 'auto' or name them"
        )


def _nominal(
    question: Question, shelf: Shelf, key: str, progress: Progress | None
) -> tuple[Strength, tuple[ErrorEstimate, ...]]:
    """The scene's own S with its interval, and what its G errs by; G is on the ``shelf`` under ``key`` once solved."""

    def solved() -> TransferFile:
        """G of the scene."""
        return TransferFile(simulate(scenario, base=base, progress=within(progress, "the scene itself")).transfer)

    scenario, base = question.scenario, question.base
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)  # `run` says them
        transfer = shelf.once(key, TransferFile, solved).transfer
        assert transfer is not None
        account = RenderJob.of(scenario, transfer, base=base).play(transfer).strength
    tell(progress, "the scene itself", 1, 1)
    return account, transfer.errors


def _unknown(arm: ArmModel, errors: tuple[ErrorEstimate, ...]) -> str:
    """Sentence on the errors of the arms that are in no band: those that ``arm`` says, and of cutting the limb,
    which is estimated of the scene alone (its ``errors``), whose waves decay otherwise."""
    ends = next((e for e in errors if e.source == "truncation"), None)
    if ends is None or isinstance(arm, LayeredArm):
        return arm.unknown
    own = f"an e_band of {ends.band:.1e} of the scene's own G" if ends.known else "unknown of the scene's own G, too"
    return "; ".join(s for s in (arm.unknown, f"what cutting the limb errs by for each arm is unknown ({own})") if s)


def drawn(question: Question, renderers: RenderJob, arm: ArmModel, number: int) -> Outcome:
    """Draw ``number`` of a question prepared; an arm that cannot be is data, not an error."""
    bare = is_bare(question.scenario, question.held)
    draw = draw_inputs(load_priors(), question.scenario, question.seed, number, question.laws, bare=bare)
    try:
        with freed_memory_kept():
            return outcome_of(draw, question.scenario, question.held, renderers, arm)
    except ForearmError as problem:
        return Outcome.none(number, draw.law, renderers.names, renderers.targets, str(problem))


def work(job: Job) -> dict[str, Any]:
    """The draw of ``job`` as plain data; nothing it raises leaves the worker."""
    try:
        return drawn(*_prepared(job.question), job.number).as_parts()
    except Exception as problem:
        return {LOST: f"{type(problem).__name__}: {problem} (a fault of the program, please report it)"}


def _outcome(number: int, parts: Mapping[str, Any], renderers: RenderJob) -> Outcome:
    """Outcome from the parts of :meth:`.Outcome.as_parts`, or the reason that there is none."""
    if "strengths" not in parts:
        return Outcome.none(number, "", renderers.names, renderers.targets, str(parts[LOST]))
    return Outcome(**{**parts, "number": number, "drivers": MappingProxyType(parts["drivers"])})


def _plain(question: Question) -> Plain:
    text = question.scenario.model_dump_json()
    return text, str(question.base.resolve()), question.seed, question.laws, question.held, question.layered


@lru_cache(maxsize=2)
def _prepared(plain: Plain, progress: Progress | None = None) -> tuple[Question, RenderJob, ArmModel]:
    """Parts that all draws of a process share: the question with every input that is held by name, and renderers.

    G of the scene serves for its ports alone, so one bin will do.

    A model of finite elements is made once and kept in the cache, where other processes find it.
    """
    text, base, seed, laws, held, layered = plain
    question = Question(Scenario.model_validate_json(text), Path(base), seed, laws, held, layered)
    on_layers = question.scenario.engine == "layered" or question.layered
    arm = arm_model(
        question.scenario, base=base, draws=() if on_layers else pool(question), layered=question.layered,
        progress=progress,
    )
    compliance = arm.compliance(question.scenario, frequencies(question.scenario.sweep)[:1])
    transfer = close_loop(compliance, question.scenario.device)
    every = expanded((*question.held, *arm.held), question.scenario)
    return replace(question, held=tuple(sorted(every))), RenderJob.of(question.scenario, transfer, base=base), arm


def pool(question: Question) -> list[Scenario]:
    """The arms that a model of finite elements is made from: the first 200 draws, and the scene itself."""
    fascia = () if has_fascia(question.scenario) else (FASCIA,)  # no mesh has one that the scene has not
    held, priors = expanded((*question.held, *fascia), question.scenario), load_priors()
    numbers = range(POOL)
    bare = is_bare(question.scenario, held)
    drawn = (draw_inputs(priors, question.scenario, question.seed, n, question.laws, bare=bare) for n in numbers)
    return [question.scenario, *(scenario_of(d, question.scenario, held) for d in drawn)]
