"""Inverse filter: move the target as asked and hold the zero points still."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..typing import ComplexArray
from .drives import Aim
from .funneling import absent_inputs, known_bins
from .inversion import Regularisation, invert
from .spectrum import Placed
from .zeros import AutoZeros, Zeros, chosen_zeros, within_thesis

LEAST_ERROR = 0.02  # e(f): no G of an arm is known better, and what S gains from less is its own error


@dataclass(frozen=True)
class InverseFilter:
    """Inverse filter renderer, eq. 4 of de Vlam 2022: S = H^+ U at every frequency.

    H is the rows of G of the target and the zero points, U the wavelet at the target and zero elsewhere. With
    more control points than actuators this is least squares: neither target nor zeros are met exactly, and
    without damping the target reaches the share 1 - m^2 of what was asked, m = ``Drives.inversion.misfit``,
    which varies with frequency. So ``peak`` [m], which scales the wavelet, is not reached either: use
    :func:`scale_to` for that. ``zeros`` is a rule or names of outputs. ``regularisation`` None follows the number of
    actuators: up to the thesis' four, the pseudo-inverse; more, the damping that the error of a measured G asks for
    (:class:`Regularisation`, "noise"), at least that for ``least_error`` [-], e(f) that G is taken to err by.
    """

    zeros: Zeros = field(default_factory=AutoZeros)
    regularisation: Regularisation | None = None
    peak: float = 1e-6
    least_error: float = LEAST_ERROR
    name: str = "inverse filter"

    def aim(self, placed: Placed, target: str, wavelet: ComplexArray) -> Aim:
        """Drive spectra towards output ``target``; ``wavelet`` (n_bins,) [1/Hz]."""
        return aim_at(placed, target, self.peak * wavelet, self.zeros, self.regularisation or self.least_error)

    def with_zeros(self, zeros: Zeros) -> InverseFilter:
        """The same renderer with other zero points."""
        return replace(self, zeros=zeros)


def aim_at(
    placed: Placed, target: str, displacement: ComplexArray, zeros: Zeros, regularisation: Regularisation | float
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
        return _least_squares(placed, (target, *names), displacement, rule)

    return towards(chosen_zeros(zeros, placed, target, towards))


def _least_squares(
    placed: Placed, control: tuple[str, ...], displacement: ComplexArray, regularisation: Regularisation
) -> Aim:
    rows = [placed.row(name) for name in control]
    used = known_bins(placed, rows)
    matrix = placed.bins.values[used][:, rows]
    matrix[:, :, absent_inputs(placed, rows)] = 0
    wanted = np.zeros(matrix.shape[:2], dtype=complex)
    wanted[:, 0] = displacement[used]
    spectrum = np.zeros((len(used), len(placed.inputs)), dtype=complex)
    spectrum[used], report = invert(
        matrix, wanted, regularisation, placed.bins.frequency[used], placed.error[used]
    )
    return Aim(spectrum, used, control[1:], report)
