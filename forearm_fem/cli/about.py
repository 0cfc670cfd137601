"""new, schema and doctor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import ScenarioError
from ..scenario import BODIES, Tape, parse_scenario, scenario_schema, scenario_template

# new: a commented scenario to start from.


def new(
    name: Annotated[str, typer.Argument(help="of the scenario; NAME.toml is written here")],
    out: Annotated[Path | None, typer.Option("--out", help="file to write; default NAME.toml")] = None,
    arm: Annotated[str | None, typer.Option(help="a forearm that was measured: small, median or large")] = None,
    tape: Annotated[
        str | None,
        typer.Option(help="your own: DISTANCE:CIRCUMFERENCE from the elbow, in m, e.g. 0:0.25,0.08:0.23,0.16:0.17"),
    ] = None,
    length: Annotated[float | None, typer.Option(help="elbow to wrist, in m; the device sits in its middle")] = None,
    skinfold: Annotated[float | None, typer.Option(help="a caliper's reading on the volar forearm, in m")] = None,
) -> None:
    """Write a scenario in which every key stands with its default and meaning, commented out."""
    from ..store.folder import write_text

    name = name.removesuffix(".toml")
    limb = _limb(arm, tape, length, skinfold)
    parse_scenario({"name": name, **({"limb": limb} if limb else {})}, origin="new")
    file = out or Path(f"{name}.toml")
    if file.exists():
        raise ScenarioError(f"{file}: exists already and is not overwritten; give another name, or --out FILE")
    write_text(file, scenario_template(name, limb))
    typer.echo(f"{file}: edit it, then `forearm-fem run {file} --dry-run`")


def _limb(arm: str | None, tape: str | None, length: float | None, skinfold: float | None) -> dict[str, Any] | None:
    """Keys of ``[limb]`` from the options; None where none is given."""
    if arm is not None and tape is not None:
        raise ScenarioError("--arm and --tape both say what the forearm is; give one of them")
    if arm is not None:
        if arm not in BODIES:
            raise ScenarioError(f"--arm: no forearm is called '{arm}'; known are {', '.join(BODIES)}")
        if length is not None:
            raise ScenarioError("--length: has no effect with --arm, where the device's place is known; leave it out")
        body = BODIES[arm]
        return Tape(body.circumference, body.length, skinfold, body.device).limb()
    if tape is not None:
        if length is None:
            raise ScenarioError("--tape needs --length, from elbow to wrist [m]: the device sits in its middle")
        return Tape(_pairs(tape), length, skinfold).limb()
    if length is not None or skinfold is not None:
        raise ScenarioError("--length and --skinfold go with --tape or --arm (--length with --tape alone); give one")
    return None


def _pairs(text: str) -> tuple[tuple[float, float], ...]:
    try:
        return tuple((float(a), float(b)) for a, b in (item.split(":") for item in text.split(",")))
    except ValueError:
        raise ScenarioError(
            f"--tape: expected DISTANCE:CIRCUMFERENCE pairs [m] such as 0:0.25,0.08:0.23, got '{text[:60]}'"
        ) from None


# schema, doctor: what the program accepts and what this machine offers.


def schema() -> None:
    """Print the JSON Schema of a scenario file."""
    typer.echo(scenario_schema())


def doctor() -> None:
    """Print versions, the solver found, threads, memory, the cache and whether pictures can be rendered."""
    from ..diagnosis import diagnosis

    for name, value in diagnosis().items():
        typer.echo(f"{name:22} {value}")
