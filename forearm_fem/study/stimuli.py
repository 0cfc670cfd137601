"""Stimuli of one participant: drives on that participant's G, levelled as the study says, played within limits.

A level is the motion of the skin at the target, weighted by the reciprocal thresholds of two receptor channels whose
energies add: the Pacinian channel falls by 12 dB per octave below 220 Hz and by 9 above (Verrillo 1966, volar forearm);
the other is flat and crosses it at 150 Hz (Morioka, Whitehouse and Griffin 2008, forearm). Area and place play no part:
methods that spread differently over the skin may feel unequal at equal levels, which only a matching task tells.
"""

from __future__ import annotations

import csv
import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.fft import rfft, rfftfreq

from ..errors import AccuracyWarning, DataError, HardwareError, ScenarioError
from ..files.declaration import Declaration, Ports, arbitrary_gain
from ..files.read import read
from ..measurement.daq import Daq, faded
from ..measurement.playback import play
from ..rendering.drives import drives
from ..rendering.job import renderers
from ..rendering.signals import BinnedTransfer, Record, Wavelet, bridged, on_record_bins, respond, to_spectrum
from ..scenario import Scenario
from ..scenario.measurement import DaqOptions
from ..transfer import TransferMatrix
from ..typing import BoolArray, FloatArray
from .plan import Stimuli, Study
from .session import Presented

_STEP = 1e-4  # [V] to which drives are compared: a tenth of a step of 16 bits over 10 V, far above rounding
BEST, CROSSING = 220.0, 150.0  # [Hz] of the Pacinian channel, and where the flat one is as sensitive
_BELOW, _ABOVE = 12.0, 9.0  # [dB per octave]
AUDIBLE = 1.0  # [dB] above which methods count as unequally strong: about a just noticeable difference
Key = tuple[str, str]  # method, target


@dataclass(frozen=True)
class Motion:
    """The skin at the target: ``peak`` and ``rms`` [m], and the ``weighted`` level [dB re 1 um rms at 220 Hz]."""

    peak: float
    rms: float
    weighted: float


def sensitivity(frequency: FloatArray) -> FloatArray:
    """Weights (2, n) [-] of the Pacinian and the flat channel, 1 at 220 Hz for the first; 0 at 0 Hz."""
    f = np.asarray(frequency, dtype=float)
    octaves = np.log2(np.maximum([f, np.full_like(f, CROSSING)], 1e-3) / BEST)
    return np.where(f > 0, 10 ** (np.where(octaves < 0, _BELOW * octaves, -_ABOVE * octaves) / 20), 0.0)


def motion(moved: FloatArray, sample_rate: float, seconds: float) -> Motion:
    """Motion of a record ``moved`` (n,) [m] that is played within ``seconds``, over which rms and level are taken."""
    spectrum = np.abs(rfft(moved)) ** 2 * 2 / len(moved) / sample_rate  # energy per bin, one-sided [m2 s]
    energy = float(np.sum(sensitivity(rfftfreq(len(moved), 1 / sample_rate)) ** 2 @ spectrum))
    rms = float(np.sqrt(np.sum(moved**2) / sample_rate / seconds))
    level = 10 * np.log10(energy / seconds / 1e-12) if energy > 0 else -np.inf
    return Motion(float(np.abs(moved).max()), rms, float(level))


def offsets(options: Stimuli, base: Path, participant: str) -> dict[Key, float]:
    """Offsets from equal levels [dB] by ``levels``: none, its table, or its file's lines, a participant's own first.

    ScenarioError for a file that cannot be read or leaves a method at a target out.
    """
    keys = [(m, t) for m in options.methods for t in options.targets]
    if options.levels in ("equal at target", "as rendered"):
        return dict.fromkeys(keys, 0.0)
    if isinstance(options.levels, dict):
        return {(m, t): options.levels[m][t] for m, t in keys}
    file = base / options.levels
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            rows = list(csv.DictReader(stream))
        told = {(r.get("participant") or "", r["method"], r["target"]): float(r["level_db"]) for r in rows}
    except (OSError, ValueError, KeyError, TypeError) as problem:
        raise ScenarioError(
            f"stimuli.levels: '{options.levels}' is neither 'equal at target' nor 'as rendered' nor a CSV with columns "
            f"method, target, level_db ({type(problem).__name__})"
        ) from None
    found = {k: told.get((participant, *k), told.get(("", *k), np.nan)) for k in keys}
    if lacking := [k for k, v in found.items() if not np.isfinite(v)]:
        who = f" of participant {participant}" if any(name for name, *_ in told) else ""
        raise ScenarioError(f"{file}: no level_db{who} for {lacking[0][0]} at target {lacking[0][1]}; match it, or "
                            "leave it out of the study")  # fmt: skip
    return {k: float(v) for k, v in found.items()}


def apart(motions: Mapping[Key, Motion]) -> dict[str, float]:
    """By how much methods differ at each target: largest less least weighted level [dB]."""
    targets = dict.fromkeys(t for _, t in motions)
    levels = {t: [m.weighted for (_, other), m in motions.items() if other == t] for t in targets}
    return {t: max(found) - min(found) for t, found in levels.items()}


def told(motions: Mapping[Key, Motion]) -> str:
    """One sentence: by how much methods differ at a target, and targets by one method."""
    each = apart(motions)
    worst = max(each, key=each.__getitem__)
    every = [m.weighted for m in motions.values()]
    by_method = max(np.ptp([m.weighted for (k, _), m in motions.items() if k == name]) for name, _ in motions)
    said = f"weighted level {min(every):.1f} to {max(every):.1f} dB re 1 um at the target; methods differ by up to "
    said += f"{each[worst]:.1f} dB (target {worst}), targets by up to {by_method:.1f} dB"
    if each[worst] <= AUDIBLE:
        return said
    return said + ": methods are not equally strong, and answers may differ for that alone (stimuli.levels)"


@dataclass(frozen=True, eq=False)
class Stimulus:
    """``signals`` (n_actuator, n) [V] of one wavelet, the ``moved`` target, and ``gain`` [dB re as rendered]."""

    signals: FloatArray
    moved: Motion
    gain: float = 0.0

    @property
    def digest(self) -> str:
        """First 12 digits of a SHA-256 of the drives, to 0.1 mV."""
        return _digest(np.rint(self.signals / _STEP).astype("<i4").tobytes())

    @property
    def facts(self) -> dict[str, Any]:
        """Columns of each of its trials."""
        return {
            "gain": self.gain, "peak_um": 1e6 * self.moved.peak, "rms_um": 1e6 * self.moved.rms,
            "weighted_db": self.moved.weighted, "drives": self.digest,
        }  # fmt: skip


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:12]


def provenance(transfer: TransferMatrix, scenario: Scenario, levels: Any) -> dict[str, str]:
    """Columns of each trial that say what its stimuli were made from: 12 digits of a SHA-256 each.

    ``levels`` are what the study adds to equal levels, and how strong these are.
    """
    known = np.isfinite(transfer.values) & (True if transfer.valid is None else transfer.valid)
    values = np.where(known, transfer.values, 0).astype("<c16")
    return {
        "transfer": _digest(transfer.frequency.astype("<f8").tobytes() + values.tobytes()),
        "scenario": _digest(scenario.model_dump_json().encode()),
        "levels": _digest(json.dumps(levels, sort_keys=True).encode()),
    }


def refuse_changed(
    who: str, rows: Sequence[Mapping[str, str]], sources: Mapping[str, str], stimuli: Mapping[Key, Stimulus]
) -> None:
    """DataError naming what a participant's stimuli are made from now that earlier answers (``rows``) were not."""
    names = {"transfer": "G", "scenario": "the scenario", "levels": "the levels"}
    for row in rows:
        drawn = stimuli.get((row["method"], row["target"]))
        changed = [names[k] for k, v in sources.items() if row[k] != v]
        if not changed and drawn is not None and drawn.digest != row["drives"]:
            changed = [f"the drives of {row['method']} towards {row['target']}, with the same G, scenario and levels "
                       "(another version of this program)"]  # fmt: skip
        if changed:
            raise DataError(
                f"{who}: {' and '.join(changed)} changed since {row['date']}, when trial {row['trial']} was answered; "
                "put it back, or go on under another pseudonym"
            )


def transfer_of(
    study: Study, base: Path, participant: str, ports: Ports, declaration: Declaration | None = None
) -> TransferMatrix:
    """G of a participant as the study file says; ScenarioError naming the file and what makes it.

    ``ports`` (outputs, inputs) are those of the scenario, for files that name no places; ``declaration`` is what the
    file does not say of itself.
    """
    file = base / study.transfer.replace("{participant}", participant)
    if not file.exists():
        raise ScenarioError(
            f"{file}: no G for participant {participant}; `forearm-fem calibrate SCENARIO --out {file.parent}` "
            "measures it, or name a simulated one in the study's `transfer`"
        )
    return read(file, declaration, ports=ports)


def stimuli_for(
    transfer: TransferMatrix,
    scenario: Scenario,
    options: Stimuli,
    wavelet: Wavelet,
    added: Mapping[Key, float] | None = None,
) -> dict[Key, Stimulus]:
    """A stimulus for each method and target of ``options``, ``added`` [dB] to equal levels.

    Signals keep ``options.lead`` seconds before the wavelet's centre and ``options.tail`` after, faded as they are
    played; motion is what G makes of exactly these. Holes of G are bridged as in a run (AccuracyWarning where that is
    not safe). ScenarioError for a G that is not in m/V or of arbitrary gain without ``drive``, for levels out of an
    actuator's reach, and as the renderers raise.
    """
    if transfer.unit != "m/V":
        raise ScenarioError(f"stimuli need a G in m/V, got {transfer.unit}; set device.drive = 'voltage'")
    if arbitrary_gain(transfer.provenance) and options.drive is None:
        raise ScenarioError(
            "the gain of this G is arbitrary, as was declared, so that no drive follows from micrometres; set "
            "stimuli.drive"
        )
    wanted = scenario.rendering.changed({"methods": options.methods})
    chosen = {r.name: r for r in renderers(scenario.changed({"rendering": wanted}), wavelet)}
    holes = bridged(transfer)
    if holes.left or holes.absent:
        warnings.warn(holes.sentence, AccuracyWarning, stacklevel=2)
    placed, time = on_record_bins(holes.transfer, wavelet.record), wavelet.record.time
    kept = (time >= -options.lead) & (time <= options.tail)
    fade = scenario.measurement.daq.fade
    made: dict[Key, Stimulus] = {}
    for method in options.methods:
        for target in options.targets:
            sent = drives(chosen[method], placed, target, wavelet).signals[:, kept]
            made[method, target] = Stimulus(sent, _moved(placed, sent, kept, target, fade))
    if options.levels == "as rendered":
        return made
    peak = (options.peak or scenario.rendering.amplitude) * 1e-6 / float(np.abs(wavelet.samples).max())
    shape = np.where(kept, wavelet.samples * peak, 0.0)
    level = motion(shape, wavelet.record.sample_rate, _seconds(kept, wavelet.record)).weighted
    return _levelled(made, level, added or dict.fromkeys(made, 0.0), options, scenario)


def _moved(placed: BinnedTransfer, signals: FloatArray, kept: BoolArray, target: str, fade: float) -> Motion:
    """Motion at the target by G of the faded ``signals``."""
    record = placed.record
    whole = np.zeros((len(signals), record.n))
    whole[:, kept] = faded(signals, round(fade * record.sample_rate))
    spectrum = to_spectrum(whole, record)[:, placed.bins.index].T
    return motion(respond(placed, spectrum)[placed.row(target)], record.sample_rate, _seconds(kept, record))


def _seconds(kept: BoolArray, record: Record) -> float:
    return float(np.count_nonzero(kept)) / record.sample_rate


def _levelled(
    made: Mapping[Key, Stimulus], level: float, added: Mapping[Key, float], options: Stimuli, scenario: Scenario
) -> dict[Key, Stimulus]:
    """All stimuli at ``level`` plus what is ``added``; or so that the strongest drive is ``options.drive``."""
    gains = {k: level + added[k] - s.moved.weighted for k, s in made.items()}
    if deaf := [k for k, g in gains.items() if not np.isfinite(g)]:
        raise ScenarioError(f"{deaf[0][0]} does not move target {deaf[0][1]} by this G, so no level is reached there")
    found = {k: amplified(s, gains[k]) for k, s in made.items()}
    strongest = max(float(np.abs(s.signals).max()) for s in found.values())
    if options.drive is not None:
        change = 20 * np.log10(options.drive / strongest)
        found, level = {k: amplified(s, change) for k, s in found.items()}, level + change
    over = {k: beyond(s, scenario) for k, s in found.items()}
    worst = max(over, key=lambda k: over[k][0])
    excess, said = over[worst]
    if excess > 1:
        down = np.floor(200 * np.log10(1 / excess)) / 10  # [dB], to a tenth below
        key, now = ("drive", options.drive) if options.drive else ("peak", options.peak or scenario.rendering.amplitude)
        raise ScenarioError(
            f"{worst[0]} towards {worst[1]} needs {said} for {level + added[worst]:.1f} dB re 1 um at the target; all "
            f"methods reach {level + down:.1f} dB at all targets: set stimuli.{key} = "
            f"{_below(float(now or 0.0) * 10 ** (down / 20)):g}"
        )
    return found


def _below(value: float) -> float:
    """``value`` cut to three digits."""
    step = 10 ** (np.floor(np.log10(value)) - 2)
    return float(f"{np.floor(value / step) * step:.3g}")


def amplified(stimulus: Stimulus, gain: float) -> Stimulus:
    """The same, ``gain`` [dB] stronger."""
    factor, m = 10 ** (gain / 20), stimulus.moved
    moved = Motion(m.peak * factor, m.rms * factor, m.weighted + gain)
    return replace(stimulus, signals=stimulus.signals * factor, moved=moved, gain=stimulus.gain + gain)


def beyond(stimulus: Stimulus, scenario: Scenario) -> tuple[float, str]:
    """Amplitude over the largest that the limits allow, and what is needed against which limit.

    Limits are a drive's peak (the smaller of the actuator's and the hardware's) and the power in a coil, V^2 / R over
    the stimulus.
    """
    device, daq = scenario.device, scenario.measurement.daq
    most = min(getattr(device, "max_voltage", np.inf), daq.max_voltage)
    peak = float(np.abs(stimulus.signals).max())
    found = peak / most, f"{peak:.3g} V, the limit is {most:g} V,"
    coil, bears = getattr(device, "coil", None), getattr(device, "max_power", None)
    if coil is not None and bears:
        power = float(np.mean(stimulus.signals**2, axis=1).max()) / coil.resistance
        found = max(found, (float(np.sqrt(power / bears)), f"{power:.3g} W, the limit is {bears:g} W,"))
    return found


class DevicePlayer:
    """Plays stimuli through a device within its limits; the session calls it."""

    def __init__(
        self, daq: Daq, stimuli: Mapping[Key, Stimulus], rate: float, options: DaqOptions, how: Stimuli
    ) -> None:
        self._daq, self._stimuli, self._rate, self._options, self._how = daq, stimuli, rate, options, how
        peaks = {key: float(np.abs(s.signals).max()) for key, s in stimuli.items()}  # now, not in a session's middle
        method, target = max(peaks, key=peaks.__getitem__)
        if peaks[method, target] > options.max_voltage:
            raise HardwareError(
                f"{method} towards {target} needs {peaks[method, target]:.3g} V, the limit is "
                f"{options.max_voltage:g} V; lower rendering.amplitude, or set stimuli.levels = 'equal at target'"
            )

    def __call__(self, method: str, target: str) -> Presented:
        """Play ``how.repeats`` wavelets; HardwareError where the device fails."""
        signals = self._stimuli[method, target].signals
        done = play(self._daq, signals, self._rate, self._options, repeats=self._how.repeats, pause=self._how.pause)
        if done.stopped:
            raise HardwareError("the stimulus was cut short; press start to present it again")
        return Presented(done.seconds, float(done.peak.max()))
