"""Two bells on the limb's flat twin."""

from __future__ import annotations

import numpy as np

from ..layered.hankel import HankelTable, Radial
from ..layered.integrals import Integrals, Medium
from ..typing import ComplexArray, FloatArray

_TOLERANCE = 1e-6
_AT_ONCE = 64  # distances of one quadrature


def between_flat_bells(medium: Medium, frequency: FloatArray, width: float, distances: FloatArray) -> ComplexArray:
    """Compliance (n_frequency, n_distance) [m/N] between two bells of ``width`` [m] at increasing ``distances``."""
    omega, parts = 2 * np.pi * frequency, []
    for piece in np.array_split(distances, max(1, len(distances) // _AT_ONCE)):
        zero = np.zeros(len(piece), dtype=int)
        integrals = Integrals(medium, HankelTable((Radial("bell", width),), zero, zero, zero, zero, piece), _TOLERANCE)
        out = np.empty((len(omega), len(piece)), dtype=complex)
        for chunk in integrals.chunks(omega):
            out[chunk] = integrals.solve(omega[chunk]).values
        parts.append(out)
    return np.concatenate(parts, axis=1)
