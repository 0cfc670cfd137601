"""Combination: the inverse filter, asked only for the displacement that funneling gives at the target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..typing import ComplexArray
from .drives import Aim
from .funneling import Distance, Funneling, Weights, settled_weights
from .inverse_filter import LEAST_ERROR, aim_at
from .inversion import Regularisation
from .spectrum import Placed
from .zeros import AutoZeros, Zeros, settled_zeros


@dataclass(frozen=True)
class Combination:
    """Combination renderer, III.B.3 of de Vlam 2022: eq. 4 with U at the target from funneling (eq. 3, 6, 8).

    With more control points than actuators the target's displacement is funneling's only up to the misfit, as
    in :class:`InverseFilter`; the thesis calls the two identical. ``amplitude`` [V], ``distance`` and ``weights`` are
    funneling's. The other options are the inverse filter's.
    """

    zeros: Zeros = field(default_factory=AutoZeros)
    regularisation: Regularisation | None = None
    amplitude: float = 1.0
    distance: Distance = "spacing"
    least_error: float = LEAST_ERROR
    weights: Weights | None = field(default=None, repr=False, compare=False)
    name: str = "combination"

    def aim(self, placed: Placed, target: str, wavelet: ComplexArray) -> Aim:
        """Drive spectra towards output ``target``; ``wavelet`` (n_bins,) [1/Hz]."""
        funneling = Funneling(self.amplitude, self.distance, self.weights).aim(placed, target, wavelet)
        row = placed.bins.values[:, placed.row(target)]
        displacement = np.asarray((row * funneling.spectrum).sum(axis=1))
        aim = aim_at(placed, target, displacement, self.zeros, self.regularisation or self.least_error)
        return replace(aim, used=aim.used & funneling.used)

    def with_zeros(self, zeros: Zeros) -> Combination:
        """The same renderer with other zero points."""
        return replace(self, zeros=zeros)

    def settled(self, placed: Placed, targets: Sequence[str]) -> Combination:
        """The same renderer with zero points and shares found for ``targets``, as far as places tell."""
        weights = settled_weights(self.weights, placed, targets, self.distance)
        return replace(self, zeros=settled_zeros(self.zeros, placed, targets), weights=weights)
