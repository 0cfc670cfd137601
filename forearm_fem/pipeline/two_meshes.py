"""Error of a result on one mesh from its change on a coarser one."""

from __future__ import annotations

import numpy as np

from ..transfer import relative_error
from ..typing import ComplexArray, FloatArray

COARSER = 2.0  # size ratio of the second mesh
_RESOLVED, _UNRESOLVED = (0.15, 2.0), (0.5, 3.0)  # relative change and the order assumed there (docs/decisions.md)


def remaining_error(change: FloatArray) -> FloatArray:
    """Relative error of the finer mesh from the relative ``change`` to a mesh with :data:`COARSER` times its sizes.

    change / (COARSER^p - 1). P2 outputs converge like h^3 to h^4, like h at rigid rims: order 2 lies between and was
    seen where changes are below 0.15; where they are above 0.5 the coarser mesh does not resolve the waves, and the
    error falls by order 3 at least.
    """
    (low, first), (high, last) = _RESOLVED, _UNRESOLVED
    order = np.interp(change, (low, high), (first, last))
    return np.asarray(change / (COARSER**order - 1))


def estimated_errors(coarse: ComplexArray, fine: ComplexArray) -> tuple[float, FloatArray]:
    """e_band and e(f) (n_frequency,) of ``fine`` (n_frequency, n_out, n_in), from its values on the coarser mesh."""
    size = np.linalg.norm(fine, axis=(1, 2))
    change = np.linalg.norm(coarse - fine, axis=(1, 2)) / size
    band = np.linalg.norm(remaining_error(change) * size) / np.linalg.norm(size)
    return float(band), remaining_error(relative_error(coarse, fine))
