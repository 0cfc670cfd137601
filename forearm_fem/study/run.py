"""From a study file to a session that plays, and to a rehearsal with simulated participants."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pandas as pd

from ..errors import DataError, MissingExtra
from ..geometry.device.layout import planform_ports
from ..io.declaration import Declaration
from ..measurement.daq import Daq
from ..measurement.loopback import Loopback, check_belongs
from ..measurement.run import DaqKind, hardware, wired
from ..measurement.virtual import VirtualDaq, VirtualOptions
from ..ports import Port
from ..progress import Progress, tell
from ..rendering.job import wavelet
from ..rendering.wavelet import Wavelet
from ..scenario import Scenario, load_scenario, scenario_beside
from ..transfer import TransferMatrix
from .devices import SIMULATED, BackEnd, back_end
from .field import SkinField, grid_field
from .order import Trial, trials
from .percept import Felt, Percept, SimulatedParticipant
from .plan import Study, Task, load_study
from .server import texts
from .session import Given, Player, Presented, Session
from .stimuli import DevicePlayer, Stimulus, stimuli_for, transfer_of
from .store import SIMULATION, StudyStore


@dataclass(frozen=True, eq=False)
class Prepared:
    """A study file with its scenario, wavelet and folder of data."""

    study: Study
    scenario: Scenario
    wavelet: Wavelet
    base: Path
    folder: Path

    @classmethod
    def of(cls, file: str | Path, folder: Path | None = None) -> Prepared:
        """Everything that a study file names; data go to ``folder``, or beside the file into its name."""
        path = Path(file)
        study = load_study(path)
        source = scenario_beside(path.parent, study.scenario)
        scenario = load_scenario(source)
        made = wavelet(scenario.rendering, scenario.sweep, source.parent)
        return cls(study, scenario, made, path.parent, folder or path.parent / study.name)

    def store(self, *, begin: bool = False) -> StudyStore:
        """The folder of data as it is; with ``begin`` it is made where there is none."""
        return StudyStore.open(self.folder, self.study, begin=begin)

    def grid(self) -> tuple[Port, ...]:
        """The scenario's grid points, seen from above."""
        return planform_ports(self.scenario)[0]

    def stimuli(self, transfer: TransferMatrix) -> dict[tuple[str, str], Stimulus]:
        """Stimuli on a participant's G."""
        return stimuli_for(transfer, self.scenario, self.study.stimuli, self.wavelet)


def session_for(
    prepared: Prepared, participant: str, task: str, *, consent: str = "", daq: DaqKind | Daq = "virtual",
    card: str | None = None, cable: Loopback | None = None, declaration: Declaration | None = None,
) -> tuple[Session, tuple[Port, ...]]:  # fmt: skip
    """A session of an enrolled (or now enrolled) participant, with the grid; the task's earlier answers are kept.

    ``cable`` is the loopback measured of the device, kept with the answers; ``declaration`` what the participant's G
    does not say of itself. Raises ScenarioError, DataError or HardwareError in one sentence for whatever prevents it.
    """
    asked = prepared.study.task(task)
    transfer = transfer_of(prepared.study, prepared.base, participant, planform_ports(prepared.scenario), declaration)
    stimuli = prepared.stimuli(transfer)
    player, plays = device_player(prepared, transfer, stimuli, daq, card=card, cable=cable)
    texts(prepared.study.language, prepared.base)  # refused now: who is enrolled binds the study file
    store = prepared.store(begin=True)
    store.refuse_others(simulated=False)
    store.enrol(participant, consent=consent, added=datetime.now(UTC).date().isoformat())
    return Session(store, participant, asked, transfer.outputs, player, back_end=plays), transfer.outputs


def device_player(
    prepared: Prepared, transfer: TransferMatrix, stimuli: dict[tuple[str, str], Stimulus], daq: DaqKind | Daq,
    *, card: str | None = None, cable: Loopback | None = None,
) -> tuple[DevicePlayer, BackEnd]:  # fmt: skip
    """A player through the virtual device, NI hardware, a sound card, or a device of one's own; what is known of it."""
    options = prepared.scenario.measurement.daq
    rate = prepared.wavelet.record.sample_rate
    if daq == "virtual":  # has channels of its own
        options = options.changed({"outputs": tuple(f"virtual/ao{i}" for i in range(len(transfer.inputs)))})
        daq = VirtualDaq(transfer, rate, prepared.wavelet.record.n / rate, VirtualOptions())
        daq.aim(transfer.outputs[0].name)
    elif isinstance(daq, str):
        options = wired(options, len(transfer.inputs), daq)
        daq = hardware(daq, options, card)
    if cable is not None:
        check_belongs(cable, daq, rate)
    loudest = max((t.adaptive.high for t in prepared.study.tasks if t.adaptive), default=0.0)
    player = DevicePlayer(daq, stimuli, rate, options, prepared.study.stimuli, loudest=max(loudest, 0.0))
    return player, back_end(daq, options, rate, cable)


def answers_of(store: StudyStore, task: str) -> pd.DataFrame:
    """All answers to a task, with ``participant``, withdrawn ones left out; DataError if there is none."""
    active = [p["participant_id"] for p in store.people() if p["status"] == "active"]
    rows = [
        {"participant": name.removeprefix("sub-"), **row}
        for name in active
        for row in store.answers(name.removeprefix("sub-"), task)
    ]
    if not rows:
        raise DataError(f"{store.folder}: nobody has answered task '{task}' yet; `forearm-fem study run` it first")
    return typed(pd.DataFrame(rows))


_NUMBERS = (
    "onset", "duration", "trial", "block", "repetition", "level", "response_x", "response_y", "response_area",
    "response_time", "late", "presentations", "peak_voltage", "session",
)  # fmt: skip


def typed(table: pd.DataFrame) -> pd.DataFrame:
    """A table of strings with its numbers as numbers; ``n/a`` is missing. DataError for a number that is none."""
    result = table.replace("n/a", np.nan)
    for name in (n for n in _NUMBERS if n in result):
        try:
            result[name] = pd.to_numeric(result[name])
        except (ValueError, TypeError) as problem:
            raise DataError(f"column {name}: {str(problem)[:120]}; expected a number or n/a") from None
    return result


def rehearse(
    prepared: Prepared,
    transfer: TransferMatrix,
    participants: int,
    percept: Percept,
    *,
    field: SkinField | None = None,
    seed: int = 0,
    through_device: bool = False,
    progress: Progress | None = None,
) -> StudyStore:
    """Let simulated participants do every task of the study; their answers look like anybody's, marked in ``note``.

    All share one G here; ``field`` is the skin's motion that belongs to it, the grid points' alone where there is none.
    ``through_device`` plays every stimulus through the virtual device too (slower).
    """
    store, stimuli = prepared.store(begin=True), prepared.stimuli(transfer)
    store.refuse_others(simulated=True)
    how = prepared.study.stimuli
    silence = Presented(how.repeats * (how.lead + how.tail) + (how.repeats - 1) * how.pause, float("nan"))

    def silent(method: str, target: str, level: float) -> Presented:
        """Without a device nothing sounds and no time passes."""
        return silence

    player: Player
    player, plays = silent, SIMULATED
    if through_device:
        player, plays = device_player(prepared, transfer, stimuli, "virtual")
    record = prepared.wavelet.record
    felt = Felt.of(field or grid_field(transfer), stimuli, record.sample_rate, record.n / record.sample_rate)
    today = datetime.now(UTC).date().isoformat()
    for k in range(participants):
        name, rng = f"{k + 1:02d}", np.random.default_rng([seed, k])
        store.enrol(name, consent=today, added=today, note=SIMULATION)
        person = SimulatedParticipant(percept.varied(rng), felt, transfer.outputs, rng)
        for task in prepared.study.tasks:
            session = Session(store, name, task, transfer.outputs, player, None, back_end=plays)
            while (waiting := session.view()["waiting"]) != "done":
                if waiting != "stimulus":
                    session.start()
                    continue
                session.present()
                trial = session.current
                assert trial is not None
                session.answer(answer_of(person, session.task, trial, session.level))
        tell(progress, "simulated participants", k + 1, participants)
    return store


def answer_of(person: SimulatedParticipant, task: Task, trial: Trial, level: float) -> Given:
    """What a simulated participant gives to a trial played at ``level`` [dB]."""
    kind, method, target = task.answer, trial.method, trial.target
    if task.adaptive is not None and task.adaptive.reference is not None:
        stronger = person.stronger(method, target, level, task.adaptive.reference)
        return Given(interval="first" if stronger == (trial.comparison == "first") else "second")
    if kind == "yes or no":
        return Given(yes=person.detects(method, target, level))
    if kind == "one point":
        return Given(points=(person.one_point(method, target),))
    if kind == "several points":
        return Given(points=person.several_points(method, target))
    return Given(strokes=person.outline(method, target))


def statuses(store: StudyStore) -> list[tuple[str, str, int, int]]:
    """(participant, task, answered, planned) of all who have not withdrawn."""
    names = [p["participant_id"].removeprefix("sub-") for p in store.people() if p["status"] == "active"]
    return [
        (name, task.name, len(store.answers(name, task.name)), len(trials(store.study, task, name)))
        for name in names
        for task in store.study.tasks
    ]


def require_study_extra() -> None:
    """MissingExtra where the packages of the extra "study" are not installed."""
    from importlib.util import find_spec

    for package in ("pandas", "statsmodels", "questplus", "starlette", "uvicorn"):
        if find_spec(package) is None:
            raise MissingExtra(package, "study", "a study with people")
