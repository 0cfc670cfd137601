"""Error of a result on one mesh from its change on a coarser one."""

from __future__ import annotations

import numpy as np

from ..transfer import relative_error
from ..typing import ComplexArray, FloatArray

COARSER = 2.0  # size ratio of the second mesh
_RESOLVED, _UNRESOLVED = (0.15, 1.85), (0.5, 3.0)  # relative change and the order assumed there (docs/decisions/0015)
_NEIGHBOURHOOD = 1.25  # e(f) listens to frequencies up to this ratio away (a third of an octave)


def remaining_error(change: FloatArray) -> FloatArray:
    """Relative error of the finer mesh from the relative ``change`` to a mesh with :data:`COARSER` times its sizes.

    change / (COARSER^p - 1). P2 outputs converge like h^3 to h^4, like h at rigid rims: order 1.85 lies between and is
    on the safe side of what was seen where changes are below 0.15; where they are above 0.5 the coarser mesh does not
    resolve the waves, and the error falls by order 3 at least.
    """
    (low, first), (high, last) = _RESOLVED, _UNRESOLVED
    divisor = np.interp(change, (low, high), (COARSER**first - 1, COARSER**last - 1))
    return np.asarray(change / divisor)


def estimated_errors(coarse: ComplexArray, fine: ComplexArray, frequency: FloatArray) -> tuple[float, FloatArray]:
    """e_band and e(f) (n_frequency,) of ``fine`` (n_frequency, n_out, n_in), from its values on the coarser mesh.

    Errors of two meshes cancel at some frequencies by chance, so e(f) at ``frequency`` (n_frequency,) [Hz], increasing,
    comes from the change there or from the change of the third of an octave on either side, whichever is larger.
    """
    size = np.linalg.norm(fine, axis=(1, 2))
    change = np.linalg.norm(coarse - fine, axis=(1, 2)) / size
    band = np.linalg.norm(remaining_error(change) * size) / np.linalg.norm(size)
    worst, largest = relative_error(coarse, fine), np.abs(fine).max(axis=(1, 2))
    around = np.sqrt(_around((worst * largest) ** 2, frequency) / _around(largest**2, frequency))
    return float(band), remaining_error(np.maximum(worst, around))


def _around(values: FloatArray, frequency: FloatArray) -> FloatArray:
    """Sum (n_frequency,) of ``values`` over :data:`_NEIGHBOURHOOD` around each increasing frequency."""
    reach = _NEIGHBOURHOOD * (1 + 1e-9)
    first, last = np.searchsorted(frequency, frequency / reach), np.searchsorted(frequency, frequency * reach, "right")
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[last] - total[first])
