"""Flat tetrahedra made rounder by moving their corners about at random, keeping what helps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...typing import BoolArray, FloatArray, IntArray
from ..mesh.topology import mean_ratios

_TRIALS = 200
_ROUND = 0.35  # mean ratio above which a tetrahedron is left alone
_SMALLEST, _LARGEST = -2.5, -0.6  # powers of ten of the moves, relative to the size wanted


def without_slivers(
    points: FloatArray,
    tetrahedra: IntArray,
    movable: BoolArray,
    size: Callable[[FloatArray], FloatArray],
    rng: np.random.Generator,
) -> FloatArray:
    """Points (n, 3) with the ``movable`` corners of flat ``tetrahedra`` (m, 4) moved, their connections kept.

    A move stays if the flattest tetrahedron around its point becomes rounder, so none ever gets flatter than the
    flattest one beside it was. Delaunay maximises no angle in space: one tetrahedron in a hundred is a sliver before.
    """
    points, quality = points.copy(), mean_ratios(points, tetrahedra)
    for _ in range(_TRIALS):
        flat = np.unique(tetrahedra[quality < _ROUND])
        chosen = _alone(tetrahedra, flat[movable[flat]], rng, len(points))
        if not chosen.any():
            break
        around = chosen[tetrahedra].any(axis=1)
        near = tetrahedra[around]
        owner = np.where(chosen[near], near, -1).max(axis=1)
        count, trial = int(chosen.sum()), points.copy()
        lengths = size(points[chosen]) * 10 ** rng.uniform(_SMALLEST, _LARGEST, count)
        trial[chosen] += rng.normal(size=(count, 3)) * lengths[:, None]
        before, after = np.full((2, len(points)), np.inf)
        np.minimum.at(before, owner, quality[around])
        np.minimum.at(after, owner, mean_ratios(trial, near))
        better = chosen & (after > before)
        points[better] = trial[better]
        quality[around] = mean_ratios(points, near)
    return points


def _alone(tetrahedra: IntArray, candidates: IntArray, rng: np.random.Generator, n: int) -> BoolArray:
    """Which of ``n`` points move now: candidates of which no two share a tetrahedron."""
    rank = np.full(n, -1.0)
    rank[candidates] = rng.random(len(candidates))
    beaten = (rank[tetrahedra] >= 0) & (rank[tetrahedra] < rank[tetrahedra].max(axis=1, keepdims=True))
    chosen = rank >= 0
    chosen[tetrahedra[beaten]] = False
    return chosen
