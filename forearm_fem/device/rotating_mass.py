"""An eccentric rotating mass (ERM): a source of force whose amplitude is tied to its frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import DataError
from ..scenario.actuators import ACTUATORS
from ..transfer import TransferMatrix
from ..typing import FloatArray

_GRAVITY = 9.80665  # m/s^2


@dataclass(frozen=True, eq=False)
class RotatingMass:
    """Steps of a motor: ``frequency`` (n,) [Hz] and the peak ``acceleration`` (n,) [m/s^2] it gave to some body.

    A mass m at e from the shaft pulls with m e omega^2, and shakes a free body of mass M with m e omega^2 / M. The
    normal component of the force is meant; that along the skin, as large, is left out, and so are the start of the
    motor and its speed under load.
    """

    frequency: FloatArray
    acceleration: FloatArray

    @classmethod
    def shah(cls) -> RotatingMass:
        """The motor of Shah et al. 2019: 102 to 241 Hz in twelve steps."""
        frequency, gravities = np.array(ACTUATORS["ERM"].steps).T
        return cls(frequency, gravities * _GRAVITY)

    def unbalance(self, mass: float) -> tuple[float, float]:
        """m e [kg m] for a free body of ``mass`` [kg], mean over the steps, and its relative spread over them [-]."""
        each = mass * self.acceleration / (2 * np.pi * self.frequency) ** 2
        return float(each.mean()), float(each.std(ddof=1) / each.mean())

    def force(self, mass: float) -> FloatArray:
        """Peak force (n,) [N] at each step: the body's ``mass`` [kg], which the source does not give, times its
        acceleration. DataError for a mass that no body has."""
        if not 0 < mass < np.inf:
            raise DataError(f"a rotating mass shakes a body of some kg, got {mass:g}; give the moving body's mass [kg]")
        return mass * self.acceleration

    def steady(self, transfer: TransferMatrix, mass: float, actuator: str) -> FloatArray:
        """Peak displacement (n, n_out) [m] at each step with the motor alone on contact ``actuator``, NaN where G is
        not valid beside a step.

        ``transfer`` is a G in m/N. Raises DataError for another unit, an unknown actuator, or steps beyond its band.
        """
        names = [p.name for p in transfer.inputs]
        if transfer.unit != "m/N" or actuator not in names:
            raise DataError(
                f"a rotating mass needs G in m/N (device.drive = 'force') and one of {', '.join(names)}, got a G in "
                f"{transfer.unit} and '{actuator}'"
            )
        low, high = transfer.frequency[[0, -1]]
        if not low <= self.frequency.min() <= self.frequency.max() <= high:
            raise DataError(
                f"the motor's steps reach from {self.frequency.min():g} to {self.frequency.max():g} Hz, G from {low:g} "
                f"to {high:g} Hz; solve a wider band"
            )
        usable = True if transfer.valid is None else transfer.valid
        column = np.abs(np.where(usable, transfer.values, np.nan)[:, :, names.index(actuator)])
        gain = np.array([np.interp(self.frequency, transfer.frequency, row) for row in column.T]).T
        return np.asarray(gain * self.force(mass)[:, None])
