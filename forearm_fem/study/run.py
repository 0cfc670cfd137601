"""From a study file to a session that plays, and to the answers that are analysed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import DataError, ScenarioError
from ..files.declaration import Declaration
from ..geometry.device.layout import planform_ports
from ..measurement.daq import Daq
from ..measurement.playback import Loopback, check_belongs
from ..measurement.virtual import VirtualDaq, VirtualOptions
from ..ports import Port
from ..questions.calibrate import DaqKind, hardware, wired
from ..rendering.job import wavelet
from ..rendering.signals import Wavelet
from ..scenario import Scenario, load_scenario, scenario_beside
from ..scenario.measurement import DaqOptions
from ..transfer import TransferMatrix
from .plan import Study, Task, load_study, tasks_of, trials
from .server import texts
from .session import Session
from .stimuli import DevicePlayer, Key, Stimulus, offsets, provenance, refuse_changed, stimuli_for, transfer_of
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
) -> Iterator[tuple[Session, Made, dict[str, Any]]]:  # fmt: skip
    """A session of an enrolled (or now enrolled) participant, which nobody else can open meanwhile; what plays.

    ``task`` is the participant's next one where none is named. ``cable`` is the loopback measured of the device, kept
    with the answers; ``declaration`` what the participant's G does not say of itself. Raises ScenarioError, DataError
    or HardwareError in one sentence for whatever prevents it.
    """
    named = None if task is None else prepared.study.task(task)
    made, text = prepared.made(participant, declaration), prepared.consent()
    player, plays = device_player(prepared, made, daq, card=card, cable=cable)
    texts(prepared.study.language, prepared.base)  # refused now: who is enrolled binds the study file
    store = prepared.store(begin=True)
    with store.sitting(participant):
        with store.locked():  # nobody else gets the place in the study by which the task is found
            asked = _due(store, participant, named)
            store.enrol(participant, consent=consent, age=age, sex=sex, invited=bool(text))
        yield Session(
            store, participant, asked, made.transfer.outputs, player, columns=plays | made.sources, facts=made.facts(),
            consent=text,
        ), made, plays  # fmt: skip


def _due(store: StudyStore, participant: str, named: Task | None) -> Task:
    """The task ``named``, else the first in the participant's order with trials left, or the last one.

    DataError where the order of tasks is balanced and another one comes before the one named.
    """
    order = tasks_of(store.study, place := store.place(participant))
    left = (t for t in order if len(store.answers(participant, t.name)) < len(trials(store.study, t, place)))
    due = next(left, order[-1])
    if named is None or named == due:
        return due
    if store.study.order.tasks == "balanced" and not store.answers(participant, named.name):
        raise DataError(
            f"sub-{participant}: {due.name} comes before {named.name} by the balanced order of tasks; leave --task out"
        )
    return named


def device_player(
    prepared: Prepared, made: Made, daq: DaqKind | Daq, *, card: str | None = None, cable: Loopback | None = None
) -> tuple[DevicePlayer, dict[str, Any]]:
    """A player through the virtual device, NI hardware, a sound card, or a device of one's own; columns about it."""
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
    return player, known_of(daq, options, rate, cable)


def known_of(daq: Daq, options: DaqOptions, rate: float, cable: Loopback | None) -> dict[str, Any]:
    """Columns of each trial about what plays.

    Latency is known of a virtual device, measured by a ``cable``, or declared in the scenario; else it is missing.
    """
    late, gain = options.latency or None, None
    if isinstance(daq, VirtualDaq):
        late = daq.latency / rate
    elif cable is not None:
        late, gain = cable.seconds, cable.gain
    return {"device": daq.name, "latency": late, "cable_gain": gain}


def statuses(store: StudyStore) -> list[tuple[str, str, int, int]]:
    """(participant, task, answered, planned) of all who have not withdrawn, tasks in each one's order."""
    return [
        (name, task.name, len(store.answers(name, task.name)), len(trials(store.study, task, place)))
        for place, person in enumerate(store.people(), start=1) if person["status"] != "withdrawn"
        for name in [person["participant_id"].removeprefix("sub-")]
        for task in tasks_of(store.study, place)
    ]  # fmt: skip
