"""figures, show: a run made visible."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import DataError
from ..scenario import load_scenario
from .common import Display, noted, refuse_folder, there

Results = Annotated[
    Path, typer.Argument(help="results folder of a run",
                         callback=there("no such results folder; `forearm-fem run SCENARIO` makes one", folder=True)),
]  # fmt: skip


def figures(
    results: Results,
    only: Annotated[list[str] | None, typer.Option(help="figure names; again for more, or separated by commas")] = None,
    formats: Annotated[str, typer.Option("--format", help="any of png,pdf,svg")] = "png",
    out: Annotated[Path | None, typer.Option("--out", help="default: figures inside the results folder")] = None,
    width: Annotated[
        int | None, typer.Option(help="of a journal, in mm: 88, one column (figures of many panels take 181), or 181")
    ] = None,
    over: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME=FILE.csv: x and published curves laid over figure NAME; LABEL@2: second panel"
        ),
    ] = None,
) -> None:
    """Make the figures of a run, each with its numbers as CSV."""
    pairs = [pair.partition("=")[::2] for pair in over or ()]
    laid = dict(pairs)
    if len(laid) < len(pairs):
        raise DataError("--over: names a figure twice; put all curves for it into one table, a column each")
    if "" in laid.values():
        raise DataError("--over: expected NAME=FILE.csv, a figure and a table of curves")
    names, kinds = [n for item in only for n in _split(item)] if only else None, _split(formats)
    for option, given, read in (("--only", only, names), ("--format", formats, kinds)):
        if given and not read:
            raise DataError(f"{option}: expected names between the commas, got none; leave it out for its default")
    from ..show import make_figures
    from ..store.folder import locked

    with locked(out or results), Display() as display, noted():
        written = make_figures(
            results, out, only=names, formats=kinds,
            progress=display, width=width, over=laid,
        )  # fmt: skip
    for file in written:
        typer.echo(str(file))


def show(
    what: Annotated[Path, typer.Argument(help="results folder, or a scenario whose results lie in results/NAME")],
    save: Annotated[
        Path | None, typer.Option("--save", help="instead of a window: .png, .gif, .mp4, or .html, the workbench")
    ] = None,
) -> None:
    """Walk around the moving limb in a window, or keep a picture, film or page of it."""
    folder = _results_of(what)
    with noted():
        if save is None:
            from ..show.interact import interact

            interact(folder)
            return
        _saved(folder, save)
    typer.echo(str(save))


def _results_of(what: Path) -> Path:
    if what.is_dir():
        return what
    if what.is_file() and what.suffix != ".toml":
        raise DataError(f"{what}: has no solved field to walk around in; `forearm-fem workbench {what}` shows its G")
    folder = Path("results") / load_scenario(what).name
    if not folder.is_dir():
        raise DataError(f"{folder}: no results of {what} yet; `forearm-fem run {what}` makes them")
    return folder


def _saved(folder: Path, save: Path) -> None:
    refuse_folder(save)
    kind = save.suffix.lower()
    if kind == ".png":
        from ..show.film import render_still

        render_still(folder, save)
    elif kind in (".gif", ".mp4"):
        from ..show.film import animate

        with Display() as display:
            animate(folder, save, progress=display)
    elif kind == ".html":
        from ..show.workbench import write_workbench

        write_workbench(folder, save)
    else:
        raise DataError(f"{save}: choose a name that ends in .png, .gif, .mp4 or .html")


def _split(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())
