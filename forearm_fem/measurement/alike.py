"""Errors common to all repeats, or in step with their number: the scatter between repeats does not see them.

Mains hum of a whole number of cycles a period stands in one bin, with the same phase each time; an offset that drifts
leaves the same ramp in every period, which falls over the band like 1/f; clocks of output and input that run apart turn
the phase a little more from one period to the next. Each is looked for by what only it leaves behind, and what it may
have put into the estimate is stated beside the scatter. The values themselves stay what was measured.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import rfft, rfftfreq
from scipy.ndimage import median_filter

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
