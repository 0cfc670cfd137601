"""Error of a result on one mesh from its change on a second one, whose nodes are further apart or closer together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..transfer import relative_error
from ..typing import ComplexArray, FloatArray
from .missed import evened

COARSER = 2.0  # size ratio of the second mesh, where it can be made
# Relative error, and the order assumed there: a change of 0.3 and of 0.82 with COARSER (docs/decisions/0015).
_RESOLVED, _UNRESOLVED = (0.3 / (COARSER**1.85 - 1), 1.85), (0.82 / (COARSER**3 - 1), 3.0)
# Lags [rad] of waves on the mesh itself between which the order assumed falls to the last number (same decision).
_IN_TIME, _LATE, _LATE_ORDER = 0.04, 0.08, 1.3
_NEIGHBOURHOOD = 1.25  # e(f) listens to frequencies up to this ratio away (a third of an octave)


@dataclass(frozen=True, eq=False)
class Judged:
    """What values on one mesh err by: e_band and e(f) (n_frequency,) as :func:`estimated_errors` has them, ``unseen``
    errors of its entries that no change shows (:func:`agreed_upon`), and the ``order`` (n_frequency,) assumed
    (:func:`assumed_order`)."""

    band: float
    error: FloatArray
    unseen: FloatArray
    order: FloatArray


def judged(
    other: ComplexArray, own: ComplexArray, frequency: FloatArray, ratio: float, lag: FloatArray, coarser: FloatArray
) -> Judged:
    """The one rule for ``own`` values (n_frequency, n_out, n_in), of a scene, of an arm, of a case of verification.

    ``other`` values are those on the second mesh, whose nodes are ``ratio`` times as far apart; waves arrive with a
    ``lag`` [rad] on the mesh itself, and ``coarser`` on the coarser of the two, both shaped like the values.
    """
    unseen, order = agreed_upon(own, lag, coarser), assumed_order(own, lag)
    return Judged(*estimated_errors(other, own, frequency, ratio, unseen, order), unseen, order)


def remaining_error(change: FloatArray, ratio: float = COARSER, order: FloatArray | float = _RESOLVED[1]) -> FloatArray:
    """Relative error of a mesh from the relative ``change`` to one whose sizes are ``ratio`` (not 1) times its own.

    An error C h^p changes by C h^p |ratio^p - 1|, so change / |ratio^p - 1| is left. P2 outputs converge like h^3 to
    h^4, like h at rigid rims: ``order`` 1.85 lies between and is on the safe side of what was seen up to an error of
    0.115 (a change of 0.3) where waves are in time (:func:`assumed_order`).
    Beyond a change of 0.82, nearly G itself, the coarser mesh does not carry the waves at all, and the finer one is
    better by order 3 at least. Changes between come from coarser meshes that are as good as useless, whose distance
    tells little: finer ones erred by 0.03 to 0.27 there, and 0.115 to 0.117 is stated.
    """
    (low, _), (high, last) = _RESOLVED, _UNRESOLVED
    near, far = np.abs(ratio**order - 1), abs(ratio**last - 1)
    useless = np.clip((change - low * near) / (high * far - low * near), 0.0, 1.0)
    return np.asarray(change / (near + useless * (far - near)))


def assumed_order(own: ComplexArray, lag: FloatArray) -> FloatArray:
    """Order of convergence (n_frequency,) assumed of ``own`` (n_frequency, n_out, n_in), whose waves arrive with a
    ``lag`` [rad] of the same shape.

    Waves that are late on the mesh itself are carried by elements that have not reached their order: coarser ones
    were seen to be hardly worse, 0.6 to 1.2 of the change was left. Lags count as G's entries do, by their size.
    """
    size = np.abs(own)
    late = (size * lag).max(axis=(1, 2)) / size.max(axis=(1, 2))
    return np.asarray(np.interp(late, (_IN_TIME, _LATE), (_RESOLVED[1], _LATE_ORDER)))


def estimated_errors(
    other: ComplexArray,
    own: ComplexArray,
    frequency: FloatArray,
    ratio: float = COARSER,
    unseen: FloatArray | None = None,
    order: FloatArray | float = _RESOLVED[1],
) -> tuple[float, FloatArray]:
    """e_band and e(f) (n_frequency,) of ``own`` (n_frequency, n_out, n_in), from ``other`` values on the second mesh.

    Errors of two meshes cancel at some frequencies by chance, so e(f) at ``frequency`` (n_frequency,) [Hz], increasing,
    comes from the change there or from the change of the third of an octave on either side, whichever is larger.
    ``order`` is that of :func:`assumed_order`. ``unseen`` are errors of the entries, shaped like them, that no change
    shows: less is never stated.
    """
    size = np.linalg.norm(own, axis=(1, 2))
    whole = remaining_error(np.linalg.norm(other - own, axis=(1, 2)) / size, ratio, order)
    single = remaining_error(change_around(other, own, frequency), ratio, order)
    if unseen is not None:
        whole = np.maximum(whole, np.linalg.norm(unseen, axis=(1, 2)) / size)
        single = np.maximum(single, unseen.max(axis=(1, 2)) / np.abs(own).max(axis=(1, 2)))
    return float(np.linalg.norm(whole * size) / np.linalg.norm(size)), single


def agreed_upon(own: ComplexArray, lag: FloatArray, coarser: FloatArray) -> FloatArray:
    """Errors of ``own`` (n_frequency, n_out, n_in) by waves that arrive with a ``lag`` [rad] of the same shape, where
    that of the ``coarser`` of two meshes is more than a radian; zero elsewhere, as their difference tells more there.

    A wave that is a radian late is not the wave any more: two meshes that carry none agree, and both are wrong.
    |e^(-i lag) - 1| = 2 sin(lag / 2).
    """
    size = np.abs(own)
    lost = (size * coarser).max(axis=(1, 2)) > size.max(axis=(1, 2))
    return np.asarray(np.where(lost[:, None, None], size * 2 * np.sin(np.minimum(lag, np.pi) / 2), 0.0))


def change_around(other: ComplexArray, own: ComplexArray, frequency: FloatArray) -> FloatArray:
    """e(f) (n_frequency,) of ``other`` beside ``own``, there or over the third of an octave on either side."""
    worst, largest = relative_error(other, own), np.abs(own).max(axis=(1, 2))
    around = np.sqrt(_around((worst * largest) ** 2, frequency) / _around(largest**2, frequency))
    return np.asarray(np.maximum(worst, around))


def over_pairs(error: FloatArray, other: ComplexArray, own: ComplexArray, frequency: FloatArray) -> FloatArray:
    """|dG_ij| / max_ij |G_ij| (n_frequency, n_out, n_in) of ``own`` values, as large as ``error`` e(f) (n_frequency,)
    says and shared as they change to ``other`` ones on a second mesh; alike where nothing changes.

    Pairs that change less than their output and input do in the mean do so by chance (:func:`.evened`).
    """
    change = evened(spread_change(other, own, frequency))
    largest = change.max(axis=(1, 2), keepdims=True)
    shares = np.divide(change, largest, out=np.ones_like(change), where=largest > 0)
    return np.asarray(error[:, None, None] * shares)


def spread_change(other: ComplexArray, own: ComplexArray, frequency: FloatArray) -> FloatArray:
    """How ``other`` values differ from ``own`` (n_frequency, n, n) at each pair over the third of an octave on either
    side: the shape over pairs of an error whose size :func:`estimated_errors` tells. Unknown pairs do not differ."""
    change = np.abs(np.nan_to_num(other - own)).reshape(len(frequency), -1)
    rows = [np.sqrt(_around(column**2, frequency)) for column in change.T]
    return np.array(rows).T.reshape(own.shape)


def _around(values: FloatArray, frequency: FloatArray) -> FloatArray:
    """Sum (n_frequency,) of ``values`` over :data:`_NEIGHBOURHOOD` around each increasing frequency."""
    reach = _NEIGHBOURHOOD * (1 + 1e-9)
    first, last = np.searchsorted(frequency, frequency / reach), np.searchsorted(frequency, frequency * reach, "right")
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[last] - total[first])
