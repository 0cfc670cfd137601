"""What is wrong with a recording, in one sentence each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.fft import irfft, rfft
from scipy.stats import f as fisher

from ..io.recording import Recording
from ..typing import BoolArray, FloatArray

Severity = Literal["error", "warning"]
_ROUNDING = 1e-28  # of an energy: below it is rounding, not noise
_PARTS = 4  # of a period that are searched for lost samples


@dataclass(frozen=True)
class Finding:
    """``kind`` for programs, ``sentence`` for people; an ``error`` makes the entry unusable."""

    kind: str
    sentence: str
    severity: Severity = "error"


def diagnose(recording: Recording, band: BoolArray, *, max_drift: float = 0.05) -> tuple[Finding, ...]:
    """All findings about ``recording``; ``band`` (n // 2 + 1,) are the bins that carry the drive.

    Data that are not finite or that stand still end the search: the other checks would only repeat it.
    """
    if (hopeless := _hopeless(recording)) is not None:
        return (hopeless,)
    return (
        *(Finding("hardware", f"{recording.label}: {note}", "warning") for note in recording.notes),
        *_clipped(recording),
        *_loopback(recording, band),
        *_lost(recording),
        *_silent(recording, band),
        *_moved(recording, band, max_drift),
    )


def _hopeless(r: Recording) -> Finding | None:
    if bad := int(np.count_nonzero(~np.isfinite(r.response))):
        return Finding("not finite", f"{r.label}: {bad} of {r.response.size} samples are not numbers; record it again")
    if not np.all(np.isfinite(r.sent)) or not np.any(r.sent):
        return Finding(
            "no drive", f"{r.label}: the drive is zero or not finite, so nothing can be divided by it; check the sweep"
        )
    if np.ptp(r.response) <= 1.5 * r.resolution:
        return Finding(
            "dead channel",
            f"{r.label}: the sensor's channel stands still at "
            f"{np.mean(r.response):.4g} V; check its cable, power and range",
        )
    return None


def _clipped(r: Recording) -> Iterator[Finding]:
    """Samples at the rails; without a known full scale, three equal ones in a row at the extremes."""
    y = r.response
    if np.isfinite(r.full_scale):
        count = int(np.count_nonzero(np.abs(y) >= min(r.full_scale - 1.5 * r.resolution, 0.9999 * r.full_scale)))
    else:
        flat = (np.diff(y, n=1) == 0)[:, 1:] & (np.diff(y, n=1) == 0)[:, :-1]
        count = int(np.count_nonzero(flat & (np.abs(y[:, 1:-1]) >= 0.999 * np.abs(y).max())))
    if count:
        yield Finding(
            "clipped",
            f"{r.label}: {count} samples touch the end of the range ({np.abs(y).max():.4g} V); "
            "lower the sweep's amplitude or widen the sensor's range",
        )


def _loopback(r: Recording, band: BoolArray) -> Iterator[Finding]:
    if r.loopback is None:
        return
    if not np.all(np.isfinite(r.loopback)) or np.ptp(r.loopback) <= 1.5 * r.resolution:
        yield Finding(
            "dead loopback",
            f"{r.label}: the loopback channel stands still; check its cable or set daq.loopback to none",
        )
        return
    x, y = rfft(r.sent)[band], rfft(r.loopback.mean(axis=0))[band]
    alike = abs(np.vdot(np.abs(x), np.abs(y))) / (np.linalg.norm(x) * np.linalg.norm(y)) if band.any() else 0.0
    if alike < 0.99:
        yield Finding(
            "wrong loopback",
            f"{r.label}: the loopback's spectrum agrees with the drive's to "
            f"{alike:.2f} only; is it wired to this output?",
        )


def _lost(r: Recording) -> Iterator[Finding]:
    """Parts of a period that lag those of the first one by whole samples; with a loopback those of the drive, taken as
    late as it comes back."""
    signals = r.response if r.loopback is None else r.loopback
    reference = signals[0] if r.loopback is None else np.roll(r.sent, _late(r.sent, r.loopback))
    shifts = lags(reference, signals)
    common = int(np.bincount((shifts - shifts.min()).ravel()).argmax() + shifts.min())
    slipped = np.argwhere(shifts != common)
    if len(slipped):
        repeat, part = slipped[0]
        by = abs(int(shifts[repeat, part]) - common)
        yield Finding(
            "dropped samples",
            f"{r.label}: {by} sample(s) are missing or doubled in part {part + 1} of {_PARTS} of repeat {repeat + 1}; "
            "record it again with a larger daq.block",
        )


def _late(sent: FloatArray, back: FloatArray) -> int:
    """Lag [samples] of most of the periods ``back`` (n_repeat, n) behind ``sent`` (n,): the device's latency."""
    each = irfft(rfft(sent).conj() * rfft(back), len(sent)).argmax(axis=1)
    return int(np.bincount(each).argmax())


def lags(reference: FloatArray, signals: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Lag (n_repeat, 4) [samples] of each quarter of ``signals`` (n_repeat, n) behind that of ``reference`` (n,).

    Circular correlation; a lag counts only where it explains clearly more than none (1 % of the energy that
    is alike, and six standard deviations of what noise gives), so that noise does not invent one.
    """
    length = len(reference) // _PARTS
    parts = signals[:, : length * _PARTS].reshape(len(signals), _PARTS, length)
    first = reference[: length * _PARTS].reshape(_PARTS, length)
    likeness = irfft(rfft(first).conj()[None] * rfft(parts), length)
    best = likeness.argmax(axis=2)
    gain = likeness.max(axis=2) - likeness[:, :, 0]
    rest = np.linalg.norm(parts - first[None], axis=2)
    noise = np.linalg.norm(first, axis=1)[None] * rest / np.sqrt(length)
    clear = (gain > 1e-2 * np.abs(likeness).max(axis=2)) & (gain > 6 * noise)
    return np.where(clear, np.where(best > length // 2, best - length, best), 0)


def _silent(r: Recording, band: BoolArray) -> Iterator[Finding]:
    """Energy that follows the drive against energy that does not; 1 on average for noise alone."""
    if not band.any():
        return
    if (ratio := following(r, band)) < 1.5:
        yield Finding(
            "no response",
            f"{r.label}: the response does not follow the drive (energy ratio {ratio:.2f}, noise alone gives 1); check "
            "that the actuator touches the skin and the laser sees the point",
        )


def following(r: Recording, band: BoolArray) -> float:
    """|mean Y|^2 over the variance of the mean, summed over the band [-]; with one period, over the bins above it."""
    y = rfft(r.response)
    if len(y) > 1:
        rest = np.sum(np.abs(y[:, band] - y[:, band].mean(axis=0)) ** 2) / (len(y) - 1) / len(y)
    else:
        quiet = y[:, int(1.2 * np.nonzero(band)[0][-1]) + 1 : -1]
        if quiet.size < 10:
            return float("inf")
        rest = np.mean(np.abs(quiet) ** 2) * np.count_nonzero(band)
    above = float(np.sum(np.abs(y[:, band].mean(axis=0)) ** 2))
    return above / max(float(rest), _ROUNDING * above) if above > 0 else 0.0


def _moved(r: Recording, band: BoolArray, limit: float) -> Iterator[Finding]:
    change, certain = drift(r, band)
    if certain and change > limit:
        yield Finding(
            "moved",
            f"{r.label}: the response changes by {100 * change:.0f} % from the first to the last repeat; "
            "the arm or the laser moved: record this entry again",
            "warning",
        )


def drift(r: Recording, band: BoolArray) -> tuple[float, bool]:
    """Relative change of the response over the repeats, and whether scatter cannot explain it.

    A straight line through the spectra of the repeats at each bin, |slope| (R - 1) over |mean|; certain if
    the F test of the slope against the scatter about it, 2 n and 2 n (R - 2) degrees of freedom, is beyond
    1 - 1e-6. Two repeats only: the change itself, always taken as certain. One: 0.
    """
    y = rfft(r.response)[:, band]
    repeats, n = y.shape
    if repeats < 2 or n == 0:
        return 0.0, False
    time = np.arange(repeats) - (repeats - 1) / 2
    slope = time @ y / (time @ time)
    explained = float(time @ time * np.sum(np.abs(slope) ** 2))
    rest = float(np.sum(np.abs(y - y.mean(axis=0) - time[:, None] * slope) ** 2))
    size = float(np.linalg.norm(y.mean(axis=0)))
    change = (repeats - 1) * float(np.linalg.norm(slope)) / max(size, np.finfo(float).tiny)
    if repeats == 2:
        return change, True
    noise = max(rest / (repeats - 2), _ROUNDING * size**2, np.finfo(float).tiny)
    unbiased = max(1 - noise / explained, 0.0) if explained > 0 else 0.0
    certain = explained / noise > float(fisher.isf(1e-6, 2 * n, 2 * n * (repeats - 2)))
    return change * float(np.sqrt(unbiased)), certain
