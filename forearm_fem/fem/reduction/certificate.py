"""Where a reduced model is doubted, and what it is certified with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...transfer import relative_error
from ...typing import ComplexArray, FloatArray
from ..assembly.model import ForearmModel
from ..linear.direct import watched
from .reduced_model import ReducedModel

DOUBTFUL = 0.1  # a change by one derivative above this, anywhere, says that resonances are not resolved
_PROBES = 40
_ROUNDING = 1e-10  # weaker directions are none
_SPACING = 0.1  # probes are equally far apart in this power of the frequency


@dataclass(frozen=True)
class Certificate:
    """Error of the reduced model at a frequency where it was compared with a direct solve it had not used, or, ``by``
    its residual, twice what a richer space finds of it (:mod:`.dual`).

    ``change`` is the largest change of the model, of so many ``expansions``, by one derivative and its weak directions,
    over the band; ``frequency`` is where the model was doubted most (:func:`doubt`). Where resonances are sharp
    ``change`` is a bound of the error at every bin instead (:mod:`.bounds`), largest at ``frequency``. ``wary`` says
    that resonances are sharp, or that the change is, or was before, too large for one true error to speak for the band.
    ``rounding`` is what may be wrong with the direct solution itself, where it is not refined, or what solves left in
    the space. ``elsewhere`` is the
    largest error at frequencies that were compared before: the model was extended by these solutions and should
    reproduce them; where it does not, as with pressures of incompressible tissue, it is no better between them.
    """

    frequency: float
    error: float
    change: float = 0.0
    expansions: int = 0
    wary: bool = False
    rounding: float = 0.0
    elsewhere: float = 0.0
    by: Literal["direct solve", "elimination", "residual"] = "direct solve"

    @property
    def bound(self) -> float:
        """The error and the rounding; the change, too, where one true error cannot speak for the band."""
        here = max(self.error, self.change) if self.wary else self.error + self.rounding
        return max(here, self.elsewhere)


@dataclass(frozen=True)
class Doubt:
    """Where the reduced model is doubted most, and its largest ``change`` anywhere (relative to the largest entry) or,
    where resonances are sharp, the largest bound of its error; ``wary`` says that this is stated, too."""

    frequency: float
    change: float
    wary: bool = False


def doubt(
    model: ForearmModel, reduced: ReducedModel, frequency: FloatArray, known: Sequence[float], *, wary: bool = False
) -> Doubt | None:
    """The most doubtful of the probed frequencies that are not ``known``; None if none is left.

    The change is the error of the model with one derivative fewer, and without its weak directions: it says where a
    model is no approximation at all yet. Where the change is small everywhere, the largest error is where the
    derivatives alone change most (docs/decisions/0007).
    """
    probes = probe_frequencies(frequency, known)
    if not len(probes):
        return None
    values = _watched(model, reduced, probes)
    change = place = relative_error(_watched(model, reduced.lower(), probes), values)
    if not wary and change.max() <= DOUBTFUL:
        place = relative_error(_watched(model, reduced.lower(_ROUNDING), probes), values)
    largest = float(change.max())
    return Doubt(float(probes[int(np.argmax(place))]), largest, wary or largest > DOUBTFUL)


def most_doubtful_bin(bounds: FloatArray, frequency: FloatArray, known: Sequence[float]) -> Doubt | None:
    """The bin that is not ``known`` with the largest of the ``bounds`` (n_frequency,), which are all stated."""
    open_bins = np.flatnonzero(~np.isin(frequency, known))
    if not len(open_bins):
        return None
    worst = open_bins[int(np.argmax(bounds[open_bins]))]
    return Doubt(float(frequency[worst]), float(bounds.max()), wary=True)


def largest_change(model: ForearmModel, reduced: ReducedModel, smaller: ReducedModel, frequency: FloatArray) -> float:
    """Largest change of G over the band by what the ``smaller`` model lacks."""
    probes = probe_frequencies(frequency, ())[::2]
    return float(relative_error(_watched(model, smaller, probes), _watched(model, reduced, probes)).max())


def _watched(model: ForearmModel, reduced: ReducedModel, probes: FloatArray) -> ComplexArray:
    """Compliances (n_probe, n_output, n_input) whose error counts."""
    return reduced.compliance(probes)[np.ix_(range(len(probes)), *watched(model))]


def probe_frequencies(frequency: FloatArray, known: Sequence[float]) -> FloatArray:
    """Bins equally far apart in f^0.1, without the known ones."""
    low, high = frequency[0] ** _SPACING, frequency[-1] ** _SPACING
    wanted = np.linspace(low, high, min(_PROBES, len(frequency))) ** (1 / _SPACING)
    bins = {float(frequency[np.argmin(np.abs(frequency - f))]) for f in wanted}
    return np.array(sorted(bins - set(known)))


def certified(reduced: ReducedModel, model: ForearmModel, truth: ComplexArray, at: Doubt, used: int) -> Certificate:
    """Error at the watched ports against a direct solution's compliance (n_port, n_port) [m/N]."""
    return Certificate(at.frequency, error_at(reduced, model, at.frequency, truth), at.change, used, at.wary)


def error_at(reduced: ReducedModel, model: ForearmModel, frequency: float, truth: ComplexArray) -> float:
    """Of the reduced compliance at the watched ports, relative to the largest entry of the ``truth`` there."""
    known = truth[None][np.ix_([0], *watched(model))]
    return float(relative_error(_watched(model, reduced, np.array([frequency])), known)[0])
