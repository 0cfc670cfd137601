"""Voice coils, cones and their shared housing, closed around the skin's compliance."""

from .loop import (
    ContactState,
    DeviceResponse,
    PowerBalance,
    close_loop,
    coil_current,
    contact_state,
    driving_point_impedance,
    power,
    propagate_errors,
    respond,
)
from .rotating_mass import RotatingMass

__all__ = [
    "ContactState",
    "DeviceResponse",
    "PowerBalance",
    "RotatingMass",
    "close_loop",
    "coil_current",
    "contact_state",
    "driving_point_impedance",
    "power",
    "propagate_errors",
    "respond",
]
