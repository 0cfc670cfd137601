"""Pairs of things that are near each other, whatever their sizes."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ...typing import FloatArray, IntArray


def meeting(centre_a: FloatArray, radius_a: FloatArray, centre_b: FloatArray, radius_b: FloatArray) -> IntArray:
    """Pairs (2, k) of balls a (n, d), (n,) and b (m, d), (m,) that touch or overlap.

    The second kind is sorted into sizes within a factor of two: one wide triangle among thousands of small ones would
    otherwise make each a neighbour of all (minutes for 16,000 triangles with fans at their ends).
    """
    size = np.floor(np.log2(np.maximum(radius_b, 1e-12)))
    found = [np.zeros((2, 0), dtype=np.int64)]
    for each in np.unique(size):
        group = np.flatnonzero(size == each)
        hits = cKDTree(centre_b[group]).query_ball_point(centre_a, radius_a + radius_b[group].max(), return_sorted=True)
        a = np.repeat(np.arange(len(centre_a)), [len(h) for h in hits])
        b = group[np.concatenate([np.asarray(h, dtype=np.int64) for h in hits])] if len(a) else a
        away = ((centre_a[a] - centre_b[b]) ** 2).sum(axis=1)
        found.append(np.stack([a, b])[:, away <= (radius_a[a] + radius_b[b]) ** 2])
    return np.concatenate(found, axis=1)
