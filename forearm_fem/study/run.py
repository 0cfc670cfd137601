"""From a study file to a session that plays, and to the answers that are analysed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..errors import DataError, MissingExtra, ScenarioError
from ..files.declaration import Declaration
from ..geometry.device.layout import planform_ports
from ..measurement.daq import Daq
from ..measurement.playback import Loopback, check_belongs
from ..measurement.virtual import VirtualDaq, VirtualOptions
from ..ports import Port
from ..questions.calibrate import DaqKind, hardware, wired
from ..rendering.job import wavelet
from ..rendering.wavelet import Wavelet
from ..scenario import Scenario, load_scenario, scenario_beside
from ..transfer import TransferMatrix
from .devices import BackEnd, back_end
from .levels import Key, offsets
from .order import tasks_of, trials
from .plan import Study, Task, load_study
from .server import texts
from .session import Session
from .stimuli import DevicePlayer, Stimulus, provenance, refuse_changed, stimuli_for, transfer_of
from .store import StudyStore


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

    def consent(self) -> str:
        """The text to be agreed to; empty where consent is signed on paper."""
        if self.study.consent is None:
            return ""
        try:
            return (self.base / self.study.consent).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as problem:
            raise ScenarioError(f"consent: {self.base / self.study.consent} cannot be read as text "
                                f"({type(problem).__name__})") from None  # fmt: skip

    def made(self, participant: str, declaration: Declaration | None = None) -> Made:
        """Everything that a participant may be presented, from that participant's G; refused where it changed."""
        transfer = transfer_of(self.study, self.base, participant, planform_ports(self.scenario), declaration)
        added, how = offsets(self.study.stimuli, self.base, participant), self.study.stimuli
        stimuli = stimuli_for(transfer, self.scenario, how, self.wavelet, added)
        rule = "as rendered" if how.levels == "as rendered" else "equal"
        levels = {"rule": rule, "peak": how.peak, "drive": how.drive} | {"/".join(k): v for k, v in added.items()}
        sources, store = provenance(transfer, self.scenario, levels), self.store()
        for task in self.study.tasks:
            refuse_changed(f"sub-{participant}", store.answers(participant, task.name), sources, stimuli)
        return Made(transfer, stimuli, sources)


@dataclass(frozen=True, eq=False)
class Made:
    """A participant's G, the stimuli made from it, and ``sources``: hashes of what they are made from."""

    transfer: TransferMatrix
    stimuli: dict[Key, Stimulus]
    sources: dict[str, str]

    def facts(self) -> dict[Key, dict[str, Any]]:
        """Columns of each trial about its stimulus."""
        return {k: s.facts for k, s in self.stimuli.items()}


@contextmanager
def sitting(
    prepared: Prepared, participant: str, task: str | None = None, *, consent: str = "", age: float | None = None,
    sex: str = "", daq: DaqKind | Daq = "virtual", card: str | None = None, cable: Loopback | None = None,
    declaration: Declaration | None = None,
) -> Iterator[tuple[Session, Made]]:  # fmt: skip
    """A session of an enrolled (or now enrolled) participant, which nobody else can open meanwhile.

    ``task`` is the participant's next one where none is named. ``cable`` is the loopback measured of the device, kept
    with the answers; ``declaration`` what the participant's G does not say of itself. Raises ScenarioError, DataError
    or HardwareError in one sentence for whatever prevents it.
    """
    asked = next_task(prepared.store(), participant) if task is None else prepared.study.task(task)
    refuse_early(prepared.store(), participant, asked)
    made, text = prepared.made(participant, declaration), prepared.consent()
    player, plays = device_player(prepared, made, daq, card=card, cable=cable)
    texts(prepared.study.language, prepared.base)  # refused now: who is enrolled binds the study file
    store = prepared.store(begin=True)
    with store.sitting(participant):
        store.enrol(participant, consent=consent, age=age, sex=sex, invited=bool(text))
        yield Session(
            store, participant, asked, made.transfer.outputs, player, back_end=plays, sources=made.sources,
            facts=made.facts(), consent=text,
        ), made  # fmt: skip


def next_task(store: StudyStore, participant: str) -> Task:
    """The first task in a participant's order with trials left; the last one where none is."""
    order = tasks_of(store.study, place := store.place(participant))
    left = (t for t in order if len(store.answers(participant, t.name)) < len(trials(store.study, t, place)))
    return next(left, order[-1])


def refuse_early(store: StudyStore, participant: str, task: Task) -> None:
    """DataError where the order of tasks is balanced and another one comes first for this participant."""
    due = next_task(store, participant)
    if store.study.order.tasks == "balanced" and due != task and not store.answers(participant, task.name):
        raise DataError(
            f"sub-{participant}: {due.name} comes before {task.name} by the balanced order of tasks; leave --task out"
        )


def device_player(
    prepared: Prepared, made: Made, daq: DaqKind | Daq, *, card: str | None = None, cable: Loopback | None = None
) -> tuple[DevicePlayer, BackEnd]:
    """A player through the virtual device, NI hardware, a sound card, or a device of one's own; what is known of it."""
    options, transfer = prepared.scenario.measurement.daq, made.transfer
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
    player = DevicePlayer(daq, made.stimuli, rate, options, prepared.study.stimuli)
    return player, back_end(daq, options, rate, cable)


def answers_of(store: StudyStore, task: str) -> pd.DataFrame:
    """All answers to a task, with ``participant``, withdrawn ones left out; DataError if there is none."""
    active = [p["participant_id"] for p in store.people() if p["status"] != "withdrawn"]
    rows = [
        {"participant": name.removeprefix("sub-"), **row}
        for name in active
        for row in store.answers(name.removeprefix("sub-"), task)
    ]
    if not rows:
        raise DataError(f"{store.folder}: nobody has answered task '{task}' yet; `forearm-fem study run` it first")
    return typed(pd.DataFrame(rows))


_NUMBERS = (
    "onset", "duration", "trial", "block", "repetition", "response_x", "response_y", "response_area",
    "response_time", "late", "presentations", "peak_voltage", "session", "gain", "peak_um", "rms_um", "weighted_db",
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


def statuses(store: StudyStore) -> list[tuple[str, str, int, int]]:
    """(participant, task, answered, planned) of all who have not withdrawn, tasks in each one's order."""
    return [
        (name, task.name, len(store.answers(name, task.name)), len(trials(store.study, task, place)))
        for place, person in enumerate(store.people(), start=1) if person["status"] != "withdrawn"
        for name in [person["participant_id"].removeprefix("sub-")]
        for task in tasks_of(store.study, place)
    ]  # fmt: skip


def require_study_extra() -> None:
    """MissingExtra where the packages of the extra "study" are not installed."""
    from importlib.util import find_spec

    for package in ("pandas", "starlette", "uvicorn"):
        if find_spec(package) is None:
            raise MissingExtra(package, "study", "a study with people")
