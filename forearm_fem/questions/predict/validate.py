"""Every published finding against draws of arms: measured, predicted band, inside or not, and how wide the band is."""

from __future__ import annotations

import hashlib
import inspect
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ... import __version__
from ...engines.layered import flat_layers, flat_membrane, without_bones
from ...errors import DataError, ForearmError, ScenarioError
from ...geometry.device.layout import planform_ports
from ...layered import Disc, Layer, Surface, layered_compliance
from ...metrics import fit_waves
from ...metrics.strength import thesis_table
from ...ports import is_thesis_grid
from ...progress import Progress, tell
from ...rendering.interval import Strength, strength_of
from ...rendering.job import RenderJob, targets_of, wavelet, wavelet_for
from ...scenario import Scenario
from ...scenario.actuators import ACTUATORS
from ...scenario.rendering import RickerWavelet
from ...store.shelf import WORK, Shelf
from ...store.text import write_json
from ...store.work import done_once
from ...transfer import TransferMatrix
from ...typing import ComplexArray, FloatArray
from ...usercode import is_code
from .draws import LAWS, draw_inputs, expanded, is_bare, load_priors, scenario_of, taped
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

# Published measurements of forearms, to judge predictions by; values that were not seen are named, not invented.
# ``kind``: "value" is judged by whether it lies in the 5-95 % band of arms, "trend" by whether at least 5 % of the arms
# show it, "not comparable" says why neither is done. ``fitted`` marks what the joint fit of the tissue laws used: no
# test of the model, only of the fit.

Kind = Literal["value", "trend", "not comparable"]


@dataclass(frozen=True)
class Target:
    """A published finding: ``name`` of its observable (:mod:`.observables`), ``value`` in ``unit`` for a value."""

    name: str
    group: str
    what: str
    kind: Kind
    source: str
    value: float = float("nan")
    spread: str = ""
    unit: str = ""
    fitted: bool = False
    note: str = ""


_A = "de Vlam 2022, appendix A, one person; text seen, no numbers of figure A.2"
_SHAH = "Shah et al. 2019 (doi 10.3390/app9204329), six people; abstract and tables seen, accelerations not seen"
_SOFIA = "Sofia and Jones 2013 (doi 10.1109/TOH.2013.1); abstract seen"

TARGETS = (
    Target("appendix A, speed", "appendix A", "surface speed at 50-125 Hz, thesis' estimator", "value", _A, 4.0,
           unit="m/s"),
    Target("appendix A, speed rises", "appendix A", "speed at 300 Hz above that at 125 Hz", "trend", _A),
    Target("appendix A, decay rises", "appendix A", "decay at 250 Hz above that at 50 Hz", "trend", _A),
    Target("appendix A, decay levels off", "appendix A", "decay at 500 Hz within a quarter of that at 250 Hz", "trend",
           _A, note="a quarter is our reading of 'plateaus'"),
    Target("Zhang, speed", "Zhang", "surface speed at 200 Hz", "value",
           "Zhang et al. 2011, abstract seen; distances not seen", 3.25, "+-0.19", "m/s",
           fitted=True, note="5 to 15 mm taken, where the half-space of their mu and eta reads 4.2 m/s: near field, so "
           "that the fit leans soft"),
    Target("Zhang, speeds of 30", "Zhang", "surface speed at 100, 150 and 200 Hz, 30 people", "not comparable",
           "PMC5743597, abstract seen", note="the speeds were not seen"),
    Target("Sueda, relaxed", "Sueda", "stiffness under 0.50 cm^2, relaxed", "value", "Sueda 1972, abstract seen", 80.0,
           unit="N/m", fitted=True),
    Target("Sueda, tense", "Sueda", "stiffness under 0.50 cm^2, tense", "value", "Sueda 1972, abstract seen", 350.0, "",
           "N/m", note="the priors are of relaxed arms: no muscle is tense in them"),
    Target("Sofia, loss at 8 mm", "Sofia", "share of the motor's amplitude lost at 8 mm", "value",
           "Sofia and Jones 2013 as the thesis quotes it; the abstract says 'markedly attenuated'", 0.8, "", "-",
           note="motor's radius and frequency not seen: 5 mm, 200 Hz; 8 mm from its rim"),
    Target("Sofia, threshold at 24 mm", "Sofia", "above threshold at 24 mm", "not comparable", _SOFIA,
           note="the motor's amplitude and the threshold were not seen"),
    Target("Shah, 4 cm", "Shah", "acceleration at 4 cm larger at 241 Hz than at 102 Hz", "trend", _SHAH,
           note="present only above 150 Hz; the sensor's floor was not seen"),
    Target("Shah, 8 cm", "Shah", "acceleration at 8 cm below 5 % of the source's at every step", "trend", _SHAH,
           note="'substantially below thresholds'; these were not seen, 5 % is ours"),
    Target("Diller, impedance", "Diller", "impedance of a 0.5 mm probe, normal, larger at 200 Hz than at 20 Hz",
           "trend",
           "Diller 2001 (studylib 10821980), abstract seen: 'generally increasing with frequency'; range not seen"),
    Target("Diller, tangential", "Diller", "tangential impedance above normal", "not comparable",
           "Diller 2001, abstract seen", note="the layered model has no tangential ports"),
    Target("Parker, forearm", "Parker", "stiffness of the forearm half the thenar's", "not comparable",
           "Parker and Hunter 2017, abstract seen", note="there is no thenar here"),
)  # fmt: skip

SHAH_STEPS = ACTUATORS["ERM"].steps  # Shah's motor: frequency [Hz] and amplitude [g] by step
# Six people: sex, arm length and circumference [m] at the source and 4, 8, 12, 16 cm from it.
SHAH_ARMS = (
    ("m", 0.267, (0.279, 0.279, 0.266, 0.241, 0.203)),
    ("m", 0.279, (0.267, 0.260, 0.260, 0.232, 0.194)),
    ("f", 0.216, (0.254, 0.254, 0.241, 0.203, 0.178)),
    ("f", 0.229, (0.222, 0.222, 0.210, 0.178, 0.156)),
    ("f", 0.244, (0.199, 0.186, 0.173, 0.152, 0.136)),
    ("f", 0.216, (0.251, 0.248, 0.210, 0.178, 0.159)),
)
# Maughan 1984, CT of whole forearms: share of fat in the section, men and women.
FAT_SHARE = {"m": 0.150, "f": 0.293}


# Published measurements repeated on a drawn arm: speeds, decay, stiffness, loss over distance.

TOLERANCE = 1e-7  # of the largest displacement at each frequency; 8 cm from a motor there are 1e-4 of it left
_CONE = Disc(0.0, 0.0, 3.5e-3)
_A2 = np.array([50.0, 75.0, 100.0, 125.0, 250.0, 300.0, 500.0])
_A2_LINE: FloatArray = np.arange(6.0, 29.0, 2.5) * 1e-3  # ten points every 2.5 mm, counted from the cone's rim
_BALL, _BALL_LINE = Disc(0.0, 0.0, 1.5e-3), np.linspace(5e-3, 15e-3, 5)
_PLATE = Disc(0.0, 0.0, math.sqrt(0.5e-4 / math.pi), "bonded")
_MOTOR, _MOTOR_LINE = Disc(0.0, 0.0, 5e-3), (13e-3, 40e-3, 80e-3)  # 8 mm from its rim, then Shah's from its centre
_PROBE = Disc(0.0, 0.0, 0.25e-3)
_MOST_LEFT = 0.05  # of the source at 8 cm


@dataclass(frozen=True)
class Arm:
    """Layers and sheet of a drawn arm, flat and without end."""

    layers: tuple[Layer, ...]
    surface: Surface

    @classmethod
    def of(cls, scenario: Scenario) -> Arm:
        """Arm of ``scenario``."""
        return cls(tuple(flat_layers(scenario)), flat_membrane(scenario.tissues))

    def respond(self, frequency: FloatArray, source: Disc, line: Sequence[float] | FloatArray) -> ComplexArray:
        """Displacement per force (n_frequency, 1 + n_line) [m/N] under ``source`` and along x."""
        receivers = [source, *(Disc(float(x), 0.0) for x in line)]
        omega = 2 * np.pi * np.asarray(frequency, dtype=float)
        found = layered_compliance(self.layers, omega, [source], receivers, surface=self.surface, tolerance=TOLERANCE)
        return np.asarray(found.values[:, :, 0])


def observables(arm: Arm) -> dict[str, float]:
    """Every observable of :data:`.targets.TARGETS` on ``arm``; trends are 1 where they show, else 0.

    By the same estimator as the thesis for its appendix. Distances and radii that the sources do not say are named in
    the targets' notes.
    """
    fit = fit_waves(_A2, _A2_LINE, arm.respond(_A2, _CONE, _A2_LINE)[:, 1:])
    speed, decay = (dict(zip(_A2, each, strict=True)) for each in (fit.speed, fit.attenuation))
    at = np.array([200.0])
    zhang = fit_waves(at, _BALL_LINE, arm.respond(at, _BALL, _BALL_LINE)[:, 1:])
    stiffness = float((1 / arm.respond(np.array([20.0]), _PLATE, ())[0, 0]).real)
    # relative motion along the arm; a motor that is its own source of motion keeps its amplitude
    ratio = motor_ratios(arm, np.array([SHAH_STEPS[0][0], 200.0, SHAH_STEPS[-1][0]]))
    near = np.array([SHAH_STEPS[0][1], 1.0, SHAH_STEPS[-1][1]]) * ratio[:, 1]
    band = np.array([20.0, 200.0])
    impedance = 1 / np.abs(2j * np.pi * band * arm.respond(band, _PROBE, ())[:, 0])
    return {
        "appendix A, speed": float(1 / np.mean(1 / fit.speed[:4])),
        "appendix A, speed rises": float(1 / speed[300.0] < 1 / speed[125.0]),  # a near field passes infinity
        "appendix A, decay rises": float(decay[250.0] > decay[50.0]),
        "appendix A, decay levels off": float(0.8 <= decay[500.0] / decay[250.0] <= 1.25),
        "Zhang, speed": float(zhang.speed[0]),
        "Sueda, relaxed": stiffness,
        "Sueda, tense": stiffness,
        "Sofia, loss at 8 mm": float(1 - ratio[1, 0]),
        "Shah, 4 cm": float(near[2] > near[0]),
        "Shah, 8 cm": float((ratio[:, 2] < _MOST_LEFT).all()),
        "Diller, impedance": float(impedance[1] > impedance[0]),
    }


def motor_ratios(arm: Arm, frequency: FloatArray) -> FloatArray:
    """|u| at 8 mm from the motor's rim, 4 and 8 cm from its centre, over that under it (n_frequency, 3) [-]."""
    found = np.abs(arm.respond(frequency, _MOTOR, _MOTOR_LINE))
    return np.asarray(found[:, 1:] / found[:, :1])


def fat_of(sex: str, circumference: float, skin: float) -> float:
    """Fat [m] below ``skin`` [m] that makes Maughan's share of a round section of ``circumference`` [m]."""
    radius = circumference / (2 * math.pi)
    ring = radius * (1 - math.sqrt(1 - FAT_SHARE[sex]))
    return max(ring - skin, 0.5e-3)


# Every published finding against draws of arms: measured, predicted band, inside or not, and how wide the band is.

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
