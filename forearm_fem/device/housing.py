"""The shell shared by all actuators: a rigid body with heave, roll and pitch on strap and foam.

Generalised coordinates q = (z, g theta_x, g theta_y) [m] with g the radius of gyration, about the mean of the contacts,
so that the mass matrix is m I. Left out: sliding and yaw, for the strap's forces along the skin are not modelled.
"""

from __future__ import annotations

import numpy as np

from ..ports import Port, positions
from ..scenario.device import AnyHousing, Device, HeldHousing, VoltageDevice
from ..typing import ComplexArray, FloatArray


def lever_matrix(
    housing: AnyHousing, contacts: tuple[Port, ...], places: tuple[Port, ...] | None = None
) -> FloatArray:
    """H (n_place, n_q) with x2 = H q: the housing's displacement along each port's axis; n_q = 0 if fixed.

    x2_k = a_z (z + theta_x (y_k - ybar) - theta_y (x_k - xbar)), a_z the axis' component along z and (xbar, ybar) the
    mean of the ``contacts``, which are the ``places``, too, where these are left out.
    """
    places = contacts if places is None else places
    if isinstance(housing, HeldHousing):
        return np.zeros((len(places), 0))
    lever = (positions(places) - positions(contacts).mean(axis=0)) / housing.gyration
    upward = np.array([p.axis[2] for p in places])
    return np.asarray(upward[:, None] * np.stack([np.ones(len(places)), lever[:, 1], -lever[:, 0]], axis=1))


def strap_stiffness(housing: AnyHousing) -> ComplexArray:
    """Strap and foam per coordinate (n_q,) [N/m]: k (1 + i loss), times (lever/gyration)^2 for rotations."""
    if isinstance(housing, HeldHousing):
        return np.zeros(0, dtype=complex)
    ratio = (housing.strap_radius / housing.gyration) ** 2
    return np.asarray(housing.strap_stiffness * (1 + 1j * housing.strap_loss) * np.array([1.0, ratio, ratio]))


def dynamic_stiffness(housing: AnyHousing, omega: FloatArray) -> ComplexArray:
    """Diagonal of k (1 + i loss) - omega^2 m per coordinate (n_frequency, n_q) [N/m]; omega > 0."""
    mass = 0.0 if isinstance(housing, HeldHousing) else housing.mass
    return np.asarray(strap_stiffness(housing) - mass * omega[:, None] ** 2)


def carries_points(device: Device) -> bool:
    """Whether the skin at the points follows a share of the housing's motion (``device.housing.skin_share``)."""
    return isinstance(device, VoltageDevice) and device.housing.skin_share > 0
