"""The voice coil as a lumped circuit (physics_data.md 4), one frequency axis at a time.

V = (Re + i omega Le) I + Bl i omega (x1 - x2), and the coil pushes the cone with Bl I. Positive voltage
pushes outward, along the port's axis. Linear: no Le(x), no Bl(x), no heating of Re.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scenario.device import VoltageDevice
from ..typing import ComplexArray, FloatArray


@dataclass(frozen=True)
class Circuit:
    """The same coil and cone for every actuator; arrays are (n_frequency,)."""

    omega: FloatArray
    electrical: ComplexArray
    """Blocked coil impedance Ze = Re + i omega Le [ohm]."""
    suspension: ComplexArray
    """Kms + i omega Rms [N/m]."""
    force_factor: float
    mass: float
    """Coil and cone [kg]."""

    @property
    def force_per_volt(self) -> ComplexArray:
        """Bl / Ze [N/V]: force of the blocked coil (n_frequency,)."""
        return np.asarray(self.force_factor / self.electrical)

    @property
    def spring(self) -> ComplexArray:
        """Suspension with the shorted coil's damping: Kms + i omega (Rms + Bl^2 / Ze) [N/m]."""
        return np.asarray(self.suspension + 1j * self.omega * self.force_factor**2 / self.electrical)

    @property
    def inertia(self) -> FloatArray:
        """-omega^2 (Mms + mc) [N/m] (n_frequency,)."""
        return np.asarray(-(self.omega**2) * self.mass)


def circuit(device: VoltageDevice, omega: FloatArray) -> Circuit:
    """Circuit of ``device`` at ``omega`` (n_frequency,) [rad/s]; Kms = Mms w0^2, Rms = w0 Mms / Qms."""
    coil = device.coil
    w0 = 2 * np.pi * coil.resonance
    return Circuit(
        omega=omega,
        electrical=np.asarray(coil.resistance + 1j * omega * coil.inductance),
        suspension=np.asarray(coil.moving_mass * (w0**2 + 1j * omega * w0 / coil.quality)),
        force_factor=coil.force_factor,
        mass=coil.moving_mass + device.cone.mass,
    )
