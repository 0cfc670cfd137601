"""figures, show: a run made visible."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import DataError
from .common import Display, noted

Results = Annotated[Path, typer.Argument(help="results folder of a run")]


def figures(
    results: Results,
    only: Annotated[
        list[str] | None, typer.Option(help="figure names; again for more, or separated by commas")
    ] = None,
    formats: Annotated[str, typer.Option("--format", help="any of png,pdf,svg")] = "png",
    out: Annotated[
        Path | None, typer.Option("--out", help="default: figures inside the results folder")
    ] = None,
) -> None:
    """Make the figures of a run, each with its numbers as CSV."""
    if not results.is_dir():
        raise DataError(f"{results}: no such results folder; `forearm-fem run SCENARIO` makes one")
    from ..figures import make_figures

    with Display() as display, noted():
        written = make_figures(
            results, out, only=_listed(only), formats=_split(formats),
            progress=lambda done, total, _: display("figures", done, total),
        )  # fmt: skip
    for file in written:
        typer.echo(str(file))


def show(
    what: Annotated[Path, typer.Argument(help="scenario file or results folder")],
    picture: Annotated[
        Path | None, typer.Option("--save", help="write a picture instead of opening a window")
    ] = None,
) -> None:
    """Look at a limb, its mesh and the ports in a window, or as a picture."""
    if not what.exists():
        raise DataError(f"{what}: no such scenario file or results folder")
    from ..figures import show as open_window

    with noted():
        written = open_window(what, picture)
    if written is not None:
        typer.echo(str(written))


def _listed(items: list[str] | None) -> list[str] | None:
    return [name for item in items for name in _split(item)] if items else None


def _split(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())
