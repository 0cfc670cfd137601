"""What the contacts do per unit drive: one result for voltage, force and displacement drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from ..arguments import checked
from ..scenario.device import Device, VoltageDevice
from ..transfer import Compliance
from ..typing import BoolArray, ComplexArray
from .housing import lever_matrix
from .response import contact_flexibility, contact_map, contact_ports, drive_gains, in_contact, respond


@dataclass(frozen=True)
class ContactState:
    """What the skin feels per unit drive; arrays (n_frequency, n_actuator, n_input), "unit" V, N or m.

    ``force`` F on the skin [N/unit], ``contacts`` displacement of the cones [m/unit], ``reaction`` S [N/m]
    the loss of force when the skin is raised: a change dC of the compliance gives dF = -S dC_cc F. ``carried``
    (n_frequency, n_point, n_input) [m/unit] is what the points follow of the housing, and ``released``
    (n_frequency, n_point, n_actuator) [-] the loss of that when the skin is raised.
    """

    force: ComplexArray
    contacts: ComplexArray
    reaction: ComplexArray
    carried: ComplexArray
    released: ComplexArray

    def at_points(self, compliance: Compliance) -> ComplexArray:
        """Displacement of the points (n_frequency, n_point, n_input) [m/unit]."""
        return np.asarray(compliance.block("point", "contact") @ self.force + self.carried)


@checked
def contact_state(compliance: Compliance, device: Device) -> ContactState:
    """Forces, displacements and reactions at the contacts per unit of ``device.drive``, ``device.gains`` included."""
    state = _STATES[device.drive](compliance, device)
    gains = drive_gains(device, state.force.shape[2])
    return replace(state, force=state.force * gains, contacts=state.contacts * gains, carried=state.carried * gains)


def _voltage(compliance: Compliance, device: Device) -> ContactState:
    assert isinstance(device, VoltageDevice)
    response, housing = respond(compliance, device), device.housing
    points = tuple(compliance.ports[i] for i in compliance.indices("point"))
    levers = lever_matrix(housing, contact_ports(compliance, device), points)
    carried, released = (housing.skin_share * (levers @ q) for q in (response.coordinates, response.lifted))
    return ContactState(response.force, response.cone, response.reaction, np.asarray(carried), np.asarray(released))


def _force(compliance: Compliance, device: Device) -> ContactState:
    under, touching = _under(compliance, device)
    force = np.broadcast_to(np.diag(touching).astype(complex), under.shape)
    still = _still(compliance)
    return ContactState(force, under @ force, np.zeros_like(under), still, still)


def _displacement(compliance: Compliance, device: Device) -> ContactState:
    under, touching = _under(compliance, device)
    both = touching[:, None] & touching[None, :]
    force = np.where(both, np.linalg.inv(contact_map(under, touching, np.zeros(len(touching)))), 0)
    still = _still(compliance)
    return ContactState(force, under @ force, force, still, still)


def _under(compliance: Compliance, device: Device) -> tuple[ComplexArray, BoolArray]:
    """Displacements of the cones per force on the skin, springs included, and who touches it."""
    n = len(contact_ports(compliance, device))
    under = compliance.block("contact", "contact") + np.diag(contact_flexibility(device, n))
    return np.asarray(under), in_contact(device, n)


def _still(compliance: Compliance) -> ComplexArray:
    """Nothing carried: no housing moves where forces or displacements are given."""
    return np.zeros_like(compliance.block("point", "contact"))


_STATES: Mapping[str, Callable[[Compliance, Device], ContactState]] = MappingProxyType(
    {"voltage": _voltage, "force": _force, "displacement": _displacement}
)
