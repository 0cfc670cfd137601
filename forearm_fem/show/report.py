"""The report as one self-contained page and as Markdown."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path

from jinja2 import Environment
from matplotlib import style
from PIL import Image

from ..errors import DataError, ForearmError, NotApplicable
from ..progress import Progress, tell
from ..store.folder import atomic_path, write_text
from ..store.text import markdown_table
from . import facts
from .data import Results
from .facts import Block
from .film import render_still
from .motion import View
from .registry import applies, kinds, thesis_figure
from .style import SHEET, Drawn, arrange, figure_of, sign
from .targets import plot_traces, target_waves


@dataclass(frozen=True)
class Picture:
    """A PNG in base64, its caption, and the name of its file in ``figures/``."""

    title: str
    data: str
    name: str = ""


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it."""

    anchor: str
    title: str
    block: Block | None = None
    paragraphs: list[str] = field(default_factory=list)
    bullets: list[str] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    warn: bool = False


def write_report(
    results_dir: str | Path | Results, out_dir: str | Path | None = None, progress: Progress | None = None
) -> tuple[Path, Path]:
    """``report.html`` (self-contained), ``report.md`` and ``figures/`` in the folder, or in ``out_dir``; their paths.

    Only a few figures are made; `forearm-fem figures` makes all. A picture that cannot be drawn here becomes a
    sentence. Raises DataError for an unfinished or unwritable folder.
    """
    results = results_dir if isinstance(results_dir, Results) else Results.open(results_dir)
    for name in ("scenario.json", "transfer.nc", "drives.nc", "displacements.nc", "signal_strength.csv"):
        results.path(name)
    folder = Path(out_dir) if out_dir is not None else results.folder
    paths = folder / "report.html", folder / "report.md"
    sections = _sections(results, progress)
    for picture in (p for section in sections for p in section.pictures):
        with atomic_path(folder / "figures" / f"{picture.name}.png") as target:
            target.write_bytes(base64.b64decode(picture.data))
    whole = f"Run of scene {results.scenario.name}", facts.headline(results), sections, results.stamp
    write_text(paths[1], markdown_of(*whole))
    write_text(paths[0], html_of(*whole))
    return paths


def strengths_by_target(results: Results) -> str:
    """S of every method and target with its interval, to the report's digits, and what it is taken over."""
    block = facts.by_target_block(results)
    return f"{markdown_table(block.header, block.rows)}\n{block.note}"


def _sections(results: Results, progress: Progress | None) -> list[Section]:
    drawn, missing = _pictures(results, progress)
    limits = facts.exceeded(results)
    by_name = {name: [p for n, p in drawn if n == name] for name, _ in drawn}
    waves = [p for n, p in drawn if n.startswith("target")] + by_name.get("wavefield", [])
    strength = facts.strength_block(results)
    sections = [
        Section("scene", "Scene", facts.scene_block(results)),
        Section("mesh", "Mesh", facts.mesh_block(results), pictures=by_name.get("mesh", []),
                paragraphs=[] if results.has("mesh.vtu") else ["There is no mesh: G does not come from one."]),
        Section("errors", "Estimated errors of G", facts.errors_block(results)),
        Section("transfer", "Transfer matrix G", facts.matrix_block(results), pictures=by_name.get("transfer", [])),
        Section("renderers", "Renderers", facts.renderer_block(results)),
        Section("limits", "Limits", bullets=limits, warn=True, paragraphs=[_limit_words(limits, results)]),
        Section("strength", "Signal strength S", facts.by_target_block(results)),
        Section("thesis", "Beside the thesis' Table I", strength, bullets=facts.differences(results),
                paragraphs=[] if strength else ["The grid is not the thesis' 3 × 3, so there is no Table I."]),
        Section("waves", "Waves", pictures=waves, bullets=missing),
        Section("warnings", "Warnings", bullets=facts.warnings_of(results), warn=True,
                paragraphs=[] if facts.warnings_of(results) else ["None."]),
        Section("cost", "Cost", facts.cost_block(results)),
        Section("provenance", "Provenance", facts.provenance_block(results),
                paragraphs=[f"`forearm-fem figures {results.folder}` makes all figures with their numbers."]),
    ]  # fmt: skip
    return [s for s in sections if s.block or s.paragraphs or s.bullets or s.pictures]


def _limit_words(limits: list[str], results: Results) -> str:
    if results.drives.unit != "V":
        return "The drives are no voltages, so limits were not checked."
    if not limits:
        return "No drive exceeds the actuators' limits in voltage or mean power."
    return "One limit is exceeded." if len(limits) == 1 else f"{len(limits)} limits are exceeded."


def _pictures(results: Results, progress: Progress | None) -> tuple[list[tuple[str, Picture]], list[str]]:
    """Pictures by name, and a sentence for each that could not be made."""
    known = kinds(results)
    jobs: list[tuple[str, Callable[[], Picture]]] = []
    fitting = [name for name in ("mesh", "transfer") if not applies(known[name], results)]
    jobs += [(name, lambda name=name: _figure(results, name)) for name in fitting]  # type: ignore[misc]
    shown: list[str] = [t for t in ("5", "6") if t in results.displacements.targets] or [
        results.displacements.targets[0]
    ]
    jobs += [(f"target-{t}", lambda t=t: _traces(results, t)) for t in shown]  # type: ignore[misc]
    if results.has_field:
        jobs.append(("wavefield", lambda: _still(results, shown[0])))
    drawn, missing = [], []
    for done, (name, make) in enumerate(jobs):
        tell(progress, "report", done, len(jobs))
        try:
            drawn.append((name, replace(make(), name=name)))
        except NotApplicable as problem:
            missing.append(f"{name}: {problem}")
        except DataError:
            raise
        except ForearmError as problem:  # no way to draw in space here
            missing.append(f"{name}: {problem}")
    return drawn, missing


def _figure(results: Results, name: str) -> Picture:
    kind = kinds(results)[name]
    return embedded(kind.draw(kind.compute(results)), kind.title, results.stamp)


def _traces(results: Results, target: str) -> Picture:
    thesis = thesis_figure(target, results)
    title = f"Displacement of all points over time, target {target} solid{f', as in the {thesis}' if thesis else ''}"
    return embedded(plot_traces(target_waves(results, target)), title, results.stamp)


def embedded(drawn: Drawn, title: str, stamp: str, name: str = "") -> Picture:
    """A figure as a picture of a report, signed with ``stamp``; ``name`` is that of its file."""
    figure = figure_of(drawn)
    sign(figure, stamp)
    arrange(figure)
    stream = io.BytesIO()
    with style.context(SHEET):
        figure.savefig(stream, format="png", dpi=130)
    return Picture(title, base64.b64encode(stream.getvalue()).decode(), name)


def _still(results: Results, target: str) -> Picture:
    methods = results.drives.methods
    view = View("inverse filter" if "inverse filter" in methods else methods[0], target)
    stream = io.BytesIO()
    Image.fromarray(render_still(results, view=view)).save(stream, "PNG")
    title = f"The skin at t = 0: {view.method} towards target {target}; colours cover the range of the grid points"
    return Picture(title, base64.b64encode(stream.getvalue()).decode())


def html_of(title: str, lead: str, sections: list[Section], stamp: str) -> str:
    """A self-contained page of ``sections`` below a ``title`` and a sentence that leads; it fetches nothing."""
    source = resources.files(__package__).joinpath("page.html.j2").read_text(encoding="utf-8")
    page = Environment(autoescape=True, trim_blocks=True).from_string(source)
    return page.render(title=title, lead=lead, sections=sections, stamp=stamp)


def markdown_of(title: str, lead: str, sections: list[Section], stamp: str) -> str:
    """The same as :func:`html_of` in Markdown, its pictures as files beside it."""
    parts = [f"# {title}\n", lead + "\n"]
    for section in sections:
        body = [text + "\n" for text in section.paragraphs]
        if section.block and section.block.rows:
            body.append(markdown_table(section.block.header, section.block.rows))
        if section.block and section.block.note:
            body.append(section.block.note + "\n")
        body += [f"![{picture.title}](figures/{picture.name}.png)\n" for picture in section.pictures]
        body += [*(f"- {line}" for line in section.bullets), *([""] if section.bullets else [])]
        if body:
            parts += [f"## {section.title}\n", *body]
    return "\n".join([*parts, f"*{stamp}*\n"])
