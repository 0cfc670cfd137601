"""All figures by name, and the one function that makes them from a results folder."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import style
from matplotlib.figure import Figure

from ..errors import DataError, ForearmError, NotApplicable
from ..ports import is_thesis_grid
from ..progress import Progress, tell
from ..store.folder import atomic_path, write_text
from . import device, film, judge, matrix, motion
from .answer import beside_thesis
from .data import Results
from .page import as_csv, tables
from .style import SHEET, WIDTHS, Drawn, arrange, clear_legends, figure_of, lettering, sign

FORMATS = ("png", "pdf", "svg")
_DPI = 300
_REPRODUCIBLE: Mapping[str, Any] = MappingProxyType({"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}})


@dataclass(frozen=True)
class FigureKind:
    """A figure: ``compute`` takes its numbers from a run, ``draw`` draws them ``width`` [mm] wide.

    ``extra`` writes other files beside it. ``needs`` are the files without which it cannot be made; with one of
    ``optional`` missing it does not apply to the run (a measured G has no mesh) and is left out unless asked for by
    name.
    """

    name: str
    title: str
    compute: Callable[[Results], xr.Dataset]
    draw: Callable[..., Figure]
    extra: Callable[[xr.Dataset], Mapping[str, str]] = lambda _: {}
    needs: tuple[str, ...] = ("transfer.nc",)
    optional: tuple[str, ...] = ()


_SIGNALS = ("transfer.nc", "drives.nc", "displacements.nc")
_STRENGTHS = ("transfer.nc", "signal_strength.csv")
_FIXED = (
    FigureKind("figure-2", "A wavelet along a line", matrix.travel, matrix.plot_travel, needs=_SIGNALS[:2]),
    FigureKind("figure-4", "From sweep to transfer function to drives", device.method, device.plot_method,
               needs=_SIGNALS),
    FigureKind("table-1", "Signal strength beside the thesis' Table I", lambda r: judge.table_one(judge.strengths(r)),
               judge.plot_table_one, judge.table_one_extra, _STRENGTHS),
    FigureKind("figure-a2", "Attenuation and dispersion", matrix.dispersion, matrix.plot_dispersion),
    FigureKind("transfer", "G: size, within its error, and phase", lambda r: matrix.transfer_of(r.transfer),
               matrix.plot_transfer),
    FigureKind("condition", "Singular values and condition number of G", matrix.conditioning,
               matrix.plot_conditioning),
    FigureKind("drives", "Drives and their limits", device.drive_levels, device.plot_drives, needs=("drives.nc",)),
    FigureKind("impedance", "Driving-point impedance", device.impedance, device.plot_impedance,
               optional=("compliance",)),
    FigureKind("wavefield", "The skin at the moment of focus", film.wavefield, film.plot_wavefield, needs=_SIGNALS,
               optional=("mesh.vtu", "wavefield.nc")),
    FigureKind("mesh", "The mesh cut open", motion.cutaway, motion.plot_cutaway, optional=("mesh.vtu",)),
    FigureKind("errors", "Estimated errors of G by source", judge.errors, judge.plot_errors, optional=("errors",)),
    FigureKind("strength", "Signal strength over the targets", lambda r: judge.strengths(r).to_xarray(),
               judge.plot_strength_maps, needs=_STRENGTHS),
)  # fmt: skip


def kinds(results: Results | None = None) -> Mapping[str, FigureKind]:
    """Every figure by name: those of the thesis first; ``target-N`` for each target of ``results``, of which the thesis
    shows 5 and 6 as figures 6 and 7."""
    names: Iterable[str] = results.displacements.targets if results and results.has("displacements.nc") else ("5", "6")
    by_target = []
    for t in names:
        thesis = thesis_figure(t, results)
        title = f"Waves towards target {t}{f' ({thesis})' if thesis else ''}"
        by_target.append(
            FigureKind(_name_of(t, bool(thesis)), title, partial(device.target_waves, target=t), device.plot_target,
                       needs=_SIGNALS)
        )  # fmt: skip
    return {k.name: k for k in (*_FIXED, *by_target)}


_THESIS = {"5": "figure-6", "6": "figure-7"}  # targets whose waves the thesis shows


def _name_of(target: str, in_thesis: bool) -> str:
    """The figure of waves towards ``target``, by the thesis' number where it shows them."""
    return _THESIS[target] if in_thesis else f"target-{target}"


def thesis_figure(target: str, results: Results | None) -> str:
    """The thesis' figure of waves towards ``target``; empty where it has none, or the grid is another."""
    if results is not None and not is_thesis_grid(results.transfer.outputs):
        return ""
    return {"5": "thesis' figure 6", "6": "thesis' figure 7"}.get(target, "")


def applies(kind: FigureKind, results: Results) -> str:
    """Empty if the figure suits the run, else the reason why not, in a sentence."""
    if any(_never_made(name, results) for name in kind.needs):
        return f"{kind.name}: does not apply to {results.folder}: rendering.methods is empty: its scene renders nothing"
    for name in kind.optional:
        if name == "errors" and not results.transfer.errors:
            return f"{kind.name}: G carries no error estimate"
        if name != "errors" and not results.has(name):
            what = "it holds no compliance" if name == "compliance" else f"{name} is missing; {results.remedy(name)}"
            return f"{kind.name}: does not apply to {results.folder}: {what}"
    if kind.name == "table-1" and not beside_thesis(results):
        return "table-1: the thesis' Table I is for its own device, 2 x 2 actuators 45 mm apart over 3 x 3 points"
    return ""


def make_figures(
    results_dir: str | Path | Results,
    out_dir: str | Path | None = None,
    only: Sequence[str] | None = None,
    formats: Sequence[str] = ("png",),
    progress: Progress | None = None,
    *,
    width: int | None = None,
    footer: bool = True,
    font: str = "",
) -> list[Path]:
    """Make the figures of a results folder with their numbers as CSV, and return all files written.

    ``out_dir`` defaults to ``figures`` inside the folder; ``only`` are names from :func:`kinds`; ``formats`` any of
    png, pdf and svg; ``width`` one of :data:`.style.WIDTHS` [mm], exactly; ``footer`` False
    leaves out the line on scene and version; ``font`` is one that the machine has, default DejaVu Sans. Files appear
    whole or not at all. Figures that do not apply to the run are left out unless named. Raises DataError for an
    unfinished folder, an unknown name, format or font, and a folder that cannot be written.
    """
    results = results_dir if isinstance(results_dir, Results) else Results.open(results_dir)
    chosen = _chosen(results, only)
    if bad := [f for f in formats if f not in FORMATS]:
        raise DataError(f"'{bad[0]}' is no format for figures; choose among {', '.join(FORMATS)}")
    if width is not None and width not in WIDTHS:
        raise DataError(f"figures are {' or '.join(map(str, WIDTHS))} mm wide for a journal, not {width}")
    with lettering(font):  # refused before the work
        folder = Path(out_dir) if out_dir is not None else results.folder / "figures"
    try:  # fails before the work rather than after it
        write_text(folder / ".writable", "")
        (folder / ".writable").unlink()
    except (ForearmError, OSError):
        raise DataError(f"{folder}: figures cannot be written there; name another folder with --out") from None
    written: list[Path] = []
    for done, kind in enumerate(chosen):
        tell(progress, "figures", done, len(chosen))
        try:
            with lettering(font):
                written += make_figure(kind, results, folder, formats, width, footer=footer)
        except NotApplicable as problem:
            if only is not None:
                raise
            if width is not None:
                warnings.warn(f"left out: {problem}", stacklevel=2)
    tell(progress, "figures", len(chosen), len(chosen))
    return written


def _chosen(results: Results, only: Sequence[str] | None) -> list[FigureKind]:
    known = kinds(results)
    names = results.displacements.targets if only and results.has("displacements.nc") else ()
    alias = {f"target-{t}": _THESIS[t] for t in names if t in _THESIS and _THESIS[t] in known}
    only = [alias.get(n, n) for n in only] if only is not None else None
    if unknown := [n for n in only or () if n not in known]:
        raise DataError(f"no figure is called '{unknown[0]}'; known are {', '.join(known)}")
    chosen = [known[n] for n in only or known]
    for kind in chosen:
        for name in kind.needs:
            if not _never_made(name, results):
                results.path(name)
    reasons = {k.name: applies(k, results) for k in chosen}
    if only and (told := [r for r in reasons.values() if r]):
        raise DataError(told[0])
    return [k for k in chosen if not reasons[k.name]]


def _never_made(name: str, results: Results) -> bool:
    """True if a file is one of renderers', of which the run has none."""
    return name != "transfer.nc" and not results.has(name) and not results.scenario.rendering.methods


def make_figure(
    kind: FigureKind,
    results: Results,
    folder: Path,
    formats: Sequence[str],
    width: int | None = None,
    *,
    footer: bool = True,
) -> list[Path]:
    """One figure in every format, ``width`` [mm] wide, its CSV, and what else belongs
    beside it."""
    data = kind.compute(results)
    stem = folder / kind.name
    try:
        drawn = kind.draw(data) if width is None else kind.draw(data, width=width)
    except NotApplicable as problem:
        raise NotApplicable(f"{kind.name}: {problem}") from None
    written = save_drawn(drawn, stem, formats, results.stamp if footer else "")
    texts = {f"{name}.csv" if name else "csv": as_csv(t, results.stamp) for name, t in tables(data).items()}
    for ending, text in {**texts, **kind.extra(data)}.items():
        path = stem.with_name(f"{stem.name}{'.' if ending == 'csv' else '-'}{ending}")
        write_text(path, text)
        written.append(path)
    return written


def save_drawn(drawn: Drawn, stem: Path, formats: Sequence[str], source: str = "") -> list[Path]:
    """Sign what was drawn and save it beside ``stem``."""
    figure = figure_of(drawn)
    if source:
        sign(figure, source)
    with style.context(SHEET):
        clear_legends(figure)
    arrange(figure)
    wide = figure.get_figwidth()
    dpi = (np.ceil(_DPI * wide) + 0.01) / wide  # whole pixels that make the width exactly
    written = []
    for ending in formats:
        path = stem.with_name(f"{stem.name}.{ending}")
        with atomic_path(path) as beside, style.context(SHEET):
            figure.savefig(beside, format=ending, dpi=dpi, metadata=dict(_REPRODUCIBLE[ending]))
        written.append(path)
    return written
