"""From the skin's compliance to the transfer matrix G."""

from __future__ import annotations

from ..arguments import checked
from ..scenario.device import Device
from ..transfer import UNITS, Compliance, TransferMatrix
from .response import contact_ports
from .sensitivity import propagate_errors
from .state import contact_state


@checked
def close_loop(compliance: Compliance, device: Device) -> TransferMatrix:
    """G (n_frequency, n_point, n_actuator) of ``device`` on the skin described by ``compliance``.

    ``device.drive`` sets the meaning of a unit drive:

    voltage : 1 V at one amplifier, 0 V at the others [m/V]; ``contacts`` are the cones' displacements.
    force : 1 N outward on the skin under one contact, no force at the others [m/N].
    displacement : 1 m outward at one contact, the others held at 0, for cones are rigid [m/m].

    ``device.gains`` multiply the drives, ``device.contact_springs`` lie between cones and skin, and
    ``device.housing.skin_share`` of the housing's motion is added at the points: it moves the skin there without
    being felt by the contacts. An actuator out of contact exerts no force: for force and displacement its column is
    zero, and ``contacts`` then holds the free skin under it.
    """
    state = contact_state(compliance, device)
    return TransferMatrix(
        frequency=compliance.frequency,
        values=state.at_points(compliance),
        outputs=tuple(compliance.ports[i] for i in compliance.indices("point")),
        inputs=contact_ports(compliance, device),
        unit=UNITS[device.drive],
        contacts=state.contacts,
        errors=propagate_errors(compliance, state),
        provenance={**compliance.provenance, "device": device.model_dump(mode="json")},
    )
