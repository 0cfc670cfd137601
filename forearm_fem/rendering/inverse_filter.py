"""Inverse filter, its combination with funneling, and precomputation that aims share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, Self, runtime_checkable

import numpy as np

from ..typing import ComplexArray
from .drives import Aim, Renderer
from .funneling import Distance, Funneling, Weights, absent_inputs, known_bins, settled_weights
from .inversion import Control, Regularisation, decomposed, least_squares
from .spectrum import BinnedTransfer
from .zeros import AutoZeros, FixedZeros, Zeros, chosen_zeros, settled_zeros, within_thesis

# Inverse filter: move the target as asked and hold the zero points still.

LEAST_ERROR = 0.02  # e(f): no G of an arm is known better, and what S gains from less is its own error


@dataclass(frozen=True)
class InverseFilter:
    """Inverse filter renderer, eq. 4 of de Vlam 2022: S = H^+ U at every frequency.

    H is the rows of G of the target and the zero points, U the wavelet at the target and zero elsewhere. With
    more control points than actuators this is least squares: neither target nor zeros are met exactly, and
    without damping the target reaches the share 1 - m^2 of what was asked, m = ``Drives.inversion.misfit``,
    which varies with frequency. So ``peak`` [m], which scales the wavelet, is not reached either. ``zeros`` is a rule
    or names of outputs. ``regularisation`` None follows the number of actuators: up to the thesis' four, the
    pseudo-inverse; more, the damping that the error of a measured G asks for (:class:`Regularisation`, "noise"), at
    least that for ``least_error`` [-], e(f) that G is taken to err by.
    """

    zeros: Zeros = field(default_factory=AutoZeros)
    regularisation: Regularisation | None = None
    peak: float = 1e-6
    least_error: float = LEAST_ERROR
    name: str = "inverse filter"

    def aim(self, placed: BinnedTransfer, target: str, wavelet: ComplexArray) -> Aim:
        """Drive spectra towards output ``target``; ``wavelet`` (n_bins,) [1/Hz]."""
        return aim_at(placed, target, self.peak * wavelet, self.zeros, self.regularisation or self.least_error)

    def with_zeros(self, zeros: Zeros) -> InverseFilter:
        """The same renderer with other zero points."""
        return replace(self, zeros=zeros)

    def precomputed_for_targets(self, placed: BinnedTransfer, targets: Sequence[str]) -> InverseFilter:
        """The same renderer with its zero points found for ``targets``, as far as places tell."""
        return replace(self, zeros=settled_zeros(self.zeros, placed, targets))


def aim_at(
    placed: BinnedTransfer,
    target: str,
    displacement: ComplexArray,
    zeros: Zeros,
    regularisation: Regularisation | float,
) -> Aim:
    """Drive spectra for ``displacement`` (n_bins,) [m/Hz] at output ``target`` and none at the zero points.

    A number in place of a ``regularisation`` is the least error of :class:`InverseFilter`.

    Bins where G is unknown between the control points and the inputs are not driven. Raises ScenarioError for
    unknown or repeated control points and DataError if no bin is left.
    """
    placed.row(target)
    rule = regularisation
    if not isinstance(rule, Regularisation):
        rule = Regularisation() if within_thesis(placed) else Regularisation("noise", rule)

    def towards(names: tuple[str, ...]) -> Aim:
        """Drives that move the target and hold the points ``names`` still."""
        control = control_of(placed, (target, *names))
        used = control.used
        wanted = np.zeros((int(used.sum()), len(control.rows)), dtype=complex)
        wanted[:, control.rows.index(placed.row(target))] = displacement[used]
        spectrum = np.zeros((len(used), len(placed.inputs)), dtype=complex)
        spectrum[used], report = least_squares(control.h, wanted, rule, placed.bins.frequency[used], placed.error[used])
        return Aim(spectrum, used, names, report)

    return towards(chosen_zeros(zeros, placed, target, towards))


def control_of(placed: BinnedTransfer, names: Iterable[str]) -> Control:
    """Control points by name, decomposed here unless ``placed`` has them already.

    Rows are in G's order whoever asks, so that drives are the same to the last bit either way. Raises DataError where G
    is known on no bin between these points and the inputs.
    """
    rows = tuple(sorted({placed.row(name) for name in names}))
    if rows in placed.controls:
        return placed.controls[rows]
    used = known_bins(placed, list(rows))
    matrix = placed.bins.values[used][:, rows]
    matrix[:, :, absent_inputs(placed, list(rows))] = 0
    return Control(rows, used, decomposed(matrix))


# Combination: the inverse filter, asked only for the displacement that funneling gives at the target.

@dataclass(frozen=True)
class Combination:
    """Combination renderer, III.B.3 of de Vlam 2022: eq. 4 with U at the target from funneling (eq. 3, 6, 8).

    With more control points than actuators the target's displacement is funneling's only up to the misfit, as
    in :class:`InverseFilter`; the thesis calls the two identical. ``amplitude`` [V], ``distance`` and
    ``weights`` are funneling's. The other options are the inverse filter's.
    """

    zeros: Zeros = field(default_factory=AutoZeros)
    regularisation: Regularisation | None = None
    amplitude: float = 1.0
    distance: Distance = "spacing"
    least_error: float = LEAST_ERROR
    weights: Weights | None = field(default=None, repr=False, compare=False)
    name: str = "combination"

    def aim(self, placed: BinnedTransfer, target: str, wavelet: ComplexArray) -> Aim:
        """Drive spectra towards output ``target``; ``wavelet`` (n_bins,) [1/Hz]."""
        funneling = Funneling(self.amplitude, self.distance, self.weights).aim(placed, target, wavelet)
        row = placed.bins.values[:, placed.row(target)]
        displacement = np.asarray((row * funneling.spectrum).sum(axis=1))
        aim = aim_at(placed, target, displacement, self.zeros, self.regularisation or self.least_error)
        return replace(aim, used=aim.used & funneling.used)

    def with_zeros(self, zeros: Zeros) -> Combination:
        """The same renderer with other zero points."""
        return replace(self, zeros=zeros)

    def precomputed_for_targets(self, placed: BinnedTransfer, targets: Sequence[str]) -> Combination:
        """The same renderer with zero points and shares found for ``targets``, as far as places tell."""
        weights = settled_weights(self.weights, placed, targets, self.distance)
        return replace(self, zeros=settled_zeros(self.zeros, placed, targets), weights=weights)


# Precomputation shared by several aims: by places for any G of theirs, by G for all its targets.

@runtime_checkable
class Settling(Renderer, Protocol):
    """A renderer that can say beforehand what it takes from places."""

    def precomputed_for_targets(self, placed: BinnedTransfer, targets: Sequence[str]) -> Self:
        """The same renderer with all that follows from where ports are found for ``targets``."""


def prepared(
    placed: BinnedTransfer, methods: Iterable[Renderer], targets: Sequence[str]
) -> tuple[BinnedTransfer, tuple[Renderer, ...]]:
    """G and renderers with all that aims at ``targets`` share: :func:`precomputed_for_targets`, then
    :func:`with_controls`."""
    found = precomputed_for_targets(methods, placed, targets)
    return with_controls(placed, found, targets), found


def precomputed_for_targets(
    methods: Iterable[Renderer], placed: BinnedTransfer, targets: Sequence[str]
) -> tuple[Renderer, ...]:
    """The same renderers with zero points and shares of funneling found for ``targets``, so that draws of G find them
    there; for any G with the ports of ``placed`` whose inputs are known as there.

    Zero points that are searched stay a search. Raises as :meth:`.Renderer.aim` for ports that a renderer cannot serve.
    """
    return tuple(m.precomputed_for_targets(placed, targets) if isinstance(m, Settling) else m for m in methods)


def with_controls(placed: BinnedTransfer, methods: Iterable[Renderer], targets: Sequence[str]) -> BinnedTransfer:
    """The same G with each set of control points by which precomputed_for_targets ``methods`` aim at ``targets``
    decomposed once.

    Corners of the thesis' grid have the control points of its middle, and where all other points are held still every
    target has the same. Drives are the same to the last bit. Raises as :func:`.control_of`.
    """
    sets = dict.fromkeys(
        frozenset((target, *zeros)) for m in methods for target in targets if (zeros := _zeros(m, target)) is not None
    )
    controls = (control_of(placed, names) for names in sets)
    return replace(placed, controls={c.rows: c for c in controls})


def _zeros(method: Renderer, target: str) -> tuple[str, ...] | None:
    """Zero points that are known before the renderer aims."""
    zeros = getattr(method, "zeros", None)
    return zeros.by_target.get(target) if isinstance(zeros, FixedZeros) else zeros if isinstance(zeros, tuple) else None
