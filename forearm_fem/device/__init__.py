"""Voice coils, cones and their shared housing, closed around the skin's compliance."""

from .loop import close_loop
from .power import PowerBalance, coil_current, driving_point_impedance, power
from .response import DeviceResponse, respond
from .rotating_mass import RotatingMass
from .sensitivity import propagate_errors
from .state import ContactState, contact_state

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
