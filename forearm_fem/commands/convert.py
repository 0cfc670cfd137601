"""convert: any readable G, or raw sweeps, to netCDF, CSV or MATLAB."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..errors import DataError
from ..scenario import apply_overrides, load_scenario, scenario_file
from .common import Declared, Overrides, declaration, holds_g, noted, refuse_folder, transfer_file

_ENDINGS = (".nc", ".csv", ".mat")


def _writable(file: Path) -> Path:
    if file.suffix.lower() not in _ENDINGS:
        raise DataError(f"{file}: cannot write '{file.suffix}'; choose a name that ends in {', '.join(_ENDINGS)}")
    refuse_folder(file)
    return file


def convert(
    source: Annotated[
        Path,
        typer.Argument(metavar="IN", callback=holds_g,
                       help="G: a file of any known kind, a results folder, or a folder or pattern of files"),
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="G.nc, G.csv or G.mat", callback=_writable)],
    scenario: Annotated[
        Path | None, typer.Option(help="that was measured: places, and of raw sweeps the sweep and the sensor")
    ] = None,
    overrides: Overrides = None,
    declare: Declared = None,
) -> None:
    """Write any readable G as netCDF, CSV or MATLAB; raw sweeps become G as in `calibrate`."""
    if overrides and scenario is None:
        raise DataError("--set: has no effect without --scenario; name one, or leave it out")
    apply_overrides({}, overrides or ())
    asked = None if scenario is None else load_scenario(scenario_file(scenario), overrides=overrides or ())
    from ..files.read import read

    with noted():
        g = read(transfer_file(source), declaration(declare), scenario=asked)
    g.save(target)
    usable = np.isfinite(g.values) if g.valid is None else g.valid
    typer.echo(
        f"{len(g.outputs)} points, {len(g.inputs)} actuators, {len(g.frequency)} frequencies from "
        f"{g.frequency[0]:g} to {g.frequency[-1]:g} Hz, in {g.unit}; {100 * usable.mean():.3g} % of the entries may be "
        f"used\nG: {target}"
    )
