"""Cones, housing and coils on the skin, and the loop closed: from compliance to G, and from its errors to G."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from ..errors import DataError, ScenarioError
from ..ports import Port, positions
from ..scenario.device import ActuatorArray, AnyHousing, Device, HeldHousing, VoltageDevice
from ..transfer import UNITS, Compliance, ErrorEstimate, TransferMatrix
from ..typing import BoolArray, ComplexArray, FloatArray

# The voice coil as a lumped circuit (physics_data.md 4), one frequency axis at a time.
# V = (Re + i omega Le) I + Bl i omega (x1 - x2), and the coil pushes the cone with Bl I. Positive voltage
# pushes outward, along the port's axis. Linear: no Le(x), no Bl(x), no heating of Re.


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


# The shell shared by all actuators: a rigid body with heave, roll and pitch on strap and foam.
# Generalised coordinates q = (z, g theta_x, g theta_y) [m] with g the radius of gyration, about the mean of the
# contacts, so that the mass matrix is m I. Left out: sliding and yaw, for the strap's forces along the skin are not
# modelled.


def lever_matrix(housing: AnyHousing, contacts: tuple[Port, ...], places: tuple[Port, ...] | None = None) -> FloatArray:
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
    """True if the skin at the points follows a share of the housing's motion (``device.housing.skin_share``)."""
    return isinstance(device, VoltageDevice) and device.housing.skin_share > 0


# Closing the loop: voice coils, cones and housing around the skin's compliance, for unit voltages.
# With F the outward force on the skin, x1 the cones and x2 = H q the housing (outward positive),
# x1 = (C_cc + 1/k) F                                         skin and contact spring (F = 0 out of contact)
# Bl/Ze V = s (x1 - H q) - omega^2 (Mms + mc) x1 + F          cones, s = Kms + i omega (Rms + Bl^2/Ze)
# (strap - omega^2 m) q = H^T (s (x1 - H q) - Bl/Ze V)        housing
# The unknowns are u and q, where u_k is F_k in contact and x1_k out of contact: (n + 3) equations per
# frequency, solved for all frequencies at once. No new finite-element solve, whatever changes here.


@dataclass(frozen=True)
class DeviceResponse:
    """Motions, forces and currents of all parts of the device per volt, (n_frequency, n_actuator, n_input).

    The amplifiers are voltage sources: the actuators not driven are held at 0 V, not disconnected.
    """

    frequency: FloatArray
    cone: ComplexArray
    """x1 [m/V], outward."""
    housing: ComplexArray
    """x2 of the housing at each actuator [m/V], outward."""
    coordinates: ComplexArray
    """q of the housing (n_frequency, n_q, n_input) [m/V]; see ``housing``."""
    force: ComplexArray
    """F on the skin [N/V], outward; zero out of contact."""
    current: ComplexArray
    """Coil currents [A/V], the admittance matrix of the device's electrical terminals."""
    reaction: ComplexArray
    """S [N/m]: raising the skin under actuator k by d (all coils shorted) changes F by -S[:, k] d."""
    lifted: ComplexArray
    """The same changes q by -lifted[:, k] d (n_frequency, n_q, n_actuator) [-]."""

    @property
    def input_impedance(self) -> ComplexArray:
        """V_k / I_k at each actuator with the others at 0 V (n_frequency, n_actuator) [ohm]."""
        return np.asarray(1 / np.diagonal(self.current, axis1=1, axis2=2))


def respond(compliance: Compliance, device: VoltageDevice) -> DeviceResponse:
    """Response of ``device`` on the skin described by ``compliance`` to 1 V at each coil in turn.

    ``device.gains`` lie before the coils: they are left to :func:`.state.contact_state`.
    """
    contacts = contact_ports(compliance, device)
    touching = in_contact(device, len(contacts))
    lumped = circuit(device, 2 * np.pi * compliance.frequency)
    system = _System(
        lumped,
        contact_map(compliance.block("contact", "contact"), touching, contact_flexibility(device, len(contacts))),
        touching,
        lever_matrix(device.housing, contacts),
        dynamic_stiffness(device.housing, lumped.omega),
    )
    return system.response()


def contact_ports(compliance: Compliance, device: ActuatorArray) -> tuple[Port, ...]:
    """The contact ports, one per actuator in order A1, A2, ...; else :class:`ScenarioError`."""
    contacts = tuple(compliance.ports[i] for i in compliance.indices("contact"))
    if len(contacts) != len(device.centres):
        raise ScenarioError(
            f"device.contacts: the device has {len(device.centres)} actuators, but the compliance "
            f"was computed for {len(contacts)} contacts; solve it anew for this device"
        )
    return contacts


def in_contact(device: ActuatorArray, n: int) -> BoolArray:
    """True where an actuator of A1..An touches the skin (n,)."""
    return np.array([f"A{i + 1}" not in device.out_of_contact for i in range(n)])


def contact_flexibility(device: ActuatorArray, n: int) -> FloatArray:
    """1/k (n,) [m/N] of the springs between the cones A1..An and the skin, 0 where there is none.

    A spring carries the whole push of its cone and has neither mass nor loss; a real contact's stiffness grows with
    the force, and its rim moves: neither is covered.
    """
    return np.array([1 / device.contact_springs.get(f"A{i + 1}", np.inf) for i in range(n)])


def drive_gains(device: ActuatorArray, n: int) -> FloatArray:
    """Factors (n,) on the drives of the actuators A1..An."""
    return np.array([device.gains.get(f"A{i + 1}", 1.0) for i in range(n)])


def contact_map(block: ComplexArray, touching: BoolArray, flexibility: FloatArray) -> ComplexArray:
    """X (n_frequency, n, n) with x1 = X u: C_cc + 1/k among touching contacts, the identity for the others."""
    both = touching[:, None] & touching[None, :]
    return np.asarray(np.where(both, block + np.diag(flexibility), np.diag(~touching).astype(complex)))


@dataclass(frozen=True)
class _System:
    """The linear system of the module's heading, all frequencies at once."""

    lumped: Circuit
    skin: ComplexArray
    touching: BoolArray
    levers: FloatArray
    shell: ComplexArray

    def matrix(self) -> ComplexArray:
        """(n_frequency, n + n_q, n + n_q), rows cones then housing, unknowns u then q [N/m or 1]."""
        s, h = self.lumped.spring[:, None, None], self.levers
        cones = (s + self.lumped.inertia[:, None, None]) * self.skin + np.diag(self.touching)
        housing = s * (h.T @ h) + self.shell[:, :, None] * np.eye(h.shape[1])
        return np.concatenate(
            [
                np.concatenate([cones, -s * h], axis=2),
                np.concatenate([-s * (h.T @ self.skin), housing], axis=2),
            ],
            axis=1,
        )

    def loads(self) -> ComplexArray:
        """(n_frequency, n + n_q, 2 n): 1 V on each actuator, then the skin raised by 1 m under each."""
        s, inertia = self.lumped.spring[:, None, None], self.lumped.inertia[:, None, None]
        eye = np.eye(len(self.levers))
        volts = self.lumped.force_per_volt[:, None, None] * np.concatenate([eye, -self.levers.T], axis=0)
        raised = np.concatenate([(s + inertia) * eye, -s * self.levers.T], axis=1)
        return np.concatenate([volts, raised * self.touching], axis=2)

    def response(self) -> DeviceResponse:
        """Solve, and recover displacements, forces and I = (V - Bl i omega (x1 - x2)) / Ze."""
        n, lumped = len(self.levers), self.lumped
        solution = np.linalg.solve(self.matrix(), self.loads())
        q: ComplexArray = np.asarray(solution[:, n:, :n])
        unknown, raised = (np.asarray(part) for part in (solution[:, :n, :n], solution[:, :n, n:]))
        cone, shell = self.skin @ unknown, self.levers @ q
        back_emf = (1j * lumped.omega * lumped.force_factor)[:, None, None] * (cone - shell)
        return DeviceResponse(
            frequency=lumped.omega / (2 * np.pi),
            cone=cone,
            housing=shell,
            coordinates=q,
            force=np.asarray(unknown * self.touching[:, None]),
            current=np.asarray((np.eye(n) - back_emf) / lumped.electrical[:, None, None]),
            reaction=np.asarray(raised * self.touching[:, None]),
            lifted=np.asarray(solution[:, n:, n:]),
        )


# Impedances and the time-averaged power balance of the device on the skin.
# Phasors are peak amplitudes of steady sinusoids: mean power is Re(V conj I) / 2.

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


# From the skin's compliance to the transfer matrix G, and from its errors to those of G.

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
