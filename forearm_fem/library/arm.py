"""The arm's library: what any discs of one radius, and any points, on a patch of skin need for their compliance."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from ..errors import GeometryError, ScenarioError
from ..geometry.device.layout import layout_of
from ..geometry.device.place import parametric_skin, ports_on
from ..layered.response import LayeredResult
from ..layered.rigid import Disc
from ..layered.tabulated import Tabulated
from ..pipeline.frequencies import frequencies
from ..pipeline.layered_engine import flat_layers
from ..pipeline.solved import Solved
from ..ports import Port, positions
from ..results import SolutionRecord
from ..scenario import Scenario
from ..scenario.limb import CylinderLimb, ForearmLimb, SlabLimb
from ..transfer import Compliance, ErrorEstimate, ErrorSource
from ..typing import ComplexArray, FloatArray
from .bands import Bands
from .between import Lattice, Prior, shape_of
from .limb import Limb
from .skin import FlatSkin, flat_skin

MARGIN = 0.02  # [m] of skin around the patch that bells reach
WIDTH = 0.4  # of a bell, in steps of the lattice
_SPREAD, _LEAST, _NOISE = 0.7, 60.0, 1e-6  # kappa in shortest wavenumbers, and [1/m]; docs/decisions/0037-library.md
_SIDEWAYS = 2 / 3  # stiffness of a bonded disc sideways over that along its normal
_CONTACT = MappingProxyType({
    "bonded": "what discs held sideways take from the limb's difference from its flat twin, were that as large "
    "sideways as along the normal; and a quarter of the disc's squared curvature",
    "frictionless": "what discs held against tilt take from the limb's own motion is not known; make the library with "
    "device.cone.contact = 'bonded' or 'pressure'",
    "pressure": "a quarter of the disc's squared curvature",
})  # fmt: skip
_SAME = ("limb", "tissues", "supports")  # what a scenario shares with its library


@dataclass(frozen=True, eq=False)
class ArmLibrary:
    """Answers for any arrangement of discs on the patch of ``scenario``'s limb.

    ``centres`` (n, 2) [m] of bells of ``width`` [m] in flat coordinates; ``fine`` is the limb through them, ``coarse``
    on a second mesh whose nodes are ``ratio`` times as far apart (None where there is none), ``freed`` with free ends
    (None where none absorb). ``flat`` (n_part, n_node, n_distance) is the twin between two bells at ``distances``
    [m], at the nodes of :class:`Bands`; ``twin`` the twin for discs. ``spread`` (n_part, n_bin) is the standard
    deviation [m/N] of what is interpolated, by distance (``bins`` (n_bin,) [m]), in units of the prior. ``reduction``
    (2, n) are frequencies [Hz] and the reduced model's e(f) there, against direct solves.
    """

    scenario: Scenario
    centres: FloatArray
    width: float
    fine: Limb
    coarse: Limb | None
    freed: Limb | None
    ratio: float
    distances: FloatArray
    flat: ComplexArray
    twin: Tabulated
    bins: FloatArray
    spread: FloatArray
    reduction: FloatArray
    facts: Mapping[str, Any]

    @property
    def mark(self) -> str:
        """SHA-256 of the limb's poles and what its loads see of them."""
        seen = hashlib.sha256(self.fine.poles.tobytes() + self.fine.left.tobytes() + repr(self.twin.contact).encode())
        return seen.hexdigest()[:16]

    def compliance(self, scenario: Scenario) -> Compliance:
        """Compliance of the contacts and points of ``scenario`` with errors by interpolation, contacts and reduction.

        Raises ScenarioError for another arm, radius, contact or band, GeometryError for places off the patch.
        Entries between points are NaN: no device drives there.
        """
        return self._answer(scenario, self.fine, with_errors=True)

    def solved(self, scenario: Scenario) -> Solved:
        """The same as the solver's result, with the second mesh and the freed ends for the other errors."""
        fine = self.compliance(scenario)
        coarse = None if self.coarse is None else self._answer(scenario, self.coarse)
        freed = None if self.freed is None else self._answer(scenario, self.freed)
        if coarse is not None:
            coarse = replace(coarse, provenance={"ratio": self.ratio})
        unknown = () if coarse is not None else (
            ErrorEstimate("discretisation", np.nan, "the library was made without a second mesh"),
        )  # fmt: skip
        empty = np.zeros((0, 3, 0)), np.zeros((len(fine.frequency), 0, 0), dtype=complex)
        return Solved(fine, coarse, freed, *empty, SolutionRecord(solver="library"), unknown)

    def _answer(self, scenario: Scenario, limb: Limb, *, with_errors: bool = False) -> Compliance:
        ports, frequency = self.ports(scenario), frequencies(scenario.sweep)
        self._check_band(frequency)
        places = self.skin.flat(positions(ports))
        flat = self._flat_discs(ports, places, frequency)
        part, carry = self.bands.number(frequency), self.bands.between(frequency)
        values, errors = flat.values.copy(), []
        for b in np.unique(part):
            mine = part == b
            weights, variance = self._weights(int(b), ports, places)
            values[mine] += limb.between(frequency[mine], weights)
            values[mine] -= np.einsum("fn,nij->fij", carry[mine], weights.T @ self._flat_bells[b] @ weights)
            if with_errors:
                errors.append(self._deviation(int(b), places, variance))
        values = 0.5 * (values + values.swapaxes(1, 2))
        found = Compliance(frequency, values, ports)
        return replace(found, errors=self._errors(found, part, errors, flat)) if with_errors else found

    def ports(self, scenario: Scenario) -> tuple[Port, ...]:
        """Ports of ``scenario`` on the library's skin, after all that may be refused was."""
        self._check_same(scenario)
        cone = scenario.device.cone
        if abs(cone.radius - self.twin.radius) > 1e-9 or cone.contact != self.twin.contact:
            raise ScenarioError(
                f"device.cone: the library holds {self.twin.contact} discs of {self.twin.radius * 1e3:g} mm radius, "
                f"asked for {cone.contact} ones of {cone.radius * 1e3:g} mm; make a library for these"
            )
        layout_of(scenario)
        ports = ports_on(scenario, self.skin.skin)
        self._check_on_patch(ports)
        if cone.contact == "pressure":
            self._check_none_under(ports)
        return ports

    @cached_property
    def skin(self) -> FlatSkin:
        """The skin laid flat."""
        return library_skin(self.scenario)

    @cached_property
    def bands(self) -> Bands:
        """Parts of the library's band."""
        return Bands.of(*library_band(self.scenario))

    @cached_property
    def lattices(self) -> tuple[Lattice, ...]:
        """The lattice in each part of the band."""
        return tuple(lattice(self.scenario, self.centres, self.width, high) for high in self.bands.edges[1:])

    def _weights(self, part: int, ports: tuple[Port, ...], places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights (n, p) of bells and variances (2, p), before and known, for the ports."""
        weights, variance = np.empty((len(self.centres), len(ports))), np.empty((2, len(ports)))
        shapes = [shape_of(port) for port in ports]
        for shape in set(shapes):
            mine = [i for i, s in enumerate(shapes) if s == shape]
            weights[:, mine], variance[:, mine] = self.lattices[part].weights(shape, places[mine])
        return weights, variance

    @cached_property
    def _flat_bells(self) -> ComplexArray:
        """The twin (n_part, n_node, n, n) between bells."""
        number, _ = pair_distances(self.centres)
        return self.flat[:, :, number]

    def _flat_discs(self, ports: tuple[Port, ...], places: FloatArray, frequency: FloatArray) -> LayeredResult:
        """The flat twin of the ports."""
        discs = [Disc(u, v) if port.kind == "point" else Disc(u, v, port.radius, port.contact)
                 for port, (u, v) in zip(ports, places.tolist(), strict=True)]  # fmt: skip
        return self.twin.compliance(2 * np.pi * frequency, discs)

    def _deviation(self, part: int, places: FloatArray, variance: FloatArray) -> FloatArray:
        """Standard deviation (p, p) [m/N] of what is interpolated between the ports."""
        away = np.linalg.norm(places[:, None] - places[None], axis=2)
        scale = np.interp(away, self.bins, self.spread[part])
        before, known = variance
        left = np.maximum(np.outer(before, before) - np.outer(known, known), 0.0)
        return np.asarray(scale * np.sqrt(left))

    def _errors(
        self, found: Compliance, part: Any, deviations: list[FloatArray], flat: LayeredResult
    ) -> tuple[ErrorEstimate, ...]:
        """Of interpolation, of the twin's tractions, of what the limb does to discs, and of the reduced model."""
        rows, columns = found.indices("point") or found.indices("contact"), found.indices("contact")
        block = np.ix_(rows, columns)
        values = found.values[:, block[0], block[1]]
        number = np.searchsorted(np.unique(part), part)
        deviation = np.array([d[block] for d in deviations])[number]
        size = np.abs(values).max(axis=(1, 2))
        between = deviation.max(axis=(1, 2)) / size
        band = float(np.linalg.norm(deviation) / np.linalg.norm(values))
        frequency = tuple(found.frequency.tolist())
        held = self._held(found, flat.values, rows, columns) + 0.25 * (self.twin.radius * self.skin.curvature) ** 2
        reduction = np.interp(found.frequency, self.reduction[0], self.reduction[1])
        return (
            ErrorEstimate("interpolation", band, "spread of what lies between the library's loads, by leaving each of "
                          "them out", frequency, tuple(between.tolist())),
            _weighed("quadrature", flat.error, size, frequency, "the flat twin's tables, and last terms and orders of "
                     "the tractions under its discs"),
            _weighed("contact", held, size, frequency, _CONTACT[self.twin.contact]),
            _weighed("reduction", reduction, size, frequency, "against direct solves for some of the library's loads "
                     "at three frequencies, and between them"),
        )  # fmt: skip

    def _held(self, found: Compliance, flat: ComplexArray, rows: list[int], discs: list[int]) -> FloatArray:
        """e(f) (n_frequency,) of discs that hold the limb's own motion in silence.

        A rigid disc keeps its place sideways with 16/3 mu a, two thirds of what 8 mu a along its normal is (Mindlin
        1949, incompressible), so that n of them take x/(1 + x) of a motion D, x = n 2/3 |D|/|T|, with D of the limb
        and T of the twin between the discs. Pressed discs hold nothing; of frictionless ones, which hold tilt alone, it
        is NaN, unknown.
        """
        if self.twin.contact != "bonded":
            return np.full(len(found.frequency), 0.0 if self.twin.contact == "pressure" else np.nan)
        apart, own = found.values - flat, flat[:, discs, discs]
        grip = len(discs) * _SIDEWAYS * np.abs(apart[:, discs][:, :, discs]).max(axis=(1, 2)) / np.abs(own).mean(axis=1)
        seen = np.abs(apart[:, rows][:, :, discs]).max(axis=(1, 2)) / np.abs(found.values[:, rows][:, :, discs]).max(
            axis=(1, 2)
        )
        return np.asarray(grip / (1 + grip) * seen)

    def _check_same(self, scenario: Scenario) -> None:
        if scenario.engine != "fem":
            raise ScenarioError("engine: a library stands for finite elements; set engine = 'fem', or leave it out")
        for key in _SAME:
            if getattr(scenario, key) != getattr(self.scenario, key):
                raise ScenarioError(
                    f"{key}: this library was made for another arm than the scenario's; make one for it "
                    "(`forearm-fem library`), or leave --library out"
                )

    def _check_band(self, frequency: FloatArray) -> None:
        low, high = self.bands.edges[0], self.bands.edges[-1]
        if frequency[0] < low * (1 - 1e-9) or frequency[-1] > high * (1 + 1e-9):
            raise ScenarioError(
                f"sweep: the library holds {low:g} to {high:g} Hz, asked for {frequency[0]:g} to {frequency[-1]:g} Hz; "
                "narrow the sweep, or make a library for it"
            )

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
        """Under pressed discs points do not move with them, and the twin's tables begin at the rim."""
        flat = self.skin.flat(positions(ports))
        for port, at in zip(ports, flat, strict=True):
            for disc, centre in zip(ports, flat, strict=True):
                if port.kind == "point" and disc.kind == "contact" and np.linalg.norm(at - centre) < disc.radius:
                    raise GeometryError(
                        f"grid point {port.name} lies under the pressed disc {disc.name}, which a library does not "
                        "answer for; move one of them, or make the library with device.cone.contact = 'bonded'"
                    )


def _weighed(
    source: ErrorSource, error: FloatArray, size: FloatArray, frequency: tuple[float, ...], method: str
) -> ErrorEstimate:
    """An estimate with e(f) ``error`` (n,) of compliances of ``size`` (n,) [m/N]."""
    band = float(np.linalg.norm(error * size) / np.linalg.norm(size))
    return ErrorEstimate(source, band, method, frequency, tuple(error.tolist()))


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
            f"limb: a library needs a forearm, a cylinder or a whole slab, whose flat twin is known, but this is a "
            f"{limb.shape}{' cut by limb.symmetry' if cut else ''}; solve its arrangements one by one"
        )
    skin = parametric_skin(scenario)
    assert skin is not None
    return flat_skin(skin, scenario.library.length, scenario.library.width, MARGIN)


def lattice(scenario: Scenario, centres: FloatArray, width: float, high: float) -> Lattice:
    """The lattice for waves up to ``high`` [Hz]."""
    omega = np.array([2 * np.pi * high])
    shortest = max(float(abs(omega[0] * np.sqrt(x.density / x.modulus(omega)[0]))) for x in flat_layers(scenario))
    return Lattice.of(centres, width, Prior(_SPREAD * shortest + _LEAST, _NOISE))


def pair_distances(centres: FloatArray) -> tuple[Any, FloatArray]:
    """The number (n, n) of each pair's distance among the distinct ones, and these (m,) [m], rising."""
    away = np.linalg.norm(centres[:, None] - centres[None], axis=2).round(9)
    distances, number = np.unique(away, return_inverse=True)
    return number.reshape(away.shape), distances
