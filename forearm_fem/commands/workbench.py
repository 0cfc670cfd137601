"""workbench: a run as a page in which its model goes on working."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..scenario import scenario_file
from .common import Declared, Display, declaration, ends_in, noted, scene_of, there


def workbench(
    what: Annotated[
        Path,
        typer.Argument(help="results folder of a run, NAME.library.nc of an arm, or a measured G: a file or a "
                       "calibration's folder",
                       callback=there("no such results folder or file; `forearm-fem run SCENARIO` makes a folder")),
    ],
    save: Annotated[
        Path | None,
        typer.Option("--save", help="the page; default workbench.html in the folder, NAME.html beside a file",
                     callback=ends_in(".html")),
    ] = None,
    scenario: Annotated[
        Path | None,
        typer.Option(help="of a measured G, for its record, wavelet and limits; or a device on a library's arm"),
    ] = None,
    declare: Declared = None,
) -> None:  # fmt: skip
    """Write one HTML page in which the waves move and everything can be tried: no server, no network."""
    asked = scene_of(scenario)
    from ..show.workbench.bundle import page_beside, write_workbench

    page = save or (what / "workbench.html" if what.is_dir() else page_beside(what))
    with noted(), Display() as display:
        write_workbench(
            what, page, scenario=asked, declaration=declaration(declare), progress=display,
            base=scenario_file(scenario).parent if scenario else Path(),
        )  # fmt: skip
    typer.echo(f"{page}: {page.stat().st_size / 1e6:.1f} MB, opens in any browser")
