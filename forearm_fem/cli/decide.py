"""predict, validate, design, campaign and library: choices before hardware exists."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from ..errors import DataError, ScenarioError
from ..scenario import load_scenario
from .common import (
    Declared,
    LibraryFile,
    OutFolder,
    Overrides,
    Resume,
    ScenarioFile,
    Scheduler,
    Workers,
    ends_in,
    holds_g,
    job,
    library_file,
    measured_g,
    out_folder,
    print_notes,
    refuse_folder,
    there,
)

# predict, validate: what S people will see, and how that compares with what was measured.

Held = Annotated[
    list[str] | None,
    typer.Option(
        "--hold", help="keep the scenario's value of an input or group, e.g. tissue, placement, tape, 'arm motion'"
    ),
]


def predict(
    scenario: ScenarioFile,
    overrides: Overrides = None,
    out: OutFolder = None,
    draws: Annotated[
        int, typer.Option(min=20, max=100_000, help="arms drawn; 20 is the least for a band of 90 %")
    ] = 200,
    seed: Annotated[int, typer.Option(min=0, help="of the draws: the same seed gives the same arms")] = 0,
    law: Annotated[
        list[str] | None,
        typer.Option(help="draw this tissue law only (repeatable): kelvin-voigt, zener, springpot, or module:Name"),
    ] = None,
    hold: Held = None,
    layered: Annotated[
        bool, typer.Option("--layered/--own", help="arms on the layered model, or by the scene's own engine")
    ] = False,
    resume: Resume = True,
    workers: Workers = None,
    scheduler: Scheduler = None,
    sobol: Annotated[
        bool, typer.Option("--sobol/--no-sobol", help="Sobol' indices, with the extra 'prediction'")
    ] = True,
) -> None:
    """S on people: draws of arms, devices and measurements; bands apart from the error of the numerics."""
    asked = load_scenario(scenario, overrides=overrides or ())
    folder = out_folder(out, asked, overrides) / "prediction"
    with job(folder, "questions.predict.run", "show.prediction") as display:
        from ..questions.predict.draws import LAWS
        from ..questions.predict.run import Question
        from ..questions.predict.run import predict as run

        question = Question(asked, scenario.parent, seed, tuple(law or LAWS), tuple(hold or ()), layered)
        found = run(
            question, folder, draws=draws, resume=resume, workers=workers, scheduler=scheduler, progress=display
        )
        page, plain = found.save(folder, sobol=sobol, progress=display)
    typer.echo(plain.read_text(encoding="utf-8"))
    typer.echo(f"prediction: {page} ({found.reused} of {draws} draws were there, {found.seconds:.0f} s)")


def validate(
    scenario: ScenarioFile,
    overrides: Overrides = None,
    out: OutFolder = None,
    draws: Annotated[int, typer.Option(min=60, max=100_000, help="arms drawn; 60 leave about 20 for each law")] = 300,
    seed: Annotated[int, typer.Option(min=0, help="of the draws")] = 0,
    hold: Held = None,
    resume: Resume = True,
    workers: Workers = None,
    scheduler: Scheduler = None,
    measured: Annotated[
        Path | None,
        typer.Option(help="a measured G (file or results folder) to run through the same comparison", callback=holds_g),
    ] = None,
    declare: Declared = None,
) -> None:
    """Judge predictions by what was published: measured, band over arms, inside or not; where it fails comes first."""
    asked = load_scenario(scenario, overrides=overrides or ())
    name = "" if measured is None else measured.name
    folder = out_folder(out, asked, overrides) / "prediction"
    with job(folder, "questions.predict.validate", "show.prediction") as display:
        from ..questions.predict.run import Question
        from ..questions.predict.validate import validate as run
        from ..show.prediction import failures, validation_page

        found = run(
            Question(asked, scenario.parent, seed, held=tuple(hold or ())), folder, draws=draws, resume=resume,
            workers=workers, scheduler=scheduler, measured=measured_g(measured, asked, declare, "--measured"),
            measured_name=name, progress=display,
        )  # fmt: skip
    page = validation_page(found, asked.name)
    written, _ = page.save(folder, "validation")
    typer.echo(page.title)
    for what, seen, arms in failures(found):
        typer.echo(f"{what}: {seen}, arms {arms}")
    for line in page.answer:
        typer.echo(line)
    typer.echo(f"open {written}")


# design: which device to build.


def design(
    file: Annotated[
        Path, typer.Argument(help="design file: scenario, variables, objective and constraints",
                             callback=there("no such design file")),
    ],
    out: Annotated[Path | None, typer.Option("--out", help="default results/NAME")] = None,
    confirm: Annotated[
        bool, typer.Option("--confirm/--no-confirm", help="solve the winner in full by the scenario's own engine")
    ] = True,
    library: LibraryFile = None,
    scheduler: Scheduler = None,
    workers: Annotated[int | None, typer.Option(min=1, help="processes on this machine; default 1")] = None,
) -> None:  # fmt: skip
    """Search for the device with the largest S within limits; interrupted, it goes on where it was."""
    from ..questions.design import load_design, run_design
    from ..questions.design.report import outcome_words

    asked = load_design(file)
    folder = out_folder(out, asked.asked.name)
    with job(folder) as display:
        result = run_design(
            asked, folder, arm=library_file(library), confirm=confirm, scheduler=scheduler, workers=workers,
            progress=display,
        )  # fmt: skip
    for line in outcome_words(result):
        typer.echo(line)
    typer.echo(f"{len(result.candidates)} candidates, {len(result.front)} on the Pareto front: {folder / 'report.md'}")


# library: one long run per arm, after which any arrangement of discs on its patch is answered in a second.

_LATER = ("device.", "grid.", "rendering.", "measurement.")  # tables of which a library knows the cone alone


def library(
    scenario: ScenarioFile,
    overrides: Overrides = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="the file to write; default NAME.library.nc", callback=ends_in(".nc"))
    ] = None,
) -> None:
    """Solve once for a patch of an arm's skin; `run --library` then needs no solve."""
    from ..engines.library import is_library, make_library, save_library

    asked = load_scenario(scenario, overrides=overrides or ())
    if asked.engine != "fem":
        raise ScenarioError("engine: a library is made of finite elements; set engine = 'fem', or leave it out")
    file = out or Path(f"{asked.name}.library.nc")
    refuse_folder(file)
    if file.is_file() and not is_library(file):
        raise DataError(f"{file}: is there and no library; it is not replaced, name another file with --out")
    print_notes(_idle(overrides or ()))
    with job(file.parent, sums=False) as display:
        made = make_library(asked, base=scenario.parent, progress=display)
        save_library(file, made)
    patch, facts = asked.library, made.facts
    typer.echo(f"patch        {patch.length * 1e3:.3g} x {patch.width * 1e3:.3g} mm, {facts['loads']} loads")
    typer.echo(f"space        {facts['size']} directions from {facts['solves']} solves of {facts['unknowns']} unknowns")
    off = ", ".join(f"{error:.1e} at {f:g} Hz" for f, error, _ in made.reduction.T)
    typer.echo(f"reduction    {off}")
    typer.echo(f"library: {file} ({file.stat().st_size / 1e6:.0f} MB, {facts['seconds']:.0f} s)")


def _idle(overrides: Sequence[str]) -> list[str]:
    """A note on keys that were set for a library and are asked of it later."""
    given = [item.partition("=")[0].strip() for item in overrides]
    idle = [k for k in given if k.startswith(_LATER) and k not in ("device.cone.radius", "device.cone.contact")]
    return [f"{', '.join(idle)}: no effect on a library; give it to `run --library`"] if idle else []


# verify and campaign: many solves for one table.


def campaign(
    file: Annotated[
        Path, typer.Argument(help="campaign file: a scenario and a list, grid or draw of overrides",
                             callback=there("no such campaign file")),
    ],
    out: Annotated[Path | None, typer.Option("--out", help="default results/NAME")] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
) -> None:  # fmt: skip
    """Run many variants of a scenario; finished ones are skipped, failed ones do not stop the rest."""
    from ..questions.campaign import load_campaign, run_campaign

    asked = load_campaign(file)
    folder = out_folder(out, asked.name)
    with job(folder) as display:
        result = run_campaign(asked, folder, scheduler=scheduler, workers=workers, progress=display)
    typer.echo(result.table)
    print_notes([f"{m.name}: {m.problem}" for m in result.members if m.problem])
    typer.echo(f"campaign: {result.folder}")
    if any(m.problem for m in result.members):
        raise typer.Exit(1)


def verify(
    out: Annotated[Path, typer.Option("--out", help="folder that the page is written to")] = Path("results/verify"),
) -> None:
    """Check this installation against exact solutions; exit code 1 where a number misses its tolerance."""
    from ..verification.run import run_verification, verification_page

    with job(out) as display:
        rows = run_verification(display)
        page = verification_page(rows)
        written, _ = page.save(out, "verification")
    for line in (page.title, *page.answer, f"open {written}"):
        typer.echo(line)
    if not all(r.met for r in rows):
        raise typer.Exit(1)
