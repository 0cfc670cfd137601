"""figures and workbench: what a run looks like."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ..errors import DataError, ForearmError, MissingExtra, optional
from ..scenario import scenario_file
from .common import Declared, declaration, ends_in, job, refuse_folder, scene_of, there

# figures: a run made visible.

Results = Annotated[
    Path, typer.Argument(help="results folder of a run",
                         callback=there("no such results folder; `forearm-fem run SCENARIO` makes one", folder=True)),
]  # fmt: skip


def film_name(film: Path | None) -> Path | None:
    """A callback that refuses a film of another kind, or a folder, before the work."""
    if film is not None and film.suffix.lower() not in (".gif", ".mp4", ".png"):
        raise DataError(f"--film {film}: films end in .gif or .mp4, a picture of the focus in .png")
    refuse_folder(film)
    return film


def figures(
    results: Results,
    only: Annotated[list[str] | None, typer.Option(help="figure names; again for more, or separated by commas")] = None,
    formats: Annotated[str, typer.Option("--format", help="any of png,pdf,svg")] = "png",
    out: Annotated[Path | None, typer.Option("--out", help="default: figures inside the results folder")] = None,
    width: Annotated[
        int | None, typer.Option(help="of a journal, in mm: 88, one column (what it cannot hold is refused), or 181")
    ] = None,
    font: Annotated[
        str, typer.Option(help="of all letters, one that this machine has, e.g. Arial; default DejaVu Sans")
    ] = "",
    footer: Annotated[bool, typer.Option(help="the line on scene and version at the foot")] = True,
    film: Annotated[
        Path | None,
        typer.Option(
            "--film", help="a film of the skin instead: .gif or .mp4; .png: the focus alone", callback=film_name
        ),
    ] = None,
    method: Annotated[str | None, typer.Option(help="of the film; default inverse filter")] = None,
    target: Annotated[str | None, typer.Option(help="of the film; default 5, or the first")] = None,
    view: Annotated[str, typer.Option(help="of the film: oblique, top, side or wrist")] = "oblique",
    speed: Annotated[
        float, typer.Option(help="of the film, as a share of real time: 0.006 shows 1 ms in 0.17 s", min=1e-5)
    ] = 0.006,
) -> None:
    """Make the figures of a run, each with its numbers as CSV; or a film."""
    if film is not None:
        _filmed(results, film, method, target, view, speed)
        return
    names, kinds = [n for item in only for n in _split(item)] if only else None, _split(formats)
    for option, given, read in (("--only", only, names), ("--format", formats, kinds)):
        if given and not read:
            raise DataError(f"{option}: expected names between the commas, got none; leave it out for its default")
    from ..show import make_figures
    with job(out or results) as display:
        written = make_figures(
            results, out, only=names, formats=kinds,
            progress=display, width=width, footer=footer, font=font,
        )  # fmt: skip
    for file in written:
        typer.echo(str(file))


def _filmed(results: Path, film: Path, method: str | None, target: str | None, view: str, speed: float) -> None:
    """A film of the skin: of a method and target, from a camera, at a share of real time."""
    _refuse_film(results, film)
    from ..show.data import Results as Folder
    from ..show.film import Look, animate, default_view, frames_at, plot_wavefield, wavefield
    from ..show.registry import save_drawn

    found = Folder.open(results)
    first = default_view(found)
    asked = replace(first, method=method or first.method, target=target or first.target)
    with job() as display:
        if film.suffix.lower() == ".png":
            drawn = plot_wavefield(wavefield(found, view=asked, look=Look(view, size=(2400, 1500))))
            save_drawn(drawn, film.with_suffix(""), ("png",), found.stamp)
        else:
            animate(found, film, view=asked, look=Look(view), frames_per_second=frames_at(speed), progress=display)
    typer.echo(str(film))


def _refuse_film(results: Path, film: Path) -> None:
    """Refuse a film that cannot be made, with all reasons at once, before anything is loaded."""
    reasons: list[ForearmError] = []
    try:
        for package in ("imageio", "imageio_ffmpeg") if film.suffix.lower() == ".mp4" else ():
            optional(package, "movie", "an .mp4 film")
    except MissingExtra as problem:
        reasons.append(problem)
    if not (results / "wavefield.nc").is_file():
        from ..show.data import Results as Folder
        from ..show.motion import View, check_view

        try:
            check_view(Folder.open(results), View())
        except DataError as problem:
            reasons.append(problem)
    if len(reasons) == 2:
        raise DataError(
            f"{film.name}: an .mp4 needs python3 -m pip install 'forearm-fem[movie]', and no motion between the points "
            f"is known in {results.name} (the layered model, a library and measured G have none)"
        )
    if reasons:
        raise reasons[0]


def _split(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


# workbench: a run as a page in which its model goes on working.


def workbench(
    what: Annotated[
        Path,
        typer.Argument(help="results folder of a run, NAME.library.nc of an arm, or a measured G: a file or a "
                       "calibration's folder",
                       callback=there("no such results folder or file; `forearm-fem run SCENARIO` makes a folder")),
    ],
    save: Annotated[
        Path | None,
        typer.Option("--save", help="the page; default workbench.html in the folder, NAME.html beside a file",
                     callback=ends_in(".html")),
    ] = None,
    scenario: Annotated[
        Path | None,
        typer.Option(help="of a measured G, for its record, wavelet and limits; or a device on a library's arm"),
    ] = None,
    declare: Declared = None,
) -> None:  # fmt: skip
    """Write one HTML page in which the waves move and everything can be tried: no server, no network."""
    asked = scene_of(scenario)
    from ..show.workbench.bundle import page_beside, write_workbench

    page = save or (what / "workbench.html" if what.is_dir() else page_beside(what))
    with job() as display:
        write_workbench(
            what, page, scenario=asked, declaration=declaration(declare), progress=display,
            base=scenario_file(scenario).parent if scenario else Path(),
        )  # fmt: skip
    typer.echo(f"{page}: {page.stat().st_size / 1e6:.1f} MB, opens in any browser")
