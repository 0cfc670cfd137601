"""Wavenumber of the surface wave of a layered medium: the root of its kernel's inverse."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..typing import ComplexArray, FloatArray
from .closed_forms import rayleigh_wavenumber
from .kernel import Layer, shear_modulus

Kernel = Callable[[ComplexArray, FloatArray], ComplexArray]
_FINEST = 4.0  # most percent by which omega grows between steps of the continuation


def trace_root(kernel: Kernel, layers: Sequence[Layer], omega: FloatArray) -> ComplexArray:
    """k (n,) [1/m], Im k < 0, with 1 / kernel(k, omega) = 0, followed from low frequencies.

    At the lowest frequency the wave is long against the layers, so that the Rayleigh root of the half-space
    below them is near; from there on each root starts the search of the next. NaN where the search fails or
    jumps. Other roots of a layered medium are not covered.
    """
    low, high = 0.1 * float(omega[0]), float(omega[-1])
    steps = np.geomspace(low, high, int(np.log(high / low) / np.log1p(_FINEST / 100)) + 2)
    path = np.unique(np.concatenate([steps[steps < high], omega]))
    base = layers[-1]
    k = complex(rayleigh_wavenumber(path[:1], shear_modulus(path[:1], base), base.density)[0])
    out = np.full(len(path), np.nan + 0j)
    for i, w in enumerate(path):
        guess = k * (w / path[i - 1] if i else 1.0)
        found = _newton(kernel, guess, float(w))
        if not np.isfinite(found) or abs(found - guess) > 0.3 * abs(guess):
            break
        out[i], k = found, found
    return np.asarray(out[np.searchsorted(path, omega)])


def _newton(kernel: Kernel, k: complex, omega: float) -> complex:
    """Newton's method on 1 / kernel with a central difference."""
    w = np.array([omega])
    for _ in range(40):
        h = 1e-5 * abs(k)
        low, here, high = (1 / complex(kernel(np.array([k + d]), w)[0]) for d in (-h, 0, h))
        step = here * 2 * h / (high - low)
        k -= step
        if abs(step) < 1e-9 * abs(k):
            return k
    return complex(np.nan)
