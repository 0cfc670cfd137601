"""Attenuation and wave speed from responses along a line: the thesis' estimator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import least_squares

from ..errors import DataError
from ..typing import BoolArray, ComplexArray, FloatArray

DecayFit = Literal["nonlinear", "log", "normalised"]
_DOUBTFUL = 0.8 * np.pi  # rad between neighbours: beyond, noise decides which way a phase is unwrapped
_ABOUT = 5  # frequencies whose median that is
_RIM, _MIDDLE = 1.05, 1e-3  # of the radius, m: nearer points belong to the source


@dataclass(frozen=True, eq=False)
class WaveFit:
    """Fit of A exp(-delta x) exp(-i k x) per ``frequency`` (n,) [Hz].

    ``attenuation`` delta (n,) [1/m], ``wavenumber`` k (n,) [rad/m], ``speed`` omega / k (n,) [m/s]. ``decay_misfit``
    (n,) [-] is the rms of the amplitude's misfit over its largest value, ``phase_misfit`` (n,) [rad] the rms of the
    phase's; ``phase_step`` (n,) [rad] is the largest change between neighbours: near pi the unwrapping is a guess.
    """

    frequency: FloatArray
    attenuation: FloatArray
    wavenumber: FloatArray
    speed: FloatArray
    decay_misfit: FloatArray
    phase_misfit: FloatArray
    phase_step: FloatArray


def fit_waves(
    frequency: FloatArray, distance: FloatArray, response: ComplexArray, *, decay: DecayFit = "nonlinear"
) -> WaveFit:
    """Attenuation and speed of ``response`` (n, m) [any unit] at ``distance`` (m,) [m] from the source.

    De Vlam 2022, appendix A: an exponential through |H(x)| and a line through the unwrapped phase, c = omega / k (A.6),
    over 10 points every 2.5 mm. The phase of an outgoing wave falls with x (e^{+i omega t}), so k = -slope. ``decay``:
    "nonlinear" is least squares of A exp(-delta x) on |H| with A free; "log" a line through log|H|, which weighs far
    points more; "normalised" least squares of exp(-delta (x - x1)) on |H| / |H(x1)|, the thesis' one-parameter y =
    exp(-delta x) (A.5), whose normalisation the thesis does not state. Rows with NaN or zeros give NaN.

    Near the source and beyond 2-3 attenuation lengths the response is no plane wave: c and delta then depend on the
    window, so compare like with like. Raises DataError for fewer than 3 distances, ones that do not increase, and a
    ``decay`` that is none of the three.
    """
    x = np.asarray(distance, dtype=float)
    if x.ndim != 1 or len(x) < 3 or not (np.isfinite(x).all() and np.all(np.diff(x) > 0)):
        raise DataError("a wave fit needs at least 3 increasing distances")
    if decay not in get_args(DecayFit):
        raise DataError(f"a wave's decay is fitted by one of {', '.join(get_args(DecayFit))}, got {decay!r}")
    if frequency.ndim != 1 or response.shape != (len(frequency), len(x)):
        raise DataError(f"responses have shape {response.shape}, expected ({frequency.size}, {len(x)})")
    usable = np.all(np.isfinite(response), axis=1) & np.all(response != 0, axis=1)
    size = np.abs(response[usable])
    columns = np.full((6, len(frequency)), np.nan)
    columns[:2, usable] = _decay(x, size / size.max(axis=1, keepdims=True, initial=0), decay)
    columns[2:5, usable] = _phase(x, response[usable])
    k = columns[2]
    columns[5] = np.divide(2 * np.pi * frequency, k, out=np.full(len(k), np.nan), where=np.isfinite(k) & (k != 0))
    return WaveFit(np.asarray(frequency), columns[0], k, columns[5], columns[1], columns[3], columns[4])


def phase_told(fit: WaveFit) -> BoolArray:
    """At which frequencies (n,) the phases of a ``fit`` could be unwrapped: below the one from which on neighbours are
    more than 0.8 pi apart. Beyond, wavenumber and speed may be those of an alias, however well they fit."""
    known = np.isfinite(fit.phase_step)
    steps = median_filter(fit.phase_step[known], _ABOUT, mode="nearest") if known.any() else fit.phase_step[known]
    found = known.copy()
    found[known] = np.cumsum(steps > _DOUBTFUL) == 0
    return np.asarray(found & ~(fit.phase_step > _DOUBTFUL))


def beside(distance: FloatArray, radius: float) -> BoolArray:
    """True where a point at ``distance`` (m,) [m] from the middle of a cone of ``radius`` [m] lies beside it.

    Points under it move with it, not with its wave, and belong into no wave fit.
    """
    return np.asarray(distance > max(_RIM * radius, _MIDDLE))


def _phase(x: FloatArray, response: ComplexArray) -> FloatArray:
    """Wavenumber, misfit and largest step (3, n) of the unwrapped phase."""
    phase = np.unwrap(np.angle(response), axis=1)
    centred = x - x.mean()
    slope = phase @ centred / (centred @ centred)
    misfit = phase - phase.mean(axis=1, keepdims=True) - slope[:, None] * centred
    step = np.abs(np.diff(phase, axis=1)).max(axis=1, initial=0)
    return np.stack([-slope, np.sqrt(np.mean(misfit**2, axis=1)), step])


def _decay(x: FloatArray, size: FloatArray, decay: DecayFit) -> FloatArray:
    """Attenuation and misfit (2, n) of ``size`` (n, m), largest value 1 in each row."""
    centred = x - x.mean()
    logs = np.log(size)
    start = -logs @ centred / (centred @ centred)
    if decay == "log":
        fitted = np.exp(logs.mean(axis=1, keepdims=True) - start[:, None] * centred)
        return np.stack([start, np.sqrt(np.mean((fitted - size) ** 2, axis=1))])
    if decay == "normalised":
        rows = [_nonlinear(x - x[0], y / y[0], np.array([d])) for y, d in zip(size, start, strict=True)]
    else:
        level = np.exp(logs.mean(axis=1) + start * (x.mean() - x[0]))
        rows = [_nonlinear(x - x[0], y, np.array([d, a])) for y, d, a in zip(size, start, level, strict=True)]
    return np.array(rows).reshape(-1, 2).T


def _nonlinear(x: FloatArray, y: FloatArray, start: FloatArray) -> tuple[float, float]:
    """delta [1/m] and rms misfit of p[1] exp(-delta x), p[1] = 1 unless it is among the parameters."""
    span = x[-1]

    def misfit(p: FloatArray) -> FloatArray:
        """Of the exponential, at each distance."""
        return np.asarray((p[1] if len(p) > 1 else 1.0) * np.exp(-p[0] * x / span) - y)

    def slope(p: FloatArray) -> FloatArray:
        """Derivatives of the misfit by the parameters."""
        shape = np.exp(-p[0] * x / span)
        by_delta = -(p[1] if len(p) > 1 else 1.0) * x / span * shape
        return np.stack([by_delta, shape][: len(p)], axis=1)

    first = np.concatenate([start[:1] * span, start[1:]])
    best = least_squares(misfit, first, jac=slope, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return float(best.x[0] / span), float(np.sqrt(np.mean(best.fun**2)))
