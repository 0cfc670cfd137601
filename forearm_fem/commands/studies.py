"""verify and campaign: many solves for one table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import DataError
from .common import Display, noted, print_notes, there

Full = Annotated[bool, typer.Option("--full", help="the long version")]


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
    full: Full = False,
    hard: Annotated[
        bool, typer.Option("--hard", help="the hard cases instead: extreme scenes and their verdicts")
    ] = False,
    out: Annotated[Path, typer.Option("--out", help="folder that the table is written to")] = Path("results/verify"),
) -> None:
    """Check this installation against exact solutions; exit code 1 where a number misses its tolerance."""
    from .. import verification
    from ..store.folder import locked, write_text
    from ..verification import report

    if full and hard:
        raise DataError("--full: has no effect with --hard, which runs all of its cases; leave one of them out")
    with locked(out), Display() as display, noted():
        if hard:
            cases = verification.run_hard_cases(progress=display)
            good = all(c.verdict != "WRONG" for c in cases)
            file, page, last = out / "stability.md", report.stability_page(cases), report.hard_summary(cases)
        else:
            rows = verification.run_verification(full=full, progress=display)
            good = all(r.met for r in rows)
            file, page, last = out / "verification.md", report.verification_page(rows), report.count_met(rows)
        write_text(file, page)
    typer.echo(report.hard_table(cases) if hard else report.verification_table(rows))
    typer.echo(f"{last}\n{file}")
    if not good:
        raise typer.Exit(1)
