"""library: one long run per arm, after which any arrangement of discs on its patch is answered in a second."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from ..errors import DataError, ScenarioError
from ..scenario import load_scenario
from .common import Display, Overrides, ScenarioFile, ends_in, print_notes, refuse_folder

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
    from ..store.folder import locked

    asked = load_scenario(scenario, overrides=overrides or ())
    if asked.engine != "fem":
        raise ScenarioError("engine: a library is made of finite elements; set engine = 'fem', or leave it out")
    file = out or Path(f"{asked.name}.library.nc")
    refuse_folder(file)
    if file.is_file() and not is_library(file):
        raise DataError(f"{file}: is there and no library; it is not replaced, name another file with --out")
    print_notes(_idle(overrides or ()))
    with locked(file.parent, sums=False), Display() as display:
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
