"""How strong a stimulus is where it is aimed, and equal strength of all methods at all targets.

A level is the motion of the skin at the target, weighted by the reciprocal thresholds of two receptor channels whose
energies add: the Pacinian channel falls by 12 dB per octave below 220 Hz and by 9 above (Verrillo 1966, volar forearm);
the other is flat and crosses it at 150 Hz (Morioka, Whitehouse and Griffin 2008, forearm). Area and place play no part:
methods that spread differently over the skin may feel unequal at equal levels, which only a matching task tells.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.fft import rfft, rfftfreq

from ..errors import ScenarioError
from ..typing import FloatArray
from .plan import Stimuli

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
    """What ``levels`` adds to equal levels [dB]: nothing, its table, or its file's lines, a participant's own first.

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
