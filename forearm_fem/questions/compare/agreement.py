"""Agreement of two G, and the bands, pairs and places where they differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ...metrics.common_ground import CommonGround
from ...typing import ComplexArray, FloatArray
from .readings import explained

# Numbers that say how alike two transfer matrices are, per entry, per frequency and overall.


@dataclass(frozen=True, eq=False)
class Agreement:
    """B against A, A being the reference; NaN where nothing could be compared.

    Per entry (n_out, n_in): ``magnitude_db`` the rms of 20 log10 |B/A|; ``bias_db`` its mean; ``phase``
    [rad] the rms of the phase of B/A, weighted with |A|^2; ``delay`` [s] the slope of that phase (positive:
    B is later); ``error`` ||B - A|| / ||A||; ``frac`` the frequency response assurance criterion |<A, B>|^2
    / (<A, A><B, B>) over frequency. Per frequency (n,): ``per_frequency`` e(f) and ``fdac`` the same
    criterion over entries. Overall: ``band`` e_band, ``overall_frac``, and ``misfit`` the rms of |B - A|
    over the standard deviations of both, 1 where they differ by noise alone, NaN without deviations.
    """

    magnitude_db: FloatArray
    bias_db: FloatArray
    phase: FloatArray
    delay: FloatArray
    error: FloatArray
    frac: FloatArray
    per_frequency: FloatArray
    fdac: FloatArray
    band: float
    overall_frac: float
    misfit: float
    misfit_entries: FloatArray


def agreement(g: CommonGround) -> Agreement:
    """All of :class:`Agreement` from the valid entries of ``g``."""
    a, b = np.where(g.valid, g.a, 0), np.where(g.valid, g.b, 0)
    both = (a != 0) & (b != 0)
    ratio = np.divide(b, a, out=np.full(a.shape, np.nan + 0j), where=both)
    ratio_db, phase = 20 * np.log10(np.abs(ratio)), np.where(both, np.angle(ratio), np.nan)
    off, largest = np.abs(b - a).max(axis=(1, 2)), np.abs(a).max(axis=(1, 2))
    entry = (0,)
    variance = np.zeros(g.valid.shape)
    for deviation in (g.deviation_a, g.deviation_b):
        variance = variance + (0 if deviation is None else np.nan_to_num(deviation, nan=0.0) ** 2)
    known = g.valid & (variance > 0)  # where something is known about either
    misfit = np.asarray(np.divide(_power(g.b - g.a), variance, out=np.full(g.valid.shape, np.nan), where=known))
    return Agreement(
        magnitude_db=np.sqrt(_mean(ratio_db**2, entry)),
        bias_db=_mean(ratio_db, entry),
        phase=np.sqrt(_share(_power(a) * phase**2, _power(a), entry)),
        delay=_delay(g.omega, a, b),
        error=np.sqrt(_share(_power(b - a), _power(a), entry)),
        frac=assurance(a, b, entry),
        per_frequency=np.divide(off, largest, out=np.full(len(a), np.nan), where=largest > 0),
        fdac=assurance(a, b, (1, 2)),
        band=float(np.sqrt(_share(_power(b - a), _power(a), (0, 1, 2)))),
        overall_frac=float(assurance(a, b, (0, 1, 2))),
        misfit=float(np.sqrt(_mean(misfit, (0, 1, 2)))),
        misfit_entries=np.sqrt(_mean(misfit, entry)),
    )


def assurance(a: ComplexArray, b: ComplexArray, axes: tuple[int, ...]) -> FloatArray:
    """|sum a* b|^2 / (sum |a|^2 sum |b|^2) over ``axes``: 1 if b is a complex number times a; NaN if either is zero.

    Over frequency it is the FRAC (Heylen & Lammens 1996), over entries the diagonal of the FDAC (Pascual et
    al. 1997) in its squared form.
    """
    below = _power(a).sum(axis=axes) * _power(b).sum(axis=axes)
    above = np.abs((a.conj() * b).sum(axis=axes)) ** 2
    return np.asarray(np.divide(above, below, out=np.full(np.shape(below), np.nan), where=below > 0))


def fdac_matrix(g: CommonGround) -> FloatArray:
    """FDAC (n, n) [-] between every frequency of A (rows) and of B (columns): a ridge off the diagonal is a shift."""
    a, b = (np.where(g.valid, m, 0).reshape(len(g.frequency), -1) for m in (g.a, g.b))
    below = _power(a).sum(axis=1)[:, None] * _power(b).sum(axis=1)
    above = np.abs(a.conj() @ b.T) ** 2
    return np.asarray(np.divide(above, below, out=np.full(below.shape, np.nan), where=below > 0))


def _power(x: ComplexArray) -> FloatArray:
    return np.asarray(x.real**2 + x.imag**2)


def _mean(x: FloatArray, axes: tuple[int, ...]) -> FloatArray:
    """Mean of the finite values, NaN if there are none."""
    known = np.isfinite(x)
    count = known.sum(axis=axes)
    total = np.where(known, x, 0).sum(axis=axes)
    return np.asarray(np.divide(total, count, out=np.full(np.shape(count), np.nan), where=count > 0))


def _share(x: FloatArray, weight: FloatArray, axes: tuple[int, ...]) -> FloatArray:
    """sum x / sum weight, NaN for no weight."""
    below = weight.sum(axis=axes)
    above = np.where(np.isfinite(x), x, 0).sum(axis=axes)
    return np.asarray(np.divide(above, below, out=np.full(np.shape(below), np.nan), where=below > 0))


def _delay(omega: FloatArray, a: ComplexArray, b: ComplexArray) -> FloatArray:
    """Delay (n_out, n_in) [s] of b behind a from the phase steps of the cross spectrum between neighbouring
    frequencies, weighted with its size: no unwrapping. NaN with fewer than two frequencies."""
    cross = a.conj() * b
    steps = cross[1:] * cross[:-1].conj()
    width = np.diff(omega)[:, None, None]
    even = np.isclose(width, np.median(width)) if len(omega) > 1 else np.zeros(width.shape, dtype=bool)
    total = np.where(even, steps, 0).sum(axis=0)
    if len(omega) < 2:
        return np.full(a.shape[1:], np.nan)
    return np.where(total != 0, -np.angle(total) / np.median(width), np.nan)


# Where two transfer matrices differ: over points, actuators and bands of frequency, and by what simple cause.

_BANDS = 4
_HALF = 0.5  # of the difference: a cause that takes away as much is named
_MOST = 0.5  # of the squared difference: one channel that holds as much is named, where its fair share is half of it
_NOTHING = 1e-9
_ONE = 0.01  # a gain nearer to 1 is not named


@dataclass(frozen=True, eq=False)
class Where:
    """``error`` (n_band, n_output, n_input) [-]: norm of the difference of an entry over that of A's largest entry of
    the same band, NaN where nothing is known to both; ``bands`` (low, high) [Hz]; ``share`` (n_band, n_output,
    n_input) of the squared difference [-]; ``cause`` the likeliest one in a sentence."""

    bands: tuple[tuple[float, float], ...]
    error: FloatArray
    share: FloatArray
    cause: str

    def worst(self) -> tuple[int, int, int]:
        """Band, output and input of the largest error."""
        at = np.unravel_index(int(np.nanargmax(self.error)), self.error.shape)
        return int(at[0]), int(at[1]), int(at[2])


def where(ground: CommonGround) -> Where:
    """Differences of B from A, in up to four bands of equal ratio of frequency."""
    f = ground.frequency
    edges = np.geomspace(f[0], f[-1], _BANDS + 1) if len(f) > 1 else np.array([f[0], f[0]])
    inside = [(f >= low) & ((f < high) | (high == edges[-1])) for low, high in pairwise(edges)]
    inside = [rows for rows in inside if rows.any()]
    squared = np.where(ground.valid, np.abs(ground.b - ground.a) ** 2, 0.0)
    own = np.where(ground.valid, np.abs(ground.a) ** 2, 0.0)
    difference = np.array([squared[rows].sum(axis=0) for rows in inside])
    size = np.array([own[rows].sum(axis=0).max() for rows in inside])
    known = np.array([ground.valid[rows].any(axis=0) for rows in inside])
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.where(known, np.sqrt(difference / size[:, None, None]), np.nan)
    total = max(float(difference.sum()), np.finfo(float).tiny)
    share = difference / total
    bands = tuple((float(f[rows][0]), float(f[rows][-1])) for rows in inside)
    return Where(bands, error, share, likeliest_cause(ground, share, bands))


def where_words(found: Where, ground: CommonGround) -> str:
    """E.g. ``They differ most at point 3 from A2 at 188 to 500 Hz: by 24 % of the largest entry there``."""
    if not np.nanmax(found.error, initial=0.0) > _NOTHING:
        return "They do not differ"
    b, o, i = found.worst()
    low, high = found.bands[b]
    return (f"They differ most at point {ground.outputs[o].name} from {ground.inputs[i].name} at {low:.3g} to "
            f"{high:.3g} Hz: by {percent(found.error[b, o, i])} of the largest entry there")  # fmt: skip


def percent(share: float) -> str:
    """E.g. ``24 %`` or ``150 %``."""
    return f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.0f} %"


def likeliest_cause(ground: CommonGround, share: FloatArray, bands: tuple[tuple[float, float], ...]) -> str:
    """The likeliest cause first: a mistake of units, convention or wiring, other scenarios, a gain, one channel, one
    band, or tissue."""
    if said := explained(ground):
        return said
    a, b = (np.where(ground.valid, m, 0) for m in (ground.a, ground.b))
    before = _left(a, b)
    if before < _NOTHING:
        return ""
    if said := other_scenario(ground):
        return said
    names = [p.name for p in ground.outputs], [p.name for p in ground.inputs]
    for what, axes in (("one gain", None), ("a gain of each actuator", (0, 1)), ("a gain of each point", (0, 2))):
        gain = _gains(a, b, axes)
        after = _left(a, np.asarray(b * gain, dtype=complex))
        if after <= _HALF * before:
            return (f"{what} explains most: {_gain_words(gain, axes, names)}. Then e_band is {after:.2g} instead of "
                    f"{before:.2g}; check calibration and contact")  # fmt: skip
    for axis, kind in ((2, "actuator"), (1, "point")):
        by = share.sum(axis=tuple(k for k in range(3) if k != axis))
        k = int(by.argmax())
        if by[k] >= max(_MOST, 2 / len(by)) and len(by) > 1:
            name = names[2 - axis][k] if axis == 1 else names[1][k]
            advice = "check its contact and its coil" if kind == "actuator" else "check where it was measured"
            return f"{kind} {name} alone holds {by[k]:.0%} of the squared difference; {advice}"
    by = share.sum(axis=(1, 2))
    k = int(by.argmax())
    told = ""
    if len(by) > 1 and by[k] >= _MOST:
        told = f" most of it at {bands[k][0]:.3g} to {bands[k][1]:.3g} Hz ({by[k]:.0%});"
    return (f"no single gain, channel or mistake explains the difference:{told} tissue, contact and model remain, and "
            "`forearm-fem fit` tells which parameters")  # fmt: skip


_NO_PHYSICS = (
    "name",
    "description",
    "accuracy",
    "rendering",
    "measurement",
    "mesh",
    "solver",
    "sweep",
    "schema_version",
)
_NAMED = 5  # keys in a sentence


def other_scenario(ground: CommonGround) -> str:
    """In which keys the scenarios differ that both were simulated by; empty where one is measured, or they agree."""
    a, b = (p.get("scenario") for p in ground.provenance)
    if not isinstance(a, Mapping) or not isinstance(b, Mapping):
        return ""
    keys = [k for top in dict.fromkeys((*a, *b)) if top not in _NO_PHYSICS for k in _apart(a.get(top), b.get(top), top)]
    keys = ["limb.shape" if k.startswith("limb.") and "limb.shape" in keys else k for k in keys]
    found = list(dict.fromkeys(keys))
    if not found:
        return ""
    more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    return f"the two were simulated by scenarios that differ in {', '.join(found[:_NAMED])}{more}"


def _apart(a: Any, b: Any, key: str) -> list[str]:
    """Dotted keys in which ``a`` and ``b`` differ."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return [k for name in dict.fromkeys((*a, *b)) for k in _apart(a.get(name), b.get(name), f"{key}.{name}")]
    return [] if a == b else [key]


def _left(a: ComplexArray, b: ComplexArray) -> float:
    """Norm of the difference over that of ``a``."""
    return float(np.linalg.norm(b - a) / max(float(np.linalg.norm(a)), np.finfo(float).tiny))


def _gains(a: ComplexArray, b: ComplexArray, axes: tuple[int, ...] | None) -> FloatArray:
    """Real factors on ``b`` that bring it nearest to ``a``, one over ``axes``."""
    cross = np.real(b.conj() * a).sum(axis=axes, keepdims=True)
    own = (np.abs(b) ** 2).sum(axis=axes, keepdims=True)
    return np.asarray(np.divide(cross, own, out=np.ones_like(own), where=own > 0))


def _gain_words(gain: FloatArray, axes: tuple[int, ...] | None, names: tuple[list[str], list[str]]) -> str:
    if axes is None:
        return f"B times {float(gain.ravel()[0]):.3g}"
    own = names[1] if axes == (0, 1) else names[0]
    off = [(n, g) for n, g in zip(own, gain.ravel(), strict=True) if abs(g - 1) > _ONE]
    rest = ", the others as they are" if len(off) < len(own) else ""
    return f"B's {', '.join(f'{n} times {g:.3g}' for n, g in off)}{rest}"
