"""Impedances and the time-averaged power balance of the device on the skin.

Phasors are peak amplitudes of steady sinusoids: mean power is Re(V conj I) / 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import DataError
from ..scenario.device import VoltageDevice
from ..transfer import Compliance
from ..typing import ComplexArray, FloatArray
from .response import DeviceResponse, circuit, drive_gains, respond, strap_stiffness


@dataclass(frozen=True)
class PowerBalance:
    """Mean powers [W] per actuator (n_frequency, n_actuator); ``strap`` (n_frequency,) is the housing's.

    ``source`` = coil + suspension + skin (summed over actuators) + strap, for nothing else dissipates.
    The skin's entries may be negative one by one: one cone can be driven by another through the skin.
    """

    source: FloatArray
    coil: FloatArray
    suspension: FloatArray
    skin: FloatArray
    strap: FloatArray


def power(compliance: Compliance, device: VoltageDevice, drives: ComplexArray) -> PowerBalance:
    """Balance of the electrical power of ``drives`` (n_frequency, n_actuator) [V, peak], ``device.gains`` included."""
    response = respond(compliance, device)
    _refuse_unlike(response, drives)
    drives = drives * drive_gains(device, drives.shape[1])
    omega = 2 * np.pi * compliance.frequency
    lumped = circuit(device, omega)
    current = coil_current(response, drives)
    cone, stroke = _apply(response.cone, drives), _apply(response.cone - response.housing, drives)
    shell = _apply(response.coordinates, drives)
    loss = strap_stiffness(device.housing).imag
    return PowerBalance(
        source=_mean(drives, current),
        coil=device.coil.resistance * np.abs(current) ** 2 / 2,
        suspension=(omega * lumped.suspension.imag)[:, None] * np.abs(stroke) ** 2 / 2,
        skin=_mean(_apply(response.force, drives), 1j * omega[:, None] * cone),
        strap=omega * (np.abs(shell) ** 2 @ loss) / 2,
    )


def coil_current(response: DeviceResponse, drives: ComplexArray) -> ComplexArray:
    """Currents (n_frequency, n_actuator) [A] for ``drives`` of that shape [V]."""
    _refuse_unlike(response, drives)
    return _apply(response.current, drives)


def _refuse_unlike(response: DeviceResponse, drives: ComplexArray) -> None:
    """DataError for drives of other frequencies or actuators."""
    if drives.shape != response.current.shape[:2]:
        raise DataError(f"drives have the shape {response.current.shape[:2]} (frequency, actuator), got {drives.shape}")


def driving_point_impedance(compliance: Compliance) -> ComplexArray:
    """Skin impedance F / (i omega u) under each contact, the others free (n_frequency, n_contact) [N s/m]."""
    own = np.diagonal(compliance.block("contact", "contact"), axis1=1, axis2=2)
    return np.asarray(1 / (2j * np.pi * compliance.frequency[:, None] * own))


def _apply(matrix: ComplexArray, drives: ComplexArray) -> ComplexArray:
    return np.asarray((matrix @ drives[:, :, None])[:, :, 0])


def _mean(effort: ComplexArray, flow: ComplexArray) -> FloatArray:
    return np.asarray((effort * flow.conj()).real / 2)
