"""The command line: parses, shows progress, prints; all work is done by the library."""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from . import __version__
from .errors import ForearmError
from .scenario import Scenario, load_scenario, scenario_schema

app = typer.Typer(
    add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False,
    help="Simulate vibration in a layered forearm, render on it, and say how wrong each number may be.",
)  # fmt: skip
console = Console(stderr=True)

ScenarioFile = Annotated[Path, typer.Argument(help="scenario file, e.g. scenarios/thesis.toml")]
Overrides = Annotated[list[str] | None, typer.Option("--set", help="override a key, e.g. device.spacing=0.040")]
OutFolder = Annotated[Path | None, typer.Option("--out", help="results folder; default results/NAME")]


def main() -> None:
    """Entry point: a known failure is one sentence and exit code 2, an interruption exit code 130."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    try:
        app(standalone_mode=False)
    except ForearmError as problem:
        console.print(f"[red]error:[/red] {problem}", highlight=False, soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        console.print("interrupted; what was finished is kept, run the same command to go on")
        sys.exit(130)
    except typer.Exit as stop:
        sys.exit(stop.exit_code)
    except Exception as problem:
        if type(problem).__module__.startswith(("click", "typer")):
            console.print(f"[red]error:[/red] {getattr(problem, 'message', problem) or problem}", highlight=False)
            sys.exit(2)
        raise


@app.command()
def run(
    scenario: ScenarioFile,
    overrides: Overrides = None,
    out: OutFolder = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="print size, cost and resolution; solve nothing")] = False,
) -> None:
    """The main job: mesh, solve, render, figures and report."""
    asked = load_scenario(scenario, overrides=overrides or ())
    if dry_run:
        _print_forecast(asked, scenario.parent)
        return
    from .pipeline.folder import run_all

    job = _stage(asked, scenario, out, run_all)
    typer.echo((job.out / "report.md").read_text(encoding="utf-8"))
    typer.echo(f"results: {job.out}")


@app.command()
def mesh(scenario: ScenarioFile, overrides: Overrides = None, out: OutFolder = None) -> None:
    """Make or find the mesh and write mesh.vtu."""
    from .pipeline.folder import run_mesh

    asked = load_scenario(scenario, overrides=overrides or ())
    job = _stage(asked, scenario, out, run_mesh)
    _print_forecast(asked, scenario.parent)
    typer.echo(f"mesh: {job.out / 'mesh.vtu'}")


@app.command()
def solve(scenario: ScenarioFile, overrides: Overrides = None, out: OutFolder = None) -> None:
    """Solve for G and its errors, reusing what is there."""
    from .pipeline.folder import run_solve

    job = _stage(load_scenario(scenario, overrides=overrides or ()), scenario, out, run_solve)
    account = json.loads((job.out / "run.json").read_text(encoding="utf-8"))
    for error in account["errors"]:
        typer.echo(f"{error['source']:15} band {error['band']:.2e}  worst e(f) {error['worst']:.2e}")
    typer.echo(account["accuracy"])
    typer.echo(f"G: {job.out / 'transfer.nc'}")


@app.command()
def render(scenario: ScenarioFile, overrides: Overrides = None, out: OutFolder = None) -> None:
    """Run the renderers on G, solving only what is missing."""
    from .pipeline.folder import run_render

    job = _stage(load_scenario(scenario, overrides=overrides or ()), scenario, out, run_render)
    typer.echo((job.out / "signal_strength.csv").read_text(encoding="utf-8"))


@app.command()
def schema() -> None:
    """Print the JSON Schema of a scenario file."""
    typer.echo(scenario_schema())


@app.command()
def doctor() -> None:
    """Print versions, the solver found, threads, memory and whether pictures can be rendered."""
    from .diagnosis import diagnosis

    for name, value in diagnosis().items():
        typer.echo(f"{name:22} {value}")


def _stage(asked: Scenario, file: Path, out: Path | None, work: Any) -> Any:
    """Run ``work`` on a new run with a progress display."""
    from .pipeline.folder import Run

    with Display() as display:
        job = Run.start(asked, out or Path("results") / asked.name, file.parent, display)
        work(job)
    for note in dict.fromkeys(job.notes):
        console.print(f"[yellow]note:[/yellow] {note}", highlight=False, soft_wrap=True)
    return job


def _print_forecast(asked: Scenario, base: Path) -> None:
    from .pipeline.forecast import forecast
    from .pipeline.frequencies import frequencies

    band = frequencies(asked.sweep)
    if asked.engine == "layered":
        typer.echo(f"layered half-space: no mesh, no unknowns; {len(band)} frequencies in about 2 s")
        return
    expected = forecast(asked, base=base)
    typer.echo(f"tetrahedra       {expected.tetrahedra}")
    typer.echo(f"unknowns         {expected.unknowns} ({asked.mesh.element}, displacement and pressure)")
    typer.echo(f"memory           about {expected.memory_bytes / 1e9:.1f} GB")
    typer.echo(f"time             about {expected.seconds / 60:.1f} min on 2 cores, for {len(band)} frequencies")
    for r in expected.resolution:
        typer.echo(
            f"{r.tissue:16} {r.per_wavelength_near_ports:.1f} nodes per shear wavelength and {r.per_decay_near_ports:.1f} per "
            f"decay length near the ports at {band[-1]:g} Hz; {r.per_wavelength:.1f} and {r.per_decay:.1f} at worst"
        )
    for sentence in expected.sentences(float(band[-1])):
        typer.echo(f"warning: {sentence}")


class Display:
    """A progress bar per stage with count and time left, on stderr."""

    def __init__(self) -> None:
        self._bars = Progress(
            TextColumn("{task.description:42}"), BarColumn(20), MofNCompleteColumn(), TimeElapsedColumn(),
            TextColumn("left"), TimeRemainingColumn(), console=console,
        )  # fmt: skip
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Display:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Progress callback of the library."""
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=total)
        self._bars.update(self._tasks[stage], completed=done, total=total)


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="print the version and stop", is_eager=True)] = False,
) -> None:
    if version:
        typer.echo(f"forearm-fem {__version__}")
        raise typer.Exit()


if __name__ == "__main__":
    main()
