"""Work of `forearm-fem compare` and `fit`, as plain functions; the command line only prints."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from ...device.loop import close_loop
from ...engines.parametric import ParametricModel
from ...engines.simulation import Engine
from ...engines.skin_model import BEYOND
from ...errors import DataError, ForearmError, ScenarioError
from ...files.declaration import Declaration, arbitrary_gain, declared_by
from ...files.read import read
from ...geometry.device.layout import planform_ports
from ...metrics.common_ground import common_ground
from ...notebook import Manners, place
from ...ports import Port
from ...progress import Progress, tell, within
from ...results.files import write_transfer
from ...scenario import Scenario
from ...show.style import INK
from ...store.folder import check_kind, set_kind, write_text
from ...store.text import plain
from ...transfer import UNITS, ErrorEstimate, TransferMatrix
from ..predict.arm import perturbed_answers
from .compare import Comparison, compare
from .fit import (
    FALLBACK_NOISE,
    GAIN,
    SCALE,
    FitResult,
    fit,
    is_calibration,
    moved_by,
    with_model_error,
    with_scattered_error,
)  # fmt: skip
from .next_best import NextBest, next_best
from .parameters import (
    LayeredBetween,
    LessElements,
    Parameter,
    ScenarioModel,
    common_parameters,
    fem_meshes_for,
    fem_model_for,
)
from .readings import explained, mistake
from .report import FILES, answer_lines, as_markdown, picture, save_report

if TYPE_CHECKING:
    import xarray as xr

FIT_FILES = ("fit.json", "fit.md", "fitted.nc")
_QUIET = 0.1  # of the misfit: what the layered model's own error is told from
_ANY = 100.0  # times either way that an arbitrary gain may be off the ratio to the model at its start
__all__ = ["CompareResult", "FitCommandResult", "run_compare", "run_fit"]


@dataclass(frozen=True, eq=False, repr=False)
class CompareResult(Manners):
    """The comparison, what was ``asked`` (files, how they were read) and the files written, none without a folder."""

    comparison: Comparison
    asked: Mapping[str, Any]
    files: tuple[Path, ...]

    @property
    def text(self) -> str:
        """The report in its short form, Markdown."""
        return as_markdown(self.comparison, self.asked)

    @property
    def line(self) -> str:
        """Distance, and where the two differ."""
        return answer_lines(self.comparison)[0]

    @property
    def rows(self) -> list[list[str]]:
        """||B - A|| / ||A|| of each entry."""
        g, error = self.comparison.ground, self.comparison.agreement.error
        return [["point", *(p.name for p in g.inputs)],
                *([p.name, *(f"{e:.3g}" for e in row)] for p, row in zip(g.outputs, error, strict=True))]  # fmt: skip

    def sel(self, output: str, input: str) -> float:
        """||B - A|| / ||A|| [-] of one point by one actuator."""
        g = self.comparison.ground
        o = place([p.name for p in g.outputs], output, "point")
        return float(self.comparison.agreement.error[o, place([p.name for p in g.inputs], input, "actuator")])

    def to_xarray(self) -> xr.Dataset:
        """Both G at the frequencies that both cover."""
        import xarray as xr

        g, dimensions = self.comparison.ground, ("frequency", "output", "input")
        values = {n: (dimensions, np.where(g.valid, v, np.nan), {"units": g.unit}) for n, v in (("a", g.a), ("b", g.b))}
        sides = {"output": [p.name for p in g.outputs], "input": [p.name for p in g.inputs]}
        return xr.Dataset(values, {"frequency": g.frequency, **sides})

    def plot(self) -> Figure:
        """The worst entry, e(f), likeness of frequencies, and S of drives played on the other."""
        return picture(self.comparison)

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write report, picture and numbers into ``folder``."""
        return save_report(self.comparison, folder, self.asked)


def run_compare(
    a: str | Path | TransferMatrix,
    b: str | Path | TransferMatrix,
    *,
    folder: str | Path | None = None,
    declaration_a: Declaration | None = None,
    declaration_b: Declaration | None = None,
    scenario: Scenario | None = None,
    render: bool = True,
    progress: Progress | None = None,
) -> CompareResult:
    """Compare B against A, each a file of any kind known or a TransferMatrix; write into ``folder`` if
    given. ``scenario`` is what was measured: its points and actuators are those of files that name no places.
    """
    asked = {
        "A": _said(a, declaration_a), "B": _said(b, declaration_b), "render": render,
        "scenario": None if scenario is None else scenario.model_dump(mode="json"),
    }  # fmt: skip
    if folder is not None:
        check_kind(folder, "comparison", asked, FILES)
    tell(progress, "reading", 0, 1)
    first, second = _load(a, declaration_a, scenario, "--declare-a"), _load(b, declaration_b, scenario, "--declare-b")
    names = (_name(a, "A"), _name(b, "B"))
    if names[0] == names[1]:  # their folders tell them apart
        names = (str(a), str(b))
    folders = [Path(g).resolve().parent for g in (a, b) if not isinstance(g, TransferMatrix)]
    result = compare(first, second, names=names, render=render, folders=folders, progress=progress)
    tell(progress, "report", 0, 1)
    files = save_report(result, folder, asked) if folder is not None else ()
    return CompareResult(result, asked, files)


def _load(
    what: str | Path | TransferMatrix, declaration: Declaration | None, scenario: Scenario | None,
    option: str = "--declare",
) -> TransferMatrix:  # fmt: skip
    with declared_by(option):
        return what if isinstance(what, TransferMatrix) else read(what, declaration, scenario=scenario)


def _said(what: str | Path | TransferMatrix, declaration: Declaration | None) -> list[Any]:
    """Names and readings of the G's, as an account has them."""
    file = None if isinstance(what, TransferMatrix) else str(what)
    return [file, None if declaration is None else declaration.model_dump(mode="json", exclude_none=True)]


def _name(what: str | Path | TransferMatrix, otherwise: str) -> str:
    if isinstance(what, TransferMatrix):
        return otherwise
    file = Path(what)
    return file.resolve().parent.name if file.name == "transfer.nc" else file.name


@dataclass(frozen=True, eq=False, repr=False)
class FitCommandResult(Manners):
    """The fit, the fitted scenario's model of G on the frequencies used, a text and the files written.

    ``following`` is the next best measurement, ``reduction`` e_band that a reduced model of finite elements states for
    itself at the fitted values (NaN on the layered model), ``numerics`` what is said of the model's own error.
    """

    fit: FitResult
    model: TransferMatrix
    following: NextBest
    reduction: float
    numerics: str
    text: str
    files: tuple[Path, ...]
    asked: Mapping[str, Any]
    notes: tuple[str, ...]

    @property
    def line(self) -> str:
        """Values and misfit."""
        found = ", ".join(f"{n} {v:.4g}" for n, v in self.fit.values.items())
        return f"{found}; misfit {self.fit.e_band:.2g} (e_band)"

    @property
    def rows(self) -> list[list[str]]:
        """Each parameter with its 95 % interval."""
        head = ["parameter", "value", "from", "to", "unit"]
        units = {p.name: p.unit for p in self.fit.parameters}
        return [head, *([n, *(f"{x:.4g}" for x in self.sel(n)), units[n]] for n in self.fit.values)]

    def sel(self, parameter: str) -> tuple[float, float, float]:
        """Value and 95 % bounds of a parameter, by its key or the short name that was asked for."""
        names = list(self.fit.values)
        short = [n for n in names if n.endswith(f".{parameter}")]
        name = short[0] if len(short) == 1 else names[place(names, parameter, "parameter")]
        return (self.fit.values[name], *self.fit.interval[name])

    def to_xarray(self) -> xr.Dataset:
        """Values, deviations, bounds and correlations by parameter."""
        import xarray as xr

        names = list(self.fit.values)
        table = np.array([self.sel(n) for n in names]).T
        numbers = dict(zip(("value", "low", "high"), table, strict=True))
        numbers["deviation"] = np.array([self.fit.deviation[n] for n in names])
        correlation = (("parameter", "other"), self.fit.correlation)
        return xr.Dataset(
            {**{n: ("parameter", v) for n, v in numbers.items()}, "correlation": correlation},
            {"parameter": names, "other": names},
        )

    def plot(self) -> Figure:
        """Values within the ranges that were allowed, with their 95 % intervals."""
        figure = Figure(figsize=(5.0, 0.6 + 0.4 * len(self.fit.parameters)), layout="constrained")
        axes = figure.add_subplot()
        for k, p in enumerate(self.fit.parameters):
            value, low, high = (p.to_unit(min(max(x, p.lower), p.upper)) for x in self.sel(p.name))
            axes.errorbar(value, k, xerr=[[max(value - low, 0)], [max(high - value, 0)]], fmt="o", color=INK)
        axes.set_yticks(range(len(self.fit.parameters)), [p.name for p in self.fit.parameters])
        axes.set(xlim=(-0.03, 1.03), xlabel="place in the allowed range")
        return figure

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write fit.json, fit.md and the fitted G into ``folder``."""
        return _save_fit(Path(folder), self.asked, self.fit, self.model, self.text, self.notes)


def run_fit(
    scenario: Scenario,
    measured: str | Path | TransferMatrix,
    parameters: Sequence[str],
    *,
    folder: str | Path | None = None,
    declaration: Declaration | None = None,
    frequencies: int = 24,
    engine: Engine | None = None,
    fem: bool = False,
    base: str | Path = ".",
    named: str = "",
    progress: Progress | None = None,
) -> FitCommandResult:
    """Fit ``parameters`` (short names of :func:`common_parameters`) of ``scenario`` to a measured G.

    ``frequencies`` of its bins are used, spread evenly; ``named`` is the scenario as a command line names it. The
    layered model answers unless an ``engine`` is given, or the scenario's own finite elements with ``fem`` (a
    parametric model, made once and kept in the cache; ``base`` is the folder of the scenario's files). Actuators of
    the device that were not measured are there all the same.

    Writes fit.json, fit.md and fitted.nc into ``folder``; their notes say which reading of the data (:mod:`.readings`)
    would make model and data agree. DataError for a G without valid entries, of another drive than ``device.drive``,
    of inputs that the device does not have, or of arbitrary gain without ``scale`` to find.
    """
    asked = {
        "scenario": scenario.model_dump(mode="json"), "measured": _said(measured, declaration),
        "parameters": list(parameters), "frequencies": frequencies, "fem": fem,
    }  # fmt: skip
    if folder is not None:
        check_kind(folder, "fit", asked, FIT_FILES)
    data = thinned(_load(measured, declaration, scenario), frequencies)
    parameters = _with_gains(parameters, data)
    _check_data(scenario, data, parameters)
    chosen = common_parameters(scenario, parameters)
    inputs, outputs = all_inputs(scenario, data), data.outputs
    reduced: ParametricModel | None = None
    if fem:
        _check_reach(scenario, data)
        reduced = fem_model_for(scenario, chosen, base=base, progress=progress)
        engine = reduced
        outputs = tuple(p for p in reduced.ports if p.kind == "point")
    elif engine is None:
        outputs = (*outputs, *_unmeasured(scenario, data))
        engine = LayeredBetween(outputs, inputs)
    whole = ScenarioModel(scenario, engine, data.frequency)

    def model(values: Mapping[str, float]) -> TransferMatrix:
        """G of the scenario with ``values`` in place, as the data have it."""
        return answering(whole(values), data)

    begun = model({p.name: p.start for p in chosen if not is_calibration(p.name)})
    chosen = _rescaled(chosen, data, begun)
    result, numerics = fit(model, data, chosen, progress=progress), ""
    if reduced is not None:
        result, numerics = _with_model_errors(result, reduced, scenario, data, base, progress)
    free = _scenario_values(result)
    best, following = model(free), _following(result, whole, data, outputs)
    reduction = float(whole(free).errors[0].band) if fem else float("nan")
    numerics = numerics or _series_note(whole(free).errors, result)
    numerical = (*_reduction_note(reduction, result), *((numerics,) if numerics else ()))
    flat = "" if fem else " (flat layers, no bone); finite elements with `--fem`"
    notes = (
        f"model: {engine.name}{flat}", *_explained(data, (begun, best)), *_biased(data), *numerical,
        following.sentence, _simulated(named or scenario.name, result, fem),
    )  # fmt: skip
    text = fit_text(result, notes)
    files = () if folder is None else _save_fit(Path(folder), asked, result, best, text, notes)
    return FitCommandResult(result, best, following, reduction, numerics, text, files, asked, notes)


def _rescaled(chosen: Sequence[Parameter], data: TransferMatrix, start: TransferMatrix) -> tuple[Parameter, ...]:
    """The parameters, ``scale`` about the ratio of ``data`` of arbitrary gain to the model at its ``start``."""
    if not arbitrary_gain(data.provenance):
        return tuple(chosen)
    used = np.isfinite(data.values) if data.valid is None else data.valid & np.isfinite(data.values)
    ratio = float(np.linalg.norm(data.values[used]) / np.linalg.norm(start.values[used]))
    low, high = ratio / _ANY, ratio * _ANY
    return tuple(replace(p, start=ratio, lower=low, upper=high) 
                 if p.name == SCALE or p.name.startswith(GAIN) else p for p in chosen)


def _refitted(
    skin: Engine, scenario: Scenario, data: TransferMatrix, result: FitResult, progress: Progress | None
) -> dict[str, float]:
    """Values that another model finds in the same data, from those of ``result`` on."""
    other = ScenarioModel(scenario, skin, data.frequency)
    again = [replace(p, start=min(max(result.values[p.name], p.lower), p.upper)) for p in result.parameters]
    return dict(fit(lambda values: answering(other(values), data), data, again, progress=progress).values)


def _with_model_errors(
    result: FitResult, reduced: ParametricModel, scenario: Scenario, data: TransferMatrix, base: str | Path,
    progress: Progress | None,
) -> tuple[FitResult, str]:  # fmt: skip
    """The fit with intervals that hold what the reduction and the elements err by, and a sentence on the latter; or the
    sentence that says why they do not."""
    moved = _refitted(reduced.coarser, scenario, data, result, within(progress, "reduction"))
    result = with_model_error(result, moved, reduced.factor)
    try:
        meshes = fem_meshes_for(scenario, result.parameters, base=base, progress=within(progress, "coarser mesh"))
    except ForearmError as problem:
        return result, f"numerics: unknown; what the elements err by is in no interval ({problem})"
    own = ScenarioModel(scenario, reduced, data.frequency)
    arm = own.scenario(_scenario_values(result))
    found = reduced.compliance(arm, data.frequency)
    estimate, missed = meshes.missed(arm, found)
    less = LessElements(reduced, meshes.second, meshes.share(arm, found))
    moved = _refitted(less, scenario, data, result, within(progress, "coarser mesh"))
    said = (
        f"numerics: the elements err by an e_band of {100 * estimate.band:.2g} % there, which intervals hold; what "
        "cutting the limb errs by is in none, a run of the scene states it as truncation"
    )
    wrong = [answering(close_loop(c, arm.device), data).values for c in perturbed_answers(found, [missed.of(found)])]
    by_chance = moved_by(lambda values: answering(own(values), data), data, result, wrong)
    return with_scattered_error(with_model_error(result, moved, 1.0), by_chance), said


def _scenario_values(result: FitResult) -> dict[str, float]:
    """Scenario keys of the fitted values."""
    return {n: v for n, v in result.values.items() if not is_calibration(n)}


def _simulated(named: str, result: FitResult, fem: bool) -> str:
    """The command that simulates the scene, as a command line names it, with the fitted values."""
    set_ = [f"--set {n}={_plainly(v, 4)}" for n, v in _scenario_values(result).items()]
    engine = [] if fem else ["--set engine=layered"]
    return " ".join([f"simulate it: forearm-fem run {named}", *engine, *set_])


def _unmeasured(scenario: Scenario, data: TransferMatrix) -> tuple[Port, ...]:
    """The scenario's grid points that the data have not: what could be measured next."""
    known = {p.name for p in data.outputs}
    return tuple(p for p in planform_ports(scenario)[0] if p.name not in known)


def _following(result: FitResult, whole: ScenarioModel, data: TransferMatrix, outputs: tuple[Port, ...]) -> NextBest:
    """Best next measurement of ``outputs`` at the frequencies and inputs of the ``data``: nothing is known of them."""
    values = np.zeros((len(data.frequency), len(outputs), len(data.inputs)), dtype=complex)
    wide = replace(data, values=values, outputs=outputs, contacts=None, valid=None, deviation=None, errors=())
    names = [p.name for p in outputs]
    inputs = [p.name for p in data.inputs]
    return next_best(result, lambda v: answering(whole(v), wide).values, data.frequency, names, inputs, _noise_of(data))


def _noise_of(data: TransferMatrix) -> float:
    """Standard deviation of an entry that the fit used: the data's own in the median, else what it takes for it."""
    used = np.isfinite(data.values) if data.valid is None else data.valid & np.isfinite(data.values)
    stated = np.zeros(0) if data.deviation is None else data.deviation[used & np.isfinite(data.deviation)]
    if (stated > 0).any():
        return float(np.median(stated[stated > 0]))
    return FALLBACK_NOISE * float(np.sqrt(np.mean(np.abs(data.values[used]) ** 2)))


def _biased(data: TransferMatrix) -> tuple[str, ...]:
    """Sentence on intervals of data by an estimator that noise makes too large in every entry alike."""
    how = data.provenance.get("measurement")
    kind = how.get("estimator") if isinstance(how, Mapping) else None
    if kind not in ("H2", "Hv"):
        return ()
    return (
        f"the data were estimated by {kind}, which noise makes too large in all entries alike: intervals take that for "
        "noise of each and do not hold it; evaluate the recordings with measurement.estimator = 'H1'",
    )


def _reduction_note(reduction: float, result: FitResult) -> tuple[str, ...]:
    """Reduction error that finite elements state for themselves, which is in no interval."""
    if not np.isfinite(reduction):
        return ()
    return (
        f"finite elements, reduced: e_band {100 * reduction:.2g} % stated at the fitted values, beside a misfit of "
        f"{100 * result.e_band:.2g} %; intervals hold noise and what a coarser reduction finds in the same data",
    )


def _series_note(errors: tuple[ErrorEstimate, ...], result: FitResult) -> str:
    """Truncation error of the layered model's few terms and orders, where it counts beside the misfit of quiet data."""
    stated = sum(e.band for e in errors if e.source == "quadrature")
    if not stated > _QUIET * result.e_band:
        return ""
    return (
        f"numerics: series and quadrature of the fit's layered model err by an e_band of at most {100 * stated:.2g} % "
        "there, which is in no interval"
    )


def _check_reach(scenario: Scenario, data: TransferMatrix) -> None:
    """DataError where the scene's finite elements have not all that was measured, before minutes of reducing them."""
    points = {str(k) for k in range(1, len(scenario.grid.places) + 1)}
    if strange := [p.name for p in data.outputs if p.name not in points]:
        raise DataError(
            f"the measured G has the outputs {', '.join(strange)[:80]}, the scene's grid the points 1 to {len(points)};"
            " name each output after its point, or lay the grid out as it was measured"
        )
    low, high = scenario.sweep.span
    if beyond := [f for f in data.frequency.tolist() if not low / BEYOND <= f <= high * BEYOND]:
        raise DataError(
            f"the measured G has {beyond[0]:g} Hz, the scene sweeps {low:g} to {high:g} Hz; widen sweep.f_min and "
            "sweep.f_max, or cut the data"
        )


def _check_data(scenario: Scenario, data: TransferMatrix, parameters: Sequence[str]) -> None:
    """DataError where the scenario's drive gives another unit than the data have, or nothing finds their gain."""
    if (unit := UNITS[scenario.device.drive]) != data.unit:
        drive = next((d for d, u in UNITS.items() if u == data.unit), None)
        remedy = f"set device.drive = '{drive}', or correct the unit declared" if drive else "correct the unit declared"
        raise DataError(
            f"the measured G is in {data.unit}, but device.drive = '{scenario.device.drive}' gives {unit}; {remedy}"
        )
    if arbitrary_gain(data.provenance) and not any(n == SCALE or n.startswith(GAIN) for n in parameters):
        raise DataError("the measured G has an arbitrary gain, as was declared: name `scale` among the parameters")


def _with_gains(parameters: Sequence[str], data: TransferMatrix) -> list[str]:
    """The names, with ``gains`` as one for each actuator that was measured; ScenarioError where scale is asked, too."""
    each = [f"{GAIN}{p.name}" for p in data.inputs]
    named = [n for asked in parameters for n in (each if asked == "gains" else [asked])]
    if SCALE in named and set(each) <= set(named):
        raise ScenarioError("scale and a gain for each actuator say the same: leave scale out")
    return named


def all_inputs(scenario: Scenario, data: TransferMatrix) -> tuple[Port, ...]:
    """The device's actuators A1, A2, ... as ports: where they were measured, at the place that the data give.

    DataError for inputs that the device does not have.
    """
    own = {p.name: p for p in planform_ports(scenario)[1]}
    if strange := [p.name for p in data.inputs if p.name not in own]:
        raise DataError(
            f"the measured G has the inputs {', '.join(strange)[:80]}, the scenario's device {', '.join(own)[:80]}; "
            "name each input after its actuator, or give the device as many (device.contacts)"
        )
    return tuple((own | {p.name: p for p in data.inputs}).values())


def answering(model: TransferMatrix, data: TransferMatrix) -> TransferMatrix:
    """The rows and columns of ``model`` that ``data`` have, in their order; DataError where one is missing."""
    names = [p.name for p in model.outputs], [p.name for p in model.inputs]
    wanted = [p.name for p in data.outputs], [p.name for p in data.inputs]
    for known, asked in zip(names, wanted, strict=True):
        if missing := [n for n in asked if n not in known]:
            raise DataError(f"the model has no {', '.join(missing)[:100]}; it has {', '.join(known)[:100]}")
    rows, columns = ([k.index(n) for n in w] for k, w in zip(names, wanted, strict=True))
    return replace(
        model,
        values=model.values[:, rows][:, :, columns],
        outputs=tuple(model.outputs[r] for r in rows),
        inputs=tuple(model.inputs[c] for c in columns),
        contacts=None if model.contacts is None else model.contacts[:, columns][:, :, columns],
        errors=tuple(replace(e, per_pair=None, together=None) for e in model.errors),
    )


def _explained(data: TransferMatrix, models: tuple[TransferMatrix, ...]) -> tuple[str, ...]:
    """The reading of the data (B) that brings them to one of the ``models`` (A), or a ratio that none explains."""
    grounds = [common_ground(model, data) for model in models]
    readings = [said for g in grounds if (said := mistake(g))]
    sentence = readings[0] if readings else explained(grounds[-1])
    return (f"model A, data B: {sentence}",) if sentence else ()


def thinned(measured: TransferMatrix, n: int) -> TransferMatrix:
    """At most ``n`` of the frequencies with valid entries, evenly spread, ends included."""
    finite = np.isfinite(measured.values)
    usable = finite if measured.valid is None else measured.valid & finite
    rows = np.nonzero(usable.any(axis=(1, 2)))[0]
    if len(rows) == 0:
        raise DataError(
            "the measured G has no valid entry to fit to: all are marked invalid or not finite; measure again"
        )
    pick = rows[np.unique(np.linspace(0, len(rows) - 1, min(n, len(rows))).round().astype(int))]
    return replace(
        measured,
        frequency=measured.frequency[pick],
        values=measured.values[pick],
        contacts=None,
        valid=None if measured.valid is None else measured.valid[pick],
        deviation=None if measured.deviation is None else measured.deviation[pick],
    )


def fit_text(result: FitResult, notes: Sequence[str] = ()) -> str:
    """Table of the parameters, below it ``notes`` and what the fit says of itself."""
    lines = ["| parameter | value | 95 % interval | started from | unit |", "|---|---|---|---|---|"]
    for p in result.parameters:
        low, high = result.interval[p.name]
        value = result.values[p.name]
        digits = _digits(value, high - low)
        least, most = (_plainly(x, digits) for x in (low, high))
        cells = [p.name, _plainly(value, digits), f"{least} to {most}", _plainly(p.start, 4), p.unit or "-"]
        lines.append(f"| {' | '.join(cells)} |")
    chi = "unknown (no standard deviations)" if np.isnan(result.chi2) else f"{result.chi2:.2f}"
    lines += [
        "",
        f"reduced chi^2 {chi}; misfit {100 * result.e_band:.2g} % of the data's norm; {result.n_data} numbers.",
        f"misfit by actuator: {', '.join(f'{n} {100 * x:.2g} %' for n, x in result.left.items())}.",
        "Intervals hold what noise leaves open, not what the model leaves out of an arm.",
    ]
    return "\n".join([*lines, *notes, *result.sentences]) + "\n"


def _plainly(value: float, digits: int) -> str:
    """``value`` with as many significant ``digits``, without an exponent where it is readable so."""
    if not (np.isfinite(value) and 1e-3 <= abs(value) < 1e6):
        return f"{value:.{digits}g}"
    return np.format_float_positional(value, precision=digits, fractional=False, trim="-")


def _digits(value: float, width: float) -> int:
    """Digits of ``value`` that tell the ends of an interval of this width apart, two of the width itself; 4 to 12."""
    if not (np.isfinite(width) and width > 0 and value):
        return 4
    return int(np.clip(np.ceil(np.log10(abs(value) / width)) + 2, 4, 12))


def _save_fit(
    folder: Path, asked: Mapping[str, Any], result: FitResult, best: TransferMatrix, text: str, notes: Sequence[str]
) -> tuple[Path, ...]:
    content = {
        "asked": asked,
        "values": dict(result.values),
        "deviation": {k: plain(v) for k, v in result.deviation.items()},
        "interval_95": {k: [plain(x) for x in v] for k, v in result.interval.items()},
        "correlation": [[plain(x) for x in row] for row in result.correlation],
        "singular_values": [plain(x) for x in result.singular_values],
        "chi2_reduced": plain(result.chi2),
        "e_band": plain(result.e_band),
        "identified": result.identified,
        "sentences": [*notes, *result.sentences],
    }
    set_kind(folder, "fit", asked, FIT_FILES)
    account, page, g = (folder / name for name in FIT_FILES)
    write_text(account, json.dumps(content, indent=1, allow_nan=False))
    write_text(page, text)
    write_transfer(g, best)
    return account, page, g
