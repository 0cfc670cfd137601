"""Truncation error: of cutting the limb, from the change of G under other conditions at its ends."""

from __future__ import annotations

import numpy as np

from ..transfer import ErrorEstimate, TransferMatrix
from .discretisation import smoothed_relative_change

SHARE = 0.5  # of the change by other ends: the error of cutting the limb (decision 0016)
ENOUGH_TOGETHER = 20  # frequencies, between which what entries do together can be read


def freed_ends_error(transfer: TransferMatrix, freed: TransferMatrix) -> ErrorEstimate:
    """Truncation error of G, from G with ``freed`` in place of absorbing ends on the same mesh."""
    return _truncation(transfer, transfer, freed, "the absorbing ends are freed (by the reduced model)")


def other_ends_error(transfer: TransferMatrix, coarse: TransferMatrix, other: TransferMatrix) -> ErrorEstimate:
    """Truncation error of G, from G on the coarser mesh with its own (``coarse``) and with ``other`` ends."""
    method = "the ends are clamped (where they are clamped: freed), on the coarser mesh"
    return _truncation(transfer, coarse, other, method)


def _truncation(transfer: TransferMatrix, own: TransferMatrix, other: TransferMatrix, method: str) -> ErrorEstimate:
    """Half of the change of G when the ends are changed, tested against longer limbs and endless layers.

    Waves from the ends cancel at some frequencies by chance, so e(f) listens to its neighbours as two meshes' does.
    Waves that reach the ends are long, so all pairs err about alike and are not told apart. The truth lies between
    two G that err by as much either way, and what is stated is relative to it: where ends make most of G, clamped ones
    leave nothing of it, and half of that change would be half of G at most.
    """
    same = own.values[np.searchsorted(own.frequency, other.frequency)]
    size = np.linalg.norm(same, axis=(1, 2))
    between = np.clip(np.linalg.norm(same + other.values, axis=(1, 2)) / 2, size / 2, size)
    shares = SHARE * size / between
    change = np.linalg.norm(other.values - same, axis=(1, 2)) / size
    weight = np.linalg.norm(transfer.values, axis=(1, 2)) ** 2
    together = SHARE * (other.values - same) / np.abs(same).max(axis=(1, 2), keepdims=True)
    spread = np.interp(np.sqrt(transfer.frequency), np.sqrt(other.frequency), shares * change)
    return ErrorEstimate(
        "truncation",
        float(np.sqrt(np.sum(weight * spread**2) / np.sum(weight))),
        f"{SHARE:g} of the change of G when {method}, over what lies between the two where that is less",
        tuple(other.frequency.tolist()),
        tuple((shares * smoothed_relative_change(other.values, same, other.frequency)).tolist()),
        together=together if len(other.frequency) >= ENOUGH_TOGETHER else None,
    )
