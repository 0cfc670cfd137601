"""Discretisation error from a second mesh, whose nodes lie a little further apart."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..scenario import Scenario
from ..scenario.limb import MeshLimb
from ..transfer import ErrorEstimate, TransferMatrix, relative_error
from ..typing import ComplexArray, FloatArray
from .estimates import raised_to_row_column_mean

# Size ratio of the second mesh, where it can be made. One twice as coarse carries no waves where the first one just
# does: between 2 and 57 times the error was its change under rigid cones, that of this one 2 to 6 times.
COARSER = math.sqrt(2)
SECOND_ORDER, THIRD_ORDER = 2.1, 3.2  # of convergence, by the elements around the ports
LOST = 0.2  # change of G beyond which the second mesh carries no waves, and the error grows as its square root
_NEIGHBOURHOOD = 1.25  # e(f) listens to frequencies up to this ratio away (a third of an octave)


@dataclass(frozen=True, eq=False)
class DiscretisationError:
    """Discretisation error of values on one mesh: ``band`` e_band and ``error`` e(f) (n_frequency,), as of
    :func:`estimated_errors`."""

    band: float
    error: FloatArray


def order_of(scenario: Scenario) -> float:
    """Order of convergence of G. A mesh of the user's, whose element pair changes in place of its sizes, has the
    lowest."""
    third = scenario.element in ("P2/P3", "P3") and not isinstance(scenario.limb, MeshLimb)
    return THIRD_ORDER if third else SECOND_ORDER


def discretisation_of(fine: TransferMatrix, coarse: TransferMatrix, scenario: Scenario) -> ErrorEstimate:
    """Discretisation error of G on the ``fine`` mesh by its change on the ``coarse`` one."""
    ratio, order = float(coarse.provenance["ratio"]), order_of(scenario)
    found = estimated_errors(coarse.values, fine.values, fine.frequency, ratio, order)
    pairs = over_pairs(found.error, coarse.values, fine.values, fine.frequency)
    change = _relative_change(coarse.values, fine.values)
    left = np.divide(remaining_error(change, ratio, order), change, out=np.zeros_like(change), where=change > 0)
    together = left[:, None, None] * (coarse.values - fine.values) / np.abs(fine.values).max(axis=(1, 2), keepdims=True)
    return ErrorEstimate(
        "discretisation",
        found.band,
        f"change of G on a second mesh, nodes {ratio:.2g} times as far apart, over |{ratio:.2g}^{order:g} - 1|, "
        f"beyond {LOST:g} its geometric mean with that",
        tuple(fine.frequency.tolist()),
        tuple(found.error.tolist()),
        pairs,
        together,
    )


def remaining_error(change: FloatArray, ratio: float = COARSER, order: float = SECOND_ORDER) -> FloatArray:
    """Relative error of a mesh from the relative ``change`` to one whose sizes are ``ratio`` (not 1) times its own.

    An error C h^p changes by C h^p |ratio^p - 1|, p the ``order``, so change / |ratio^p - 1| is left; of changes
    beyond :data:`LOST` their geometric mean with it.
    """
    return np.asarray(np.minimum(change, np.sqrt(LOST * change)) / abs(ratio**order - 1))


def estimated_errors(
    other: ComplexArray,
    own: ComplexArray,
    frequency: FloatArray,
    ratio: float = COARSER,
    order: float = SECOND_ORDER,
) -> DiscretisationError:
    """Discretisation error of ``own`` values (n_frequency, n_out, n_in): the one rule for scenes, arms and
    verification.

    ``other`` values are those on the second mesh, whose nodes are ``ratio`` times as far apart. Errors of two meshes
    cancel at some frequencies by chance, so e(f) at ``frequency`` (n_frequency,) [Hz], increasing, comes from the
    change there or from the change of the third of an octave on either side, whichever is larger. e_band sums what
    each frequency's own change leaves.
    """
    size = np.linalg.norm(own, axis=(1, 2))
    left = remaining_error(_relative_change(other, own), ratio, order) * size
    single = remaining_error(smoothed_relative_change(other, own, frequency), ratio, order)
    return DiscretisationError(float(np.linalg.norm(left) / np.linalg.norm(size)), single)


def _relative_change(other: ComplexArray, own: ComplexArray) -> FloatArray:
    """||other - own||_F / ||own||_F at each frequency (n_frequency,)."""
    return np.asarray(np.linalg.norm(other - own, axis=(1, 2)) / np.linalg.norm(own, axis=(1, 2)))


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
