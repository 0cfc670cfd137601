"""Exponential sine sweeps and estimators of a frequency response."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Self

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import brentq
from scipy.special import gammainccinv, gammaincinv

from ..errors import ScenarioError
from ..scenario import Scenario
from ..scenario.measurement import Estimator, MeasurementOptions
from ..scenario.sweep import Band
from ..typing import BoolArray, ComplexArray, FloatArray

# The exponential sine sweep of the calibration, and which bins of a record carry its energy.


@dataclass(frozen=True)
class ExponentialSweep:
    """x(t) = A sin(2 pi f1 T / ln(f2/f1) ((f2/f1)^(t/T) - 1)), t in [0, T) (Farina 2000; de Vlam 2022, III.B).

    ``amplitude`` A [V]; ``taper`` is the part of T faded in and out by half a cosine each, which keeps the
    jump from f2 back to f1 between repeats from clicking. |X|^2 falls like 1/f.
    """

    f_min: float = 10.0
    f_max: float = 500.0
    duration: float = 2.0
    sample_rate: float = 10000.0
    amplitude: float = 1.0
    taper: float = 0.01

    def __post_init__(self) -> None:
        if not 0 < self.f_min < self.f_max <= self.sample_rate / 2:
            raise ScenarioError(
                f"a sweep needs 0 < f_min < f_max <= {self.sample_rate / 2:g} Hz, "
                f"got {self.f_min:g} to {self.f_max:g} Hz"
            )
        if abs(self.n - self.duration * self.sample_rate) > 1e-6 or self.n < 16:
            raise ScenarioError(
                f"a sweep needs a whole number of at least 16 samples, got "
                f"{self.duration:g} s at {self.sample_rate:g} Hz"
            )

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """The sweep that a scenario's ``sweep`` and ``measurement`` ask for."""
        band, how = scenario.sweep, scenario.measurement
        if not isinstance(band, Band):
            raise ScenarioError("sweep.frequencies: a calibration sweeps a band; give sweep.f_min and f_max instead")
        return cls(band.f_min, band.f_max, band.duration, band.sample_rate, how.amplitude, how.taper)

    @property
    def n(self) -> int:
        """Number of samples of one period."""
        return round(self.duration * self.sample_rate)

    @property
    def frequency(self) -> FloatArray:
        """One-sided bins of one period (n // 2 + 1,) [Hz]."""
        return np.asarray(rfftfreq(self.n, 1 / self.sample_rate))

    def samples(self) -> FloatArray:
        """One period (n,) [V]."""
        from scipy.signal.windows import tukey  # scipy.signal takes half a second

        t = np.arange(self.n) / self.sample_rate
        rate = np.log(self.f_max / self.f_min)
        phase = 2 * np.pi * self.f_min * self.duration / rate * np.expm1(rate * t / self.duration)
        return np.asarray(self.amplitude * np.sin(phase) * tukey(self.n, 2 * self.taper, sym=False))

    def train(self, periods: int) -> FloatArray:
        """``periods`` sweeps without a pause (periods * n,) [V]."""
        return np.tile(self.samples(), periods)


def excited(drive: FloatArray, sample_rate: float, band: tuple[float, float], floor: float) -> BoolArray:
    """Bins (n // 2 + 1,) inside ``band`` [Hz] where |X| of one period ``drive`` (n,) exceeds ``floor``
    times its largest inside the band; all the others carried no energy worth dividing by."""
    frequency = rfftfreq(len(drive), 1 / sample_rate)
    inside = (frequency >= band[0] - 1e-9) & (frequency <= band[1] + 1e-9) & (frequency > 0)
    size = np.abs(rfft(drive))
    if not inside.any():
        return np.asarray(inside)
    return np.asarray(inside & (size > floor * size[inside].max()))


# From repeated periods of drive and response to a transfer function with coherence and standard deviation.
# Spectra are averaged over the repeats at full resolution (``scipy.signal.csd``, one rectangular segment per
# period): the drive is periodic, so there is no leakage to window away. With noise of variance s^2 per bin on
# the response, R periods and a drive X known exactly, every estimator that divides by X has
# E|H - H_true|^2 = s^2 / (R |X|^2)                                        (Bendat & Piersol 2010, 9.2.3)
# and s^2 is measured by the scatter between the repeats, R - 1 complex degrees of freedom per bin. What a converter
# rounds off alike in each repeat, and what a window cuts off a response, do not scatter: both are added.
# H1 is too small under noise on the drive, H2 too large under noise on the response, and no number of repeats mends it.
# Where the two noises are independent the truth lies between them (Bendat & Piersol 2010, 9.1.4), so that their
# distance bounds what H2 and Hv are biased by: it is in their deviation, and so is what regularisation takes off a
# deconvolution. What noise on a measured drive takes off H1 follows from how far the drive's own repeats scatter, and
# is in it too.

_SMOOTH = 15  # bins over which the noise is taken as even
_AROUND = 31  # bins whose median is what is typical among them
_LEAST = 0.01  # of the drive's power: what is left of it under its noise, where that is all there is


@dataclass(frozen=True, eq=False)
class Spectra:
    """One-sided averages over the repeats, each (n_bins,): ``xx``, ``yy`` [V^2], ``xy`` = <X* Y>, of ``repeats``
    periods; ``noise`` (n_bins,) [V^2] is the variance of Y about H1 X of one period, as if all of it fell with the
    repeats; NaN if it is unknown. ``drive_noise`` (n_bins,) [V^2] is that of X about its mean, part of ``xx``; 0 where
    one period cannot tell."""

    xx: FloatArray
    yy: FloatArray
    xy: ComplexArray
    repeats: int
    noise: FloatArray
    drive_noise: FloatArray

    @property
    def coherence(self) -> FloatArray:
        """|S_xy|^2 / (S_xx S_yy) (n_bins,) [-]; NaN for a single period, where it would be 1 whatever was measured."""
        if self.repeats < 2:
            return np.full(len(self.xx), np.nan)
        below = self.xx * self.yy
        return np.asarray(np.divide(np.abs(self.xy) ** 2, below, out=np.zeros(len(below)), where=below > 0))


@dataclass(frozen=True, eq=False)
class Estimate:
    """H (n_bins,) [V/V] with its ``deviation`` sqrt(E|dH|^2) (n_bins,), NaN if unknown, and the ``coherence``.

    ``usable`` (n_bins,) is False where the estimator itself is not to be trusted (edges of a window).
    """

    value: ComplexArray
    deviation: FloatArray
    coherence: FloatArray
    usable: BoolArray


def spectra(drive: FloatArray, response: FloatArray, band: BoolArray, step: float = 0.0) -> Spectra:
    """Averages over the periods of ``drive`` and ``response`` (n_repeat, n) [V]; ``band`` (n_bins,) carries the drive.

    The noise is the scatter between the repeats, smoothed over 15 bins of the band, and what a converter of that
    ``step`` [V] rounds alike in each. With one period it is taken from the bins above the band, which presumes a floor
    as even as a vibrometer's.
    """
    from scipy.signal import csd

    repeats, n = response.shape

    def average(a: FloatArray, b: FloatArray) -> ComplexArray:
        """Cross spectrum of two signals, averaged over the repeats."""
        _, s = csd(
            a.ravel(),
            b.ravel(),
            window="boxcar",
            nperseg=n,
            noverlap=0,
            detrend=False,
            return_onesided=False,
            scaling="spectrum",
        )
        return np.asarray(s[: n // 2 + 1] * n**2)

    xx, yy = average(drive, drive).real, average(response, response).real
    xy = average(drive, response)
    noise = np.full(len(xx), np.nan)
    if repeats > 1 and band.any():
        rest = np.maximum(yy[band] - np.divide(np.abs(xy[band]) ** 2, xx[band]), 0)
        even = _even(rest, repeats)
        noise[band] = even * repeats / (repeats - 1) + repeats * n * _rounded_alike(response, step)
    else:
        above = np.nonzero(band)[0][-1] + 1 if band.any() else 0
        quiet = yy[int(1.2 * above) : -1]
        noise[band] = np.mean(quiet) if quiet.size >= 10 else np.nan
    beside = np.maximum(xx - np.abs(rfft(drive.mean(axis=0))) ** 2, 0) * repeats / max(repeats - 1, 1)
    return Spectra(xx, yy, xy, repeats, noise, np.asarray(uniform_filter1d(beside, _SMOOTH, mode="nearest")))


def _even(rest: FloatArray, repeats: int) -> FloatArray:
    """Scatter ``rest`` (n,) smoothed over 15 bins, but its own in bins that stand out of an even one: lines, as of hum
    that is not in step with the repeats.

    An even scatter of R repeats is a gamma variable of R - 1 degrees of freedom; beyond its 1e-6 point is none.
    """
    typical = median_filter(rest, min(_AROUND, len(rest)), mode="reflect") / gammaincinv(repeats - 1, 0.5)
    out = rest > gammainccinv(repeats - 1, 1e-6) * typical
    even = uniform_filter1d(np.where(out, typical * (repeats - 1), rest), _SMOOTH, mode="nearest")
    return np.asarray(np.maximum(np.where(out, np.maximum(rest, even), even), 0))


def _rounded_alike(response: FloatArray, step: float) -> float:
    """Variance [V^2] of what a converter of that ``step`` [V] rounds off the same in each period (n_repeat, n).

    All of step^2 / 12 without noise; noise of deviation s leaves exp(-(2 pi s / step)^2) of it and makes the rest
    differ between periods, in whose scatter it is beside the noise (Widrow and Kollar, Quantization Noise, 2008).
    """
    if step <= 0:
        return 0.0
    scatter = float(response.var(axis=0, ddof=1).mean()) / step**2

    def left(noise: float) -> float:
        """Rest that noise of the variance ``noise`` leaves of it, both in squared steps."""
        return math.exp(-((2 * math.pi) ** 2) * noise) / 12

    def too_much(noise: float) -> float:
        """Scatter between periods with such ``noise``, less what was seen."""
        return noise + 1 / 12 - left(noise) - scatter

    return step**2 * left(brentq(too_much, 0.0, scatter) if scatter > 0 else 0.0)


def estimate(kind: Estimator, s: Spectra, band: BoolArray, options: MeasurementOptions, rate: float) -> Estimate:
    """The estimate ``kind`` asks for, zero outside ``band``; ``rate`` is the sample rate [Hz]."""
    if kind == "deconvolution":  # S_xy / (S_xx + lambda max S_xx), optionally cut to a window of the impulse response
        below = s.xx + options.regularisation * s.xx[band].max(initial=0)
        value = np.where(band, _ratio(s.xy, below), 0)
        plain = Estimate(value, _deviation(s, below, band), s.coherence, band)
        found = plain if options.window is None else _windowed(plain, band, options.window, rate)
        damped = np.abs(value) * np.divide(below - s.xx, s.xx, out=np.zeros(len(s.xx)), where=band)  # too small by that
        return replace(found, deviation=np.hypot(found.deviation, damped + _bias(kind, s, value)))
    value = np.where(band, _ESTIMATORS[kind](s), 0)
    return Estimate(value, np.hypot(_deviation(s, s.xx, band), _bias(kind, s, value)), s.coherence, band)


def _bias(kind: Estimator, s: Spectra, value: ComplexArray) -> FloatArray:
    """Bias (n_bins,) of ``value``, at most: for H2 and Hv its distance from the farther of H1 and H2, between which
    the truth lies; else the loss by noise on the drive."""
    if kind in ("H2", "Hv"):
        return np.asarray(np.maximum(np.abs(value - _h1(s)), np.abs(value - _h2(s))))
    rest = np.maximum(s.xx - s.drive_noise, _LEAST * s.xx)
    return np.asarray(np.abs(value) * np.divide(s.drive_noise, rest, out=np.zeros(len(value)), where=rest > 0))


def _deviation(s: Spectra, below: FloatArray, band: BoolArray) -> FloatArray:
    """sqrt(s^2 |X|^2 / R) / ``below``: for below = |X|^2 the formula of the module's heading."""
    with np.errstate(invalid="ignore"):
        size = np.sqrt(s.noise * s.xx / s.repeats)
    return np.asarray(np.divide(size, below, out=np.full(len(s.xx), np.nan), where=band))


def _h1(s: Spectra) -> ComplexArray:
    """<X* Y> / <X* X>: unbiased under noise on the response."""
    return _ratio(s.xy, s.xx)


def _h2(s: Spectra) -> ComplexArray:
    """<Y* Y> / <Y* X>: unbiased under noise on the drive, too large by 1 / coherence under noise on the response
    (:func:`_bias`)."""
    return _ratio(s.yy.astype(complex), s.xy.conj())


def _hv(s: Spectra) -> ComplexArray:
    """sqrt(<Y* Y> / <X* X>) with the phase of <X* Y>: the geometric mean of H1 and H2 (Rocklin et al. 1985)."""
    size = np.sqrt(np.maximum(_ratio(s.yy.astype(complex), s.xx).real, 0))
    return np.asarray(size * np.exp(1j * np.angle(s.xy)))


def _ratio(a: ComplexArray, b: FloatArray | ComplexArray) -> ComplexArray:
    return np.divide(a, b, out=np.zeros(len(a), dtype=complex), where=b != 0)


# "fourier" is the thesis' Y / X; averaged over repeats of one and the same drive it is H1.
_ESTIMATORS: Mapping[str, Callable[[Spectra], ComplexArray]] = MappingProxyType(
    {"fourier": _h1, "H1": _h1, "H2": _h2, "Hv": _hv}
)


def _windowed(plain: Estimate, band: BoolArray, window: float, rate: float) -> Estimate:
    """Noise falls by sqrt(kept / record); bins closer than 2 / window to the band's edges are smeared: not usable.

    What is cut off holds noise and the response's own end. Of the latter, which is missing then, is what the noise does
    not explain: it is in the deviation.
    """
    n = 2 * (len(band) - 1)
    keep = min(int(window * rate), n)
    before = min(keep // 4, n - keep)
    shape = np.zeros(n)
    fade = np.sin(np.pi / 2 * (np.arange(before) + 0.5) / max(before, 1)) ** 2
    shape[: keep - before] = 1
    shape[keep - before : keep] = fade[::-1]
    if before:
        shape[-before:] = fade
    value = rfft(irfft(plain.value, n) * shape)
    share = np.sqrt(np.sum(shape**2) / n)
    edge = int(np.ceil(2 * n / (window * rate)))
    index = np.nonzero(band)[0]
    usable = band & (np.arange(len(band)) >= index[0] + edge) & (np.arange(len(band)) <= index[-1] - edge)
    smooth = partial(uniform_filter1d, size=2 * edge + 1)
    power = np.maximum(smooth(np.where(band, plain.deviation, 0) ** 2), 0)  # the running sum may round below zero
    inner = np.maximum(smooth(usable.astype(float)), 1e-9)  # bins at the edges miss what lies beyond them
    cut = np.maximum(smooth(np.where(usable, np.abs(value - plain.value) ** 2, 0)), 0) / inner
    missing = np.maximum(cut - (1 - share**2) * power, 0)
    deviation = np.sqrt(share**2 * power + missing)
    return replace(plain, value=value, deviation=np.where(band, deviation, np.nan), usable=usable)
