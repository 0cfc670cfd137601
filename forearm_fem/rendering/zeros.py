"""Zero points: the outputs an inverse filter holds still while it moves the target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Protocol, Self

import numpy as np

from ..errors import ScenarioError
from ..metrics.strength import signal_strength
from ..transfer import TransferMatrix
from .drives import Aim, Renderer
from .lattice import lattice
from .spectrum import Placed, place, respond
from .wavelet import Wavelet

_MOST_SETS = 20_000


class ZeroRule(Protocol):
    """Chooses zero points for a target."""

    def choose(self, placed: Placed, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the zero points; ``aim`` gives the drives that a set of zero points would lead to."""


@dataclass(frozen=True)
class ThesisZeros:
    """Corners of the grid; for a corner target the other three corners and the centre.

    De Vlam 2022, III.B.1, states only target 5 (the four corners) and that four zeros are used. Edges -> the
    four corners and corners -> three corners and the centre are our choice. Needs outputs on a rectangular
    grid; the centre of a grid without a middle point is the one nearest to it.
    """

    def choose(self, placed: Placed, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the zero points; raises GeometryError if the outputs form no rectangle."""
        grid = lattice(placed.outputs, "zero points by the corner rule, outputs")
        last = np.array([len(grid.rows) - 1, len(grid.columns) - 1])
        corner = (np.isin(grid.place, 0) | (grid.place == last)).all(axis=1)
        names = [p.name for p in placed.outputs]
        chosen = [n for n, is_corner in zip(names, corner, strict=True) if is_corner and n != target]
        if len(chosen) == 3:
            middle = names[int(np.argmin(np.abs(grid.place - last / 2).sum(axis=1)))]
            chosen += [middle] if middle not in (*chosen, target) else []
        return tuple(chosen)


@dataclass(frozen=True)
class SearchedZeros:
    """The set of ``size`` zero points with the largest S, by trying all of them.

    S (eq. 9) over the ``window`` (start, end) [s], or the whole record. C(8, 4) = 70 sets for the thesis'
    grid; raises ScenarioError beyond 20000 sets.
    """

    size: int = 4
    window: tuple[float, float] | None = None

    def choose(self, placed: Placed, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the best zero points."""
        return self.ranking(placed, target, aim)[0][0]

    def ranking(
        self, placed: Placed, target: str, aim: Callable[[tuple[str, ...]], Aim]
    ) -> tuple[tuple[tuple[str, ...], float], ...]:
        """All sets with their S, best first."""
        row = placed.row(target)
        others = [p.name for p in placed.outputs if p.name != target]
        sets = comb(len(others), max(self.size, 0))
        if self.size < 0 or not 1 <= sets <= _MOST_SETS:
            raise ScenarioError(
                f"searching {self.size} zero points among {len(others)} outputs is {sets} sets; "
                f"allowed are 1 to {_MOST_SETS}"
            )
        scored = []
        for zeros in combinations(others, self.size):
            response = respond(placed, aim(zeros).spectrum)
            scored.append((zeros, signal_strength(response, row, time=placed.record.time, window=self.window)))
        return tuple(sorted(scored, key=lambda pair: -pair[1] if pair[1] == pair[1] else float("inf")))


Zeros = ZeroRule | tuple[str, ...]


def chosen_zeros(zeros: Zeros, placed: Placed, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
    """Names from a rule or a tuple, checked: known, distinct, not the target; raises ScenarioError."""
    names = zeros if isinstance(zeros, tuple) else zeros.choose(placed, target, aim)
    if target in names:
        raise ScenarioError(f"output '{target}' is both the target and a zero point; take it out of the zero points")
    if len(set(names)) != len(names):
        raise ScenarioError(f"zero points {', '.join(names)} name an output twice")
    for name in names:
        placed.row(name)
    return names


class Zeroed(Renderer, Protocol):
    """A renderer (a dataclass) with zero points."""

    @property
    def zeros(self) -> Zeros:
        """Its zero points."""

    def with_zeros(self, zeros: Zeros) -> Self:
        """The same renderer with other zero points."""


@dataclass(frozen=True)
class ZeroSearch:
    """Best ``zeros`` and their ``strength`` S [-]; ``ranking`` has every set with its S, best first."""

    zeros: tuple[str, ...]
    strength: float
    ranking: tuple[tuple[tuple[str, ...], float], ...]


def best_zeros(
    renderer: Zeroed,
    transfer: TransferMatrix | Placed,
    target: str,
    wavelet: Wavelet,
    *,
    size: int = 4,
    window: tuple[float, float] | None = None,
) -> ZeroSearch:
    """The ``size`` zero points that give ``renderer`` the largest S at output ``target``, by exhaustive
    search.

    S is that of the same G the drives are computed from; a set that is best on a wrong G need not be on the
    arm. Raises ScenarioError for too many sets or an unknown target.
    """
    placed = transfer if isinstance(transfer, Placed) else place(transfer, wavelet.record)
    spectrum = wavelet.spectrum[placed.bins.index]

    def aim(zeros: tuple[str, ...]) -> Aim:
        return renderer.with_zeros(zeros).aim(placed, target, spectrum)

    ranking = SearchedZeros(size, window).ranking(placed, target, aim)
    return ZeroSearch(ranking[0][0], ranking[0][1], ranking)
