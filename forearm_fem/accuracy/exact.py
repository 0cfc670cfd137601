"""Error of G on a slab: its difference from the layered model, which has no mesh and no ends."""

from __future__ import annotations

import numpy as np

from ..transfer import ErrorEstimate, ErrorSource, TransferMatrix, relative_error_at
from ..typing import FloatArray
from .truncation import freed_ends_error

_METHOD = "difference from the layered model"


def known_errors(
    transfer: TransferMatrix, exact: TransferMatrix, freed: TransferMatrix | None
) -> tuple[ErrorEstimate, ...]:
    """Errors of G by mesh and ends, from ``exact`` G of the same layers without end, whose own error is added.

    Truncation has the more of the squared difference the larger half of the change by ``freed`` ends is beside it, and
    discretisation the rest. Without freed ends all of it is called discretisation.
    """
    off = exact.values - transfer.values
    largest, other = (np.abs(g.values).max(axis=(1, 2)) for g in (transfer, exact))
    size = np.minimum(largest, other)
    error = np.abs(off).max(axis=(1, 2)) / size
    own = sum((relative_error_at(e, transfer.frequency) for e in exact.errors), np.zeros(len(error)))
    grown = 1 + np.divide(own, error, out=np.zeros(len(error)), where=error > 0)

    def part(source: ErrorSource, share: FloatArray, method: str) -> ErrorEstimate:
        """The ``share`` (n_frequency,) of the squared difference."""
        off_by = (np.sqrt(share) * grown)[:, None, None] * np.abs(off)
        pairs = off_by / size[:, None, None]
        return ErrorEstimate(
            source,
            float(np.linalg.norm(off_by) / np.linalg.norm(exact.values)),
            method,
            tuple(transfer.frequency.tolist()),
            tuple(pairs.max(axis=(1, 2)).tolist()),
            pairs,
            (share / largest)[:, None, None] * off,
            exact=True,
        )

    if freed is None:
        return (part("discretisation", np.ones(len(error)), f"{_METHOD}, cut ends included"),)
    ends = relative_error_at(freed_ends_error(transfer, freed), transfer.frequency)
    share = np.divide(ends**2, ends**2 + error**2, out=np.zeros(len(error)), where=error > 0)
    return (
        part("discretisation", 1 - share, f"{_METHOD}, beside what freed ends change"),
        part("truncation", share, f"{_METHOD}, by half the change of G when the absorbing ends are freed"),
    )
