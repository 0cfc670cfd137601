"""Where a reduced model is doubted, what it is certified with, and when that is enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..transfer import relative_error
from ..typing import ComplexArray, FloatArray
from .direct import watched
from .model import ForearmModel
from .reduce import ReducedModel

DOUBTFUL = 0.1  # a change by one derivative above this, anywhere, says that resonances are not resolved
_WARY = 4  # one of dozens of resonances may be met by luck: 3e-8 was stated where the truth was 3e-3
_PROBES, _MANY = 40, 1000
_ROUNDING = 1e-10  # weaker directions are none
_APART = 1.03  # ratio of frequencies: four neighbouring bins tell no more than one of them
_SPACING = 0.1  # probes are equally far apart in this power of the frequency


@dataclass(frozen=True)
class Certificate:
    """Error of the reduced model at a frequency where it was compared with a direct solve it had not used.

    ``change`` is the largest change of the model, of so many ``expansions``, by one derivative and its weak directions,
    over the band; ``frequency`` is where the model was doubted most (:func:`doubt`), away from earlier comparisons.
    """

    frequency: float
    error: float
    change: float = 0.0
    expansions: int = 0
    wary: bool = False

    @property
    def bound(self) -> float:
        """The error, or the change where one true error cannot speak for the band.

        That is so where the change is large, and where resonances were seen to be unresolved before (``wary``).
        """
        return max(self.error, self.change) if self.wary or self.change > DOUBTFUL else self.error


@dataclass(frozen=True)
class Doubt:
    """Where the reduced model is doubted most, its largest ``change`` anywhere (relative to the largest entry), and
    whether every bin was probed because resonances had been seen to be unresolved."""

    frequency: float
    change: float
    wary: bool = False


def doubt(
    model: ForearmModel,
    reduced: ReducedModel,
    frequency: FloatArray,
    known: Sequence[float],
    *,
    wary: bool = False,
    compared: Sequence[float] = (),
) -> Doubt | None:
    """The most doubtful of the probed frequencies that are not ``known``; None if none is left.

    Nor is it one next to where this model was ``compared`` with direct solves already.

    The change is the error of the model with one derivative fewer, and without its weak directions: an upper bound
    that says where a model is no approximation at all yet. ``wary`` probes nearly every bin: where resonances were not
    resolved before, they may hide between few probes. Where the change is small everywhere, the largest error is where
    the derivatives alone change most (docs/decisions/0007).
    """
    probes = probe_frequencies(frequency, known, wary=wary)
    for f in compared:
        probes = probes[(probes > f * _APART) | (probes < f / _APART)]
    if not len(probes):
        return None
    values = _watched(model, reduced, probes)
    change = place = relative_error(_watched(model, reduced.lower(), probes), values)
    if not wary and change.max() <= DOUBTFUL:
        place = relative_error(_watched(model, reduced.lower(_ROUNDING), probes), values)
    return Doubt(float(probes[int(np.argmax(place))]), float(change.max()), wary)


def largest_change(model: ForearmModel, reduced: ReducedModel, frequency: FloatArray) -> float:
    """Largest change of G over the band by what the lower model lacks."""
    probes = probe_frequencies(frequency, ())[::2]
    change = relative_error(_watched(model, reduced.lower(), probes), _watched(model, reduced, probes))
    return float(change.max())


def _watched(model: ForearmModel, reduced: ReducedModel, probes: FloatArray) -> ComplexArray:
    """Compliances (n_probe, n_output, n_input) whose error counts."""
    return reduced.compliance(probes)[np.ix_(range(len(probes)), *watched(model))]


def probe_frequencies(frequency: FloatArray, known: Sequence[float], *, wary: bool = False) -> FloatArray:
    """Bins equally far apart in f^0.1 (in f and many if ``wary``), without the known ones."""
    power, count = (1.0, _MANY) if wary else (_SPACING, _PROBES)
    low, high = frequency[0] ** power, frequency[-1] ** power
    wanted = np.linspace(low, high, min(count, len(frequency))) ** (1 / power)
    bins = {float(frequency[np.argmin(np.abs(frequency - f))]) for f in wanted}
    return np.array(sorted(bins - set(known)))


def certified(reduced: ReducedModel, model: ForearmModel, solutions: ComplexArray, at: Doubt, used: int) -> Certificate:
    """Error at the watched ports against direct solutions (n, n_port)."""
    block = np.ix_([0], *watched(model))
    truth = ((model.functionals.T @ solutions) * model.shares)[None]
    estimate = reduced.compliance(np.array([at.frequency]))
    return Certificate(at.frequency, float(relative_error(estimate[block], truth[block])[0]), at.change, used, at.wary)


def enough(certificates: Sequence[Certificate]) -> bool:
    """Whether the model as it is now was compared at enough frequencies."""
    wary = any(c.change > DOUBTFUL for c in certificates)
    return sum(c.expansions == certificates[-1].expansions for c in certificates) >= (_WARY if wary else 1)


def most_doubtful(
    model: ForearmModel,
    reduced: ReducedModel,
    frequency: FloatArray,
    used: Sequence[float],
    certificates: Sequence[Certificate],
) -> Doubt | None:
    """Where to certify next; probed at every bin once resonances were seen to be unresolved, away from where the
    model as it is now was compared already."""
    known = [*(c.frequency for c in certificates), *used]
    wary = any(c.change > DOUBTFUL for c in certificates)
    compared = [c.frequency for c in certificates if c.expansions == len(used)]
    worst = doubt(model, reduced, frequency, known, wary=wary, compared=compared)
    if worst is not None and worst.change > DOUBTFUL and not wary:
        return doubt(model, reduced, frequency, known, wary=True, compared=compared)
    return worst
