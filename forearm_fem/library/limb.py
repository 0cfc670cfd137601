"""The limb as bells on its skin see it: poles and residues."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class Limb:
    """Compliance between bells, sum_k left_ik right_kj / (i omega - poles_k), made symmetric.

    ``left`` (n, k), ``right`` (k, n), ``poles`` (k,) [1/s].
    """

    poles: ComplexArray
    left: ComplexArray
    right: ComplexArray

    def between(self, frequency: FloatArray, weights: FloatArray) -> ComplexArray:
        """Compliance (n_frequency, p, p) of p combinations ``weights`` (n, p) of bells."""
        left, right = weights.T @ self.left, self.right @ weights
        s = 2j * np.pi * frequency
        if len(s) < len(left):  # pairs of hundreds of bells, times all poles, come to gigabytes
            products = np.array([(left / (one - self.poles)) @ right for one in s])
            return np.asarray((products + products.transpose(0, 2, 1)) / 2)
        i, j = np.triu_indices(weights.shape[1])
        pairs = (left[i] * right.T[j] + left[j] * right.T[i]) / 2
        values = (1 / (s[:, None] - self.poles)) @ pairs.T
        whole = np.empty((len(frequency), len(left), len(left)), dtype=complex)
        whole[:, i, j] = whole[:, j, i] = values
        return whole
