"""Every published finding against draws of arms: measured, predicted band, inside or not, and how wide the band is."""

from __future__ import annotations

import hashlib
import inspect
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...errors import DataError, ForearmError, ScenarioError
from ...geometry.device.layout import planform_ports
from ...metrics.strength import thesis_table
from ...progress import Progress, tell
from ...rendering.funneling import is_thesis_grid
from ...rendering.interval import Strength, strength_of
from ...rendering.job import RenderJob, targets_of, wavelet, wavelet_for
from ...scenario import Scenario
from ...scenario.rendering import RickerWavelet
from ...store.shelf import WORK, Shelf
from ...store.text import write_json
from ...store.work import done_once
from ...transfer import TransferMatrix
from ...typing import FloatArray
from ...usercode import is_code
from .arm import without_bones
from .draws import LAWS, draw_inputs, expanded, is_bare, load_priors, scenario_of, taped
from .published import SHAH_ARMS, SHAH_STEPS, TARGETS, TOLERANCE, Arm, Target, fat_of, motor_ratios, observables
from .run import Prediction, Question, check_question, predict
from .statistics import (
    LEVELS,
    Draws,
    IntervalSamples,
    group_deviations,
    group_means,
    joint_distance,
    log_score,
    quantiles,
    winners,
)

FILE = "validation.json"
_SUBJECT_DRAWS = 25
_SHOWN_STEPS = (0, 3, 11)  # of Shah's motor: below, at and far above the 150 Hz that its abstract names
_SEEN = 0.05  # of the arms must show a trend
_FEWEST = 10  # arms of a band
_LOST, _MOST_LOST = 0.02, 0.5  # of the wavelet's energy: a band that ends at 500 Hz leaves out 1 % of the thesis'
TABLE = {"window": "reported", "record": "reported, record"}  # the thesis does not state what it sums over


def validate(
    question: Question,
    folder: str | Path,
    *,
    draws: int,
    resume: bool = True,
    workers: int | None = None,
    scheduler: str | None = None,
    measured: TransferMatrix | None = None,
    measured_name: str = "",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """All findings as plain data, and ``folder/validation.json``.

    ``draws`` arms of the question's scene give S (:func:`.run.predict`, resumable) and, on the same arms, what each
    published measurement would have found. A ``measured`` G, ``measured_name`` on the page, runs through the same
    comparison as Table I. Arms give S by the scene's engine, and all else on flat layers. Raises ScenarioError for
    scenes without the thesis' grid and targets or without layers.
    """
    if is_code(question.scenario.engine):
        raise ScenarioError("validate draws arms on finite elements or layers, not by your engine; set engine=layered")
    outputs = planform_ports(question.scenario)[0]
    if not is_thesis_grid(outputs):
        raise ScenarioError("validate compares with Table I, which is of 3 x 3 points; leave grid as in the thesis")
    aims = question.scenario.rendering.targets
    if aims != "all" and set(aims) != {p.name for p in outputs}:
        raise ScenarioError("validate compares with Table I: the scene must aim at the targets 1 to 9")
    # as the thesis measured: each entry by one sweep, on tape
    scenario = taped(question.scenario.changed({"measurement.repeats": 1}), question.held)
    question = replace(question, scenario=scenario)
    check_question(question)
    # a G that gives no S is said before minutes of draws
    given = None if measured is None else _strengths_of(measured, question)
    out = Path(folder)
    prediction = predict(
        question, out, draws=draws, resume=resume, workers=workers, scheduler=scheduler, progress=progress
    )
    rows = _observed(question, out, draws, resume, progress)
    content = {
        "program": __version__,
        "scenario": question.scenario.model_dump(mode="json"),
        "question": question.digest,
        "draws": draws,
        "seed": question.seed,
        "levels": [LEVELS[0], LEVELS[-1]],
        "model": prediction.model,
        "left_out": prediction.left_out,
        "other_device": list(other_device(question.scenario)),
        "numerics": {
            "S": float(np.median(prediction.draws.numerics)),
            "largest": float(prediction.draws.numerics.max()),
            "factor": float(np.exp(np.median(prediction.draws.spread))),
            "observables": TOLERANCE,
        },
        "failed": dict(prediction.draws.problems),
        "targets": [_judged(t, rows) for t in TARGETS],
        "table_one": {name: _table_one(prediction.draws, reading) for name, reading in TABLE.items()},
        "shah": _shah(question, progress),
        "measured": None
        if measured is None or given is None
        else {"name": measured.provenance.get("cite") or measured_name, **_measured(*given, prediction)},
    }
    write_json(out / FILE, content)
    return content


def other_device(scenario: Scenario) -> tuple[str, ...]:
    """Keys by which the device, the grid, the stimulus or the band of ``scenario`` are not those of Table I."""
    own, theirs = scenario, Scenario()
    pairs = {
        "device": (own.device.centres, theirs.device.centres),
        "device.cone.radius": (own.device.cone.radius, theirs.device.cone.radius),
        "device.drive": (own.device.drive, theirs.device.drive),
        "grid": (own.grid.places, theirs.grid.places),
        "rendering.wavelet": (own.rendering.wavelet, theirs.rendering.wavelet),
        "sweep": (own.sweep.span, theirs.sweep.span),
    }
    return tuple(key for key, (mine, thesis) in pairs.items() if mine != thesis)


def _observed(
    question: Question, out: Path, draws: int, resume: bool, progress: Progress | None
) -> list[dict[str, Any]]:
    """Observables of every draw with its law; on the folder's shelf as they are made."""
    shelf, mark = Shelf(out / WORK, "finished measurements"), f"{question.digest[:32]}-{hash_of_targets()}"
    jobs = {f"observables-{number}-{mark}": number for number in range(draws)}
    if not resume:
        shelf.drop(*jobs)

    def measured(number: int) -> dict[str, Any]:
        """Of one draw; an arm that cannot be measured is missing from the band."""
        held = expanded(question.held, question.scenario)
        bare = is_bare(question.scenario, held)
        draw = draw_inputs(load_priors(), question.scenario, question.seed, number, question.laws, bare=bare)
        try:
            seen = observables(Arm.of(without_bones(scenario_of(draw, question.scenario, held))))
        except ForearmError:
            seen = {}
        return {"law": draw.law, **seen}

    rows = dict(done_once(shelf, jobs, measured, tell=partial(tell, progress, "published measurements")))
    return [rows[key] for key in jobs]


def hash_of_targets() -> str:
    """Changes when an observable or target does: kept rows are then made anew."""
    text = inspect.getsource(Arm) + inspect.getsource(sys.modules[Arm.__module__]) + repr([t.name for t in TARGETS])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _judged(target: Target, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """One target: its band over all arms and over those of each law."""
    told: dict[str, Any] = {
        "name": target.name, "group": target.group, "what": target.what, "kind": target.kind, "source": target.source,
        "unit": target.unit, "spread": target.spread, "fitted": target.fitted, "note": target.note,
        "measured": target.value if np.isfinite(target.value) else None,
    }  # fmt: skip
    if target.kind != "not comparable":
        told |= {"all": _band(target, rows)}
        told |= {law: _band(target, [r for r in rows if r["law"] == law]) for law in LAWS}
    return told


def _band(target: Target, rows: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    values = np.array([r[target.name] for r in rows if np.isfinite(r.get(target.name, np.nan))])
    if len(values) < _FEWEST:
        return None
    if target.kind == "trend":
        share = float(values.mean())
        return {"share": share, "inside": share >= _SEEN, "sure": _sure_share(share, len(values))}
    arms = IntervalSamples(values, values, values)
    low, median, high = (float(x) for x in arms.quantiles()[[0, 2, -1]])
    within, sure = arms.judged(np.array(target.value))
    return {"low": low, "median": median, "high": high, "inside": bool(within), "sure": bool(sure),
            "width": float(np.sqrt(high / low)) if low > 0 else None}  # fmt: skip


def _sure_share(share: float, count: int) -> bool:
    """True if most other draws of ``count`` arms would say the same of a trend: Wilson's interval of 95 %."""
    z = 1.96**2 / count
    middle, half = (share + z / 2) / (1 + z), np.sqrt(z * (share * (1 - share) + z / 4)) / (1 + z)
    return not middle - half < _SEEN <= middle + half


def _table_one(draws: Draws, reading: str) -> dict[str, Any]:
    """The thesis' nine entries against all arms and those of each law that has enough for a band."""
    theirs = thesis_table()
    rows = [theirs.methods.index(m) for m in draws.methods]
    laws = {"all": draws} | {law: draws.of_law(law) for law in LAWS if draws.laws.count(law) >= _FEWEST}
    return {
        law: _entries(arms, reading, theirs.mean.T[rows]) | _deviations(arms, reading, theirs.std.T[rows])
        for law, arms in laws.items()
    }


def _deviations(draws: Draws, reading: str, point: FloatArray) -> dict[str, Any]:
    """The thesis' deviations ``point`` (n_method, n_group) over the targets of a group against those of the arms."""
    arms = group_deviations(draws.reading(reading), draws.groups)
    low, high = np.quantile(arms, [LEVELS[0], LEVELS[-1]], axis=0)
    rows = [
        {"method": method, "group": group, "measured": float(point[m, g]), "low": float(low[m, g]),
         "high": float(high[m, g]), "inside": bool(low[m, g] <= point[m, g] <= high[m, g])}
        for m, method in enumerate(draws.methods)
        for g, group in enumerate(draws.groups)
        if np.isfinite(point[m, g]) and np.isfinite(low[m, g])
    ]  # fmt: skip
    return {"deviations": rows}


def _entries(draws: Draws, reading: str, point: FloatArray) -> dict[str, Any]:
    """``point`` (n_method, n_group) against the group means of S."""
    arms = draws.enclosed(reading).of_groups(draws.groups)
    means = arms.value
    hit, sure = arms.judged(point)
    low, median, high = quantiles(means)[[0, 2, -1]]
    joint = joint_distance(means.reshape(len(means), -1), point.ravel())
    score = log_score(means.reshape(len(means), -1), point.ravel())
    distance, beyond, score_or_none = (x if np.isfinite(x) else None for x in (*joint, score))
    entries = [
        {"method": method, "group": group, "measured": float(point[m, g]), "low": float(low[m, g]),
         "median": float(median[m, g]), "high": float(high[m, g]), "inside": bool(hit[m, g]), "sure": bool(sure[m, g]),
         "width": float(np.sqrt(high[m, g] / low[m, g]))}
        for m, method in enumerate(draws.methods)
        for g, group in enumerate(draws.groups)
    ]  # fmt: skip
    order = [[draws.methods[int(i)] for i in np.argsort(-winners(means)[:, g])] for g in range(len(draws.groups))]
    return {"draws": len(means), "entries": entries, "inside": int(hit.sum()), "distance": distance, "beyond": beyond,
            "score": score_or_none,
            "width": float(np.exp(np.mean(np.log(high / low)) / 2)), "order": order}  # fmt: skip


def _shah(question: Question, progress: Progress | None) -> list[dict[str, Any]]:
    """Accelerations [g] at 4 and 8 cm for each of the six: its fat from sex and girth, the rest drawn."""
    frequency = np.array([SHAH_STEPS[k][0] for k in _SHOWN_STEPS])
    amplitude = np.array([SHAH_STEPS[k][1] for k in _SHOWN_STEPS])
    found = []
    for subject, (sex, length, circumference) in enumerate(SHAH_ARMS):
        tell(progress, "six arms", subject, len(SHAH_ARMS))
        reached = []
        for number in range(_SUBJECT_DRAWS):
            draw = draw_inputs(load_priors(), question.scenario, question.seed, number, question.laws)
            fat = fat_of(sex, circumference[0], draw.values["skin thickness"])
            own = replace(draw, values={**draw.values, "fat thickness": fat})
            arm = Arm.of(without_bones(scenario_of(own, question.scenario)))
            reached.append(motor_ratios(arm, frequency)[:, 1:] * amplitude[:, None])
        low, median, high = np.quantile(reached, [LEVELS[0], 0.5, LEVELS[-1]], axis=0)
        found.append({
            "subject": subject + 1, "sex": sex, "length": length, "circumference": list(circumference),
            "fat": fat_of(sex, circumference[0], 1.2e-3), "frequency": frequency.tolist(), "source": amplitude.tolist(),
            "low": low.tolist(), "median": median.tolist(), "high": high.tolist(),
        })  # fmt: skip
    tell(progress, "six arms", len(SHAH_ARMS), len(SHAH_ARMS))
    return found


def _strengths_of(transfer: TransferMatrix, question: Question) -> tuple[Strength, str]:
    """S of a measured G by the scene's methods and wavelet at its targets, and what of it is not known; DataError where
    S is not."""
    names, scenario = {p.name for p in transfer.outputs}, question.scenario
    options, targets = scenario.rendering, targets_of(scenario, planform_ports(scenario)[0])
    if missing := [t for t in targets if t not in names]:
        raise DataError(f"the measured G has no output called '{missing[0]}'; it needs the scene's targets 1 to 9")
    shape = wavelet(options, scenario.sweep, question.base)
    place = transfer.frequency / shape.record.df
    its_bins = len(place) > 1 and np.allclose(place, np.rint(place), rtol=0, atol=1e-3)
    if isinstance(options.wavelet, RickerWavelet) and not its_bins:
        shape = wavelet_for(transfer.frequency, options.wavelet.peak)  # a record on whose bins this G lies
    job = RenderJob.of(scenario, transfer, targets=targets, shape=shape)
    found = job.play(transfer)
    lost = max(r.drives.lost for r in found.values())
    if lost > _MOST_LOST or not np.isfinite(found.strengths).all():
        raise DataError(
            f"the measured G gives no S: {lost:.0%} of the wavelet's energy lies where it is unknown; measure it"
        )
    silent = f"{lost:.0%} of the wavelet's energy lies where it is unknown and is not driven" if lost >= _LOST else ""
    account = strength_of(found, job.methods, shape, measured=True)
    return account, "; ".join(s for s in (found.bridged.sentence, silent, account.unknown) if s)


def _measured(found: Strength, note: str, prediction: Prediction) -> dict[str, Any]:
    """S of a measured G against the arms, and the ``interval`` [low, high] that the scatter of G and its bridged holes
    leave of each; a verdict that would be another one at an end of it is not sure.
    """
    rows = [found.methods.index(m) for m in prediction.draws.methods]
    point, *ends = group_means(np.stack([found.value, found.low, found.high])[:, rows], prediction.draws.groups)
    judged = _entries(prediction.draws, "reported", point)
    intervals = [[float(x) for x in pair if np.isfinite(x)] for pair in np.stack(ends, axis=-1).reshape(-1, 2)]
    judged["entries"] = [
        {**e, "interval": interval,
         "sure": e["sure"] and all((e["low"] <= end <= e["high"]) == e["inside"] for end in interval)}
        for e, interval in zip(judged["entries"], intervals, strict=True)
    ]  # fmt: skip
    return {**judged, "note": note}
