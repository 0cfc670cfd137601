"""run and render: from a scenario to a results folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..errors import DataError
from ..progress import tell, within
from ..scenario import Scenario, load_scenario, scenario_file
from .common import (
    Declared,
    Display,
    LibraryFile,
    OutFolder,
    Overrides,
    ScenarioFile,
    asked_words,
    declaration,
    is_g,
    job,
    library_file,
    out_folder,
    print_notes,
    scene_of,
    transfer_file,
)

if TYPE_CHECKING:
    from ..engines.forecast import Forecast
    from ..questions.run import Run

Until = Literal["mesh", "solve"]


def run(
    scenario: ScenarioFile,
    overrides: Overrides = None,
    out: OutFolder = None,
    library: LibraryFile = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="print size, cost and resolution; solve nothing")] = False,
    until: Annotated[Until | None, typer.Option(help="stop after this stage")] = None,
) -> None:
    """The main job: mesh, solve, render, figures and report."""
    asked = load_scenario(scenario, overrides=overrides or ())
    if until is not None:
        for option, given in (("--dry-run", dry_run), ("--library", library is not None)):
            if given:
                raise DataError(f"--until: has no effect with {option}; leave one of them out")
        _until(asked, scenario, until, out, overrides)
        return
    if dry_run:
        from ..engines.forecast import scene_notes
        from ..questions.run import check_rendering
        from ..scenario.sweep import frequencies

        check_rendering(asked, scenario.parent)
        if (kept := library_file(library)) is not None:
            kept.ports(asked)  # what it does not answer for is said now
            typer.echo(f"library: no mesh and no solve; {len(frequencies(asked.sweep))} frequencies in seconds")
            return
        with job() as display:
            expected = _expected(asked, scenario.parent, display)
        _print_forecast(asked, expected)
        print_notes(scene_notes(asked))
        return
    if asked.engine == "fem" and library is None:  # beside the other imports
        from ..fem.reduction.compile_ahead import start_compiling

        start_compiling()
    from ..questions.run import run_all

    made = run_of(asked, scenario, out, run_all, overrides, library)
    if not asked.rendering.methods:
        typer.echo(f"open {made.out / 'report.html'}")
        return
    _print_answer(made)


def _until(asked: Scenario, scenario: Path, last: Until, out: Path | None, overrides: Overrides) -> None:
    """Stop after the mesh or the solution, and print what that gave."""
    from ..questions.run import run_mesh, run_solve

    made = run_of(asked, scenario, out, run_mesh if last == "mesh" else run_solve, overrides)
    if made.record is None:
        _print_forecast(asked, _expected(asked, scenario.parent))
        if asked.engine == "fem":
            typer.echo(f"mesh: {made.out / 'mesh.vtu'}")
        return
    for error in made.record.errors:
        band, worst = ("unknown" if e is None else f"{e:.2e}" for e in (error.band, error.worst))
        typer.echo(f"{error.source:15} band {band}  worst e(f) {worst}")
    typer.echo(made.record.accuracy)
    typer.echo(f"G: {made.out / 'transfer.nc'}")


def render(
    what: Annotated[
        Path,
        typer.Argument(help="scenario, or a measured or simulated G: a file of any known kind or a results folder",
                       callback=scenario_file),
    ],
    overrides: Overrides = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="results folder; default results/NAME, of a G results/render-NAME")
    ] = None,
    scenario: Annotated[
        Path | None, typer.Option(help="that was measured: its renderers, limits, and places that the file lacks")
    ] = None,
    declare: Declared = None,
) -> None:  # fmt: skip
    """Run the renderers on any G: a scenario's (solving only what is missing), or one that is there."""
    if is_g(what):
        _render_given(what, scenario, overrides, out, declare)
        return
    for option, value in (("--scenario", scenario), ("--declare", declare)):
        if value:
            raise DataError(f"{option}: has no effect on a scenario; name a file or folder that holds a G")
    from ..questions.run import run_render

    asked = load_scenario(what, overrides=overrides or ())
    _print_answer(run_of(asked, what, out, run_render, overrides))


def _render_given(
    what: Path, scenario: Path | None, overrides: Overrides, out: Path | None, declare: list[str] | None
) -> None:
    """Drives, displacements, S, figures and report of a G that is there."""
    from ..files.read import read
    from ..questions.run import Run, run_given
    from ..rendering.job import scenario_for

    file, asked = transfer_file(what), scene_of(scenario)
    base = file.parent if scenario is None else scenario_file(scenario).parent
    folder = out_folder(out, f"render-{what.stem}")
    with job(folder) as display:
        g = read(file, declaration(declare), scenario=asked)
        scene, notes = scenario_for(g, asked, overrides or ())
        made = Run.given(scene, folder, base, display)
        made.notes += [f"drives are made on the G of {file}", *notes]
        run_given(made, g)
    print_notes(made.notes)
    _print_answer(made)


def _print_answer(made: Run) -> None:
    from ..show.answer import console_lines
    from ..show.data import Results

    results = Results.holding(made.out, scenario=made.scenario, run=made.record, **made.known)
    typer.echo("\n".join(console_lines(results)))


def _expected(asked: Scenario, base: Path, display: Display | None = None) -> Forecast | None:
    """Forecast of the solve's cost, on the mesh, which is made if need be; None for the layered engine."""
    if asked.engine != "fem":
        return None
    from ..engines.forecast import forecast
    from ..geometry.build import cached_mesh
    from ..scenario.model import resolve_tissues

    resolve_tissues(asked)  # what they lack is said before anything is meshed
    progress = within(display, "mesh")
    tell(progress, "looking for a finished one", 0, 0)
    mesh = cached_mesh(asked, base=base, progress=progress)
    tell(progress, "counting unknowns", 0, 0)
    return forecast(asked, base=base, mesh=mesh)


def _print_forecast(asked: Scenario, expected: Forecast | None) -> None:
    from ..scenario.sweep import frequencies

    band = frequencies(asked.sweep)
    if expected is None:
        typer.echo(f"layered half-space: no mesh, no unknowns; {len(band)} frequencies in about 2 s")
        return
    typer.echo(f"tetrahedra       {expected.tetrahedra}")
    typer.echo(f"unknowns         {expected.unknowns} ({asked.element}, displacement and pressure, held ones included)")
    typer.echo(f"memory           about {expected.memory_bytes / 1e9:.1f} GB")
    typer.echo(f"time             about {expected.seconds / 60:.1f} min on 2 cores, for {len(band)} frequencies")
    for r in expected.resolution:
        typer.echo(
            f"{r.tissue:16} {r.per_wavelength_near_ports:.1f} nodes per shear wavelength and "
            f"{r.per_decay_near_ports:.1f} per decay length near the ports at {band[-1]:g} Hz; "
            f"{r.per_wavelength:.1f} and {r.per_decay:.1f} where elements are largest, far away"
        )
    for sentence in expected.sentences(float(band[-1])):
        typer.echo(f"warning: {sentence}")


_BY_LIBRARY = (
    "{library}: answers in place of a solve; mesh and solver keys have no effect",
    "library: the limb acts on each disc's net force; what it does to a disc held against tilt and slide is the "
    "layered model's, and its error is stated as contact",
)


def run_of(
    asked: Scenario,
    file: Path,
    out: Path | None,
    work: Callable[[Run], Any],
    overrides: Sequence[str] | None = None,
    library: Path | None = None,
) -> Run:
    """The run of a scenario by ``work`` in its folder; its notes are printed.

    A ``library`` of the arm is read first, and answers in place of a solve.
    """
    from ..questions.run import Run

    folder, kept = out_folder(out, asked, overrides), library_file(library)
    with job(folder) as display:
        run = Run.start(asked, folder, file.parent, display)
        run.asked = asked_words(file, overrides, library)
        if kept is not None:
            run.engine = kept
            run.notes += [note.format(library=library) for note in _BY_LIBRARY]
        work(run)
    print_notes(run.notes)
    return run
