"""Zero points: the outputs an inverse filter holds still while it moves the target."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from math import comb
from typing import Protocol

import numpy as np

from ..errors import GeometryError, ScenarioError
from ..metrics.strength import area, plain_strength
from ..progress import Progress, tell
from ..typing import FloatArray
from .drives import Aim
from .lattice import lattice_of
from .spectrum import BinnedTransfer, respond

_MOST_SETS = 200  # tried one by one
_LOUDEST, _ROUNDS = 12, 2  # of an exchange
THESIS_ACTUATORS = 4


class ZeroRule(Protocol):
    """Chooses zero points for a target."""

    def choose(self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the zero points; ``aim`` gives the drives that a set of zero points would lead to."""


@dataclass(frozen=True)
class ThesisZeros:
    """Corners of the grid; for a corner target the other three corners and the centre.

    De Vlam 2022, III.B.1, states only target 5 (the four corners) and that four zeros are used. Edges -> the
    four corners and corners -> three corners and the centre are our choice. Needs outputs on a rectangular
    grid; the centre of a grid without a middle point is the one nearest to it.
    """

    def choose(self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the zero points; raises GeometryError if the outputs form no rectangle."""
        grid = lattice_of(placed.outputs, "zero points by the corner rule, outputs")
        last = np.array([len(grid.rows) - 1, len(grid.columns) - 1])
        corner = (np.isin(grid.place, 0) | (grid.place == last)).all(axis=1)
        names = [p.name for p in placed.outputs]
        chosen = [n for n, is_corner in zip(names, corner, strict=True) if is_corner and n != target]
        if len(chosen) == 3:
            middle = names[int(np.argmin(np.abs(grid.place - last / 2).sum(axis=1)))]
            chosen += [middle] if middle not in (*chosen, target) else []
        return tuple(chosen)


def within_thesis(placed: BinnedTransfer) -> bool:
    """True if G has at most the thesis' four actuators (columns known on some bin count)."""
    return int(np.count_nonzero(placed.bins.valid.any(axis=(0, 1)))) <= THESIS_ACTUATORS


@dataclass(frozen=True)
class AutoZeros:
    """The thesis' rule for its four actuators on a rectangular grid, else all other outputs.

    With all others held still, least squares gives at each frequency the drive with the largest energy at the target
    over the energy elsewhere, which no further actuator can make smaller. The corners alone leave the actuators
    beyond four free to move whatever lies between.
    """

    def choose(self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the zero points."""
        if within_thesis(placed):
            try:
                return ThesisZeros().choose(placed, target, aim)
            except GeometryError:  # no rectangle, so no corners
                pass
        return tuple(p.name for p in placed.outputs if p.name != target)


@dataclass(frozen=True)
class FixedZeros:
    """Zero points by ``target``, as found before: for studies that aim anew but do not search anew."""

    by_target: Mapping[str, tuple[str, ...]]

    def choose(self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the zero points; raises ScenarioError for a target without any on record."""
        if target not in self.by_target:
            raise ScenarioError(f"no zero points are on record for target '{target}'")
        return self.by_target[target]


@dataclass(frozen=True)
class SearchedZeros:
    """The set of ``size`` zero points with the largest S found; ``size`` None: as many as there are actuators, 4 at
    least.

    S (eq. 9) over the ``window`` (start, end) [s], or the whole record. Up to 200 sets are all tried (the thesis' grid
    has C(8, 4) = 70). Beyond that, points are added one at a time and then exchanged one at a time while S rises, in
    two rounds at most, each time among the 12 outputs that move most: a local best after at most 36 tries a point.
    ``progress`` counts the sets of one target. Raises ScenarioError for more zero points than outputs.
    """

    size: int | None = None
    window: tuple[float, float] | None = None
    progress: Progress | None = field(default=None, repr=False, compare=False)

    def choose(self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]) -> tuple[str, ...]:
        """Names of the best zero points."""
        return self.ranking(placed, target, aim)[0][0]

    def ranking(
        self, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]
    ) -> tuple[tuple[tuple[str, ...], float], ...]:
        """The sets tried with their S, best first."""
        placed.row(target)
        others = [p.name for p in placed.outputs if p.name != target]
        size = self.size if self.size is not None else max(4, len(placed.inputs))
        size = min(size, len(others)) if self.size is None else size
        if not 0 <= size <= len(others):
            raise ScenarioError(f"{size} zero points cannot be searched among {len(others)} outputs beside the target")
        few = comb(len(others), size) <= _MOST_SETS
        trial = _Trial(placed, target, aim, self, comb(len(others), size) if few else (_ROUNDS + 1) * size * _LOUDEST)
        if few:
            for zeros in combinations(others, size):
                trial.strength(zeros)
        else:
            _exchange(trial, size, [p.name for p in placed.outputs])
        found = [(zeros, s) for zeros, s in trial.found.items() if len(zeros) == size]
        return tuple(sorted(found, key=lambda pair: -pair[1] if pair[1] == pair[1] else float("inf")))


@dataclass
class _Trial:
    """Sets tried for one target, with S and the area of every output."""

    placed: BinnedTransfer
    target: str
    aim: Callable[[tuple[str, ...]], Aim]
    rule: SearchedZeros
    most: int
    found: dict[tuple[str, ...], float] = field(default_factory=dict)
    areas: dict[tuple[str, ...], FloatArray] = field(default_factory=dict)

    def strength(self, zeros: tuple[str, ...]) -> float:
        """S with these zero points; -inf where it is no number."""
        if zeros not in self.found:
            response, time = respond(self.placed, self.aim(zeros).spectrum), self.placed.record.time
            row, window = self.placed.row(self.target), self.rule.window
            self.found[zeros] = plain_strength(response, row, time=time, window=window)
            self.areas[zeros] = area(response, time=time, window=window)
            tell(self.rule.progress, "zero points of one target", len(self.found), self.most)
        found = self.found[zeros]
        return found if found == found else float("-inf")


def _exchange(trial: _Trial, size: int, names: list[str]) -> None:
    """Zero points added one at a time, then each exchanged for a better one while S rises."""

    def best_with(rest: tuple[str, ...]) -> tuple[str, ...]:
        """The set of most S that adds one of the loudest points to ``rest``."""
        trial.strength(rest)
        loud = [names[i] for i in np.argsort(-trial.areas[rest]) if names[i] not in (trial.target, *rest)]
        # names in the order of the outputs, so that a set met again is known
        return max((tuple(sorted((*rest, n), key=names.index)) for n in loud[:_LOUDEST]), key=trial.strength)

    chosen: tuple[str, ...] = ()
    for _ in range(size):
        chosen = best_with(chosen)
    for _ in range(_ROUNDS):
        before = chosen
        for name in before:
            chosen = max(chosen, best_with(tuple(n for n in chosen if n != name)), key=trial.strength)
        if chosen == before:
            return


Zeros = ZeroRule | tuple[str, ...]


def chosen_zeros(
    zeros: Zeros, placed: BinnedTransfer, target: str, aim: Callable[[tuple[str, ...]], Aim]
) -> tuple[str, ...]:
    """Names from a rule or a list, checked: known, distinct, not the target; raises ScenarioError."""
    if not hasattr(zeros, "choose") and not isinstance(zeros, list | tuple):
        raise ScenarioError(f"zero points: expected a rule or names of outputs such as ('1', '3'), got {zeros!r}")
    names = tuple(zeros) if isinstance(zeros, list | tuple) else zeros.choose(placed, target, aim)
    if target in names:
        raise ScenarioError(f"output '{target}' is both the target and a zero point; take it out of the zero points")
    if len(set(names)) != len(names):
        raise ScenarioError(f"zero points {', '.join(names)} name an output twice")
    for name in names:
        placed.row(name)
    return names


def settled_zeros(zeros: Zeros, placed: BinnedTransfer, targets: Sequence[str]) -> Zeros:
    """Zero points of ``targets`` by a rule that looks at places alone; others stay the rules that they are."""
    if not isinstance(zeros, ThesisZeros | AutoZeros):
        return zeros
    return FixedZeros({t: zeros.choose(placed, t, _unasked) for t in targets})


def _unasked(names: tuple[str, ...]) -> Aim:
    raise AssertionError(f"a rule of places aimed with {names}")
