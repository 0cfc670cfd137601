"""Smooth functions of frequency from few of their values: Chebyshev polynomials in the root of the frequency."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from ..typing import BoolArray, ComplexArray, FloatArray

_DEGREES = (48, 96)  # nested: the second uses the values of the first
MOST = _DEGREES[-1]
_TAIL = 8  # coefficients whose sum bounds what a geometric series leaves beyond them, were they to fall by a tenth each


class Sampled(NamedTuple):
    """Values (n_freq, ...), the errors (n_freq, k) that came with them, and that of the interpolation (n_freq,) over
    the largest |value|."""

    values: ComplexArray
    errors: FloatArray
    interpolation: FloatArray


Evaluate = Callable[[FloatArray], tuple[ComplexArray, FloatArray]]


def sampled(evaluate: Evaluate, omega: FloatArray, tolerance: float) -> Sampled:
    """``evaluate`` (values (n, ...) and their errors (n, k) at n angular frequencies) at all of ``omega`` (n_freq,).

    Where ``omega`` has many more values than the degree it takes to follow the function to ``tolerance`` of the largest
    |value| at each frequency, only the degree's nodes are evaluated; elsewhere all of ``omega``.
    """
    low, high = np.sqrt(omega.min()), np.sqrt(omega.max())
    x = 2 * (np.sqrt(omega) - low) / (high - low) - 1 if high > low else np.zeros(omega.size)
    known: tuple[ComplexArray, FloatArray] | None = None
    for degree in _DEGREES:
        if omega.size < 2 * degree:
            break
        nodes = np.cos(np.pi * np.arange(degree + 1) / degree)
        wanted = np.ones(degree + 1, dtype=bool) if known is None else np.arange(degree + 1) % 2 == 1
        found = evaluate((low + 0.5 * (high - low) * (nodes[wanted] + 1)) ** 2)
        known = found if known is None else _merged(known, found, wanted)
        result = _interpolated(x, nodes, *known)
        if np.all(result.interpolation <= tolerance):
            return result
    values, errors = evaluate(omega)
    return Sampled(values, errors, np.zeros(omega.size))


def chebyshev_nodes(low: float, high: float, degree: int) -> FloatArray:
    """Angular frequencies (degree + 1,) [rad/s], falling from ``high`` to ``low``: the rule's nodes in their root."""
    x = np.cos(np.pi * np.arange(degree + 1) / degree)
    return np.asarray((np.sqrt(low) + 0.5 * (np.sqrt(high) - np.sqrt(low)) * (x + 1)) ** 2)


def chebyshev_between(
    low: float, high: float, omega: FloatArray, values: ComplexArray
) -> tuple[ComplexArray, FloatArray]:
    """``values`` (degree + 1, ...) at the nodes of :func:`chebyshev_nodes`, at ``omega`` (n_freq,) [rad/s], and what
    the rule's last coefficients say is missing, over the largest |value| (n_freq,)."""
    x = 2 * (np.sqrt(omega) - np.sqrt(low)) / (np.sqrt(high) - np.sqrt(low)) - 1
    nodes = np.cos(np.pi * np.arange(len(values)) / (len(values) - 1))
    found = _interpolated(x, nodes, values, np.zeros((len(values), 1)))
    return found.values, found.interpolation


def _merged(
    old: tuple[ComplexArray, FloatArray], new: tuple[ComplexArray, FloatArray], is_new: BoolArray
) -> tuple[ComplexArray, FloatArray]:
    """Values and errors of both, in the order of the finer nodes."""
    out = []
    for before, now in zip(old, new, strict=True):
        both = np.empty((is_new.size, *before.shape[1:]), dtype=before.dtype)
        both[~is_new], both[is_new] = before, now
        out.append(both)
    return out[0], out[1]


def _interpolated(x: FloatArray, nodes: FloatArray, values: ComplexArray, errors: FloatArray) -> Sampled:
    """Interpolant at ``x``, in (-1, 1), of values at ``nodes`` (falling from 1 to -1)."""
    degree = nodes.size - 1
    flat = values.reshape(nodes.size, -1)
    coefficients = np.linalg.solve(chebyshev.chebvander(nodes, degree), flat)
    found = chebyshev.chebvander(x, degree) @ coefficients
    tail = np.abs(coefficients[-_TAIL:]).sum(axis=0).max()
    size = np.abs(found).max(axis=1)
    between = np.stack([np.interp(x, nodes[::-1], column[::-1]) for column in errors.T], axis=1)
    return Sampled(found.reshape(x.size, *values.shape[1:]), between, np.asarray(tail / size))
