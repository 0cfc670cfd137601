"""Discretisation error from a second mesh, whose nodes lie a little further apart."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..geometry.device.layout import RIGID
from ..scenario import Scenario
from ..scenario.limb import MeshLimb, SlabLimb
from ..transfer import ErrorEstimate, TransferMatrix, band_error, relative_error
from ..typing import ComplexArray, FloatArray
from .estimates import raised_to_row_column_mean

# Size ratio of the second mesh, where it can be made. One twice as coarse carries no waves where the first one just
# does: between 2 and 57 times the error was its change under rigid cones, that of this one 2 to 6 times.
COARSER = math.sqrt(2)
# Orders of convergence by the elements around the ports; third order loses some of it at points beside rims, where
# fields are singular (nearer than BESIDE [m] to a rigid one, or as Scenario.beside_discs has it), and on limbs other
# than slabs, whose layers are one element thick on both meshes.
SECOND_ORDER, THIRD_ORDER, THIRD_ROUGH = 2.1, 3.6, 2.9
BESIDE = 3e-3
# Where G changes by more than FAR_OFF, the second mesh carries waves worse than its order says, and the error follows
# the change to the power GROWS, as far as LOST: larger changes were not looked at.
FAR_OFF, LOST, GROWS = 0.03, 0.1, 0.6
_NEIGHBOURHOOD = 1.25  # e(f) listens to frequencies up to this ratio away (a third of an octave)


@dataclass(frozen=True, eq=False)
class DiscretisationError:
    """Discretisation error of values on one mesh: ``band`` e_band and ``error`` e(f) (n_frequency,), as of
    :func:`estimated_errors`."""

    band: float
    error: FloatArray


def order_of(scenario: Scenario) -> tuple[float, float]:
    """Order of convergence of G, and the change of G beyond which its error grows more slowly.

    That change is :data:`FAR_OFF` on slabs, and infinite elsewhere or where second order ends beside a disc or lies
    under a rigid one. A mesh of the user's, whose element pair changes in place of its sizes, has the lowest order.
    """
    far_off = FAR_OFF if isinstance(scenario.limb, SlabLimb) else math.inf
    if scenario.element not in ("P2/P3", "P3") or isinstance(scenario.limb, MeshLimb):
        rigid = scenario.device.cone.contact in RIGID
        return SECOND_ORDER, math.inf if rigid or scenario.beside_discs else far_off
    if not isinstance(scenario.limb, SlabLimb):
        return THIRD_ROUGH, far_off
    device, reach = scenario.device, scenario.device.cone.radius + BESIDE
    rigid = device.cone.contact in RIGID
    gaps = (math.dist(place, centre) for place in scenario.grid.places for centre in device.centres)
    beside = any(gap < reach for gap in gaps) if rigid else bool(scenario.beside_discs)
    return THIRD_ROUGH if beside else THIRD_ORDER, far_off


def discretisation_of(fine: TransferMatrix, coarse: TransferMatrix, scenario: Scenario) -> ErrorEstimate:
    """Discretisation error of G on the ``fine`` mesh by its change on the ``coarse`` one."""
    ratio, (order, far_off) = float(coarse.provenance["ratio"]), order_of(scenario)
    found = estimated_errors(coarse.values, fine.values, fine.frequency, ratio, order, far_off)
    pairs = over_pairs(found.error, coarse.values, fine.values, fine.frequency)
    largest, change = np.abs(fine.values).max(axis=(1, 2), keepdims=True), band_error(coarse.values, fine.values)
    together = (coarse.values - fine.values) / largest * (found.band / change if change > 0 else 0.0)
    return ErrorEstimate(
        "discretisation",
        found.band,
        f"change of G on a second mesh, nodes {ratio:.2g} times as far apart, over |{ratio:.2g}^{order:g} - 1|",
        tuple(fine.frequency.tolist()),
        tuple(found.error.tolist()),
        pairs,
        together,
    )


def remaining_error(
    change: FloatArray, ratio: float = COARSER, order: float = SECOND_ORDER, far_off: float = math.inf
) -> FloatArray:
    """Relative error of a mesh from the relative ``change`` to one whose sizes are ``ratio`` (not 1) times its own.

    An error C h^p changes by C h^p |ratio^p - 1|, p the ``order``, so change / |ratio^p - 1| is left. Beyond
    ``far_off`` the error grows as the change to the power :data:`GROWS`.
    """
    grown = np.maximum(np.minimum(change, LOST) / far_off, 1.0)
    return np.asarray(change * grown ** (GROWS - 1) / abs(ratio**order - 1))


def estimated_errors(
    other: ComplexArray,
    own: ComplexArray,
    frequency: FloatArray,
    ratio: float = COARSER,
    order: float = SECOND_ORDER,
    far_off: float = math.inf,
) -> DiscretisationError:
    """Discretisation error of ``own`` values (n_frequency, n_out, n_in): the one rule for scenes, arms and
    verification.

    ``other`` values are those on the second mesh, whose nodes are ``ratio`` times as far apart. Errors of two meshes
    cancel at some frequencies by chance, so e(f) at ``frequency`` (n_frequency,) [Hz], increasing, comes from the
    change there or from the change of the third of an octave on either side, whichever is larger. It is the share of
    that change which e_band is of the band's.
    """
    change = band_error(other, own)
    band = float(remaining_error(np.asarray(change), ratio, order, far_off))
    single = smoothed_relative_change(other, own, frequency) * (band / change if change > 0 else 0.0)
    return DiscretisationError(band, single)


def smoothed_relative_change(other: ComplexArray, own: ComplexArray, frequency: FloatArray) -> FloatArray:
    """e(f) (n_frequency,) of ``other`` beside ``own``, there or over the third of an octave on either side."""
    worst, largest = relative_error(other, own), np.abs(own).max(axis=(1, 2))
    around = np.sqrt(_around((worst * largest) ** 2, frequency) / _around(largest**2, frequency))
    return np.asarray(np.maximum(worst, around))


def over_pairs(error: FloatArray, other: ComplexArray, own: ComplexArray, frequency: FloatArray) -> FloatArray:
    """|dG_ij| / max_ij |G_ij| (n_frequency, n_out, n_in) of ``own`` values, as large as ``error`` e(f) (n_frequency,)
    says and shared as they change to ``other`` ones on a second mesh; alike where nothing changes.

    Pairs that change less than their output and input do in the mean do so by chance
    (:func:`.raised_to_row_column_mean`).
    """
    change = raised_to_row_column_mean(spread_change(other, own, frequency))
    largest = change.max(axis=(1, 2), keepdims=True)
    shares = np.divide(change, largest, out=np.ones_like(change), where=largest > 0)
    return np.asarray(error[:, None, None] * shares)


def spread_change(other: ComplexArray, own: ComplexArray, frequency: FloatArray) -> FloatArray:
    """Difference of ``other`` from ``own`` values (n_frequency, n, n) at each pair, in the mean over a third of an
    octave on either side: the shape over pairs of an error whose size :func:`estimated_errors` tells. Unknown pairs
    count as equal."""
    change = np.abs(np.nan_to_num(other - own)).reshape(len(frequency), -1)
    rows = [np.sqrt(_around(column**2, frequency)) for column in change.T]
    return np.array(rows).T.reshape(own.shape)


def _around(values: FloatArray, frequency: FloatArray) -> FloatArray:
    """Sum (n_frequency,) of ``values`` over :data:`_NEIGHBOURHOOD` around each increasing frequency."""
    reach = _NEIGHBOURHOOD * (1 + 1e-9)
    first, last = np.searchsorted(frequency, frequency / reach), np.searchsorted(frequency, frequency * reach, "right")
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[last] - total[first])
