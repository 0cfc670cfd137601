"""Errors of a compliance at each pair of ports: far points, which move little, are known better than near ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..transfer import Compliance
from ..typing import FloatArray


def raised_to_row_column_mean(change: FloatArray) -> FloatArray:
    """``change`` (n, n_out, n_in), each entry raised to (row rms x column rms / total rms).

    A reduced model errs by the product of what the states of two ports lack (:mod:`..fem.reduction.certificate`),
    so a pair that changes less than that does so by chance. Nothing is raised beyond the largest of all.
    """
    square = change**2
    rows, columns, all_of_it = (square.mean(axis=axes, keepdims=True) for axes in (2, 1, (1, 2)))
    product = np.sqrt(np.divide(rows * columns, all_of_it, out=np.zeros_like(square), where=all_of_it > 0))
    return np.asarray(np.maximum(change, np.minimum(product, change.max(axis=(1, 2), keepdims=True))))


@dataclass(frozen=True, eq=False)
class PairErrors:
    """Errors ``shares`` (n_probe, n_port, n_port) of the largest entry of points under contacts, at rising ``probes``
    (n_probe,) [Hz]; their largest of such a pair is e(f)."""

    probes: FloatArray
    shares: FloatArray

    def of(self, found: Compliance) -> FloatArray:
        """What ``found`` may miss (n, n_port, n_port) [m/N]: shares linear between probes, the ends' beyond."""
        between = np.array([np.interp(found.frequency, self.probes, e) for e in np.eye(len(self.probes))])
        points, contacts = found.indices("point"), found.indices("contact")
        block = found.values[:, points or contacts][:, :, contacts or points]
        size = np.abs(block).max(axis=(1, 2))
        return np.asarray(np.tensordot(between.T, self.shares, 1) * size[:, None, None])
