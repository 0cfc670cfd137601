"""Filling bins between samples of G, and refusing to where the samples are too far apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from ..errors import DataError
from ..typing import BoolArray, ComplexArray, FloatArray, IntArray

_ON_BIN = 1e-3  # of the bin spacing: further off, a sample is not on its bin
_PRINTED, _FARTHEST = 6, 0.05  # digits that programs print of a frequency; of the bin spacing, what these may be off
_EVEN = 0.01  # of the spacing: how far it may differ from bin to bin
_NOISE, _ALIKE = 0.1, 2.5  # of the values' size, noise; how much larger misses at twice the spacing are, at most
_SHORTEST = 8  # samples: fewer leave no way to judge a spline


@dataclass(frozen=True)
class Interpolation:
    """When bins between samples may be filled.

    An interval ``gap`` times wider than both its neighbours is a gap: nothing is filled there. ``tolerance`` bounds the
    estimated error of the spline, max |dG| / max |G| at one frequency. ``enabled`` False copies exact bins only.
    """

    gap: float = 3.0
    tolerance: float = 0.01
    enabled: bool = True


def filled_in(
    place: FloatArray,
    values: ComplexArray,
    valid: BoolArray,
    index: IntArray,
    df: float,
    options: Interpolation,
) -> tuple[ComplexArray, BoolArray]:
    """Values and mask (n_index, m) on bins ``index`` from samples (n, m) at ``place`` [bins], ``df`` [Hz] apart.

    Samples on a bin are copied; the others serve a cubic spline per unbroken run of valid samples. Raises
    DataError where the spline's estimated error exceeds the tolerance.
    """
    shape = (len(index), values.shape[1])
    out, on = np.zeros(shape, dtype=complex), np.zeros(shape, dtype=bool)
    nearest = np.rint(place).astype(int)
    slack = np.clip(_slack(place * df) / df, _ON_BIN, _FARTHEST)
    rows = np.nonzero((np.abs(place - nearest) < slack) & np.isin(nearest, index))[0]
    copied = nearest[rows] - index[0]
    open_bins = np.delete(index, copied)
    if options.enabled and len(open_bins):
        for columns, run in _runs(place, valid, options.gap):
            inside = open_bins[(open_bins > place[run[0]]) & (open_bins < place[run[-1]])]
            if len(inside):
                known, target = values[np.ix_(run, columns)], np.ix_(inside - index[0], columns)
                _judge(place[run], known, inside, df, options.tolerance)
                out[target], on[target] = CubicSpline(place[run], known)(inside), True
    out[copied], on[copied] = values[rows], valid[rows]
    return out, on


def _slack(frequency: FloatArray) -> FloatArray:
    """How far [Hz] a sample of ``frequency`` (n,) [Hz] may be off its bin: what six printed digits leave off."""
    digit = 10.0 ** (np.floor(np.log10(np.maximum(frequency, 1e-300))) - (_PRINTED - 1))
    return np.asarray(0.51 * digit)


def _runs(place: FloatArray, valid: BoolArray, gap: float) -> list[tuple[IntArray, IntArray]]:
    """Entries (columns) with the same mask, with each of their runs of valid samples that is long enough."""
    step = np.diff(place)
    padded = np.concatenate([[0.0], step, [0.0]])
    wide = step > gap * np.maximum(padded[:-2], padded[2:])
    patterns, group = np.unique(valid, axis=1, return_inverse=True)
    runs: list[tuple[IntArray, IntArray]] = []
    for g, pattern in enumerate(patterns.T):
        broken = wide | ~pattern[1:] | ~pattern[:-1]
        columns = np.nonzero(np.ravel(group) == g)[0]
        pieces = np.split(np.arange(len(place)), np.nonzero(broken)[0] + 1)
        runs.extend((columns, run) for run in pieces if len(run) >= _SHORTEST)
    return runs


def _judge(place: FloatArray, values: ComplexArray, bins: IntArray, df: float, tolerance: float) -> None:
    """Raise if a spline through every other sample misses the rest by more than 8 times the tolerance.

    Halving the spacing of a cubic spline divides its error by up to 16; we count on 8. Only samples next
    to an interval to be filled are asked.
    """
    odd = np.arange(1, len(place) - 1, 2)
    used = np.isin(np.arange(len(place) - 1), np.searchsorted(place, bins) - 1)
    odd = odd[used[odd] | used[odd - 1]]
    if len(odd) == 0:
        return
    miss = CubicSpline(place[::2], values[::2])(place[odd]) - values[odd]
    size = np.maximum(np.abs(values[odd]).max(axis=1), np.finfo(float).tiny)
    error = np.abs(miss).max(axis=1) / size / 8
    worst = int(np.argmax(error))
    if error[worst] > tolerance and not _noisy(place, values, odd, miss):
        at = odd[worst]
        step = float(np.median(np.diff(place))) * df
        even = bool(np.abs(np.diff(place) * df / step - 1).max() < _EVEN)
        record = f"a record whose bins lie on them, sweep.duration = {1 / step:.6g}," if even else "even frequencies"
        raise DataError(
            f"samples of G near {place[at] * df:.4g} Hz are {(place[at + 1] - place[at]) * df:.3g} Hz apart: "
            f"interpolating them would err by about {error[worst]:.1%}, allowed {tolerance:.1%}; give {record} or G on "
            "more frequencies (responses in time: fill up with zeros, time.length in a recipe)"
        )


def _noisy(place: FloatArray, values: ComplexArray, odd: IntArray, miss: ComplexArray) -> bool:
    """Whether ``miss`` (n, m) of every other sample is noise: no course between samples, but what they scatter by.

    Noise is as large whatever samples are left out, while a spline of twice the spacing errs by up to 16 times as much
    in what it follows. It is small beside the values; a response that is sampled too seldom is missed by all of them.
    """
    used = odd[(odd >= 2) & (odd < len(place) - 2)]
    if len(used) < _SHORTEST or len(place) < 4 * _SHORTEST:
        return False
    coarse = CubicSpline(place[::4], values[::4])(place[used]) - values[used]
    fine = float(np.median(np.abs(miss)))
    size = float(np.median(np.abs(values)))
    return fine < _NOISE * size and float(np.median(np.abs(coarse))) < _ALIKE * fine
