"""design: which device to build."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .common import Display, LibraryFile, library_file, noted, there


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
    scheduler: Annotated[
        str | None, typer.Option(help="address of a running Dask scheduler; default: this process")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="processes on this machine; default 1")] = None,
) -> None:  # fmt: skip
    """Search for the device with the largest S within limits; interrupted, it goes on where it was."""
    from ..questions.design import load_design, run_design
    from ..questions.design.report import outcome_words
    from ..store.folder import locked

    asked = load_design(file)
    folder = out or Path("results") / asked.asked.name
    with locked(folder), Display() as display, noted():
        result = run_design(
            asked, folder, arm=library_file(library), confirm=confirm, scheduler=scheduler, workers=workers,
            progress=display,
        )
    for line in outcome_words(result):
        typer.echo(line)
    typer.echo(f"{len(result.candidates)} candidates, {len(result.front)} on the Pareto front: {folder / 'report.md'}")
