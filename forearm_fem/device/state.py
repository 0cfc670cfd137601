"""What the contacts do per unit drive: one result for voltage, force and displacement drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from ..scenario.device import Device
from ..transfer import Compliance
from ..typing import BoolArray, ComplexArray
from .response import contact_map, contact_ports, in_contact, respond


@dataclass(frozen=True)
class ContactState:
    """What the skin feels per unit drive; arrays (n_frequency, n_actuator, n_input), "unit" V, N or m.

    ``force`` F on the skin [N/unit], ``contacts`` displacement of the cones [m/unit], ``reaction`` S [N/m]
    the loss of force when the skin is raised: a change dC of the compliance gives dF = -S dC_cc F.
    """

    force: ComplexArray
    contacts: ComplexArray
    reaction: ComplexArray


def contact_state(compliance: Compliance, device: Device) -> ContactState:
    """Forces, displacements and reactions at the contacts per unit of ``device.drive``."""
    return _STATES[device.drive](compliance, device)


def _voltage(compliance: Compliance, device: Device) -> ContactState:
    response = respond(compliance, device)
    return ContactState(response.force, response.cone, response.reaction)


def _force(compliance: Compliance, device: Device) -> ContactState:
    skin, touching = _skin(compliance, device)
    force = np.broadcast_to(np.diag(touching).astype(complex), skin.shape)
    return ContactState(force, skin @ force, np.zeros_like(skin))


def _displacement(compliance: Compliance, device: Device) -> ContactState:
    skin, touching = _skin(compliance, device)
    both = touching[:, None] & touching[None, :]
    force = np.where(both, np.linalg.inv(contact_map(skin, touching)), 0)
    return ContactState(force, skin @ force, force)


def _skin(compliance: Compliance, device: Device) -> tuple[ComplexArray, BoolArray]:
    contacts = contact_ports(compliance, device)
    return compliance.block("contact", "contact"), in_contact(device, len(contacts))


_STATES: Mapping[str, Callable[[Compliance, Device], ContactState]] = MappingProxyType(
    {"voltage": _voltage, "force": _force, "displacement": _displacement}
)
