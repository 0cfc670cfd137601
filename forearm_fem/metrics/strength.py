"""Signal strength S, and the thesis' table of it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import AccuracyWarning, DataError
from ..typing import BoolArray, FloatArray


def area(
    displacement: FloatArray, *, time: FloatArray | None = None, window: tuple[float, float] | None = None
) -> FloatArray:
    """Mean |u| (n_out,) [m] of ``displacement`` (n_out, n_t): the area under |u(t)| over its duration.

    Taken over ``window`` (start, end) [s] of ``time`` (n_t,) [s], or over all samples. Raises DataError for
    an empty window.
    """
    if displacement.ndim != 2 or displacement.shape[1] < 1:
        raise DataError(f"S needs displacements (n_out, n_t) with at least one sample, got {displacement.shape}")
    if window is None:
        return np.asarray(np.abs(displacement).mean(axis=1))
    if time is None:
        raise DataError("a window of S needs the time of the samples")
    if time.shape != displacement.shape[1:]:
        raise DataError(f"a window of S needs a time for each of the {displacement.shape[1]} samples, got {time.shape}")
    start, end = seconds_of(window)
    inside = (time >= start) & (time <= end)
    if not inside.any():
        raise DataError(f"no sample lies in the window {start:g} to {end:g} s")
    return np.asarray(np.abs(displacement[:, inside]).mean(axis=1))


def signal_strength(
    displacement: FloatArray,
    target: int,
    *,
    time: FloatArray | None = None,
    window: tuple[float, float] | None = None,
) -> float:
    """S [-] = area of |u| at output ``target`` over the mean area at the others, eq. 9 of de Vlam 2022.

    ``displacement`` (n_out, n_t) in any unit. The thesis does not state the time over which it integrates:
    all samples here, or ``window`` (start, end) [s] of ``time``. Rows of NaN among the others are left out of
    the mean with an AccuracyWarning; a target of NaN, or others that are all zero, give NaN and inf. Others that move
    by rounding alone (S beyond 1e6) are said by an AccuracyWarning, too. Raises DataError for fewer than two outputs
    or an empty window.
    """
    found = plain_strength(displacement, target, time=time, window=window, level=4)
    if WITHOUT_BOUND < found < np.inf:
        warnings.warn(
            f"S has no bound, {found:.1g} is what rounding leaves: all other points are still; lay more points to see "
            "what moves between",
            AccuracyWarning,
            stacklevel=3,
        )
    return found


def plain_strength(
    displacement: FloatArray,
    target: int,
    *,
    time: FloatArray | None = None,
    window: tuple[float, float] | None = None,
    level: int = 2,
) -> float:
    """:func:`signal_strength` for those who look at rounding themselves; ``level`` of the stack is the caller's."""
    if displacement.ndim != 2 or not 0 <= target < len(displacement) or len(displacement) < 2:
        raise DataError(f"S needs at least two outputs and one of them as target, got {displacement.shape}, {target}")
    areas = area(displacement, time=time, window=window)
    others = np.delete(areas, target)
    known = np.isfinite(others)
    if not np.isfinite(areas[target]) or not known.any():
        return float("nan")
    if not known.all():
        warnings.warn(
            f"S leaves out {np.count_nonzero(~known)} of {len(others)} outputs whose displacement is unknown",
            AccuracyWarning,
            stacklevel=level,
        )
    moved, elsewhere = float(areas[target]), float(others[known].mean())
    if elsewhere > 0:
        return moved / elsewhere
    return float("inf") if moved > 0 else float("nan")


def seconds_of(window: object) -> tuple[float, float]:
    """Start and end [s] of a ``window``; DataError for anything else than two numbers."""
    if isinstance(window, list | tuple | np.ndarray) and len(window) == 2:
        try:
            return float(window[0]), float(window[1])
        except (TypeError, ValueError):
            pass
    raise DataError(f"a window of S is start and end in seconds, e.g. (-0.05, 0.05), got {window!r}")


WITHOUT_BOUND = 1e6  # of S: beyond it rounding is all that moves the other points


def without_bound(methods: Sequence[str], targets: Sequence[str], strengths: FloatArray) -> str:
    """A sentence where some of ``strengths`` (n_method, n_target) [-] are made of rounding, else empty."""
    finite = np.where(np.isfinite(strengths), strengths, 0.0)
    if not finite.max(initial=0.0) > WITHOUT_BOUND:
        return ""
    m, t = (int(k) for k in np.unravel_index(int(finite.argmax()), finite.shape))
    return (
        f"S of {methods[m]} towards {targets[t]} has no bound, {finite[m, t]:.1g} is what rounding leaves: actuators "
        "are enough to hold all other points still; lay more points (grid) to see what moves between"
    )


def numerics_words(low: float, high: float) -> str:
    """E.g. ``1.30-1.32``, or that S does not move in its second decimal."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return "unknown"
    return f"{low:.2f}-{high:.2f}" if f"{low:.2f}" != f"{high:.2f}" else "below ±0.01"


def strength_text(value: float) -> str:
    """S in words: two decimals; two digits from a thousand on, where the others hardly move."""
    return f"{value:.2f}" if not value >= 1000 else f"{value:.2g}"


GROUPS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("Middle (5)", ("5",)),
    ("Edges (2/4/6/8)", ("2", "4", "6", "8")),
    ("Corners (1/3/7/9)", ("1", "3", "7", "9")),
)


@dataclass(frozen=True, eq=False)
class StrengthTable:
    """S by place on the grid: ``mean`` and ``std`` (n_group, n_method) [-]; ``std`` is NaN for a single target."""

    methods: tuple[str, ...]
    groups: tuple[str, ...]
    mean: FloatArray
    std: FloatArray

    def as_text(self) -> str:
        """The table in lines of text, mean or mean ± std, laid out as the thesis' Table I."""
        cells = [
            [
                strength_text(m) if np.isnan(s) or s < 0.005 else f"{strength_text(m)} ± {strength_text(s)}"
                for m, s in zip(ms, ss, strict=True)
            ]
            for ms, ss in zip(self.mean, self.std, strict=True)
        ]
        rows = [["", *self.methods], *([g, *row] for g, row in zip(self.groups, cells, strict=True))]
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
        return "\n".join("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def signal_strength_table(
    methods: Sequence[str], targets: Sequence[str], strengths: FloatArray, counted: BoolArray | None = None
) -> StrengthTable:
    """Middle, edges and corners of ``strengths`` (n_method, n_target) [-]: mean and standard deviation (N - 1).

    N - 1 is MATLAB's `std`, in which the thesis was computed. Groups with no target are left out, groups with
    some of theirs are averaged over these; targets that are not ``counted`` (n_target,) are in none. Raises DataError
    if a target is none of the 3 x 3 grid's "1".."9".
    """
    values = np.asarray(strengths, dtype=float)
    if values.shape != (len(methods), len(targets)):
        raise DataError(f"strengths have shape {values.shape}, expected {(len(methods), len(targets))}")
    if stray := sorted(set(targets) - {t for _, group in GROUPS for t in group}):
        raise DataError(f"Table I is for a 3 x 3 grid of targets 1 to 9, got also {', '.join(stray)}")
    groups, means, stds = [], [], []
    for label, members in GROUPS:
        columns = [i for i, t in enumerate(targets) if t in members and (counted is None or counted[i])]
        if columns:
            groups.append(label)
            means.append(values[:, columns].mean(axis=1))
            alone = np.full(len(methods), np.nan)
            with np.errstate(invalid="ignore"):  # an S may be inf
                stds.append(values[:, columns].std(axis=1, ddof=1) if len(columns) > 1 else alone)
    shape = (len(groups), len(methods))
    return StrengthTable(tuple(methods), tuple(groups), np.reshape(means, shape), np.reshape(stds, shape))


def thesis_table() -> StrengthTable:
    """Table I of de Vlam 2022: S measured on participant 2, one person, with the laser vibrometer's G."""
    return StrengthTable(
        methods=("inverse filter", "funneling", "combination"),
        groups=tuple(label for label, _ in GROUPS),
        mean=np.array([[1.31, 0.63, 1.72], [1.34, 0.67, 1.69], [2.25, 2.42, 2.60]]),
        std=np.array([[np.nan] * 3, [0.09, 0.32, 0.19], [0.56, 0.79, 0.92]]),
    )
