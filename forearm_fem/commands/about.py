"""schema, doctor: what the program accepts and what this machine offers."""

from __future__ import annotations

import typer

from ..scenario import scenario_schema


def schema() -> None:
    """Print the JSON Schema of a scenario file."""
    typer.echo(scenario_schema())


def doctor() -> None:
    """Print versions, the solver found, threads, memory, the cache and whether pictures can be rendered."""
    from ..diagnosis import diagnosis

    for name, value in diagnosis().items():
        typer.echo(f"{name:22} {value}")
