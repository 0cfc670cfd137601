"""Truncation error: of cutting the limb, from the change of G under other conditions at its ends."""

from __future__ import annotations

import numpy as np

from ..transfer import ErrorEstimate, TransferMatrix, between, relative_error_at
from ..typing import FloatArray
from .discretisation import smoothed_relative_change

# Shares of a change of ends that bracket the true error of cutting the limb (decision 0016).
OTHER_ENDS, _OTHER = 0.5, "the ends are clamped (where they are clamped: freed), on the coarser mesh"
FREED_ENDS, _FREED = 0.5, "the absorbing ends are freed (by the reduced model)"
LEAST_TOGETHER = 0.3  # of e(f): freed ends may move G by less than they err
ENOUGH_TOGETHER = 20  # frequencies, between which what entries do together can be read


def freed_ends_error(transfer: TransferMatrix, freed: TransferMatrix) -> ErrorEstimate:
    """Truncation error of G, from G with ``freed`` in place of absorbing ends on the same mesh."""
    return _truncation(transfer, transfer, freed, FREED_ENDS, _FREED)


def other_ends_error(transfer: TransferMatrix, coarse: TransferMatrix, other: TransferMatrix) -> ErrorEstimate:
    """Truncation error of G, from G on the coarser mesh with its own (``coarse``) and with ``other`` ends."""
    return _truncation(transfer, coarse, other, OTHER_ENDS, _OTHER)


def combined_truncation_error(estimates: list[ErrorEstimate]) -> ErrorEstimate:
    """The largest of ``estimates``, freed ends first, at each frequency: with ends that reflect a share r of -1
    (clamped) to 1 (free), and E what comes back from free ones, they err by |r| E and change by (1 - r) E when freed,
    (1 + r) E when clamped. Half of the larger change is (1 + |r|) E / 2 >= |r| E, half of either alone may be zero.

    Nor is less stated than at any higher frequency: E decays with frequency, but where waves are longer than the slab
    both changes may pass through small values.
    """
    if len(estimates) == 1:
        return estimates[0]
    freed, clamped = estimates
    frequency = np.unique(np.concatenate([e.frequency for e in estimates]))
    larger = np.maximum(relative_error_at(freed, frequency), interpolated_in_log_ratio(clamped, freed, frequency))
    error = np.maximum.accumulate(larger[::-1])[::-1]
    together = None
    if freed.together is not None and freed.together.any(axis=(1, 2)).all():
        together = between(freed, freed.together, frequency)
        lacking = LEAST_TOGETHER * error / np.abs(together).max(axis=(1, 2))
        together = together * np.maximum(lacking, 1.0)[:, None, None]
    method = "at each frequency the larger of " + " and ".join(e.method for e in estimates) + ", there or higher up"
    band, own = max(e.band for e in estimates), tuple(frequency.tolist())
    return ErrorEstimate("truncation", band, method, own, tuple(error.tolist()), together=together)


def interpolated_in_log_ratio(few: ErrorEstimate, many: ErrorEstimate, frequency: FloatArray) -> FloatArray:
    """e(f) (n,) of ``few`` at ``frequency`` (n,) [Hz], between its own ones in proportion to ``many``.

    What comes back from ends decays by orders of magnitude between the few frequencies that clamped ends are solved
    at, and E is common to both. A straight line, which overstates there, is never exceeded: where freed ends change
    nothing, there is no proportion.
    """
    straight, at = relative_error_at(few, frequency), np.asarray(few.frequency)
    own, other = relative_error_at(few, at), relative_error_at(many, at)
    if not (own * other > 0).all():
        return straight
    share = np.exp(np.interp(np.sqrt(frequency), np.sqrt(at), np.log(own / other)))
    return np.asarray(np.minimum(straight, share * relative_error_at(many, frequency)))


def _truncation(
    transfer: TransferMatrix, own: TransferMatrix, other: TransferMatrix, share: float, method: str
) -> ErrorEstimate:
    """A ``share`` of the change of G when the ends are changed, tested against longer limbs and endless layers.

    Waves from the ends cancel at some frequencies by chance, so e(f) listens to its neighbours as two meshes' does.
    Waves that reach the ends are long, so all pairs err about alike and are not told apart. The truth lies between
    two G that err by as much either way, and what is stated is relative to it: where ends make most of G, clamped ones
    leave nothing of it, and half of that change would be half of G at most.
    """
    same = own.values[np.searchsorted(own.frequency, other.frequency)]
    size = np.linalg.norm(same, axis=(1, 2))
    between = np.clip(np.linalg.norm(same + other.values, axis=(1, 2)) / 2, size / 2, size)
    shares = share * size / between
    change = np.linalg.norm(other.values - same, axis=(1, 2)) / size
    weight = np.linalg.norm(transfer.values, axis=(1, 2)) ** 2
    together = share * (other.values - same) / np.abs(same).max(axis=(1, 2), keepdims=True)
    spread = np.interp(np.sqrt(transfer.frequency), np.sqrt(other.frequency), shares * change)
    return ErrorEstimate(
        "truncation",
        float(np.sqrt(np.sum(weight * spread**2) / np.sum(weight))),
        f"{share:g} of the change of G when {method}, over what lies between the two where that is less",
        tuple(other.frequency.tolist()),
        tuple((shares * smoothed_relative_change(other.values, same, other.frequency)).tolist()),
        together=together if len(other.frequency) >= ENOUGH_TOGETHER else None,
    )
