"""predict, validate: what S people will see, and how that compares with what was measured."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..scenario import load_scenario
from .common import (
    Declared,
    Display,
    OutFolder,
    Overrides,
    ScenarioFile,
    ends_in,
    holds_g,
    measured_g,
    noted,
    out_folder,
)


def predict(
    scenario: ScenarioFile,
    overrides: Overrides = None,
    out: OutFolder = None,
    draws: Annotated[
        int, typer.Option(min=20, max=100_000, help="arms drawn; 20 is the least for a band of 90 %")
    ] = 200,
    seed: Annotated[int, typer.Option(min=0, help="of the draws: the same seed gives the same arms")] = 0,
    law: Annotated[
        list[str] | None, typer.Option(help="draw this tissue law only (repeatable): kelvin-voigt, zener, springpot")
    ] = None,
    hold: Annotated[
        list[str] | None,
        typer.Option(help="keep the scenario's value of an input or group, e.g. tissue, placement, 'signal to noise'"),
    ] = None,
    twin: Annotated[
        bool, typer.Option("--twin/--own", help="arms on the layered twin, or by the scene's own engine")
    ] = False,
    resume: Annotated[bool, typer.Option("--resume/--anew", help="go on with draws that the folder holds")] = True,
    workers: Annotated[int | None, typer.Option(min=1, help="processes; default: what cores and memory allow")] = None,
    scheduler: Annotated[str | None, typer.Option(help="address of a running Dask scheduler")] = None,
    sobol: Annotated[
        bool, typer.Option("--sobol/--no-sobol", help="Sobol' indices, with the extra 'prediction'")
    ] = True,
) -> None:
    """S on people: draws of arms, devices and measurements; bands apart from the error of the numerics."""
    asked = load_scenario(scenario, overrides=overrides or ())
    with noted(), Display() as display:
        display("libraries", 0, 1)  # seconds of a slow or busy machine
        from ..prediction.draws import LAWS
        from ..prediction.run import Question
        from ..prediction.run import predict as run
        from ..prediction.summary import FOLDER, summary, write_summary
        from ..show.prediction import write_prediction
        from ..store.folder import locked

        display("libraries", 1, 1)
        folder = out_folder(out, asked, overrides) / FOLDER
        question = Question(asked, scenario.parent, seed, tuple(law or LAWS), tuple(hold or ()), twin)
        with locked(folder):
            found = run(
                question, folder, draws=draws, resume=resume, workers=workers, scheduler=scheduler, progress=display
            )
            display("report", 0, 1)
            content = summary(found, sobol)
            write_summary(folder, content)
            page, plain = write_prediction(folder, content)
            display("report", 1, 1)
        typer.echo(plain.read_text(encoding="utf-8"))
        typer.echo(f"prediction: {page} ({found.reused} of {draws} draws were there, {found.seconds:.0f} s)")


def validate(
    scenario: ScenarioFile,
    overrides: Overrides = None,
    out: OutFolder = None,
    draws: Annotated[int, typer.Option(min=60, max=100_000, help="arms drawn; 60 leave about 20 for each law")] = 300,
    seed: Annotated[int, typer.Option(min=0, help="of the draws")] = 0,
    resume: Annotated[bool, typer.Option("--resume/--anew", help="go on with draws that the folder holds")] = True,
    workers: Annotated[int | None, typer.Option(min=1, help="processes; default: what cores and memory allow")] = None,
    scheduler: Annotated[str | None, typer.Option(help="address of a running Dask scheduler")] = None,
    measured: Annotated[
        Path | None,
        typer.Option(help="a measured G (file or results folder) to run through the same comparison", callback=holds_g),
    ] = None,
    declare: Declared = None,
    page: Annotated[
        Path | None, typer.Option(help="write the page there, e.g. docs/validation.md", callback=ends_in(".md"))
    ] = None,
) -> None:
    """Judge predictions by what was published: measured, band over arms, inside or not; where it fails comes first."""
    asked = load_scenario(scenario, overrides=overrides or ())
    name = "" if measured is None else measured.name
    with noted(), Display() as display:
        display("libraries", 0, 1)  # seconds of a slow or busy machine
        from ..prediction.run import Question
        from ..prediction.summary import FOLDER
        from ..prediction.validate import validate as run
        from ..show.validation import coverage, failures, joint_words, validation_page
        from ..store.folder import locked, write_text

        display("libraries", 1, 1)
        given = measured_g(measured, asked, declare, "--measured")
        folder = out_folder(out, asked, overrides) / FOLDER
        with locked(folder):
            found = run(
                Question(asked, scenario.parent, seed), folder, draws=draws, resume=resume, workers=workers,
                scheduler=scheduler, measured=given, measured_name=name, progress=display,
            )  # fmt: skip
    target = page or folder / "validation.md"
    write_text(target, validation_page(found, asked.name))
    for what, seen, arms in failures(found):
        typer.echo(f"{what}: {seen}, arms {arms}")
    for line in (*joint_words(found), *(f"inside the band, {name}: {inside}" for name, inside in coverage(found))):
        typer.echo(line)
    typer.echo(f"validation: {target}")
