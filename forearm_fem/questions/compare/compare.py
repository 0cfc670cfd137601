"""The comparison of two transfer matrices, whole."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import AccuracyWarning
from ...files.declaration import arbitrary_gain
from ...metrics import WaveFit, condition_number, condition_summary, fit_waves
from ...metrics.common_ground import CommonGround, common_ground
from ...metrics.waves import beside, phase_told
from ...ports import distances
from ...progress import Progress, tell
from ...store.text import plain
from ...transfer import TransferMatrix
from ...typing import ComplexArray, FloatArray
from .agreement import Agreement, Where, agreement, where
from .crossplay import CrossPlay, try_cross_play

_TOGETHER = 0.5e-3  # m: points as far from the source as this count as one distance


@dataclass(frozen=True, eq=False)
class Comparison:
    """B against A: names, the common ground, agreement, waves per input, condition numbers (n,) and cross-play.

    ``waves_a`` and ``waves_b`` hold one fit per input by the thesis' estimator over the points sorted by
    distance, None where there are fewer than three distances. ``crossed`` is None with the reason in
    ``not_crossed``. ``notes`` come before all figures: ports that do not lie where their names say, entries that are
    missing, scales that are arbitrary, and what S leaves out. ``where`` says where they differ and the likeliest cause.
    """

    names: tuple[str, str]
    ground: CommonGround
    agreement: Agreement
    waves_a: tuple[WaveFit | None, ...]
    waves_b: tuple[WaveFit | None, ...]
    condition_a: FloatArray
    condition_b: FloatArray
    crossed: CrossPlay | None
    where: Where
    not_crossed: str = ""
    notes: tuple[str, ...] = ()


def compare(
    a: TransferMatrix,
    b: TransferMatrix,
    *,
    names: tuple[str, str] = ("A", "B"),
    render: bool = True,
    folders: Sequence[Path] = (),
    progress: Progress | None = None,
) -> Comparison:
    """Everything about how far ``b`` is from ``a``; ``render`` False leaves the cross-play out (the slow part).

    A wavelet's file that a scenario in their provenance names is looked for in ``folders``, then in the current one.
    """
    tell(progress, "common ground", 0, 1)
    ground = common_ground(a, b)
    tell(progress, "where they differ", 0, 1)
    found = where(ground)
    tell(progress, "drives of one played on the other", 0, 1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", AccuracyWarning)
        crossed, why = try_cross_play(ground, folders) if render else (None, "not asked for")
    left_out = tuple(dict.fromkeys(str(w.message) for w in caught))
    tell(progress, "agreement", 0, 1)
    of_scale = [
        f"the gain of {side} is arbitrary, as was declared: FRAC, phases, delays, condition numbers and S hold, "
        "e_band, e, dB and the misfit mean nothing"
        for side, provenance in zip("AB", ground.provenance, strict=True)
        if arbitrary_gain(provenance)
    ]
    return Comparison(
        names,
        ground,
        agreement(ground),
        _waves(ground, ground.a),
        _waves(ground, ground.b),
        _condition(ground, ground.a),
        _condition(ground, ground.b),
        crossed,
        found,
        why,
        tuple(note for note in (*of_scale, *ground.notes, *left_out) if note),
    )


def _condition(ground: CommonGround, values: ComplexArray) -> FloatArray:
    """s_max / s_min per frequency, NaN where an entry is missing."""
    return condition_number(np.where(ground.valid, values, np.nan))


def _waves(ground: CommonGround, values: ComplexArray) -> tuple[WaveFit | None, ...]:
    """The thesis' fit over increasing distance from each input, beside its cone; points equally far are averaged, as in
    an isotropic skin."""
    masked, fits = np.where(ground.valid, values, np.nan), list[WaveFit | None]()
    for i, every in enumerate(distances(ground.outputs, ground.inputs).T):
        outside = np.flatnonzero(beside(every, ground.inputs[i].radius))
        order = outside[np.argsort(every[outside], kind="stable")]
        if len(order) < 3:
            fits.append(None)
            continue
        distance = every[order]
        group = np.concatenate([[0], np.cumsum(np.diff(distance) > _TOGETHER)])
        x = np.bincount(group, distance) / np.bincount(group)
        if len(x) < 3:
            fits.append(None)
            continue
        share = (group[:, None] == np.arange(len(x))) / np.bincount(group)
        response = masked[:, order, i]
        known = np.isfinite(response).all(axis=1)
        merged = np.full((len(response), len(x)), np.nan + 0j)
        merged[known] = response[known] @ share
        fits.append(fit_waves(ground.frequency, x, merged))
    return tuple(fits)


def comparison_record(c: Comparison) -> dict[str, Any]:
    """The comparison in plain numbers, for JSON; NaN becomes None."""
    g, agree = c.ground, c.agreement
    return {
        "A": c.names[0],
        "B": c.names[1],
        "unit": g.unit,
        "notes": list(c.notes),
        "cause": c.where.cause,
        "where": [
            {"from_Hz": low, "to_Hz": high, "e": [[plain(v) for v in row] for row in error]}
            for (low, high), error in zip(c.where.bands, c.where.error, strict=True)
        ],
        "frequencies": {
            "common": len(g.frequency),
            "first_Hz": float(g.frequency[0]),
            "last_Hz": float(g.frequency[-1]),
            "interpolated": g.interpolated,
            "entries_compared": g.covered,
            "only_in_A_Hz": [list(r) for r in g.only_a],
            "only_in_B_Hz": [list(r) for r in g.only_b],
        },
        "overall": {
            "e_band": plain(agree.band),
            "FRAC": plain(agree.overall_frac),
            "misfit_in_sigma": plain(agree.misfit),
            "worst_e_f": plain(np.nanmax(agree.per_frequency)) if np.isfinite(agree.per_frequency).any() else None,
        },
        "entries": [
            {
                "output": o.name,
                "input": i.name,
                "e": plain(agree.error[r, k]),
                "dB_rms": plain(agree.magnitude_db[r, k]),
                "dB_bias": plain(agree.bias_db[r, k]),
                "phase_rad": plain(agree.phase[r, k]),
                "delay_s": plain(agree.delay[r, k]),
                "FRAC": plain(agree.frac[r, k]),
                "misfit_in_sigma": plain(agree.misfit_entries[r, k]),
            }
            for r, o in enumerate(g.outputs)
            for k, i in enumerate(g.inputs)
        ],
        "condition_number": {"A": _conditioning(c.condition_a), "B": _conditioning(c.condition_b)},
        "waves": [_wave_summary(g, c, k) for k in range(len(g.inputs))],
        "rendered": c.crossed.how if c.crossed else "",
        "signal_strength": _crossed(c.crossed) if c.crossed else {"missing": c.not_crossed},
    }


def _conditioning(condition: FloatArray) -> dict[str, float | int | None]:
    found = condition_summary(condition)
    return {"min": found.least, "median": found.median, "max": found.largest, "infinite_at": found.singular}


def _wave_summary(g: CommonGround, c: Comparison, k: int) -> dict[str, Any]:
    both = {"A": c.waves_a[k], "B": c.waves_b[k]}
    return {
        "input": g.inputs[k].name,
        **{
            name: None if w is None else {**_speed(w), "attenuation_1_m": extremes(w.attenuation)}
            for name, w in both.items()
        },
    }


def _speed(w: WaveFit) -> dict[str, Any]:
    """Speeds up to the frequency beyond which the points lie too far apart for the waves' phase to be told."""
    told = phase_told(w)
    return {"speed_m_s": extremes(w.speed[told]), "speed_to_Hz": float(w.frequency[told][-1]) if told.any() else None}


def _crossed(x: CrossPlay) -> dict[str, Any]:
    rows = {"A_on_A": x.a_on_a, "B_on_B": x.b_on_b, "A_on_B": x.a_on_b, "B_on_A": x.b_on_a, "worth": x.worth}
    return {
        "targets": list(x.targets),
        **{m: {k: [plain(v) for v in s[j]] for k, s in rows.items()} for j, m in enumerate(x.methods)},
    }


def extremes(values: FloatArray) -> dict[str, float | None]:
    """Smallest, median and largest of the finite values."""
    known = values[np.isfinite(values)]
    if not len(known):
        return {"min": None, "median": None, "max": None}
    return {"min": float(known.min()), "median": float(np.median(known)), "max": float(known.max())}
