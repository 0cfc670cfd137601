"""Where two transfer matrices differ: over points, actuators and bands of frequency, and by what simple cause."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...typing import ComplexArray, FloatArray
from .common import CommonGround
from .readings import explained

_BANDS = 4
_HALF = 0.5  # of the difference: a cause that takes away as much is named
_MOST = 0.5  # of the squared difference: one channel that holds as much is named, where its fair share is half of it
_NOTHING = 1e-9


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
    """Where B differs from A, in up to four bands of equal ratio of frequency."""
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
            f"{high:.3g} Hz: by {100 * found.error[b, o, i]:.2g} % of the largest entry there")  # fmt: skip


def likeliest_cause(ground: CommonGround, share: FloatArray, bands: tuple[tuple[float, float], ...]) -> str:
    """The likeliest cause first: a mistake of units, convention or wiring, a gain, one channel, one band, or tissue."""
    if said := explained(ground):
        return said
    a, b = (np.where(ground.valid, m, 0) for m in (ground.a, ground.b))
    before = _left(a, b)
    if before < _NOTHING:
        return ""
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
    told = ", ".join(f"{n} times {g:.3g}" for n, g in zip(own, gain.ravel(), strict=True))
    return f"B's {told}"
