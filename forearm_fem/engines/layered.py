"""The layered model as an engine, for a scene and for draws of arms, and its tables for many arrangements."""

from __future__ import annotations

import hashlib
import math
from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .. import __version__
from ..accuracy.estimates import quadrature_estimate
from ..errors import ScenarioError
from ..geometry.device.layout import layers_of, layout_of
from ..geometry.device.place import parametric_skin, ports_on
from ..layered import Disc, Layer, Sheet, Surface, layered_compliance
from ..layered.tables import Tabulated, from_arrays, tabulate
from ..ports import Port
from ..progress import Progress
from ..scenario import Scenario
from ..scenario.limb import MeshLimb, SurfacesLimb, Tissues
from ..scenario.model import resolve_tissues
from ..scenario.sweep import frequencies
from ..store.folder import default_cache_dir
from ..store.shelf import Shelf
from ..transfer import Compliance
from ..typing import ComplexArray, FloatArray

__all__ = ["LayeredEngine", "solve_layered"]

# The semi-analytic engine: the same ports on flat layers without end, by the same rules of placement.

_TOLERANCE = 1e-7  # of the quadrature and of the interpolation in frequency: far below what rigid contacts leave
NO_PATCH = (
    "tissues.patch: tables and fits of the layered model have no tape; use engine = 'fem', or cover all of the skin by "
    "tissues.membrane"
)
_LEFT_OUT = "curvature, bones, supports, sides and ends are left out: what they change, only engine = fem can tell"


@dataclass(frozen=True)
class LayeredEngine:
    """Flat layers without end, semi-analytic: seconds, and no mesh."""

    progress: Progress | None = None
    name: str = "layered"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: limbs of layers."""
        return _no_layers(scenario) if isinstance(scenario.limb, MeshLimb | SurfacesLimb) else fibrous(scenario)

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """See :class:`.Engine`."""
        return solve_layered(scenario, frequency, progress=self.progress)


def solve_layered(scenario: Scenario, frequency: FloatArray, *, progress: Progress | None = None) -> Compliance:
    """Compliance of the scenario's ports on its layers, flat and without end, at ``frequency`` (n,) [Hz].

    Contacts are as the scenario has them and scatter each other's waves. Leaves out curvature, bones, supports, sides
    and ends. Raises what the finite elements raise for ports, tissues and limbs that cannot be.
    """
    layers, ports = flat_layers(scenario), flat_ports(scenario)
    contacts, discs = ([flat_disc(port) for port in some] for some in (contacts_of(ports), ports))
    result = layered_compliance(
        layers, 2 * np.pi * frequency, contacts, discs, surface=flat_membrane(scenario.tissues),
        sheet=flat_sheet(scenario.tissues), tolerance=_TOLERANCE, progress=progress,
    )  # fmt: skip
    values = between_ports(result.values, ports)
    integrals = (result.quadrature + result.interpolation) * _over_points(values, ports)
    error = np.asarray(result.truncation + result.sheet + integrals)
    estimate = quadrature_estimate(
        frequency, error,
        "Hankel quadrature's own control and the last coefficients between frequencies, relative to the largest entry "
        "of points, and the last terms and orders of the tractions under rigid discs, relative to the largest entry",
    )  # fmt: skip
    return Compliance(frequency, values, ports, (estimate,))


def contacts_of(ports: Sequence[Port]) -> list[Port]:
    """Those of the ``ports`` that drive."""
    return [port for port in ports if port.kind == "contact"]


def between_ports(values: ComplexArray, ports: Sequence[Port]) -> ComplexArray:
    """All pairs (n, n_port, n_port) of ``ports`` from the columns (n, n_port, n_contact) of contacts; NaN between two
    points, which do not drive."""
    out = np.full((*values.shape[:2], len(ports)), np.nan + 0j)
    contacts = [i for i, port in enumerate(ports) if port.kind == "contact"]
    out[:, contacts] = values.swapaxes(1, 2)
    out[:, :, contacts] = values
    return out


def _over_points(values: ComplexArray, ports: tuple[Port, ...]) -> FloatArray:
    """Largest entry over the largest between contacts and points (n,) [-]: integrals err by a share of the former, and
    G, which is made of the latter, by as much of itself; 1 where there are no points."""
    size, point = np.abs(values), np.array([port.kind == "point" for port in ports])
    if not point.any() or point.all():
        return np.ones(len(values))
    return np.asarray(np.nanmax(size, axis=(1, 2)) / size[:, point][:, :, ~point].max(axis=(1, 2)))


def flat_ports(scenario: Scenario) -> tuple[Port, ...]:
    """Contacts and grid points of the scenario on the plane z = 0.

    Raises :class:`GeometryError` for all that the limb itself would not take: overlaps, places beside or beyond it.
    """
    skin = parametric_skin(scenario)
    if skin is None:
        raise ScenarioError(_no_layers(scenario))
    layout = layout_of(scenario)
    places = np.vstack([layout.contacts, layout.points])
    normals = skin(places)[1]
    return tuple(
        replace(port, position=(float(x), float(y), 0.0), axis=_flat_axis(np.array(port.axis), normal))
        for port, (x, y), normal in zip(ports_on(scenario, skin), places, normals, strict=True)
    )


def _flat_axis(axis: FloatArray, normal: FloatArray) -> tuple[float, float, float]:
    """An axis on a limb as the unrolled skin has it: parts along x, along y and along the ``normal``."""
    if np.allclose(axis, normal, rtol=0, atol=1e-12):
        return 0.0, 0.0, 1.0
    along = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    along = along / np.linalg.norm(along)
    return float(axis @ along), float(axis @ np.cross(normal, along)), float(axis @ normal)


def flat_disc(port: Port) -> Disc:
    """The port as a disc of the layered body."""
    if port.kind == "point":
        return Disc(*port.position[:2], axis=port.axis)
    return Disc(*port.position[:2], port.radius, port.contact)


def flat_layers(scenario: Scenario) -> list[Layer]:
    """The limb's layers on a half-space of its core; :class:`ScenarioError` for a limb without layers, or fibres."""
    limb, tissues = scenario.limb, resolve_tissues(scenario)
    if isinstance(limb, MeshLimb | SurfacesLimb):
        raise ScenarioError(_no_layers(scenario))
    if reason := fibrous(scenario):
        raise ScenarioError(reason)
    stack = [(layer.tissue, layer.thickness) for layer in layers_of(limb)] + [(limb.core, math.inf)]
    return [Layer(h, tissues[t].density, tissues[t].modulus.at, tissues[t].bulk) for t, h in stack]


def flat_surface(tissues: Tissues) -> Surface:
    """As :func:`flat_membrane` where that is all; :class:`ScenarioError` for a patch, which has edges."""
    if tissues.patch.is_on:
        raise ScenarioError(NO_PATCH)
    return flat_membrane(tissues)


def flat_membrane(tissues: Tissues) -> Surface:
    """The membrane on the skin: an incompressible sheet, E h/(1 - nu^2) = 4 mu h."""
    membrane = tissues.membrane
    return Surface(membrane.tension, 4 * membrane.stiffness, membrane.mass, 4 * membrane.viscosity)


def flat_sheet(tissues: Tissues) -> Sheet | None:
    """The patch of tape on the skin, or None."""
    patch = tissues.patch
    if not patch.is_on:
        return None
    return Sheet(patch.length, patch.width, patch.mass, 4 * patch.stiffness, 4 * patch.viscosity, patch.bending)


def flat_notes(compliance: Compliance) -> tuple[str, ...]:
    """Sentences for the report: what the layered model leaves out, and what its contacts are."""
    contacts = [port for port in compliance.ports if port.kind == "contact"]
    notes = [f"engine = layered: flat layers without end; {_LEFT_OUT}"]
    if contacts and contacts[0].contact != "pressure":
        notes.append(
            f"the {contacts[0].contact} cones are rigid discs that scatter each other's waves and, as in the finite "
            "elements, cannot tilt or slide"
        )
    return tuple(notes)


def fibrous(scenario: Scenario) -> str:
    """Reason that the layered model cannot have the limb's tissues, as one has fibres; empty where none has."""
    tissues = resolve_tissues(scenario)
    for name in dict.fromkeys(scenario.tissue_keys.values()):
        if (ratio := tissues[name].fibres) != 1:
            return (
                f"tissues.override.{name}.fibres: expected 1 (none) on the layered model, whose waves have no "
                f"preferred direction, got {ratio:g}; set engine = 'fem', or leave it out"
            )
    return ""


def without_fibres(scenario: Scenario) -> Scenario:
    """The same with each tissue's mean stiffness in all directions."""
    return scenario.changed({f"tissues.override.{t}.fibres": None for t in scenario.tissues.override})


def _no_layers(scenario: Scenario) -> str:
    return f"engine: 'layered' needs layers, but limb.shape is '{scenario.limb.shape}'; use engine = 'fem'"


# Tables of a scenario's layered model, made once per tissue, disc and band, and kept in the cache.

_REACH = 0.1  # [m]: tables reach to multiples of it, so that one serves every device of a forearm


def tables_reach(span: float) -> float:
    """The distance [m] that tables for ports up to ``span`` [m] apart reach to."""
    return float(_REACH * np.ceil((span + 1e-9) / _REACH))


def kept_tables(
    scenario: Scenario,
    reach: float,
    *,
    folder: Path | None = None,
    known: MutableMapping[str, Tabulated] | None = None,
    progress: Progress | None = None,
) -> Tabulated:
    """The layered model of the scenario's layers for its disc and band, ports up to ``reach`` [m] apart.

    From ``known``, which is added to, else from ``folder`` (None: the cache), else made and kept there. ScenarioError
    for a patch of tape.
    """
    key, surface = _key(scenario, reach), flat_surface(scenario.tissues)
    if known is not None and key in known:
        return known[key]
    shelf = Shelf((folder or default_cache_dir()) / "layered-tables.sqlite", "tables of the layered model")
    cone, layers = scenario.device.cone, flat_layers(scenario)
    found: Tabulated | None = None
    if (arrays := shelf.get(key)) is not None:
        found = from_arrays(arrays, layers, surface, cone.radius, cone.contact)
    if found is None:
        low, high = _band(scenario)
        omega = 2 * np.pi * low, 2 * np.pi * high
        found = tabulate(layers, omega, cone.radius, cone.contact, surface=surface, farthest=reach, progress=progress)
        shelf.put(key, found.arrays())
    if known is not None:
        known[key] = found
    return found


def _band(scenario: Scenario) -> tuple[float, float]:
    """Ends [Hz], a rounding beyond the sweep's."""
    f = frequencies(scenario.sweep)
    return float(f[0]) * (1 - 1e-9), float(f[-1]) * (1 + 1e-9)


def _key(scenario: Scenario, reach: float) -> str:
    low, high = _band(scenario)
    omega = 2 * np.pi * np.geomspace(low, high, 7)
    tissues = {n: (t.density, t.bulk, np.asarray(t.modulus.at(omega)).tolist())
               for n, t in sorted(resolve_tissues(scenario).items())}  # fmt: skip
    layers = [(x.thickness_m, x.density) for x in flat_layers(scenario)]
    cone = scenario.device.cone
    parts = (__version__, tissues, layers, scenario.tissues.model_dump_json(), scenario.limb.model_dump_json(),
             cone.radius, cone.contact, round(low, 6), round(high, 6), round(reach, 6))  # fmt: skip
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]

# Draws of arms: a third of the time of the layered model's own; what it costs is stated per draw.
_OF_DRAW, _TERMS, _ORDERS = 1e-3, 4, (3, 5)
_JUDGED = 6  # every so many frequencies the series are judged
ALONE = (1,)  # orders of a change by geometry
_ENOUGH = 0.1  # e(f): where fewer orders say more (a point near a cone, little loss), more are taken


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer of a model for a draw.

    ``compliance``: its value.
    ``others``: as likely by the errors ``shown`` (their sources), whose shape over pairs of ports is known; all
    other errors count as noise.
    """

    compliance: Compliance
    others: tuple[Compliance, ...] = ()
    shown: frozenset[str] = frozenset()


@dataclass(frozen=True)
class LayeredArm:
    """The semi-analytic layered model with fewer terms: 981 bins in about half a second, with a true error of G below 1
    %.

    Azimuthal ``orders`` are taken in turn until their error is small; of a single one it is not in the errors what it
    leaves out.
    """

    solved: bool = False  # whether the scene itself is solved by finite elements
    tolerance: float = _OF_DRAW
    terms: int = _TERMS
    orders: tuple[int, ...] = _ORDERS

    @property
    def name(self) -> str:
        """See :class:`.Engine`."""
        return "layered model"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: as the layered model."""
        return LayeredEngine().holds(scenario)

    @property
    def held(self) -> frozenset[str]:
        """Inputs of the priors that the model cannot follow, which stay the scenario's: none."""
        return frozenset()

    @property
    def left_out(self) -> str:
        """Sentence on properties of an arm that the model has not."""
        beside = "; the scene itself is solved by finite elements, so that it may lie beside its own arms"
        return (
            "the arms are flat layers without end: girth, taper, bones and the device's place on the limb are not in "
            f"the band{beside if self.solved else ''}"
        )

    @property
    def unknown(self) -> str:
        """Sentence on errors of an answer that could not be estimated and are in no band: none."""
        return ""

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """See :class:`.Engine`."""
        scenario = without_bones(scenario)
        return self._between(scenario, flat_ports(scenario), frequency)

    def _between(self, scenario: Scenario, ports: tuple[Port, ...], frequency: FloatArray) -> Compliance:
        """Compliance between ``ports`` on the scenario's layers."""
        contacts, discs = ([flat_disc(port) for port in some] for some in (contacts_of(ports), ports))
        sheet = flat_sheet(scenario.tissues)
        for orders in self.orders if sheet is None else self.orders[-1:]:  # tape may reach to the cones' rims
            found = layered_compliance(
                flat_layers(scenario), 2 * np.pi * frequency, contacts, discs, surface=flat_membrane(scenario.tissues),
                sheet=sheet, tolerance=self.tolerance, terms=self.terms, orders=orders,
                judged=_JUDGED,
            )  # fmt: skip
            error = found.quadrature + found.interpolation
            error = np.asarray(error if self.orders == ALONE else error + found.truncation)
            if error.max() <= _ENOUGH:
                break
        error = error + found.sheet
        estimate = quadrature_estimate(
            frequency, error,
            "the layered model's own control, with fewer terms than it takes for a scene",
        )  # fmt: skip
        return Compliance(frequency, between_ports(found.values, ports), ports, (estimate,))

    def answer(self, scenario: Scenario, frequency: FloatArray) -> Answer:
        """The same with what it may be as well: its errors are noise."""
        return Answer(self.compliance(scenario, frequency))

    def answers(self, scenario: Scenario, seen: Scenario, frequency: FloatArray) -> tuple[Answer, Compliance]:
        """The same, and the compliance of ``seen``, which has points elsewhere or read otherwise, by one solve."""
        if seen.grid == scenario.grid:
            return (answer := self.answer(scenario, frequency)), answer.compliance
        scenario, seen = without_bones(scenario), without_bones(seen)
        own, laid = flat_ports(scenario), flat_ports(seen)
        points = tuple(port for port in laid if port.kind == "point")
        both = self._between(scenario, (*own, *points), frequency)
        contacts = [i for i, port in enumerate(own) if port.kind == "contact"]
        met = [*contacts, *range(len(own), len(both.ports))]
        every = range(len(frequency))
        true, seen_there = (
            replace(both, values=both.values[np.ix_(every, at, at)], ports=tuple(both.ports[i] for i in at))
            for at in (range(len(own)), met)
        )
        return Answer(true), seen_there


def without_bones(scenario: Scenario) -> Scenario:
    """The same without bones, which the layered model has not: thick fat need not fit around them."""
    if not getattr(scenario.limb, "bones", ()):
        return scenario
    return scenario.changed({"limb.bones": ()})
