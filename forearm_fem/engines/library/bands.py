"""Parts of a band, in each of which waves are taken as equally long, and what is smooth in frequency follows from few
nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from ...typing import FloatArray, IntArray

_RATIO = 1.6  # between the ends of a part, about
NODES = 12  # of each part


@dataclass(frozen=True)
class Bands:
    """Parts with ``edges`` (k + 1,) [Hz], rising."""

    edges: FloatArray

    @classmethod
    def of(cls, low: float, high: float) -> Bands:
        """The parts of ``low`` to ``high`` [Hz]."""
        count = max(1, round(np.log(high / low) / np.log(_RATIO)))
        return cls(np.geomspace(low, high, count + 1))

    @property
    def nodes(self) -> FloatArray:
        """Chebyshev nodes (k, NODES) [Hz] in the root of the frequency, rising."""
        x = -np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        low, high = np.sqrt(self.edges[:-1, None]), np.sqrt(self.edges[1:, None])
        return np.asarray((low + 0.5 * (high - low) * (x + 1)) ** 2)

    def number(self, frequency: FloatArray) -> IntArray:
        """The part (n,) that each ``frequency`` (n,) lies in."""
        return np.clip(np.searchsorted(self.edges, frequency, "right") - 1, 0, len(self.edges) - 2)

    def between(self, frequency: FloatArray) -> FloatArray:
        """Matrices (n, NODES) that carry values at the nodes of its part to each ``frequency`` (n,)."""
        part = self.number(frequency)
        low, high = np.sqrt(self.edges[part]), np.sqrt(self.edges[part + 1])
        x = 2 * (np.sqrt(frequency) - low) / (high - low) - 1
        at = -np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        inverse = np.linalg.inv(chebyshev.chebvander(at, NODES - 1))
        return np.asarray(chebyshev.chebvander(x, NODES - 1) @ inverse)
