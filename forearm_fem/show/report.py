"""The report of a run: answer first, the rest folded."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd
import pyvista
import xarray as xr

from .. import __version__
from ..accuracy.estimates import accuracy_verdict
from ..device import close_loop
from ..engines.layered import solve_layered
from ..errors import DataError, ForearmError
from ..metrics import fit_waves
from ..metrics.strength import strength_text
from ..metrics.waves import WaveFit, beside
from ..ports import distances
from ..progress import Progress, tell
from ..scenario import Scenario
from ..scenario.limb import SlabLimb
from ..store.folder import write_text
from ..transfer import TransferMatrix, percent, relative_error
from ..typing import FloatArray
from . import facts
from .answer import (
    answer_of,
    asked_of,
    beside_thesis,
    headline,
    interval_words,
    is_measured,
    method_answers,
    next_steps,
    subject_of,
    trust_of,
)
from .data import Results
from .device import plot_trace, target_waves
from .film import Look, plot_wavefield, wavefield
from .judge import ERRORS, Strengths, plot_strength_map, strengths
from .motion import View, cutaway
from .page import Block, Page, Picture, Section, embedded
from .registry import applies, kinds
from .style import single

# Report of a scene that renders nothing: how waves travel and decay from one contact, and the layered model beside it.

_SAME = 1e-6  # m: between the distances of two points of a line


def write_wave_report(
    scenario: Scenario, transfer: TransferMatrix, out: Path, *, notes: Sequence[str] = ()
) -> tuple[Path, Path]:
    """``report.md``, ``report.html`` and, where a line of points allows it, ``waves.csv`` with attenuation and speed.

    Verdict on the accuracy first, ``notes`` of the run last.
    """
    blocks = []
    if (fit := thesis_fit(transfer, scenario.device.first_in_contact)) is not None:
        write_text(out / "waves.csv", waves_csv(fit))
        some = np.unique(np.linspace(0, len(fit.frequency) - 1, min(10, len(fit.frequency))).astype(int))
        rows = [[f"{fit.frequency[k]:g}", f"{fit.attenuation[k]:.0f}", f"{fit.speed[k]:.2f}"] for k in some]
        waves = Block(["Hz", "attenuation 1/m", "speed m/s"], rows)
        blocks.append(Section("waves", "Attenuation and speed by the thesis' estimator (waves.csv)", waves))
    if isinstance(scenario.limb, SlabLimb) and scenario.device.drive == "force":
        blocks.append(Section("layered", "Beside the layered model", _layered(scenario, transfer)))
    errors = [[ERRORS.get(e.source, (e.source,))[0], percent(e.band), percent(e.worst), e.method]
              for e in transfer.errors]  # fmt: skip
    sections = [
        *blocks,
        Section("warnings", "Warnings", bullets=list(dict.fromkeys(notes)), warn=True),
        Section("errors", "Estimated errors of G", Block(["source", "e_band", "worst e(f)", "how"], errors)),
    ]
    answer = [f"Accuracy: {accuracy_verdict(scenario, transfer.errors)}."]
    page = Page(f"Run of scene {scenario.name}", answer, sections, f"forearm_fem {__version__}", scenario.description)
    html, plain = page.save(out)
    return plain, html


def thesis_fit(transfer: TransferMatrix, source: int = 0) -> WaveFit | None:
    """Appendix A's estimator over the points beside the contact ``source``; None for fewer than four, or no line."""
    distance = distances(transfer.outputs, transfer.inputs)[:, source]
    outside = np.flatnonzero(beside(distance, transfer.inputs[source].radius))
    order = outside[np.argsort(distance[outside])]
    if len(order) < 4 or np.diff(distance[order]).min() < _SAME:  # points abreast of each other are no line
        return None
    return fit_waves(transfer.frequency, distance[order], transfer.values[:, order, source])


def waves_csv(fit: WaveFit) -> str:
    """Lines ``frequency_hz,attenuation_per_m,speed_m_per_s``."""
    columns = {"frequency_hz": fit.frequency, "attenuation_per_m": fit.attenuation, "speed_m_per_s": fit.speed}
    return str(pd.DataFrame(columns).to_csv(index=False, lineterminator="\n", na_rep="nan"))


def _layered(scenario: Scenario, transfer: TransferMatrix) -> Block:
    """Table of errors against the layered model: each point relative to itself, and e(f) over all but the first."""
    try:
        truth = close_loop(solve_layered(scenario, transfer.frequency), scenario.device).values
    except ForearmError as problem:
        return Block([], [], f"The layered model cannot do this scene: {problem}")
    k = scenario.device.first_in_contact
    own: FloatArray = np.abs(transfer.values - truth)[:, :, k] / np.abs(truth[:, :, k])
    names = [f"{d * 1e3:.1f} mm" for d in distances(transfer.outputs, transfer.inputs)[:, k]]
    overall = relative_error(transfer.values[:, 1:], truth[:, 1:]) if len(names) > 1 else np.zeros(len(own))
    rows = [
        [f"{f:g}", *(f"{v:.4f}" for v in row), f"{e:.4f}"]
        for f, row, e in zip(transfer.frequency, own, overall, strict=True)
    ]
    note = "Error of each point relative to itself; e(f) relative to the largest of them."
    return Block(["Hz", *names, "e(f) beyond the first"], rows, note)


# The report of a run: the answer first, how far to trust it, what to do next; all else folded below.

T = TypeVar("T")
_MEANING = (
    "S compares how much the target moves with how much the other points move on average: above 1 the target stands "
    "out. White is 1, orange more, purple less."
)

_STILL, _CUT = (1000, 625), (1200, 800)  # pixels: as many as the page shows; those of the figures take longer
_TRACES = "The target solid, the other points dotted; each method has a scale of its own."


def load_pictures() -> None:
    """Load what pictures need and is loaded with the first of them: fonts, their painter, and a plotter in space."""
    embedded(single(None), "")
    _ = pyvista.Plotter


def write_report(
    results_dir: str | Path | Results, out_dir: str | Path | None = None, progress: Progress | None = None
) -> tuple[Path, Path]:
    """``report.html`` (self-contained) and ``report.md`` (its short form) in the folder or ``out_dir``; their paths.

    A picture that cannot be drawn here becomes a sentence. Raises DataError for an unfinished or unwritable folder.
    """
    results = results_dir if isinstance(results_dir, Results) else Results.open(results_dir)
    for name in ("scenario.json", "transfer.nc", "drives.nc", "displacements.nc", "signal_strength.csv"):
        results.path(name)
    return run_page(results, progress).save(out_dir if out_dir is not None else results.folder)


def run_page(results: Results, progress: Progress | None = None) -> Page:
    """The page of a run."""
    data, drawn = strengths(results), _Drawn(progress)
    warnings = [*facts.exceeded(results), *facts.warnings_of(results)]
    maps = drawn.of([lambda m=m: _map(data, m) for m in data.methods])  # type: ignore[misc]
    waves = drawn.of([lambda: target_waves(results, shown_target(data))])
    traces = drawn.of([lambda m=m: _trace(waves[0], data, m) for m in data.methods if waves])  # type: ignore[misc]
    stills = drawn.of([lambda: _still(results, data)] if results.has_field else [])
    figures = {n: drawn.of([lambda n=n: _figure(results, n)])  # type: ignore[misc]
               for n in ("transfer", "errors", "mesh") if not applies(kinds(results)[n], results)}  # fmt: skip
    thesis = facts.strength_block(results) if beside_thesis(results) else None
    sections = [
        Section("map", "S on the skin", pictures=maps, paragraphs=[_map_words(data)]),
        Section("trust", "Warnings", bullets=warnings, warn=True),
        Section("methods", "By method", methods_block(data)),
        Section("waves", f"Waves towards point {shown_target(data)}", pictures=[*stills, *traces],
                paragraphs=[_TRACES] if traces else [], bullets=drawn.missing),
        Section("drives", "Drives against limits", facts.renderer_block(results),
                paragraphs=[p for p in (facts.limit_words(results), facts.band_words(results)) if p]),
        *to_play(results, data),
        Section("next", "What to do next", commands=next_steps(results, data)),
        Section("thesis", "Beside the thesis' Table I", thesis, bullets=facts.differences(results) if thesis else (),
                folded=True),
        Section("strength", "S in numbers", facts.by_target_block(results), folded=True),
        Section("transfer", "Transfer matrix G", facts.matrix_block(results), pictures=figures.get("transfer", ()),
                folded=True),
        Section("errors", "Error sources of G", facts.errors_block(results), pictures=figures.get("errors", ()),
                folded=True),
        Section("mesh", "Mesh", facts.mesh_block(results), pictures=figures.get("mesh", ()), folded=True),
        Section("settings", "Settings", facts.scene_block(results), folded=True),
        Section("cost", "Cost", facts.cost_block(results), folded=True),
        Section("provenance", "Provenance", facts.provenance_block(results), folded=True),
    ]  # fmt: skip
    title = f"{results.scenario.name}: {headline(data)}"
    return Page(title, [*answer_of(results, data), trust_of(results, data)], sections, results.stamp,
                subject_of(results))  # fmt: skip


def to_play(results: Results, data: Strengths) -> list[Section]:
    """Drives to play on the rig that measured G: the best method's, and the others' folded."""
    if not is_measured(results):
        return []
    best, *others = (a.method for a in method_answers(data))
    line = (f"forearm-fem daq play {asked_of(results)} {shlex.quote(str(results.folder))} --method {shlex.quote(best)} "
            f"--target {shown_target(data)} --daq ni")  # fmt: skip
    return [
        Section("play", f"What to play: {best}", facts.play_block(results, [best]), commands=[("Play it", line)]),
        *([Section("play-others", "What to play by the other methods", facts.play_block(results, others), folded=True)]
          if others else []),
    ]  # fmt: skip


class _Drawn:
    """Draws pictures one by one, telling progress; what cannot be drawn here becomes a sentence in ``missing``."""

    def __init__(self, progress: Progress | None) -> None:
        self.missing: list[str] = []
        self._progress, self._done = progress, 0

    def of(self, jobs: list[Callable[[], T]]) -> list[T]:
        """Results of the ``jobs``, but for those that could not be drawn."""
        made = []
        for job in jobs:
            tell(self._progress, "report", self._done, 0)
            self._done += 1
            try:
                made.append(job())
            except DataError:
                raise
            except ForearmError as problem:  # no way to draw in space here, or waves between known frequencies
                self.missing.append(str(problem))
        return made


def shown_target(data: Strengths) -> str:
    """The target whose waves are shown: the middle one of those that count, "5" in the thesis' grid."""
    counted = [t for t, c in zip(data.targets, data.counted, strict=True) if c] or list(data.targets)
    return counted[len(counted) // 2]


def methods_block(data: Strengths) -> Block:
    """Points where each method focuses, the best first."""
    rows = [
        [a.method, f"{len(a.focused)} of {a.points}", strength_text(a.mean) if np.isfinite(a.mean) else "unknown",
         f"{strength_text(a.least)} at point {a.least_at}" if a.least_at else "unknown", ", ".join(a.open) or "–"]
        for a in method_answers(data)
    ]  # fmt: skip
    return Block(["method", "S > 1 at", "mean S", "least S", "not sure whether S > 1 at"], rows)


def _map_words(data: Strengths) -> str:
    grey = "" if data.counted.all() else (
        " Grey points lie under or beside a motor and are in no mean of S and no verdict. Their motion is part of what "
        "a target is compared with.")  # fmt: skip
    return (f"{_MEANING}{grey} Below each point its number and how uncertain the numerics leave S, where that is "
            "±0.01 or more.")  # fmt: skip


def _map(data: Strengths, method: str) -> Picture:
    m = data.methods.index(method)
    notes = [interval_words(data, m, t) for t in range(len(data.targets))]
    answer = next(a for a in method_answers(data) if a.method == method)
    title = f"{method}: S > 1 at {len(answer.focused)} of {answer.points}"
    return embedded(plot_strength_map(data.to_xarray(), method, notes), title)


def _said(data: Strengths, method: str) -> str:
    """E.g. ``S = 1.65 ±0.05``, of the target that is shown."""
    m, t = data.methods.index(method), data.targets.index(shown_target(data))
    return f"S = {strength_text(data.values[m, t])} {interval_words(data, m, t)}".rstrip()


def _trace(waves: xr.Dataset, data: Strengths, method: str) -> Picture:
    title = f"{method}: {_said(data, method)}"
    return embedded(plot_trace(waves, method, title), "")


def _figure(results: Results, name: str) -> Picture:
    kind = kinds(results)[name]
    data = cutaway(results, _CUT) if name == "mesh" else kind.compute(results)
    return embedded(kind.draw(data), kind.title)


def _still(results: Results, data: Strengths) -> Picture:
    best = method_answers(data)[0].method
    view = View(best, shown_target(data))
    drawn = plot_wavefield(wavefield(results, view=view, look=Look(size=_STILL)))
    return embedded(drawn, f"The skin at the moment of focus: {best}, {_said(data, best)}")
