"""new: a commented scenario to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import ScenarioError
from ..scenario import parse_scenario, scenario_template


def new(
    name: Annotated[str, typer.Argument(help="of the scenario; NAME.toml is written here")],
    out: Annotated[Path | None, typer.Option("--out", help="file to write; default NAME.toml")] = None,
) -> None:
    """Write a scenario in which every key stands with its default and meaning, commented out."""
    from ..io.atomic import write_text

    name = name.removesuffix(".toml")
    parse_scenario({"name": name}, origin="new")
    file = out or Path(f"{name}.toml")
    if file.exists():
        raise ScenarioError(f"{file}: exists already and is not overwritten; give another name, or --out FILE")
    write_text(file, scenario_template(name))
    typer.echo(f"{file}: edit it, then `forearm-fem run {file} --dry-run`")
