"""verify and campaign: many solves for one table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .common import Display, noted, print_notes, there


def campaign(
    file: Annotated[
        Path, typer.Argument(help="campaign file: a scenario and a list, grid or draw of overrides",
                             callback=there("no such campaign file")),
    ],
    out: Annotated[Path | None, typer.Option("--out", help="default results/NAME")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="address of a running Dask scheduler, e.g. tcp://host:8786; default: this machine"),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="processes on this machine; default: what cores and memory allow")
    ] = None,
) -> None:  # fmt: skip
    """Run many variants of a scenario; finished ones are skipped, failed ones do not stop the rest."""
    from ..campaign import load_campaign, run_campaign
    from ..store.folder import locked

    asked = load_campaign(file)
    folder = out or Path("results") / asked.name
    with locked(folder), Display() as display, noted():
        result = run_campaign(asked, folder, scheduler=scheduler, workers=workers, progress=display)
    typer.echo(result.table)
    print_notes([f"{m.name}: {m.problem}" for m in result.members if m.problem])
    typer.echo(f"campaign: {result.folder}")
    if any(m.problem for m in result.members):
        raise typer.Exit(1)


def verify(
    out: Annotated[Path, typer.Option("--out", help="folder that the table is written to")] = Path("results/verify"),
) -> None:
    """Check this installation against exact solutions; exit code 1 where a number misses its tolerance."""
    from ..store.folder import locked, write_text
    from ..verification import report, run_verification

    with locked(out), Display() as display, noted():
        rows = run_verification(display)
        write_text(out / "verification.md", report.verification_page(rows))
    typer.echo(report.verification_table(rows))
    typer.echo(f"{report.count_met(rows)}\n{out / 'verification.md'}")
    if not all(r.met for r in rows):
        raise typer.Exit(1)
