"""What `forearm-fem compare` and `fit` do, as plain functions; the command line only prints."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..io.atomic import write_text
from ..io.netcdf import write_transfer
from ..io.recognise import read_measured
from ..measurement.declaration import Declaration
from ..scenario import Scenario
from ..transfer import TransferMatrix
from .adapters import ComplianceOf, ScenarioModel, common_parameters, layered_compliance_of
from .compare import Comparison, compare, plain
from .fit import FitResult, fit
from .report import as_markdown, save

__all__ = ["CompareResult", "FitCommandResult", "run_compare", "run_fit"]


@dataclass(frozen=True, eq=False)
class CompareResult:
    """The comparison, its table as text and the files written (none without a folder)."""

    comparison: Comparison
    text: str
    files: tuple[Path, ...]


def run_compare(
    a: str | Path | TransferMatrix,
    b: str | Path | TransferMatrix,
    *,
    folder: str | Path | None = None,
    declaration_a: Declaration | None = None,
    declaration_b: Declaration | None = None,
    render: bool = True,
) -> CompareResult:
    """Compare B against A, each a file of any kind known or a TransferMatrix; write into ``folder`` if
    given.
    """
    first, second = _load(a, declaration_a), _load(b, declaration_b)
    names = (_name(a, "A"), _name(b, "B"))
    result = compare(first, second, names=names, render=render)
    files = save(result, folder) if folder is not None else ()
    return CompareResult(result, as_markdown(result), files)


def _load(what: str | Path | TransferMatrix, declaration: Declaration | None) -> TransferMatrix:
    return what if isinstance(what, TransferMatrix) else read_measured(what, declaration)


def _name(what: str | Path | TransferMatrix, otherwise: str) -> str:
    if isinstance(what, TransferMatrix):
        return otherwise
    file = Path(what)
    return file.resolve().parent.name if file.name == "transfer.nc" else file.name


@dataclass(frozen=True, eq=False)
class FitCommandResult:
    """The fit, the fitted scenario's model of G on the frequencies used, a text and the files written."""

    fit: FitResult
    model: TransferMatrix
    text: str
    files: tuple[Path, ...]


def run_fit(
    scenario: Scenario,
    measured: str | Path | TransferMatrix,
    parameters: Sequence[str],
    *,
    folder: str | Path | None = None,
    declaration: Declaration | None = None,
    frequencies: int = 24,
    compliance_of: ComplianceOf | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> FitCommandResult:
    """Fit ``parameters`` (short names of :func:`common_parameters`) of ``scenario`` to a measured G.

    ``frequencies`` of its bins are used, spread evenly; the layered twin answers unless ``compliance_of``
    is given (a reduced FE model, say, on these frequencies). Writes fit.json, fit.md and fitted.nc into
    ``folder``.
    """
    data = thinned(_load(measured, declaration), frequencies)
    skin = compliance_of or layered_compliance_of(data.frequency, data.outputs, data.inputs)
    model = ScenarioModel(scenario, skin)
    result = fit(model, data, common_parameters(scenario, parameters), progress=progress)
    best = model({n: v for n, v in result.values.items() if n not in ("scale", "delay")})
    text = fit_text(result)
    files = () if folder is None else _save_fit(Path(folder), result, best, text)
    return FitCommandResult(result, best, text, files)


def thinned(measured: TransferMatrix, n: int) -> TransferMatrix:
    """At most ``n`` of the frequencies with valid entries, evenly spread, ends included."""
    usable = np.isfinite(measured.values) if measured.valid is None else measured.valid
    rows = np.nonzero(usable.any(axis=(1, 2)))[0]
    if len(rows) == 0:
        raise DataError("the measured G has no valid entry to fit to")
    pick = rows[np.unique(np.linspace(0, len(rows) - 1, min(n, len(rows))).round().astype(int))]
    return replace(
        measured,
        frequency=measured.frequency[pick],
        values=measured.values[pick],
        contacts=None,
        valid=None if measured.valid is None else measured.valid[pick],
        deviation=None if measured.deviation is None else measured.deviation[pick],
    )


def fit_text(result: FitResult) -> str:
    """Table of the parameters and the sentences below it."""
    lines = ["| parameter | value | 95 % interval | unit |", "|---|---|---|---|"]
    for p in result.parameters:
        low, high = result.interval[p.name]
        lines.append(f"| {p.name} | {result.values[p.name]:.4g} | {low:.4g} to {high:.4g} | {p.unit or '-'} |")
    chi = "unknown (no standard deviations)" if np.isnan(result.chi2) else f"{result.chi2:.2f}"
    lines += [
        "",
        f"reduced chi^2 {chi}; misfit {100 * result.e_band:.2g} % of the data's norm; {result.n_data} numbers.",
    ]
    return "\n".join([*lines, *result.sentences]) + "\n"


def _save_fit(folder: Path, result: FitResult, best: TransferMatrix, text: str) -> tuple[Path, ...]:
    content = {
        "values": dict(result.values),
        "deviation": {k: plain(v) for k, v in result.deviation.items()},
        "interval_95": {k: [plain(x) for x in v] for k, v in result.interval.items()},
        "correlation": [[plain(x) for x in row] for row in result.correlation],
        "singular_values": [plain(x) for x in result.singular_values],
        "chi2_reduced": plain(result.chi2),
        "e_band": plain(result.e_band),
        "identified": result.identified,
        "sentences": list(result.sentences),
    }
    write_text(folder / "fit.json", json.dumps(content, indent=1, allow_nan=False))
    write_text(folder / "fit.md", text)
    write_transfer(folder / "fitted.nc", best)
    return folder / "fit.json", folder / "fit.md", folder / "fitted.nc"
