"""How errors of the compliance become errors of G: first order, entry by entry, no sampling.

G = C_pc F + K, K what points follow of the housing, with dF = -S dC_cc F and dK = -R dC_cc F give
dG = dC_pc F - (C_pc S + R) dC_cc F. The entries of dC are taken as independent, of zero mean and of one size per block:
e(f) max|block| for e(f), e_band times the block's root mean square for the band norm.
The squares of their effects add; that dC is symmetric is not used. Coherent errors (all of C too soft by one factor)
partly cancel in G, so this tends to overestimate; ``worst_case=True`` adds the sizes instead: a first-order bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..transfer import Compliance, ErrorEstimate
from ..typing import ComplexArray, FloatArray
from .state import ContactState

_METHOD = "{source} estimate of the compliance, carried to G by first-order sensitivity ({original})"


def propagate_errors(
    compliance: Compliance, state: ContactState, *, worst_case: bool = False
) -> tuple[ErrorEstimate, ...]:
    """One estimate for G per estimate of the compliance; none where nothing touches the skin."""
    if not compliance.errors or not state.force.any():
        return ()
    values, frequency = state.at_points(compliance), compliance.frequency
    peak = _effect(compliance, state, _largest, worst_case)
    mean = _effect(compliance, state, _root_mean_square, worst_case)
    peak_gain = peak.max(axis=(1, 2)) / np.abs(values).max(axis=(1, 2))  # e_G(f) / e_C(f)
    band_gain = float(np.linalg.norm(mean) / np.linalg.norm(values))
    carried = []
    for estimate in compliance.errors:
        method = _METHOD.format(source=estimate.source, original=estimate.method)
        found = ErrorEstimate(estimate.source, estimate.band * band_gain, method)
        if estimate.frequency:  # linear between its own frequencies
            size = np.interp(frequency, estimate.frequency, estimate.per_frequency)
            each = tuple((size * peak_gain).tolist())
            found = replace(found, frequency=tuple(frequency.tolist()), per_frequency=each)
        carried.append(found)
    return tuple(carried)


def _effect(
    compliance: Compliance, state: ContactState, size: Callable[[ComplexArray], FloatArray], worst_case: bool
) -> FloatArray:
    """|dG| (n_frequency, n_point, n_input) for relative errors of 1: root sum of squares, or sum."""
    power = 1 if worst_case else 2
    to_points, under = compliance.block("point", "contact"), compliance.block("contact", "contact")
    forces = (np.abs(state.force) ** power).sum(axis=1, keepdims=True)
    relayed = (np.abs(to_points @ state.reaction + state.released) ** power).sum(axis=2, keepdims=True)
    squares = forces * (size(to_points) ** power + relayed * size(under) ** power)
    return np.asarray(squares ** (1 / power))


def _largest(block: ComplexArray) -> FloatArray:
    return np.asarray(np.abs(block).max(axis=(1, 2), keepdims=True))


def _root_mean_square(block: ComplexArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(np.abs(block) ** 2, axis=(1, 2), keepdims=True)))
