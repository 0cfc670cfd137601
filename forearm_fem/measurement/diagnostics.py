"""Faults of a recording, in one sentence each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq
from scipy.ndimage import median_filter
from scipy.stats import f as fisher

from ..typing import BoolArray, ComplexArray, FloatArray
from .recording import Recording

_OUT = 8.0  # times what bins are usually off the course of their neighbours
_ALIKE = 0.5  # of a line's trace: what may be left of its five bins when the line is taken out
_AROUND = 31  # bins whose median is taken for typical
_CERTAIN = 6.0  # standard deviations of a delay's growth
_DELAYED = 0.5  # of what changes over the repeats: less is not explained by a delay
_EVEN = 0.25  # of a repeat's delay: how far each may be off an even growth (lost samples jump)
_COPY = 1e-3  # of a response's energy: what may be left when the drive is taken out of it
_TRACE = np.array([1 / 6, -2 / 3, 1.0, -2 / 3, 1 / 6])  # of a line in five bins, by cubic interpolation over its bin


def lines(value: ComplexArray, band: BoolArray) -> FloatArray:
    """Sizes (n,) of the lines that stand in single bins of the estimate ``value`` (n,) inside ``band`` (n,), 0 where
    there is none.

    An estimate of a response that dies down within a period runs smoothly from bin to bin. A line is what a cubic
    through two bins to either side misses by eight times what is usual around it, with the trace that one bin alone
    leaves. In the two outermost bins, of which the trace lies outside, the cubic through what lies inside must do.
    """
    found = np.zeros(len(value))
    inside = np.flatnonzero(band & np.isfinite(value))
    for run in np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1):
        if len(run) > _AROUND:
            found[run] = _run_of_lines(value[run])
    return found


def _run_of_lines(value: ComplexArray) -> FloatArray:
    """:func:`lines` of bins (n,) without a gap."""
    n = len(value)
    off, there = (np.pad(a, 2) for a in (np.convolve(value, _TRACE, mode="valid"), np.ones(n - 4)))
    stacked, known = (np.stack([a[k : k + n - 4] for k in range(5)]) for a in (off, there))
    size = _TRACE @ stacked / (_TRACE**2 @ known)
    left = np.linalg.norm((stacked - _TRACE[:, None] * size) * known, axis=0)
    usual = median_filter(np.abs(size), min(_AROUND, n - 4), mode="reflect")
    out = (np.abs(size) > _OUT * usual) & (left < _ALIKE * np.abs(size) * np.sqrt(_TRACE**2 @ known))
    found = np.pad(np.where(out, np.abs(size), 0), 2)
    for one, its, ends in ((value, usual[0], (0, 1, 3, 4)), (value[::-1], usual[-1], (-1, -2, -4, -5))):
        missed = abs(_OUTERMOST @ one[:5])
        if missed > _OUT * its * np.linalg.norm(_OUTERMOST) and not found[list(ends[2:])].any():
            found[ends[0]], found[ends[1]] = missed, missed / 4  # any of three: not told apart
    return found


_OUTERMOST = np.array([1.0, -4, 6, -4, 1])  # the first of five bins less the cubic through the other four


def offset_rise(response: FloatArray) -> float:
    """Rise [V] of the offset of ``response`` (n_repeat, n) in a period; 0 for a single one."""
    means = response.mean(axis=1)
    return float(means[-1] - means[0]) / (len(means) - 1) if len(means) > 1 else 0.0


def ramp_spectrum(rise: float, n: int) -> FloatArray:
    """|spectrum| (n // 2 + 1,) [V] of a ramp of ``rise`` [V] over one period of ``n`` samples; bin 0 is left at 0."""
    size = np.zeros(n // 2 + 1)
    size[1:] = abs(rise) / (2 * np.sin(np.pi * np.arange(1, len(size)) / n))
    return size


def delay_growth(r: Recording, band: BoolArray) -> float:
    """Seconds by which the response comes later in each repeat than in the one before, as clocks that run apart make
    it; 0 where that is not certain, does not explain most of what changes, or does not grow evenly.
    A loopback is as late as the response, so that nothing is off with one.
    """
    repeats = len(r.response)
    if repeats < 2 or not band.any() or r.loopback is not None:
        return 0.0
    hum = np.convolve(lines(response_over(r.sent[None], r.response, band), band) > 0, np.ones(11), mode="same") > 0
    y, band = rfft(r.response)[:, band & ~hum], band & ~hum
    turn = -2j * np.pi * rfftfreq(r.n, 1 / r.sample_rate)[band] * y.mean(axis=0)
    weight = float(np.sum(np.abs(turn) ** 2))
    if weight == 0:
        return 0.0
    change = y - y.mean(axis=0)
    delay = (change @ turn.conj()).real / weight
    rest = change - delay[:, None] * turn
    power = float(np.sum(np.abs(rest) ** 2)) / (rest.size * (repeats - 1) / repeats)
    time = np.arange(repeats) - (repeats - 1) / 2
    growth = float(time @ delay) / float(time @ time)
    spread = np.sqrt(power / 2 / weight / float(time @ time))
    even = float(np.sqrt(np.mean((delay - growth * time) ** 2))) < _EVEN * abs(growth) or repeats == 2
    jumped = repeats == 2 and abs(growth) > 0.8 / r.sample_rate  # a sample that was lost between the two does that
    explained = growth**2 * weight > _DELAYED * float(np.sum(np.abs(time @ change) ** 2)) / float(time @ time) ** 2
    return growth if abs(growth) > _CERTAIN * spread and even and explained and not jumped else 0.0


def copied(r: Recording, band: BoolArray) -> tuple[float, float] | None:
    """Factor and delay [s] by which the response is the drive itself, and nothing else in the band; None if it is not.

    No body passes a band on without a change of size or phase: a cable does.
    """
    x, y = rfft(r.sent)[band], rfft(r.response.mean(axis=0))[band]
    energy = float(np.linalg.norm(x) * np.linalg.norm(y))
    if energy == 0 or np.count_nonzero(band) < 8:
        return None
    omega = 2 * np.pi * rfftfreq(r.n, 1 / r.sample_rate)[band]
    full = np.zeros(r.n // 2 + 1, dtype=complex)
    full[band] = x.conj() * y
    course = np.fft.irfft(full, r.n)
    coarse = int(np.abs(course).argmax())
    near = (coarse if coarse <= r.n // 2 else coarse - r.n) + np.linspace(-1, 1, 81)
    alike = (np.exp(1j * np.outer(near / r.sample_rate, omega)) @ (x.conj() * y)).real / energy
    best = int(np.abs(alike).argmax())
    if 1 - alike[best] ** 2 > _COPY:
        return None
    return float(alike[best] * np.linalg.norm(y) / np.linalg.norm(x)), float(near[best] / r.sample_rate)


def response_over(drive: FloatArray, response: FloatArray, band: BoolArray) -> ComplexArray:
    """Mean response over mean drive (n_bins,), both (n_repeat, n); 0 outside ``band``."""
    x, y = rfft(drive.mean(axis=0)), rfft(response.mean(axis=0))
    return np.asarray(np.divide(y, x, out=np.zeros(len(x), dtype=complex), where=band & (x != 0)))


def off_alike(r: Recording, drive: FloatArray, band: BoolArray) -> FloatArray:
    """Error (n_bins,) of an estimate of response over ``drive`` (n_repeat, n) [V] by what the repeats of ``r`` have
    in common.

    Lines, the ramp of a drifting offset, and the delay of clocks that run apart, counted from the last period
    kept back to the beginning, of which one was thrown away. 0 outside ``band`` (n_bins,).
    """
    value, x = response_over(drive, r.response, band), rfft(drive.mean(axis=0))
    drifted = np.divide(ramp_spectrum(offset_rise(r.response), r.n), np.abs(x), out=np.zeros(len(x)), where=band)
    late = abs(delay_growth(r, band)) * ((len(r.response) + 1) / 2 + 1)
    turned = np.abs(value) * 2 * np.pi * rfftfreq(r.n, 1 / r.sample_rate) * late
    return np.asarray(np.sqrt(_beside_lines(rfft(r.response), x, band) ** 2 + drifted**2 + turned**2))


def _beside_lines(y: ComplexArray, x: ComplexArray, band: BoolArray) -> FloatArray:
    """Contribution of lines to all bins of the ``band`` [V/V]; ``y`` (n_repeat, n_bins) are the spectra of the
    repeats and ``x`` (n_bins,) is that of the drive.

    A line that is off its bin by a part d of a bin turns by that part of a cycle from one repeat to the next, and is
    seen k bins away with d / |k - d| of its size.
    """
    each = np.divide(y, x, out=np.zeros(y.shape, dtype=complex), where=band)
    found = lines(each.mean(axis=0), band)
    total, bins = found**2, np.arange(len(x))
    for k in np.flatnonzero(found):
        few = bins[max(k - 2, 0) : k + 3]
        alone = each[:, few] @ _TRACE[few - k + 2]
        part = abs(float(np.angle(np.vdot(alone[:-1], alone[1:])))) / (2 * np.pi) if len(alone) > 1 else 0.0
        seen = found[k] * abs(x[k]) * part / np.maximum(np.abs(bins - k) - part, 0.5)
        seen[k] = 0
        total += np.divide(seen, np.abs(x), out=np.zeros(len(x)), where=band) ** 2
    return np.sqrt(total)


# Faults of a recording, in one sentence each.

Severity = Literal["error", "warning"]
_ROUNDING = 1e-28  # of an energy: below it is rounding, not noise
_SLOW = 0.7  # of the band's beginning: what is slower is no response
_SEEN = 0.1  # of an entry: what errs alike in each repeat and is worth a sentence
_PARTS = 4  # of a period that are searched for lost samples
_FLAT, _STEEP = 3, 10.0  # samples, and the fall beside them in what counts as equal
_COARSE = 8.0  # steps of the converter: a part that swings by less is too coarsely rounded to tell a lag


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
        *(_apart(recording, band) or (*_lost(recording, band), *_moved(recording, band, max_drift))),
        *_silent(recording, band),
        *_in_common(recording, band),
        *_drive_itself(recording, band),
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
    """Samples at the rails, or flat tops below them: what the sensor or its filter cut off before the converter."""
    remedy = "lower the sweep's amplitude or widen the sensor's range"
    channels = [("samples", r.response, remedy)]
    if r.loopback is not None:
        channels.append(("samples of the loopback", r.loopback, "attenuate it or widen daq.input_range"))
    for what, y, remedy in channels:
        count = 0
        if np.isfinite(r.full_scale):
            count = int(np.count_nonzero(np.abs(y) >= min(r.full_scale - 1.5 * r.resolution, 0.9999 * r.full_scale)))
        if count := count or _flat_tops(y, _step(y, r.resolution)):
            most = np.abs(y).max()
            yield Finding("clipped", f"{r.label}: {count} {what} touch the end of the range ({most:.4g} V); {remedy}")


def _step(y: FloatArray, told: float) -> float:
    """Step [V] of the converter that ``y`` came through: as ``told``, or the least difference between two samples."""
    levels = np.unique(y) if told <= 0 else np.zeros(0)
    return float(np.diff(levels).min()) if len(levels) > 1 else told


def _flat_tops(y: FloatArray, step: float) -> int:
    """Samples of ``y`` (n_repeat, n) in flat tops at an extreme: three or more in a row as good as equal, and a fall to
    either side that is far steeper than a round top's.

    As good as equal is within a ``step`` [V] of the converter and six standard deviations of what differs between the
    repeats. A round top that is so flat over three samples falls by four times that within the next one, and a wider
    one by less.
    """
    scatter = float(np.sqrt(y.var(axis=0, ddof=1).mean())) if len(y) > 1 else 0.0
    same, count = step + 6 * scatter, 0
    for sign in (1.0, -1.0):
        z = sign * (y - np.median(y, axis=1, keepdims=True))
        top = z >= z.max() - same
        padded = np.pad(top.astype(np.int8), ((0, 0), (1, 1)))
        begin, end = (np.argwhere(np.diff(padded, axis=1) == d) for d in (1, -1))  # row-wise, in the same order
        for (row, first), (_, past) in zip(begin, end, strict=True):
            around = z[row, [first - 1, past]] if first > 0 and past < y.shape[1] else np.full(2, np.inf)
            if past - first >= _FLAT and z.max() - around.max() > _STEEP * same:
                count += int(past - first)
    return count


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


def _lost(r: Recording, band: BoolArray | None = None) -> Iterator[Finding]:
    """Parts of a period that lag those of the first one by whole samples; with a loopback those of the drive, taken as
    late as it comes back. What is slower than the ``band`` is an offset that wanders, and left out."""
    signals = r.response if r.loopback is None else r.loopback
    if band is not None and band.any():
        slow = rfft(signals)
        slow[:, int(np.flatnonzero(band)[0] * _SLOW) + 1 :] = 0
        signals = signals - irfft(slow, r.n)
    reference = signals[0] if r.loopback is None else np.roll(r.sent, _late(r.sent, r.loopback))
    shifts = lags(reference, signals, _step(signals, r.resolution))
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


def lags(
    reference: FloatArray, signals: FloatArray, step: float = 0.0
) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Lag (n_repeat, 4) [samples] of each quarter of ``signals`` (n_repeat, n) behind that of ``reference`` (n,).

    Circular correlation of what varies; a lag counts only where it explains clearly more than none (1 % of the energy
    that is alike, and six standard deviations of what noise gives), so that noise does not invent one. Quarters that
    swing by less than eight times the converter's ``step`` [V] are single steps up and down, of which any two are alike
    at some lag: they tell none.
    """
    length = len(reference) // _PARTS
    parts = signals[:, : length * _PARTS].reshape(len(signals), _PARTS, length)
    first = reference[: length * _PARTS].reshape(_PARTS, length)
    coarse = np.minimum(np.ptp(parts, axis=2), np.ptp(first, axis=1)) < _COARSE * step
    parts, first = (a - a.mean(axis=-1, keepdims=True) for a in (parts, first))  # an offset is alike at any lag
    likeness = irfft(rfft(first).conj()[None] * rfft(parts), length)
    best = likeness.argmax(axis=2)
    gain = likeness.max(axis=2) - likeness[:, :, 0]
    rest = np.linalg.norm(parts - first[None], axis=2)
    noise = np.linalg.norm(first, axis=1)[None] * rest / np.sqrt(length)
    clear = (gain > 1e-2 * np.abs(likeness).max(axis=2)) & (gain > 6 * noise) & ~coarse
    return np.where(clear, np.where(best > length // 2, best - length, best), 0)


def _apart(r: Recording, band: BoolArray) -> tuple[Finding, ...]:
    """Clocks of output and input that run apart, which lost samples and a moved arm would else be taken for."""
    growth = delay_growth(r, band)
    if growth == 0:
        return ()
    parts = abs(growth) / (r.n / r.sample_rate)
    when = f"{1e6 * abs(growth):.3g} us {'later' if growth > 0 else 'earlier'}"
    return (
        Finding(
            "clocks",
            f"{r.label}: the response comes {when} in each repeat, as if the clocks of output and input ran "
            f"{1e6 * parts:.3g} parts per million apart; what that does to the phase is in the deviation: set "
            "daq.clock, or wire daq.loopback",
            "error" if parts * r.n > 1 else "warning",
        ),
    )


def _in_common(r: Recording, band: BoolArray) -> Iterator[Finding]:
    """Hum and a drifting offset, which put the same into each repeat."""
    value, frequency = response_over(_drive(r), r.response, band), rfftfreq(r.n, 1 / r.sample_rate)
    seen = np.flatnonzero(lines(value, band) > _SEEN * np.abs(value))
    if len(seen):
        some = ", ".join(f"{f:g}" for f in frequency[seen[:3]]) + (", ..." if len(seen) > 3 else "")
        driven = np.flatnonzero(band)
        outermost = np.isin(seen, [*driven[:2], *driven[-2:]]).all()
        edge = " (or a steep response at the edge of the band)" if outermost else ""
        yield Finding(
            "hum",
            f"{r.label}: a line stands at {some} Hz, as hum does alike in each repeat{edge}; it is in the deviation "
            "there: shield the cables, or change sweep.duration by a quarter of its cycle (5 ms at 50 Hz), which 4 "
            "repeats average out",
            "warning",
        )
    rise = offset_rise(r.response)
    share = ramp_spectrum(rise, r.n)[band] / np.maximum(np.abs(rfft(_drive(r).mean(axis=0))[band]), _ROUNDING)
    share = np.divide(share, np.abs(value[band]), out=np.zeros(len(share)), where=value[band] != 0)
    if share.size and share.max() > _SEEN:
        yield Finding(
            "drifting offset",
            f"{r.label}: the sensor's offset drifts by {rise:.2g} V in each repeat, which puts up to "
            f"{100 * min(share.max(), 9.99):.0f} % into the entry at {frequency[band][share.argmax()]:g} Hz; it is in "
            "the deviation: let the sensor warm up, or couple it through a high-pass",
            "warning",
        )


def _drive(r: Recording) -> FloatArray:
    return r.sent[None] if r.loopback is None else r.loopback


def _drive_itself(r: Recording, band: BoolArray) -> Iterator[Finding]:
    if (copy := copied(r, band)) is not None:
        yield Finding(
            "drive itself",
            f"{r.label}: the response is the drive itself, {copy[0]:.3g} times and {1e3 * copy[1]:.3g} ms late, which "
            "no skin gives; is the sensor's input wired to the output, or does it hear the drive by crosstalk alone?",
            "warning",
        )


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
    y = rfft(r.response - offset_rise(r.response) * np.arange(r.n) / r.n)
    band = band & (lines(response_over(_drive(r), r.response, band), band) == 0)
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
