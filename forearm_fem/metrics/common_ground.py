"""Ports (by name and place) and frequencies that two G have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import median_filter

from ..errors import DataError
from ..ports import Port
from ..transfer import TransferMatrix
from ..typing import BoolArray, ComplexArray, FloatArray

# Ports of two transfer matrices matched by name and by place, and what to say where the two do not agree.

_NEAR = 0.25  # of the smallest distance between A's ports: closer ones are at the same place
_CLOSE = 1e-3  # m: what no word is lost about
_SHAPE = 0.02  # of the ports' spread: how well a scaled or mirrored layout must fit to be called so

_SIGNS = (((1, 1), ""), ((-1, 1), ", mirrored in x"), ((1, -1), ", mirrored in y"), ((-1, -1), ", turned around"))


def matched(ours: tuple[Port, ...], theirs: tuple[Port, ...], what: str) -> tuple[list[int], str]:
    """Positions in ``theirs`` of the partners of ``ours``, by name, or by place where the names differ, and a note.

    ``what`` is "outputs" or "inputs". The note says where names and places disagree ("" where they do not, or where one
    side does not know its places). Places are compared in the plane of the skin (x, y). DataError where neither names
    nor places pair all ports.
    """
    names = [p.name for p in theirs]
    by_place = _by_place(_plane(ours), _plane(theirs))
    if len(set(names)) == len(names) and sorted(names) == sorted(p.name for p in ours):
        order = [names.index(p.name) for p in ours]
        return order, _disagreement(ours, theirs, order, by_place, what)
    if by_place is None and (lacking := _lacking(ours, theirs)):
        raise DataError(
            f"{what}: {lacking}; compare needs the same {what} in both: leave the others out of one, "
            "or compare them as devices, as runs (`forearm-fem render FILE` makes one)"
        )
    if by_place is None:
        raise DataError(
            f"the {what} of A ({_listed(ours)}) and B ({_listed(theirs)}) pair neither by name nor by place; "
            "rename them"
        )
    pairs = ", ".join(f"{p.name} = {names[k]}" for p, k in zip(ours, by_place, strict=True) if p.name != names[k])
    return by_place, f"the {what} have different names and are matched by place, A = B: {_short(pairs, 180)}"


def _lacking(ours: tuple[Port, ...], theirs: tuple[Port, ...]) -> str:
    """Names of the ports that one side has beyond those of the other; "" where neither holds all of the other's."""
    a, b = ({p.name for p in side} for side in (ours, theirs))
    if not a < b and not b < a:
        return ""
    more = tuple(p for p in (*ours, *theirs) if p.name in a ^ b)
    return f"{'A lacks' if a < b else 'B lacks'} {_listed(more)} of {'B' if a < b else 'A'}"


def _plane(ports: tuple[Port, ...]) -> FloatArray | None:
    """Places (n, 2) [m], None where they are not known: not finite, or all the same."""
    place = np.array([p.position[:2] for p in ports], dtype=float).reshape(-1, 2)
    known = len(place) > 0 and np.isfinite(place).all() and (len(place) == 1 or float(np.ptp(place, axis=0).max()) > 0)
    return place if known else None


def _by_place(ours: FloatArray | None, theirs: FloatArray | None) -> list[int] | None:
    """Index of the one port of ``theirs`` at each place of ``ours``; None where that is no pairing of all."""
    if ours is None or theirs is None or len(ours) != len(theirs):
        return None
    spacing = 0.01  # m, of a single place
    if len(ours) > 1:
        spacing = float(np.linalg.norm(ours[:, None] - ours, axis=2)[np.triu_indices(len(ours), 1)].min())
    apart = np.linalg.norm(ours[:, None] - theirs, axis=2)
    nearest = apart.argmin(axis=1)
    if len(set(nearest.tolist())) < len(ours) or apart.min(axis=1).max() > _NEAR * spacing:
        return None
    return [int(k) for k in nearest]


def _disagreement(
    ours: tuple[Port, ...], theirs: tuple[Port, ...], order: list[int], by_place: list[int] | None, what: str
) -> str:
    """Sentence on ports that bear the same names."""
    if by_place is not None and by_place != order:
        moved = [f"A's {p.name} = B's {theirs[k].name}" for p, k in zip(ours, by_place, strict=True)]
        moved = [m for m, (k, o) in zip(moved, zip(by_place, order, strict=True), strict=True) if k != o]
        return (
            f"names and places of the {what} disagree: by place {_short(', '.join(moved), 110)}; they are compared by "
            f"name. If the places are right, rename B's {what}"
        )
    a, b = _plane(ours), _plane(theirs)
    if a is None or b is None:
        return ""
    b = b[order]
    furthest = float(np.linalg.norm(b - a, axis=1).max())
    if furthest <= _CLOSE:
        return ""
    how = _transform(a, b)
    return (
        f"the {what} of the same name lie up to {1e3 * furthest:.3g} mm apart in A and B{how}; they are compared by "
        "name as if they were at one place: correct the positions, or expect G to differ"
    )


def _transform(a: FloatArray, b: FloatArray) -> str:
    """Transformation of A's layout (n, 2) into B's, where it is a shift, a factor or a mirror image."""
    shift = (b - a).mean(axis=0)
    spread = max(float(np.linalg.norm(a - a.mean(axis=0), axis=1).max()), _CLOSE)
    if float(np.linalg.norm(b - a - shift, axis=1).max()) <= _SHAPE * spread:
        return f" (B is shifted by {1e3 * shift[0]:.3g}, {1e3 * shift[1]:.3g} mm)"
    from_centre, other = a - a.mean(axis=0), b - b.mean(axis=0)
    for signs, said in _SIGNS:
        turned = from_centre * np.array(signs)
        factor = float((turned * other).sum() / (turned**2).sum()) if len(a) > 1 else 0.0
        if factor > 0 and float(np.linalg.norm(other - factor * turned, axis=1).max()) <= _SHAPE * spread * factor:
            size = "" if abs(factor - 1) <= _SHAPE else f" {factor:.3g} times as wide"
            return f" (B's layout is{size or ' the same'}{said})"
    return ""


def _listed(ports: tuple[Port, ...]) -> str:
    return _short(", ".join(p.name for p in ports), 80)


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[:most].rsplit(', ', 1)[0]}, ..."


# Two transfer matrices on common ground: the same frequencies and entries, with what is missing kept in sight.

_SAME = 1e-6  # relative: frequencies closer than this are the same
_GAP = 3.0  # an interval this much wider than the median of those about it is a gap
_ABOUT = 9  # intervals
_EXACT = 0.01  # e_band of interpolation that no word is lost about
_SHORTEST = 8  # samples in a row that a spline needs


@dataclass(frozen=True, eq=False)
class CommonGround:
    """``a`` and ``b`` (n, n_out, n_in) in one unit at ``frequency`` (n,) [Hz]; ``valid`` where both are known.

    ``deviation_a`` and ``deviation_b`` (n, n_out, n_in), None if unknown. ``interpolated`` names the one
    that was splined to the other's frequencies ("", "a" or "b"); ``only_a`` and ``only_b`` are the parts of
    the bands [Hz] that the other does not cover; ``covered`` [-] is the share of entries compared. ``notes`` say where
    ports were matched by place, where names and places disagree, which entries one of the two lacks, and what
    interpolation may cost.
    """

    frequency: FloatArray
    a: ComplexArray
    b: ComplexArray
    valid: BoolArray
    deviation_a: FloatArray | None
    deviation_b: FloatArray | None
    outputs: tuple[Port, ...]
    inputs: tuple[Port, ...]
    unit: str
    interpolated: str
    only_a: tuple[tuple[float, float], ...]
    only_b: tuple[tuple[float, float], ...]
    notes: tuple[str, ...] = ()
    provenance: tuple[Mapping[str, Any], Mapping[str, Any]] = ({}, {})

    @property
    def covered(self) -> float:
        """Share of (frequency, output, input) of the common frequencies at which both are valid."""
        return float(self.valid.mean())

    @property
    def whole_outputs(self) -> BoolArray:
        """Outputs (n_out,) that both know from every input, at some frequency at least."""
        return np.asarray(np.all(np.any(self.valid, axis=0), axis=1))

    @property
    def omega(self) -> FloatArray:
        """Angular frequency [rad/s]."""
        return np.asarray(2 * np.pi * self.frequency)


def common_ground(a: TransferMatrix, b: TransferMatrix) -> CommonGround:
    """``a`` and ``b`` at the frequencies both cover.

    Where all frequencies of the coarser grid are found in the finer one they are copied; otherwise the finer one is
    interpolated by a cubic spline to the coarser one's, never across a gap, an invalid sample or beyond its ends. Ports
    are matched by name, or by place where names differ, and may come in another order (:func:`.places.matched`).
    DataError for different units, ports without partner, no common frequency, or no entry known to both.
    """
    if a.unit != b.unit:
        raise DataError(
            f"A is in {a.unit}, B in {b.unit}: these cannot be compared; make both with one device.drive "
            "('voltage' gives m/V, 'force' m/N, 'displacement' m/m), or correct the unit declared"
        )
    _check(a, "A")
    _check(b, "B")
    theirs_from = b.provenance
    b, notes = _matched(a, b)
    coarse_is_a = _within(a, b) <= _within(b, a)
    coarse, fine = (a, b) if coarse_is_a else (b, a)
    frequency = _shared(coarse, fine)
    first, second = _at(coarse, frequency), _at(fine, frequency)
    ours, theirs = (first, second) if coarse_is_a else (second, first)
    splined = "" if second.error is None else ("b" if coarse_is_a else "a")
    valid = ours.valid & theirs.valid
    if not valid.any():
        raise DataError(_nothing_shared(ours.valid, theirs.valid))
    return CommonGround(
        frequency=frequency,
        a=ours.values,
        b=theirs.values,
        valid=valid,
        deviation_a=ours.deviation,
        deviation_b=theirs.deviation,
        outputs=a.outputs,
        inputs=a.inputs,
        unit=a.unit,
        interpolated=splined,
        only_a=_uncovered(a.frequency, b.frequency),
        only_b=_uncovered(b.frequency, a.frequency),
        notes=(*notes, *_lacking_common(ours.valid, theirs.valid, a), *_guessed(splined.upper(), fine, second.error)),
        provenance=(a.provenance, theirs_from),
    )


def _nothing_shared(ours: BoolArray, theirs: BoolArray) -> str:
    """Reason that there is nothing to compare."""
    shares = [f"{name} knows {100 * v.mean():.3g} %" for name, v in (("A", ours), ("B", theirs))]
    return (
        f"A and B know no entry in common: {' and '.join(shares)} of its entries at the common frequencies, the rest "
        "is marked invalid or not finite; measure or solve it again"
    )


def _lacking_common(ours: BoolArray, theirs: BoolArray, g: TransferMatrix) -> tuple[str, ...]:
    """Entries that one of the two knows at no common frequency, a sentence for each of A and B."""
    said = []
    for name, valid in (("A", ours), ("B", theirs)):
        missing = [f"{g.outputs[o].name} <- {g.inputs[i].name}" for o, i in np.argwhere(~valid.any(axis=0))]
        if missing:
            more = f" and {len(missing) - 6} more" if len(missing) > 6 else ""
            said.append(f"{name} knows nothing of {', '.join(missing[:6])}{more}: these are in no figure below")
    return tuple(said)


def _check(g: TransferMatrix, name: str) -> None:
    expected = (len(g.frequency), len(g.outputs), len(g.inputs))
    if g.values.shape != expected:
        raise DataError(f"{name} has shape {g.values.shape}, its frequencies and ports say {expected}")
    if len(g.frequency) == 0 or np.any(np.diff(g.frequency) <= 0):
        raise DataError(f"the frequencies of {name} must increase, and there must be some")


def _matched(a: TransferMatrix, b: TransferMatrix) -> tuple[TransferMatrix, tuple[str, ...]]:
    """``b`` with its ports in the order of ``a``'s, and what is to be said of the matching."""
    (rows, first), (columns, second) = (matched(getattr(a, k), getattr(b, k), k) for k in ("outputs", "inputs"))
    pick = np.ix_(np.arange(len(b.frequency)), np.array(rows), np.array(columns))
    ordered = TransferMatrix(
        b.frequency,
        b.values[pick],
        tuple(b.outputs[r] for r in rows),
        tuple(b.inputs[c] for c in columns),
        b.unit,
        valid=None if b.valid is None else b.valid[pick],
        deviation=None if b.deviation is None else b.deviation[pick],
    )
    return ordered, tuple(note for note in (first, second) if note)


def _within(g: TransferMatrix, other: TransferMatrix) -> int:
    """Number of frequencies of ``g`` within the other's band."""
    f = g.frequency
    low, high = other.frequency[0] * (1 - _SAME), other.frequency[-1] * (1 + _SAME)
    return int(np.count_nonzero((f >= low) & (f <= high)))


def _shared(coarse: TransferMatrix, fine: TransferMatrix) -> FloatArray:
    f = coarse.frequency
    frequency = f[(f >= fine.frequency[0] * (1 - _SAME)) & (f <= fine.frequency[-1] * (1 + _SAME))]
    if len(frequency) == 0:
        raise DataError(
            f"A and B share no frequency: {coarse.frequency[0]:g}-{coarse.frequency[-1]:g} Hz and "
            f"{fine.frequency[0]:g}-{fine.frequency[-1]:g} Hz"
        )
    return np.asarray(frequency)


@dataclass(frozen=True, eq=False)
class _Sampled:
    values: ComplexArray
    valid: BoolArray
    deviation: FloatArray | None
    error: float | None = None  # e_band of what was splined, None where all was copied


def _at(g: TransferMatrix, frequency: FloatArray) -> _Sampled:
    """``g`` at ``frequency``: copied where it has these samples, else splined."""
    valid = np.isfinite(g.values) if g.valid is None else g.valid & np.isfinite(g.values)
    nearest = np.abs(g.frequency[:, None] - frequency).argmin(axis=0)
    same = np.abs(g.frequency[nearest] / frequency - 1) < _SAME
    deviation = None if g.deviation is None else g.deviation[nearest]
    values, known = np.where(valid, g.values, 0)[nearest], valid[nearest]
    if same.all():
        return _Sampled(values, known, deviation)
    splined, filled, error = _splined(g.frequency, np.where(valid, g.values, 0), valid, frequency)
    pick = same[:, None, None]
    return _Sampled(np.where(pick, values, splined), np.where(pick, known, filled), deviation, error)


def _splined(
    x: FloatArray, values: ComplexArray, valid: BoolArray, at: FloatArray
) -> tuple[ComplexArray, BoolArray, float]:
    """Cubic splines per unbroken run of valid samples, nothing elsewhere; and what they may err by, as e_band."""
    out, known = (
        np.zeros((len(at), *values.shape[1:]), dtype=complex),
        np.zeros((len(at), *values.shape[1:]), dtype=bool),
    )
    wide, off, size = _wide(x), 0.0, 0.0
    for o, i in np.ndindex(*values.shape[1:]):
        broken = wide | ~valid[1:, o, i] | ~valid[:-1, o, i]
        for run in np.split(np.arange(len(x)), np.nonzero(broken)[0] + 1):
            inside = (at >= x[run[0]]) & (at <= x[run[-1]])
            if len(run) >= _SHORTEST and inside.any():
                out[inside, o, i] = CubicSpline(x[run], values[run, o, i])(at[inside])
                known[inside, o, i] = True
                squares = _off(x[run], values[run, o, i])
                off, size = off + squares[0], size + squares[1]
    return out, known, float(np.sqrt(off / size)) if size > 0 else 0.0


def _off(x: FloatArray, y: ComplexArray) -> tuple[float, float]:
    """Squared norms of what a spline through ``y`` at ``x`` may err by, and of ``y``, at every other sample.

    That is an eighth of what a spline through the rest misses them by, as half the step divides an error by 16 and
    more; a third where that is half of ``y`` or more: waves then turn between the rest.
    """
    miss = float(np.linalg.norm(CubicSpline(x[::2], y[::2])(x[1:-1:2]) - y[1:-1:2]))
    size = float(np.linalg.norm(y[1:-1:2]))
    return (miss / (8 if miss < size / 2 else 3)) ** 2, size**2


def _wide(x: FloatArray) -> BoolArray:
    """True where an interval of ``x`` is a gap: wider than those about it, as axes may grow coarser by and by."""
    step = np.diff(x)
    return np.asarray(step > _GAP * median_filter(step, _ABOUT, mode="nearest")) if len(step) else step > 0


def _guessed(name: str, fine: TransferMatrix, error: float | None) -> tuple[str, ...]:
    """Sentences on a matrix whose interpolation may count."""
    if error is None or error <= _EXACT:
        return ()
    step = float(np.diff(fine.frequency)[~_wide(fine.frequency)].max())
    return (
        f"{name} is interpolated between samples up to {step:.3g} Hz apart, which alone may make an e_band of "
        f"{error:.2g}: the figures below hold it; solve or measure {name} at the frequencies of the other",
    )


def _uncovered(ours: FloatArray, theirs: FloatArray) -> tuple[tuple[float, float], ...]:
    """Parts of our band beyond the other's ends, and in its gaps."""
    parts = [(float(ours[0]), float(theirs[0]))] if ours[0] < theirs[0] * (1 - _SAME) else []
    gaps = [(float(theirs[k]), float(theirs[k + 1])) for k in np.flatnonzero(_wide(theirs))]
    parts += [(a, b) for a, b in gaps if ((ours > a * (1 + _SAME)) & (ours < b * (1 - _SAME))).any()]
    parts += [(float(theirs[-1]), float(ours[-1]))] if ours[-1] > theirs[-1] * (1 + _SAME) else []
    return tuple(parts)
