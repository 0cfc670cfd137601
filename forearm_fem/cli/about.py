"""new, schema and doctor: a scenario to begin with, what the program accepts, and what this machine offers."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import psutil
import typer

from .. import __version__
from ..errors import ScenarioError
from ..scenario import BODIES, Tape, parse_scenario, scenario_schema, scenario_template
from ..store.folder import default_cache_dir

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
    for name, value in diagnosis().items():
        typer.echo(f"{name:22} {value}")


# Diagnosis of this machine: versions, solver, threads, memory, rendering.

_PICTURE = (
    "import pyvista as pv; pv.OFF_SCREEN = True; p = pv.Plotter(off_screen=True, window_size=(40, 40)); "
    "p.add_mesh(pv.Sphere()); p.show(auto_close=False); print(p.render_window.GetClassName())"
)


def diagnosis() -> dict[str, str]:
    """Name -> finding; nothing raises, what fails is said."""
    from ..engines.simulation import versions
    from ..fem.linear.factor import available_backends

    found = {"forearm-fem": __version__, **versions()}
    found["direct solvers"] = ", ".join(available_backends())
    if available_backends()[0] == "superlu":
        found["direct solvers"] += " (small scenes only; python3 -m pip install mkl)"
    found["threads"] = f"{os.cpu_count()} cores, OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'unset')}"
    found["memory"] = (
        f"{psutil.virtual_memory().available / 1e9:.1f} of {psutil.virtual_memory().total / 1e9:.1f} GB free"
    )
    found["cache"] = _cache()
    found["rendering back end"] = rendering_backend()
    return found


def _cache() -> str:
    """Folder of finished meshes and solves, and its size."""
    folder = default_cache_dir()
    above = next(path for path in (folder, *folder.parents) if path.exists())
    if not above.is_dir() or not os.access(above, os.W_OK):
        return f"{folder}: nothing can be kept there ({above} is no folder that can be written); set FOREARM_FEM_CACHE"
    files, size = [path for path in folder.rglob("*") if path.is_file()], 0
    for path in files:
        with suppress(OSError):  # another command has just removed it
            size += path.stat().st_size
    return f"{folder}: {size / 1e6:.1f} MB in {len(files)} files"


def rendering_backend() -> str:
    """Class of the off-screen render window, tried in a process of its own because a missing driver may kill it."""
    try:
        done = subprocess.run([sys.executable, "-c", _PICTURE], capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.TimeoutExpired) as problem:
        return f"none ({problem})"
    if done.returncode == 0:
        return done.stdout.strip().splitlines()[-1]
    return "none: pyvista cannot render here; on Debian: apt-get install libgl1 libegl1 libxrender1"
