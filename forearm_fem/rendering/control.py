"""Control points: their rows of G, decomposed for whatever is to be done there."""

from __future__ import annotations

from dataclasses import dataclass

from ..typing import BoolArray
from .inversion import Decomposed


@dataclass(frozen=True, eq=False)
class Control:
    """H of some outputs, by increasing ``rows`` of G, on the bins that are ``used`` (n_bins,): those where all of it is
    known.

    What is wanted at these outputs is a right-hand side, so that targets and methods with the same ones share it.
    """

    rows: tuple[int, ...]
    used: BoolArray
    h: Decomposed
