"""The arm's library: what any discs of one radius, and any points, on a patch of skin need for their compliance."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.linalg

from ...accuracy.estimates import moved_by_stretch, stated_errors
from ...errors import GeometryError, ScenarioError
from ...fem.reduction.affine import Modes
from ...geometry.device.layout import layout_of
from ...geometry.device.place import parametric_skin, ports_on
from ...layered.discs import Disc
from ...layered.response import LayeredResult
from ...layered.tables import Tabulated, from_arrays
from ...ports import Port, positions
from ...results.run import SolutionRecord
from ...scenario import Scenario
from ...scenario.limb import CylinderLimb, ForearmLimb, SlabLimb
from ...scenario.sweep import frequencies
from ...store.record import dims
from ...transfer import Compliance, ErrorEstimate
from ...typing import BoolArray, ComplexArray, FloatArray, IntArray
from ..fem import Solved
from ..layered import flat_layers, flat_surface
from ..simulation import refuse_unheld
from .between import Bands, Lattice, Prior, Shape, shape_of
from .side import constrained_compliance, deviation_held, modal_compliance, real_product
from .skin import FlatSkin, flat_compliance, flat_skin

MARGIN = 0.02  # [m] of skin around the patch that bells reach
WIDTH = 0.4  # of a bell, in steps of the lattice
_SPREAD, _LEAST, _NOISE = 0.7, 60.0, 1e-6  # kappa in shortest wavenumbers, and [1/m]
_SAME = ("limb", "tissues", "supports")  # what a scenario shares with its library


@dataclass(frozen=True, eq=False)
class _Part:
    """One part of the band: its ``number``, which frequencies are ``mine``, the ``weights`` (n + 2 s, m) of bells for
    ports, then for what discs are held against, the ``flat`` layered model (n_node, m, m) between these, the
    ``variance`` (2, m) of what is interpolated, before and known."""

    number: int
    mine: BoolArray
    weights: FloatArray
    flat: ComplexArray
    variance: FloatArray


@dataclass(frozen=True, eq=False)
class _Asked:
    """Compliances that a scenario asks of any limb.

    ``places``: of p ports, flat; then of constraints of rigid discs: bonded along u and v, and tilt along u and
    v.
    ``owner`` (m,): port of each row.
    ``way`` (m,): 0 along the normal, 1 along the skin, 2 tilt.
    ``layered``: layered model of all m.
    """

    ports: tuple[Port, ...]
    frequency: FloatArray
    places: FloatArray
    owner: IntArray
    way: IntArray
    layered: LayeredResult
    parts: tuple[_Part, ...]


@dataclass(frozen=True, eq=False, repr=False)
class ArmLibrary:
    """Answers for any arrangement of discs on the patch of ``scenario``'s limb.

    Gaussian loads of ``width`` [m] push along the normal at ``centres`` (n, 2) [m] in flat coordinates, and along u,
    then along v, at ``sideways`` (s, 2), none but for bonded discs; ``fine`` is the limb through them, in this order,
    ``coarse`` on a second mesh whose nodes are ``ratio`` times as far apart (None where there is none), ``freed`` with
    free ends (None where none absorb). ``flat`` (n_part, n_node, 1 or 4, n_distance) are the layered model's integrals
    between two bells at ``distances`` [m], at the nodes of :class:`Bands`; ``tables`` the layered model for discs.
    ``spread`` (n_part, 3, n_bin) is the standard deviation [m/N] of what is interpolated, by distance (``bins``
    (n_bin,) [m]), in units of the prior: along the normal, between it and the skin, and along the skin. ``reduction``
    (3, n) are frequencies [Hz] and the reduced model's e(f) there, against direct solves, along the normal and along
    the skin, ``missed`` (n, 3, n_bin) [m/N] what it is off there by distance.
    """

    kind: ClassVar[str] = "arm's library"
    version: ClassVar[int] = 2

    scenario: Scenario
    centres: FloatArray = field(metadata=dims("bell uv", units="m"))
    sideways: FloatArray = field(metadata=dims("sideways_bell uv", units="m"))
    width: float
    fine: Modes
    coarse: Modes | None
    freed: Modes | None
    ratio: float
    distances: FloatArray = field(metadata=dims("distance", units="m"))
    flat: ComplexArray = field(metadata=dims("part node integral distance"))
    tables: Mapping[str, Any] = field(metadata=dims("*"))
    bins: FloatArray = field(metadata=dims("bin", units="m"))
    spread: FloatArray = field(metadata=dims("part direction bin"))
    reduction: FloatArray = field(metadata=dims("frequency_and_errors checked"))
    missed: FloatArray = field(metadata=dims("checked direction bin"))
    facts: Mapping[str, Any]

    def __repr__(self) -> str:
        return f"<ArmLibrary of '{self.scenario.name}', {len(self.centres)} loads; each answer states its own error>"

    @property
    def mark(self) -> str:
        """SHA-256 of the limb's poles and what its loads see of them."""
        seen = hashlib.sha256(
            self.fine.poles.tobytes() + self.fine.left.tobytes() + repr(self.layered.contact).encode()
        )
        return seen.hexdigest()[:16]

    @property
    def name(self) -> str:
        """See :class:`.Engine`."""
        return "library"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: its own arm, band, and cones."""
        if scenario.engine != "fem":
            return "engine: a library stands for finite elements; set engine = 'fem', or leave it out"
        for key in _SAME:
            if getattr(scenario, key) != getattr(self.scenario, key):
                return (
                    f"{key}: this library was made for another arm than the scenario's; make one for it "
                    "(`forearm-fem library`), or leave --library out"
                )
        frequency, low, high = frequencies(scenario.sweep), self.bands.edges[0], self.bands.edges[-1]
        if frequency[0] < low * (1 - 1e-9) or frequency[-1] > high * (1 + 1e-9):
            return (
                f"sweep: the library holds {low:g} to {high:g} Hz, asked for {frequency[0]:g} to {frequency[-1]:g} Hz; "
                "narrow the sweep, or make a library for it"
            )
        cone = scenario.device.cone
        if abs(cone.radius - self.layered.radius) > 1e-9 or cone.contact != self.layered.contact:
            return (
                f"device.cone: the library holds {self.layered.contact} discs of {self.layered.radius * 1e3:g} mm "
                f"radius, asked for {cone.contact} ones of {cone.radius * 1e3:g} mm; make a library for these"
            )
        return ""

    def compliance(self, scenario: Scenario, frequency: FloatArray | None = None) -> Compliance:
        """Compliance of the contacts and points of ``scenario`` with errors by interpolation, contacts and reduction.

        At ``frequency`` (n,) [Hz], by default the scenario's. Raises ScenarioError for another arm, radius, contact or
        band, GeometryError for places off the patch. Entries between points are NaN: no device drives there.
        """
        return self._stated(self._asked(scenario, frequency))

    def solved(self, scenario: Scenario, frequency: FloatArray | None = None) -> Solved:
        """The same as the solver's result, with the second mesh and the freed ends for the other errors."""
        asked = self._asked(scenario, frequency)
        fine = self._stated(asked)
        coarse, freed = (None if limb is None else self._answer(asked, limb)[0] for limb in (self.coarse, self.freed))
        if coarse is not None:
            coarse = replace(coarse, provenance={"ratio": self.ratio})
        unknown = () if coarse is not None else (
            ErrorEstimate("discretisation", np.nan, "the library was made without a second mesh"),
        )  # fmt: skip
        empty = np.zeros((0, 3, 0)), np.zeros((len(fine.frequency), 0, 0), dtype=complex)
        return Solved(fine, coarse, freed, *empty, SolutionRecord(solver="library"), unknown)

    def _asked(self, scenario: Scenario, frequency: FloatArray | None = None) -> _Asked:
        ports = self.ports(scenario)
        frequency = frequencies(scenario.sweep) if frequency is None else frequency
        places = self.skin.flat(positions(ports))
        rigid = [i for i, port in enumerate(ports) if port.kind == "contact" and self.layered.contact != "pressure"]
        ways = (1, 1, 2, 2) if len(self.sideways) else (2, 2)
        owner = np.concatenate([np.arange(len(ports)), np.tile(rigid, len(ways))]).astype(int)
        way = np.concatenate([np.zeros(len(ports)), np.repeat(ways, len(rigid))]).astype(int)
        discs = [Disc(u, v) if port.kind == "point" else Disc(u, v, port.radius, port.contact)
                 for port, (u, v) in zip(ports, places.tolist(), strict=True)]  # fmt: skip
        layered = self.layered.compliance(2 * np.pi * frequency, discs, free=self.layered.contact != "pressure")
        number, parts = self.bands.number(frequency), []
        for b in np.unique(number):
            weights, variance = self._weights(int(b), ports, places, rigid)
            seen = real_product(weights.T, self._flat_bells[b]) @ weights
            parts.append(_Part(int(b), number == b, weights, seen, variance))
        return _Asked(ports, frequency, places, owner, way, layered, tuple(parts))

    def _answer(self, asked: _Asked, limb: Modes) -> tuple[Compliance, ComplexArray]:
        """C through ``limb``, and what holding the discs takes, B."""
        free, carry = asked.layered.values.copy(), self.bands.between(asked.frequency)
        point = np.array([port.kind == "point" for port in asked.ports])[asked.owner]
        for part in asked.parts:
            apart = modal_compliance(limb, asked.frequency[part.mine], part.weights, ~(point[:, None] & point))
            free[part.mine] += apart - np.einsum("fn,nij->fij", carry[part.mine], part.flat)
        values, hold = constrained_compliance(0.5 * (free + free.swapaxes(1, 2)), len(asked.ports))
        return Compliance(asked.frequency, values, asked.ports), hold

    def _stated(self, asked: _Asked) -> Compliance:
        """C of the finer mesh with what is stated of interpolation, layered model, contacts and reduction."""
        found, hold = self._answer(asked, self.fine)
        deviation, missed = np.zeros(asked.layered.values.shape), self._missed(asked)
        for part in asked.parts:
            deviation[part.mine] = self._deviation(part, asked)
        spread, missed = deviation_held(deviation, hold), deviation_held(missed, hold)
        bent = 0.25 * (self.layered.radius * self.skin.curvature) ** 2
        distance = np.linalg.norm(asked.places[:, None] - asked.places, axis=2)
        moved = moved_by_stretch(asked.ports, distance, self.skin.stretch(asked.places), self.scenario.library.step)
        return replace(found, errors=stated_errors(found, spread, missed, asked.layered.error, bent, moved))

    def ports(self, scenario: Scenario) -> tuple[Port, ...]:
        """Ports of ``scenario`` on the library's skin, after all that may be refused was."""
        refuse_unheld(self, scenario)
        layout_of(scenario)
        ports = ports_on(scenario, self.skin.skin)
        self._check_on_patch(ports)
        if scenario.device.cone.contact == "pressure":
            self._check_none_under(ports)
        return ports

    @cached_property
    def layered(self) -> Tabulated:
        """The layered model for the library's discs."""
        x, cone = self.scenario, self.scenario.device.cone
        return from_arrays(self.tables, flat_layers(x), flat_surface(x.tissues), cone.radius, cone.contact)

    @cached_property
    def skin(self) -> FlatSkin:
        """The skin laid flat."""
        return library_skin(self.scenario)

    @cached_property
    def bands(self) -> Bands:
        """Parts of the library's band."""
        return Bands.of(*library_band(self.scenario))

    @cached_property
    def lattices(self) -> tuple[tuple[Lattice, ...], tuple[Lattice, ...]]:
        """The lattices of loads along the normal, and along the skin, in each part of the band."""
        made = []
        for centres in (self.centres, self.sideways):
            some = self.bands.edges[1:] if len(centres) else ()
            made.append(tuple(lattice(self.scenario, centres, self.width, high) for high in some))
        return made[0], made[1]

    def _weights(
        self, part: int, ports: tuple[Port, ...], places: FloatArray, rigid: list[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Weights (n + 2 s, m) of bells for the ports, and for what ``rigid`` discs are held against; variances (2, m),
        before and known."""
        normal, sideways = self.lattices[0][part], self.lattices[1][part] if len(self.sideways) else None
        shapes = [shape_of(port) for port in ports]
        weights, variance = np.empty((len(self.centres), len(ports))), np.empty((2, len(ports)))
        for shape in set(shapes):
            mine = [i for i, s in enumerate(shapes) if s == shape]
            weights[:, mine], variance[:, mine] = normal.weights(shape, places[mine])
        slopes, of_slopes = normal.slopes(Shape("tilt", self.layered.radius), places[rigid])
        if sideways is None:
            return np.hstack([weights, slopes]), np.hstack([variance, of_slopes])
        along, more = sideways.weights(Shape("rigid", self.layered.radius), places[rigid])
        whole = scipy.linalg.block_diag(weights, along, along)
        below = np.pad(slopes, ((0, 2 * len(self.sideways)), (0, 0)))
        return np.hstack([whole, below]), np.hstack([variance, more, more, of_slopes])

    @cached_property
    def _flat_bells(self) -> ComplexArray:
        """The layered model (n_part, n_node, n + 2 s, n + 2 s) between bells."""
        return flat_compliance(self.flat, self.distances, self.centres, self.sideways)

    def _deviation(self, part: _Part, asked: _Asked) -> FloatArray:
        """Standard deviation (m, m) [m/N] of what is interpolated between all that discs move or are held against, of
        tilts [1/N]."""
        before, known = part.variance
        left = np.sqrt(np.maximum(np.outer(before, before) - np.outer(known, known), 0.0))
        return np.asarray(left * self._by_distance(self.spread[part.number], asked))

    def _missed(self, asked: _Asked) -> FloatArray:
        """Error of the reduced model (n_frequency, m, m) [m/N] by distance and direction. Its logarithm is linear
        between the frequencies checked; its slope is at most that of the shortest wave."""
        least, checked = np.finfo(float).tiny, self.reduction[0]
        share = np.array([np.interp(asked.frequency, checked, one) for one in np.eye(len(checked))])
        each = np.array([self._by_distance(of, asked) for of in self.missed])
        waves = shortest_wavenumber(self.scenario, asked.frequency)
        scale = np.where(asked.way == 2, waves[:, None], 1.0)
        off = np.exp(np.einsum("kf,kij->fij", share, np.log(each + least)))
        return np.asarray(off * scale[:, None] * scale[..., None])

    def _by_distance(self, of: FloatArray, asked: _Asked) -> FloatArray:
        """Entries (m, m) of what is known ``of`` (3, n_bin) directions and distances; tilts are as along the normal."""
        at, along = asked.places[asked.owner], (asked.way == 1).astype(int)
        values = np.array([np.interp(np.linalg.norm(at[:, None] - at, axis=2), self.bins, one) for one in of])
        return np.asarray(np.take_along_axis(values, (along[:, None] + along)[None], axis=0)[0])

    def _check_on_patch(self, ports: tuple[Port, ...]) -> None:
        patch = self.scenario.library
        half = 0.5 * np.array([patch.length, patch.width])
        for port, flat in zip(ports, self.skin.flat(positions(ports)), strict=True):
            if not (np.abs(flat) + port.radius <= half + 1e-9).all():
                what = f"contact {port.name}" if port.kind == "contact" else f"grid point {port.name}"
                raise GeometryError(
                    f"{what} at ({port.position[0] * 1e3:.3g}, {port.position[1] * 1e3:.3g}) mm lies off the library's "
                    f"patch of {patch.length * 1e3:.3g} x {patch.width * 1e3:.3g} mm along the skin; move it, or make "
                    "a library with a larger library.length and library.width"
                )

    def _check_none_under(self, ports: tuple[Port, ...]) -> None:
        """Under pressed discs points do not move with them, and the layered model's tables begin at the rim."""
        flat = self.skin.flat(positions(ports))
        for port, at in zip(ports, flat, strict=True):
            for disc, centre in zip(ports, flat, strict=True):
                if port.kind == "point" and disc.kind == "contact" and np.linalg.norm(at - centre) < disc.radius:
                    raise GeometryError(
                        f"grid point {port.name} lies under the pressed disc {disc.name}, which a library does not "
                        "answer for; move one of them, or make the library with device.cone.contact = 'bonded'"
                    )


def library_band(scenario: Scenario) -> tuple[float, float]:
    """First and last frequency [Hz] of the scenario's sweep."""
    frequency = frequencies(scenario.sweep)
    return float(frequency[0]), float(frequency[-1])


def library_skin(scenario: Scenario) -> FlatSkin:
    """The skin of a limb that a library can be made for; ScenarioError for others."""
    limb = scenario.limb
    cut = isinstance(limb, SlabLimb) and bool(limb.symmetry)
    if cut or not isinstance(limb, ForearmLimb | CylinderLimb | SlabLimb):
        raise ScenarioError(
            f"limb: a library needs a forearm, a cylinder or a whole slab, whose layered model is known, but this is a "
            f"{limb.shape}{' cut by limb.symmetry' if cut else ''}; solve its arrangements one by one"
        )
    skin = parametric_skin(scenario)
    assert skin is not None
    return flat_skin(skin, scenario.library.length, scenario.library.width, MARGIN)


def lattice(scenario: Scenario, centres: FloatArray, width: float, high: float) -> Lattice:
    """The lattice for waves up to ``high`` [Hz]."""
    shortest = float(shortest_wavenumber(scenario, np.array([high]))[0])
    return Lattice.of(centres, width, Prior(_SPREAD * shortest + _LEAST, _NOISE))


def shortest_wavenumber(scenario: Scenario, frequency: FloatArray) -> FloatArray:
    """Largest |k| (n,) [1/m] of shear waves in the limb's layers at each ``frequency`` (n,) [Hz]."""
    omega = 2 * np.pi * frequency
    layers = flat_layers(scenario)
    return np.asarray(np.max([np.abs(omega * np.sqrt(x.density / x.modulus(omega))) for x in layers], axis=0))
