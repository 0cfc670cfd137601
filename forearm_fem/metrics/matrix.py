"""Condition of a transfer matrix: how well it can be inverted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import DataError
from ..typing import ComplexArray, FloatArray

_SINGULAR = 1e14  # condition number that rounding alone makes of a singular matrix


@dataclass(frozen=True)
class ConditionSummary:
    """Least, median and largest condition number [-] over ``regular`` frequencies, None where that is none; at
    ``singular`` ones, which are not among these, the matrix cannot be inverted at all."""

    least: float | None
    median: float | None
    largest: float | None
    regular: int
    singular: int


def singular_values(values: ComplexArray) -> FloatArray:
    """Singular values (n, min(n_out, n_in)) of ``values`` (n, n_out, n_in), descending, in its unit.

    Take the rows of the control points first to judge an inverse filter. Matrices with NaN give NaN.
    DataError for a single matrix or a row of them, and for matrices without rows or columns.
    """
    if values.ndim != 3 or 0 in values.shape[1:]:
        raise DataError(
            f"singular values are those of (n, n_out, n_in) matrices, got {values.shape}; add the first axis"
        )
    usable = np.all(np.isfinite(values), axis=(1, 2))
    out = np.full((len(values), min(values.shape[1:])), np.nan)
    out[usable] = np.linalg.svd(values[usable], compute_uv=False)
    return out


def condition_number(values: ComplexArray) -> FloatArray:
    """s_max / s_min (n,) [-] of ``values`` (n, n_out, n_in); inf where singular, NaN where unknown.

    The relative error of G is amplified by up to this number in an unregularised drive.
    """
    s = singular_values(values)
    known = np.isfinite(s[:, 0])
    out = np.where(known, np.inf, np.nan)
    return np.divide(s[:, 0], s[:, -1], out=out, where=known & (s[:, -1] > 0))


def condition_summary(condition: FloatArray) -> ConditionSummary:
    """Summary of :func:`condition_number` (n,) over a band; frequencies where it is NaN are left out."""
    regular = condition[condition <= _SINGULAR]
    singular = int(np.count_nonzero(condition > _SINGULAR))
    if not len(regular):
        return ConditionSummary(None, None, None, 0, singular)
    return ConditionSummary(
        float(regular.min()), float(np.median(regular)), float(regular.max()), len(regular), singular
    )
