"""The comparison of two transfer matrices, and what each is worth as a calibration for the other."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import AccuracyWarning, ForearmError
from ...files.declaration import arbitrary_gain
from ...metrics import WaveFit, condition_number, condition_summary, fit_waves
from ...metrics.common_ground import CommonGround, common_ground
from ...metrics.waves import beside, phase_told
from ...ports import distances
from ...progress import Progress, tell
from ...rendering import Wavelet, bridged, thesis_renderers
from ...rendering.job import RenderJob, wavelet, wavelet_for
from ...scenario.rendering import SampledWavelet
from ...store.text import plain
from ...transfer import TransferMatrix, error_words
from ...typing import ComplexArray, FloatArray
from .agreement import Agreement, Where, agreement, where

if TYPE_CHECKING:
    from ...scenario import Scenario


@dataclass(frozen=True, eq=False)
class CrossPlay:
    """S (n_method, n_target) [-] of drives made for the first-named G and played on the second.

    ``a_on_b`` is what a device gets that was calibrated on A when the arm is B; ``b_on_b`` the best it could get.
    ``how`` says whose renderers and which wavelet these are of.
    """

    methods: tuple[str, ...]
    targets: tuple[str, ...]
    a_on_a: FloatArray
    b_on_b: FloatArray
    a_on_b: FloatArray
    b_on_a: FloatArray
    how: str = ""

    @property
    def worth(self) -> FloatArray:
        """S of A's drives on B over S of B's own (n_method, n_target) [-]; 1 where A serves as well as B."""
        return np.asarray(self.a_on_b / self.b_on_b)


def cross_play(
    ground: CommonGround,
    *,
    targets: Sequence[str] | None = None,
    folders: Sequence[Path] = (),
) -> CrossPlay:
    """S at ``targets``, own and crossed, on the common frequencies.

    Renderers, wavelet, window and, without ``targets``, these are of the scenario in A's provenance, else of B's, so
    that A on A is the S that A's run printed; its wavelet's file is looked for in ``folders`` too. Where no scenario's
    bins are the common ones, its wavelet is set into a record whose bins they are, and S is not what its run printed;
    ``how`` says so. Without a scenario they are the thesis' three, its wavelet and all targets.
    Holes of either are bridged as in a run; bins that either still lacks are driven on neither, so that only the values
    differ. Points of which one knows nothing from some actuator are left out of both. Raises ForearmError where a
    renderer cannot work on this geometry or the frequencies lie too far apart.
    """
    ground = of_known_outputs(ground)
    a, b = (bridged(g).transfer for g in sides(ground))
    every = tuple(p.name for p in ground.outputs)
    found = rendering_of(ground, folders) or (
        RenderJob(thesis_renderers(), wavelet_for(ground.frequency), every),
        "the thesis' renderers",
        "",
    )
    job, whose, apart = found
    job = job if targets is None else replace(job, targets=tuple(targets))
    (a_on_a, a_on_b), (b_on_a, b_on_b) = (job.strengths(g, a, b)[0] for g in (a, b))
    how = f"{whose} with the wavelet {job.wavelet.name}{apart}"
    return CrossPlay(job.names, job.targets, a_on_a, b_on_b, a_on_b, b_on_a, how)


def of_known_outputs(ground: CommonGround) -> CommonGround:
    """The ground of the outputs that both know from every input, the others left out; whole where too few are left."""
    known = ground.whole_outputs
    if known.all() or np.count_nonzero(known) < 2:
        return ground
    deviations = [None if d is None else d[:, known] for d in (ground.deviation_a, ground.deviation_b)]
    return replace(
        ground, a=ground.a[:, known], b=ground.b[:, known], valid=ground.valid[:, known],
        deviation_a=deviations[0], deviation_b=deviations[1],
        outputs=tuple(p for p, k in zip(ground.outputs, known, strict=True) if k),
    )  # fmt: skip


def rendering_of(ground: CommonGround, folders: Sequence[Path] = ()) -> tuple[RenderJob, str, str] | None:
    """The rendering of the scenario that one side came from, whose it is, and how it differs from its run's.

    None where neither names one, its wavelet's file is in none of ``folders`` and not in the current one (said by an
    AccuracyWarning).

    One whose bins are the common ones comes first; of another the wavelet is set into a record that fits them, which
    can be done with a Ricker wavelet alone."""
    from ...scenario import parse_scenario

    other: tuple[RenderJob, str, str] | None = None
    own_ports, _ = sides(ground)
    for provenance in ground.provenance:
        known = provenance.get("scenario")
        if not isinstance(known, Mapping):
            continue
        try:
            scenario = parse_scenario(dict(known))
            options = scenario.rendering
            shape = _kept_wavelet(scenario, folders)
        except ForearmError as problem:
            warnings.warn(
                f"the renderers of scenario '{known.get('name', '')}' could not be used ({problem}): unless the other "
                "G names a scenario, S in this comparison is of the thesis' renderers and the 250 Hz Ricker wavelet, "
                "not what its run printed",
                AccuracyWarning,
                stacklevel=3,
            )
            continue
        place = ground.frequency / shape.record.df
        if not options.methods:
            continue
        whose, apart = f"the renderers of scenario '{scenario.name}'", ""
        on_bins = np.allclose(place, np.rint(place), rtol=0, atol=1e-3)
        if not on_bins:
            if other is not None or isinstance(options.wavelet, SampledWavelet) or len(ground.frequency) < 2:
                continue
            shape = wavelet_for(ground.frequency, options.wavelet.peak)
            apart = "; its bins are not the common frequencies, so that its run printed another S"
        own = RenderJob.of(scenario, own_ports, shape=shape), whose, apart
        if on_bins:
            return own
        other = own
    return other


def _kept_wavelet(scenario: Scenario, folders: Sequence[Path]) -> Wavelet:
    """The scenario's wavelet; of a file the copy that a run keeps in its folder, else the file itself."""
    if not isinstance(given := scenario.rendering.wavelet, SampledWavelet):
        return wavelet(scenario.rendering, scenario.sweep, Path("."))
    file = given.file
    places = [p for folder in folders for p in (folder / f"wavelet{Path(file).suffix}", folder / file)]
    found = next((p for p in places if p.is_file()), Path(file))
    return wavelet(scenario.rendering.changed({"wavelet.file": str(found.resolve())}), scenario.sweep, Path("."))


def sides(ground: CommonGround) -> tuple[TransferMatrix, TransferMatrix]:
    """A and B as transfer matrices on the common frequencies, both with the common mask and A's ports."""
    first = TransferMatrix(ground.frequency, ground.a, ground.outputs, ground.inputs, ground.unit, valid=ground.valid)
    return first, replace(first, values=ground.b)


def try_cross_play(ground: CommonGround, folders: Sequence[Path] = ()) -> tuple[CrossPlay | None, str]:
    """:func:`cross_play`, or None and the sentence that says why there is none."""
    try:
        return cross_play(ground, folders=folders), ""
    except ForearmError as problem:
        return None, str(problem)


# The comparison of two transfer matrices, whole.

_TOGETHER = 0.5e-3  # m: points as far from the source as this count as one distance


@dataclass(frozen=True, eq=False)
class Comparison:
    """B against A: names, the common ground, agreement, waves per input, condition numbers (n,) and cross-play.

    ``waves_a`` and ``waves_b`` hold one fit per input by the thesis' estimator over the points sorted by
    distance, None where there are fewer than three distances. ``crossed`` is None with the reason in
    ``not_crossed``. ``notes`` come before all figures: ports that do not lie where their names say, entries that are
    missing, scales that are arbitrary, and what S leaves out. ``where`` says where they differ and the likeliest cause.
    ``stated`` is what each G states of its own error, in words.
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
    stated: tuple[str, str] = ("error unknown", "error unknown")


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
        (error_words(a.errors), error_words(b.errors)),
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
        "stated": list(c.stated),
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
