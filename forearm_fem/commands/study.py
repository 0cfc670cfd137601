"""study new, run, status, analyse, rehearse, power, withdraw: the half of the thesis that is about people."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from ..errors import DataError, ScenarioError
from .common import Declared, Display, declaration, holds_g, measured_g, noted, print_notes, there

app = typer.Typer(no_args_is_help=True, help="Studies with people, from the stimulus to the statistics.")

StudyFile = Annotated[
    Path, typer.Argument(help="study file; `forearm-fem study new` writes one",
                         callback=there("no such study file; `forearm-fem study new NAME` writes one")),
]  # fmt: skip
_DATA = "folder of the answers; default beside the file"
Data = Annotated[Path | None, typer.Option("--data", help=_DATA)]
Answers = Annotated[
    Path | None, typer.Option("--data", help=_DATA, callback=there("no such folder of answers", folder=True)),
]  # fmt: skip

_TEMPLATE = """# A study: every key is optional but name and scenario. `forearm-fem study run {name}.toml` runs it.
name = "{name}"
scenario = {scenario}                                # device, wavelet, limits
transfer = "calibration/{{participant}}/transfer.nc"     # each participant's calibrated G
participants = 20
language = "en"                                         # en, de, nl, or a TOML file of texts

[stimuli]
methods = ["inverse filter", "funneling", "combination"]
targets = ["1", "2", "3", "4", "5", "6", "7", "8", "9"]

[stimuli.level]                                         # as rendered, target peak [um] or drive peak [V]
rule = "as rendered"

[order]
seed = 0
methods = "mixed"                                       # or "one after the other"
no_target_twice = true

[[tasks]]                                               # study 1 of de Vlam 2022: 3 methods x 9 targets x 3 = 81 trials
name = "identification"
answer = "one point"
repetitions = 3
blocks = 3
training = 1

[[tasks]]                                               # study 2: as many points as are felt
name = "confidence"
answer = "several points"
repetitions = 3
blocks = 3
training = 1
"""


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="letters, digits and hyphens")],
    scenario: Annotated[
        str, typer.Option(help="of the device: a file seen from the study file, or the name of a shipped one")
    ] = "thesis",
    folder: Annotated[Path, typer.Option(help="where the file goes")] = Path(),
) -> None:
    """Write a commented study file: the thesis' two studies, to be changed."""
    from ..scenario import load_scenario, scenario_beside
    from ..store.folder import write_text
    from ..study.plan import Study

    Study(name=name, scenario=scenario)  # before anything is written
    file = folder / f"{name}.toml"
    if file.exists():
        raise ScenarioError(f"{file} exists already; take another name or remove it")
    load_scenario(scenario_beside(folder, scenario))
    write_text(file, _TEMPLATE.format(name=name, scenario=json.dumps(scenario, ensure_ascii=False)))
    typer.echo(str(file))


@app.command()
def run(
    file: StudyFile,
    participant: Annotated[str, typer.Option(help="pseudonym: letters and digits, e.g. 01")],
    task: Annotated[str, typer.Option(help="of the study, e.g. identification")],
    consent: Annotated[str, typer.Option(help="date on which consent was signed; needed once per participant")] = "",
    daq: Annotated[Literal["virtual", "ni", "sound"], typer.Option(help="virtual, ni or sound")] = "virtual",
    card: Annotated[str | None, typer.Option("--card", help="sound: name or number of the card")] = None,
    cable: Annotated[
        Path | None,
        typer.Option("--loopback", help="record of `forearm-fem loopback`, kept with the answers",
                     callback=there("no such file; `forearm-fem loopback SCENARIO` makes one")),
    ] = None,
    declare: Declared = None,
    data: Data = None,
    terminal: Annotated[bool, typer.Option("--terminal", help="ask in this terminal instead of on a page")] = False,
    host: Annotated[
        str, typer.Option(help="address to serve the page on; other machines can reach 0.0.0.0")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="0: a free one")] = 0,
) -> None:  # fmt: skip
    """Run a participant's session; the same command goes on where it stopped."""
    from ..measurement.loopback import read_loopback
    from ..study.run import Prepared, require_study_extra, session_for

    require_study_extra()
    if not participant.isalnum() or len(participant) > 32:
        raise ScenarioError(f"--participant '{participant[:40]}': expected letters and digits only, e.g. 01")
    prepared = Prepared.of(file, data)
    kept = None if cable is None else read_loopback(cable)
    session, grid = session_for(
        prepared, participant, task, consent=consent, daq=daq, card=card, cable=kept, declaration=declaration(declare)
    )
    if session.back_end.latency_basis == "unknown":
        print_notes(
            ["the device's latency was not measured and is kept as unknown; `forearm-fem loopback` measures it"]
        )
    if terminal:
        from ..study.terminal import run_in_terminal

        run_in_terminal(session, grid, typer.echo)
        return
    from ..study.server import serve, texts

    def announce(theirs: str, ours: str) -> None:
        """Tell the addresses of the two pages."""
        typer.echo(f"participant:  {theirs}\nexperimenter: {ours}\nCtrl-C stops; the same command goes on.")

    words = texts(prepared.study.language, prepared.base)
    if host not in ("127.0.0.1", "localhost"):
        print_notes(["the page can be reached from other machines; its address is the only key"])
    serve(session, grid, words, beep=prepared.study.beep, host=host, port=port, announce=announce)
    view = session.view()
    typer.echo(f"{view['answered']} of {view['total']} answered; data: {prepared.folder}")


@app.command()
def status(file: StudyFile, data: Answers = None) -> None:
    """Who has answered how much."""
    from ..study.run import Prepared, statuses

    store = Prepared.of(file, data).store()
    if not store.people():
        typer.echo("nobody is enrolled yet")
    for participant, task, answered, total in statuses(store):
        typer.echo(f"{participant}  {task}: {answered} of {total}")
    for gone in (p for p in store.people() if p["status"] == "withdrawn"):
        typer.echo(f"{gone['participant_id'].removeprefix('sub-')}  withdrawn")


@app.command()
def analyse(
    file: StudyFile,
    data: Annotated[
        Path | None, typer.Option("--data", help=f"{_DATA}; of --table: where its page goes, default NAME-TABLE"),
    ] = None,
    correction: Annotated[
        Literal["bonferroni", "holm"], typer.Option(help="of comparisons: bonferroni or holm")
    ] = "bonferroni",
    thesis: Annotated[bool, typer.Option("--thesis", help="check the thesis' own degrees of freedom too")] = False,
    table: Annotated[
        Path | None,
        typer.Option(help="somebody else's answers: a CSV or TSV with the columns of an events file",
                     callback=there("no such file")),
    ] = None,
    columns: Annotated[
        list[str] | None, typer.Option("--column", help="of --table, e.g. method=condition; ours=theirs, repeatable")
    ] = None,
) -> None:  # fmt: skip
    """Errors, ellipses, confusion, confidence and statistics as one page with CSVs."""
    from ..study.report import write_analysis
    from ..study.run import Prepared, answers_of, require_study_extra
    from ..study.tables import foreign_table

    require_study_extra()
    if table is None:
        there("no such folder of answers", folder=True)(data)
        if columns:
            raise DataError("--column: has no effect without --table; name the table, or leave it out")
    prepared = Prepared.of(file, data)
    if table is not None and data is None:
        prepared = replace(prepared, folder=prepared.base / f"{prepared.study.name}-{table.stem}")
    grid = prepared.grid()
    devices: list[dict[str, str]] | None = None
    if table is not None:
        if prepared.store().people():
            raise DataError(
                f"{prepared.folder}: holds answers of its own, whose analysis a table's would replace; leave --data "
                "out, or name another folder"
            )
        answers = {prepared.study.tasks[0].name: foreign_table(table, columns or (), grid)}
    else:
        store, answers = prepared.store(), {}
        devices = store.devices()
        for task in prepared.study.tasks:
            try:
                answers[task.name] = answers_of(store, task.name)
            except DataError as problem:
                print_notes([str(problem)])
        if not answers:
            raise DataError(f"{prepared.folder}: there are no answers to analyse")
    with noted():
        page = write_analysis(
            prepared.study, answers, grid, prepared.folder, correction=correction, compare_with_thesis=thesis,
            devices=devices,
        )  # fmt: skip
    typer.echo(str(page))


@app.command()
def rehearse(
    file: StudyFile,
    transfer: Annotated[
        Path,
        typer.Option(help="G that all simulated participants share; of a results folder they feel the whole skin",
                     callback=holds_g),
    ],
    declare: Declared = None,
    participants: Annotated[int, typer.Option(min=1, max=1000, help="simulated ones")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="of their noise and lapses")] = 0,
    data: Annotated[Path | None, typer.Option("--data", help="default NAME-rehearsal beside the file")] = None,
) -> None:  # fmt: skip
    """Let simulated participants do the study: to try the analysis, never as a prediction of people."""
    from ..study.field import field_for
    from ..study.percept import Percept
    from ..study.run import Prepared, require_study_extra
    from ..study.run import rehearse as run_rehearsal

    require_study_extra()
    prepared = Prepared.of(file)
    folder = data or file.parent / f"{prepared.study.name}-rehearsal"
    field = field_for(transfer)
    if field is None:
        print_notes(["only the grid points' motion is known; skin between and under actuators is not felt"])
    with Display() as display, noted():
        g = measured_g(transfer, prepared.scenario, declare)
        assert g is not None  # it was named
        run_rehearsal(Prepared.of(file, folder), g, participants, Percept(), field=field, seed=seed, progress=display)
    typer.echo(f"{folder}: `forearm-fem study analyse {file} --data {folder}` analyses it")


@app.command()
def power(
    file: StudyFile,
    pilot: Annotated[
        Path, typer.Option(help="folder of answers to take effects and scatter from (or a rehearsal)",
                           callback=there("no such folder; `forearm-fem study rehearse` makes one", folder=True)),
    ],
    task: Annotated[str, typer.Option(help="of the study")] = "identification",
    effect: Annotated[
        Literal["location", "method", "location x method", "pairs"],
        typer.Option("--effect", help="to be found: location, method, 'location x method' or pairs"),
    ] = "method",
    studies: Annotated[
        int, typer.Option(min=100, max=100_000, help="drawn for each number of participants")
    ] = 1000,
) -> None:  # fmt: skip
    """How many participants find an effect, by studies drawn from a pilot's cell means and scatter."""
    from ..show.style import SHEET
    from ..store.folder import atomic_path
    from ..study.analysis import cell_means, with_errors
    from ..study.figures import plot_power
    from ..study.power import needed, power_curve, supposed_from, untold
    from ..study.run import Prepared, answers_of, require_study_extra

    require_study_extra()
    prepared = Prepared.of(file, pilot)
    main = with_errors(answers_of(prepared.store(), task), prepared.grid())
    values, *_ = cell_means(main, "error")
    repetitions = prepared.study.task(task).repetitions
    within = float(main.groupby(["participant", "target", "method"])["error"].std(ddof=1).pow(2).mean() ** 0.5)
    if not within > 0:
        raise DataError(f"{pilot}: repetitions are needed to tell a trial's scatter; the task has {repetitions}")
    with Display() as display:
        supposed = supposed_from(values, repetitions, within)
        curve = power_curve(
            supposed, (4, 6, 8, 10, 14, 20, 28, 40), repetitions, test=effect, studies=studies, progress=display
        )
    for p in curve:
        typer.echo(f"{p.participants:3d} participants: {100 * p.share:.0f} % ({100 * p.low:.0f}-{100 * p.high:.0f} %)")
    if doubt := untold(values, effect):
        print_notes([doubt])
    enough = needed(curve)
    typer.echo("80 % is not reached" if enough is None else f"80 % from {enough} participants on")
    from matplotlib import style

    with atomic_path(pilot / "power.png") as target, style.context(SHEET):
        plot_power(curve).savefig(target, dpi=130)
    typer.echo(str(pilot / "power.png"))


@app.command()
def withdraw(
    file: StudyFile,
    participant: Annotated[str, typer.Option(help="pseudonym")],
    data: Answers = None,
    yes: Annotated[bool, typer.Option("--yes", help="do not ask")] = False,
) -> None:
    """Delete a participant's answers for good."""
    from ..study.run import Prepared

    store = Prepared.of(file, data).store()
    if not yes and not typer.confirm(f"delete all answers of {participant}?"):
        raise typer.Abort()
    store.withdraw(participant)
    typer.echo(f"sub-{participant}: answers deleted, and any analysis that held them; `study analyse` makes it anew")
