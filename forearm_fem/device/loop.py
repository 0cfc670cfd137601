"""From the skin's compliance to the transfer matrix G, and from its errors to those of G."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from ..scenario.device import Device, VoltageDevice
from ..transfer import UNITS, Compliance, ErrorEstimate, TransferMatrix
from ..typing import BoolArray, ComplexArray, FloatArray
from .response import contact_flexibility, contact_map, contact_ports, drive_gains, in_contact, lever_matrix, respond

# Contacts per unit drive: one result for voltage, force and displacement drive.


@dataclass(frozen=True)
class ContactState:
    """Contact forces and motions per unit drive; arrays (n_frequency, n_actuator, n_input), "unit" V, N or m.

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


# Errors of G by errors of the compliance: first order, entry by entry, no sampling.
# G = C_pc F + K, K what points follow of the housing, with dF = -S dC_cc F and dK = -R dC_cc F give dG = dC_pc F -
# (C_pc S + R) dC_cc F. The entries of dC are taken as independent, of zero mean and of one size per block: e(f)
# max|block| for e(f), e_band times the block's root mean square for the band norm. The squares of their effects add;
# that dC is symmetric is not used. Coherent errors (all of C too soft by one factor) partly cancel in G, so this tends
# to overestimate; ``worst_case=True`` adds the sizes instead: a first-order bound.

_METHOD = "{source} estimate of the compliance, carried to G by first-order sensitivity ({original})"


def propagate_errors(
    compliance: Compliance, state: ContactState, *, worst_case: bool = False
) -> tuple[ErrorEstimate, ...]:
    """One estimate for G per estimate of the compliance; none where nothing touches the skin."""
    if not compliance.errors or not state.force.any():
        return ()
    values, frequency = state.at_points(compliance), compliance.frequency
    peak = _effect(compliance, state, _largest, worst_case)
    mean = _effect(compliance, state, _root_mean_square, worst_case)
    peak_gain = peak.max(axis=(1, 2)) / np.abs(values).max(axis=(1, 2))  # e_G(f) / e_C(f)
    band_gain = float(np.linalg.norm(mean) / np.linalg.norm(values))
    carried = []
    for estimate in compliance.errors:
        method = _METHOD.format(source=estimate.source, original=estimate.method)
        found = ErrorEstimate(estimate.source, estimate.band * band_gain, method)
        if estimate.frequency:  # linear between its own frequencies
            size = np.interp(frequency, estimate.frequency, estimate.per_frequency)
            each = tuple((size * peak_gain).tolist())
            found = replace(found, frequency=tuple(frequency.tolist()), per_frequency=each)
        carried.append(found)
    return tuple(carried)


def _effect(
    compliance: Compliance, state: ContactState, size: Callable[[ComplexArray], FloatArray], worst_case: bool
) -> FloatArray:
    """|dG| (n_frequency, n_point, n_input) for relative errors of 1: root sum of squares, or sum."""
    power = 1 if worst_case else 2
    to_points, under = compliance.block("point", "contact"), compliance.block("contact", "contact")
    forces = (np.abs(state.force) ** power).sum(axis=1, keepdims=True)
    relayed = (np.abs(to_points @ state.reaction + state.released) ** power).sum(axis=2, keepdims=True)
    squares = forces * (size(to_points) ** power + relayed * size(under) ** power)
    return np.asarray(squares ** (1 / power))


def _largest(block: ComplexArray) -> FloatArray:
    return np.asarray(np.abs(block).max(axis=(1, 2), keepdims=True))


def _root_mean_square(block: ComplexArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(np.abs(block) ** 2, axis=(1, 2), keepdims=True)))


# From the skin's compliance to the transfer matrix G.


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
