"""study new, run, stimuli, status, analyse, power, withdraw: the half of the thesis that is about people."""

from __future__ import annotations

import json
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

import typer

from ..errors import DataError, MissingExtra, ScenarioError
from .common import Declared, declaration, holds_g, measured_g, noted, print_notes, there

app = typer.Typer(no_args_is_help=True)


@app.callback()
def refuse_without_extra() -> None:
    """Studies with people, from the stimulus to the statistics."""
    for package in ("pandas", "pingouin", "starlette", "uvicorn"):
        if find_spec(package) is None:
            raise MissingExtra(package, "study", "a study with people")


StudyFile = Annotated[
    Path, typer.Argument(help="study file; `forearm-fem study new` writes one",
                         callback=there("no such study file; `forearm-fem study new NAME` writes one")),
]  # fmt: skip


def _pseudonym(name: str) -> str:
    if not (name.isascii() and name.isalnum() and len(name) <= 32):
        raise ScenarioError(f"--participant '{name[:40]}': expected letters and digits only, e.g. 01")
    return name


Participant = Annotated[str, typer.Option(help="pseudonym: letters and digits, e.g. 01", callback=_pseudonym)]
_DATA = "folder of the answers; default beside the file"
Data = Annotated[Path | None, typer.Option("--data", help=_DATA)]
Answers = Annotated[
    Path | None, typer.Option("--data", help=_DATA, callback=there("no such folder of answers", folder=True)),
]  # fmt: skip


def _all_there(files: list[Path] | None) -> list[Path] | None:
    for file in files or ():
        there("no such file or folder of answers")(file)
    return files


Foreign = Annotated[
    list[Path] | None,
    typer.Option("--answers", callback=_all_there, help="of PsychoPy (CSV) or jsPsych (JSON, CSV) to exported trials, "
                 "in place of our own sessions': a file or folder, repeatable"),
]  # fmt: skip

@app.command()
def new(
    name: Annotated[str, typer.Argument(help="letters, digits and hyphens")],
    scenario: Annotated[
        str, typer.Option(help="of the device: a file seen from the study file, or the name of a shipped one")
    ] = "thesis",
    folder: Annotated[Path, typer.Option(help="where the file goes")] = Path(),
    transfer: Annotated[
        Path | None, typer.Option(help="a G, to say how strong methods will be by it", callback=holds_g)
    ] = None,
    declare: Declared = None,
) -> None:
    """Write a commented study file: the thesis' two studies, to be changed."""
    from ..scenario import load_scenario, scenario_beside
    from ..store.folder import write_text
    from ..study.plan import Study

    Study(name=name, scenario=scenario)  # before anything is written
    file = folder / f"{name}.toml"
    if file.exists():
        raise ScenarioError(f"{file} exists already; take another name or remove it")
    asked = load_scenario(scenario_beside(folder, scenario))
    g = measured_g(transfer, asked, declare, "--transfer")
    text = resources.files("forearm_fem.study").joinpath("pages/study.toml").read_text(encoding="utf-8")
    write_text(file, text.replace("@name@", name).replace("@scenario@", json.dumps(scenario, ensure_ascii=False)))
    typer.echo(str(file))
    if g is None:
        typer.echo("levels: equal at target; --transfer G says by how much methods differ as rendered")
        return
    from ..study.run import Prepared
    from ..study.stimuli import stimuli_for, told

    made = Prepared.of(file)
    with noted():
        for levels in ("as rendered", "equal at target"):
            how = made.study.stimuli.model_copy(update={"levels": levels})
            found = {k: s.moved for k, s in stimuli_for(g, made.scenario, how, made.wavelet).items()}
            typer.echo(f"{levels}: {told(found)}")


@app.command()
def run(
    file: StudyFile,
    participant: Participant,
    task: Annotated[str | None, typer.Option(help="of the study; default: the participant's next one")] = None,
    consent: Annotated[
        str, typer.Option(help="date on which consent was signed on paper; needed once, unless the study has a text")
    ] = "",
    age: Annotated[float | None, typer.Option(min=0, max=150, help="in years, for participants.tsv")] = None,
    sex: Annotated[Literal["F", "M", "O", ""], typer.Option(help="F, M or O, for participants.tsv")] = "",
    daq: Annotated[Literal["virtual", "ni", "sound"], typer.Option(help="virtual, ni or sound")] = "virtual",
    card: Annotated[str | None, typer.Option("--card", help="sound: name or number of the card")] = None,
    cable: Annotated[
        Path | None,
        typer.Option("--loopback", help="record of `forearm-fem daq loopback`, kept with the answers",
                     callback=there("no such file; `forearm-fem daq loopback SCENARIO` makes one")),
    ] = None,
    declare: Declared = None,
    data: Data = None,
    host: Annotated[
        str, typer.Option(help="address to serve the page on; other machines can reach 0.0.0.0")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: a free one")] = 0,
) -> None:  # fmt: skip
    """Run a participant's session; the same command goes on where it stopped."""
    from ..measurement.playback import read_loopback
    from ..study.run import Prepared, sitting
    from ..study.server import serve, texts
    from ..study.stimuli import AUDIBLE, apart, told

    prepared = Prepared.of(file, data)
    kept = None if cable is None else read_loopback(cable)
    held = sitting(
        prepared, participant, task, consent=consent, age=age, sex=sex, daq=daq, card=card, cable=kept,
        declaration=declaration(declare),
    )  # fmt: skip

    def announce(theirs: str, ours: str) -> None:
        """Tell the addresses of the two pages."""
        typer.echo(f"participant:  {theirs}\nexperimenter: {ours}\nCtrl-C stops; the same command goes on.")

    with held as (session, made, plays):
        if plays["latency"] is None:
            print_notes(
                ["the device's latency was not measured and is kept as unknown; `forearm-fem daq loopback` measures it"]
            )
        motions = {k: s.moved for k, s in made.stimuli.items()}
        if max(apart(motions).values()) > AUDIBLE:
            print_notes([told(motions)])
        else:
            typer.echo(told(motions))
        if host not in ("127.0.0.1", "localhost"):
            print_notes([f"--host {host}: whoever reaches this machine's port and knows an address below can take part "
                         "or lead; nothing is encrypted. Give each address only to whom it is for"])  # fmt: skip
        typer.echo(f"task: {session.task.name}")
        serve(
            session, made.transfer.outputs, texts(prepared.study.language, prepared.base), beep=prepared.study.beep,
            levels=told(motions), host=host, port=port, announce=announce,
        )  # fmt: skip
        view = session.view()
    typer.echo(f"{view['answered']} of {view['total']} answered; data: {prepared.folder}")


@app.command()
def stimuli(
    file: StudyFile,
    participant: Participant,
    rate: Annotated[float, typer.Option(min=1000, max=768_000, help="of the sound card in Hz")] = 48_000.0,
    full_scale: Annotated[
        float | None, typer.Option(min=1e-3, max=1e3, help="peak of the output at digital 1 in V; default: "
                                   "measurement.daq.output_range"),
    ] = None,
    declare: Declared = None,
    data: Data = None,
) -> None:  # fmt: skip
    """Write a participant's stimuli as WAV and the trials as CSV, for PsychoPy, jsPsych or another player."""
    from ..study.handover import export
    from ..study.run import Prepared
    from ..study.stimuli import told

    prepared = Prepared.of(file, data)
    with noted():
        made = prepared.made(participant, declaration(declare))
        volts = full_scale or prepared.scenario.measurement.daq.output_range
        folder = export(prepared, participant, made, rate=rate, full_scale=volts)
    typer.echo(f"{told({k: s.moved for k, s in made.stimuli.items()})}\ndigital 1 is {volts:g} V\n{folder}")


@app.command()
def status(file: StudyFile, data: Answers = None) -> None:
    """Answers given so far, by participant."""
    from ..study.run import Prepared, statuses

    store = Prepared.of(file, data).store()
    if not store.people():
        typer.echo("nobody is enrolled yet")
    for participant, task, answered, total in statuses(store):
        typer.echo(f"{participant}  {task}: {answered} of {total}")
    for gone in (p for p in store.people() if p["status"] == "withdrawn"):
        typer.echo(f"{gone['participant_id'].removeprefix('sub-')}  withdrawn")


@app.command()
def analyse(file: StudyFile, data: Answers = None, answers: Foreign = None) -> None:
    """Errors, ellipses, confusion, confidence and statistics by the study's plan: a page, CSVs and R scripts."""
    from ..study.handover import answers as answers_of
    from ..study.report import write_analysis
    from ..study.run import Prepared

    prepared = Prepared.of(file, data)
    with noted():
        found = answers_of(prepared.store(), answers or (), prepared.grid())
        page = write_analysis(prepared.study, found, prepared.grid(), prepared.folder)
    typer.echo(str(page))


@app.command()
def power(
    file: StudyFile,
    pilot: Annotated[
        Path | None, typer.Option(help="folder of a pilot's answers; default beside the file",
                                  callback=there("no such folder of answers", folder=True)),
    ] = None,
    answers: Foreign = None,
    task: Annotated[str | None, typer.Option(help="of the study; default: its first")] = None,
    measure: Annotated[
        Literal["error", "precision", "points"] | None,
        typer.Option(help="default: the task's own, points where several are chosen"),
    ] = None,
    effect: Annotated[
        Literal["location", "method", "location x method"],
        typer.Option("--effect", help="to be found: location, method or 'location x method'"),
    ] = "method",
    least: Annotated[
        float | None,
        typer.Option(help="the least difference that matters, in the measure's unit (m for error and precision); "
                     "default: the pilot's effect"),
    ] = None,
) -> None:  # fmt: skip
    """Number of participants that finds the effect of a pilot, or the least that matters, and its interval."""
    from ..study.analysis import cells, with_errors
    from ..study.handover import answers as answers_of
    from ..study.power import power_curve, size_of_least, size_of_pilot
    from ..study.run import Prepared

    if least is not None and not 0 < least < float("inf"):
        raise DataError(f"--least: expected a positive number, got {least:g}")
    prepared = Prepared.of(file, pilot)
    asked = prepared.study.task(task) if task else prepared.study.tasks[0]
    what = measure or asked.measures[0]
    if what not in asked.measures:
        raise DataError(f"--measure {what}: task {asked.name} gives {', '.join(asked.measures)}")
    if (table := answers_of(prepared.store(), answers or (), prepared.grid()).get(asked.name)) is None:
        raise DataError(f"nobody has answered task {asked.name}; a pilot of three people tells scatter")
    values, *_ = cells(with_errors(table, prepared.grid()), what)
    size = size_of_pilot(values, effect) if least is None else size_of_least(values, effect, least)
    source = "the pilot's effect" if least is None else f"{least:g} over the pilot's scatter"
    typer.echo(f"{asked.name}, {what}, {effect}: {source}")
    curve = power_curve(size, (4, 6, 8, 10, 14, 20, 28, 40, 60), alpha=prepared.study.analysis.alpha)
    for p in curve:
        typer.echo(f"{p.participants:3d} participants: {100 * p.share:.0f} % ({100 * p.low:.0f} to {100 * p.high:.0f})")
    if size.low == 0:
        print_notes(["the pilot does not tell this effect from none; state the least that matters with --least"])
    enough = next((p.participants for k, p in enumerate(curve) if min(q.share for q in curve[k:]) >= 0.8), None)
    typer.echo("80 % is not reached" if enough is None else f"80 % from {enough} participants on")


@app.command()
def withdraw(
    file: StudyFile,
    participant: Participant,
    data: Answers = None,
    yes: Annotated[bool, typer.Option("--yes", help="do not ask")] = False,
) -> None:
    """Delete a participant's answers for good."""
    from ..study.run import Prepared

    store = Prepared.of(file, data).store()
    if not yes and not typer.confirm(f"delete all answers of {participant}?"):
        raise typer.Abort()
    with store.sitting(participant):
        store.withdraw(participant)
    typer.echo(f"sub-{participant}: answers deleted, and any analysis that held them; `study analyse` makes it anew")
