"""Contacts and points on the skin: where they land, and their ports."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from ...errors import GeometryError, MeshError
from ...ports import Port
from ...scenario import Scenario
from ...scenario.device import GridRows, Rows
from ...scenario.limb import CylinderLimb, ForearmLimb, Limb, SlabLimb
from ...typing import BoolArray, FloatArray, IntArray
from ..limb.slab import check_slab
from ..limb.tube import Tube, tube_of
from ..mesh.refinement import rim_edges
from ..mesh.tissue_mesh import TissueMesh, edge_lengths, meeting, triangle_normals
from .layout import layout_of, turned

# Landing points on the skin of a limb known only by its facets.

_SLACK = 1e-9


@dataclass(frozen=True)
class FacetSkin:
    """Skin facets (k, 3) of ``points`` (n, 3); calling it with (x, y) (m, 2) gives the uppermost place there."""

    points: FloatArray
    facets: IntArray

    @classmethod
    def of(cls, mesh: TissueMesh) -> FacetSkin:
        """The skin of ``mesh``."""
        return cls(mesh.points, mesh.facets["skin"])

    @cached_property
    def normals(self) -> FloatArray:
        """Area-weighted outward unit normals (n, 3) of the vertices; zero away from the skin."""
        normals, total = triangle_normals(self.points, self.facets), np.zeros_like(self.points)
        for corner in self.facets.T:
            np.add.at(total, corner, normals)
        return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None])

    def __call__(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (m, 3) and interpolated outward unit normals (m, 3); NaN where there is no skin."""
        at, facet = meeting(xy, np.zeros(len(xy)), *self._discs)
        weight = self._weights(xy[at], facet)
        hit = np.asarray((weight > -_SLACK).all(axis=1))
        at, facet, weight = at[hit], facet[hit], weight[hit]
        places = np.einsum("ij,ijk->ik", weight, self.points[self.facets[facet]])
        top = np.lexsort((-places[:, 2], at))
        where, first = np.unique(at[top], return_index=True)
        chosen = top[first]
        points, normals = np.full((len(xy), 3), np.nan), np.full((len(xy), 3), np.nan)
        normal = np.einsum("ij,ijk->ik", weight[chosen], self.normals[self.facets[facet[chosen]]])
        points[where] = places[chosen]
        normals[where] = normal / np.linalg.norm(normal, axis=1)[:, None]
        return points, normals

    @cached_property
    def _discs(self) -> tuple[FloatArray, FloatArray]:
        """Centres (k, 2) and radii (k,) of circles around the facets seen from above, slack included."""
        corner = self.points[self.facets][:, :, :2]
        centre = corner.mean(axis=1)
        radius = np.linalg.norm(corner - centre[:, None], axis=2).max(axis=1)
        return centre, np.asarray((1 + 1e-6) * radius)

    def _weights(self, xy: FloatArray, facet: IntArray) -> FloatArray:
        """Barycentric coordinates (m, 3) of ``xy`` (m, 2) in facets (m,) seen from above; NaN for upright ones."""
        a, b, c = self.points[self.facets[facet]][:, :, :2].transpose(1, 0, 2)
        u, v, w = b - a, c - a, xy - a
        twice = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        twice = np.where(np.abs(twice) < 1e-30, np.nan, twice)
        s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / twice
        r = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / twice
        return np.column_stack([1 - s - r, s, r])

    def lift(self, points: FloatArray) -> FloatArray:
        """Points (n, 3) set to the height of the skin above or below them where there is one."""
        landed, _ = self(points[:, :2])
        missing = np.asarray(np.isnan(landed).any(axis=1))
        return np.where(np.reshape(missing, (-1, 1)), points, landed)


# Marking the skin under each cone as a named boundary.

_LEAST_AREA = 0.9
_ON_RIM = 1e-7  # relative to the radius


def from_axis(points: FloatArray, port: Port) -> FloatArray:
    """Distance (n,) [m] of points (n, 3) from the contact's axis."""
    away = points - np.asarray(port.position)
    axis = np.asarray(port.axis)
    return np.asarray(np.linalg.norm(away - np.outer(away @ axis, axis), axis=1))


def near(points: FloatArray, port: Port) -> BoolArray:
    """Points within two radii of the contact: the axis meets a limb a second time on its underside."""
    return np.asarray(np.linalg.norm(points - np.asarray(port.position), axis=1) < 2 * port.radius)


def check_contact_areas(mesh: TissueMesh, ports: tuple[Port, ...]) -> None:
    """Raise :class:`MeshError` when a contact's facets do not fill its disc (cut in half by symmetry planes)."""
    for port in (p for p in ports if p.kind == "contact"):
        part = facet_area(mesh.points, mesh.facets[f"contact {port.name}"]) / _disc_area(mesh, port)
        if not _LEAST_AREA < part < 1.1:
            raise MeshError(
                f"the facets of contact {port.name} cover {100 * part:.0f} % of its disc, need {100 * _LEAST_AREA:g} % "
                "or more; set mesh.size_contact smaller"
            )


def with_true_rims(mesh: TissueMesh, ports: tuple[Port, ...], lead: float) -> TissueMesh:
    """The mesh with each rim moved until its polygon acts as the disc does.

    Seen along the axis the polygon gets the disc's area: on the circle it lacks 1 % of it at 25 edges, and the contact
    half of that in stiffness. A rigid disc is stiffer still by what elements cannot follow of the r^(-1/2) stress at
    its rim, as if its radius were larger by ``lead`` rim edges: it is drawn in by as much. Contacts that
    :func:`check_contact_areas` would refuse are left as they are.
    """
    points = mesh.points.copy()
    for port in (p for p in ports if p.kind == "contact"):
        centre, axis = np.asarray(port.position), np.asarray(port.axis)
        normals = triangle_normals(mesh.points, mesh.facets[f"contact {port.name}"])
        part = float(np.abs(normals @ axis).sum() / 2) / _disc_area(mesh, port)
        if part > _LEAST_AREA:
            edges = rim_edges(mesh, port.name)
            wanted = 1 - lead * float(edge_lengths(mesh.points, edges).mean()) / port.radius
            rim = np.unique(edges)
            away = mesh.points[rim] - centre
            across = away - np.outer(away @ axis, axis)
            points[rim] += (wanted * part**-0.5 - 1) * across
    return replace(mesh, points=points)


def _disc_area(mesh: TissueMesh, port: Port) -> float:
    """Area [m^2] of the part of the disc that is modelled."""
    planes = [name for name in mesh.facets if name.startswith("symmetry")]
    cuts = sum(abs(port.position["xy".index(name[-1])]) < 1e-12 for name in planes)
    return float(np.pi * port.radius**2 / 2**cuts)


def facet_area(points: FloatArray, facets: IntArray) -> float:
    """Total area [m^2] of triangles (k, 3)."""
    return float(np.linalg.norm(triangle_normals(points, facets), axis=1).sum() / 2)


def with_contacts(mesh: TissueMesh, ports: tuple[Port, ...]) -> TissueMesh:
    """The mesh with a boundary "contact <name>" for each contact among ``ports``."""
    skin = mesh.facets["skin"]
    named = {}
    for port in (p for p in ports if p.kind == "contact"):
        inside = near(mesh.points, port) & (from_axis(mesh.points, port) <= port.radius * (1 + _ON_RIM))
        chosen = skin[inside[skin].all(axis=1)]
        if not len(chosen):
            raise MeshError(
                f"no skin triangle lies under contact {port.name} of radius {port.radius * 1e3:.3g} mm; "
                "set mesh.size_contact well below it"
            )
        named[f"contact {port.name}"] = chosen
    return TissueMesh(mesh.points, mesh.tetrahedra, mesh.region, mesh.region_names, {**mesh.facets, **named})


# Where the device meets the limb: ports from contacts and grid points.

_STEEPEST = 0.5  # smallest n_z of the skin under a port: 60 degrees to the side
Skin = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


def place_ports(scenario: Scenario, mesh: TissueMesh) -> tuple[Port, ...]:
    """Contacts A1, A2, ... then points "1", "2", ..., projected along -z onto the skin of ``mesh``.

    Axes are the analytic outward normals, or for the user's own limbs smooth normals of its skin facets.
    Raises :class:`GeometryError` naming the port that misses the limb or hangs over its side.
    """
    return ports_on(scenario, skin_of(scenario, mesh))


def skin_of(scenario: Scenario, mesh: TissueMesh) -> Skin:
    """Function from (x, y) to points and outward normals of the volar skin; NaN where there is none."""
    return parametric_skin(scenario) or FacetSkin.of(mesh)


def parametric_skin(scenario: Scenario) -> Skin | None:
    """The same for a limb that needs no mesh to be known; None for the user's own. Raises where layers, bones or ports
    do not fit."""
    limb = scenario.limb
    if isinstance(limb, SlabLimb):
        check_slab(limb, layout_of(scenario))
        return _flat
    return tube_of(limb).volar if isinstance(limb, ForearmLimb | CylinderLimb) else None


def ports_on(scenario: Scenario, skin: Skin) -> tuple[Port, ...]:
    """Ports of the device on a skin given as a function of (x, y)."""
    layout, cone = layout_of(scenario), scenario.device.cone
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = layout.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    whole = skin is not _flat  # symmetry planes may cut a slab's discs: checked with the slab
    for name, xy in zip(layout.names, layout.contacts, strict=True):
        if whole and np.isfinite(skin(xy[None])[0]).all() and not np.isfinite(skin(xy + ring)[0]).all():
            raise GeometryError(
                f"contact {name} at ({xy[0] * 1e3:.4g}, {xy[1] * 1e3:.4g}) mm reaches beyond the limb with its radius "
                f"of {layout.radius * 1e3:.3g} mm; reduce device.cone.radius, {_inwards(scenario, 'contact')}, or "
                f"{_larger(scenario.limb)}"
            )
    nearer = {kind: f"{_inwards(scenario, kind)}, or {_larger(scenario.limb)}" for kind in ("contact", "grid point")}
    contacts = [
        Port(name, "contact", *landed(f"contact {name}", xy, skin, nearer["contact"]), cone.radius, cone.contact)
        for name, xy in zip(layout.names, layout.contacts, strict=True)
    ]
    points = [
        Port(str(i + 1), "point", *landed(f"grid point {i + 1}", xy, skin, nearer["grid point"]))
        for i, xy in enumerate(layout.points)
    ]
    if scenario.grid.direction == "vertical":
        points = [replace(p, axis=(0.0, 0.0, 1.0)) for p in points]
    return (*contacts, *points)


def check_places(scenario: Scenario) -> None:
    """Raise GeometryError for ports that do not fit the limb, where no mesh is needed to know: before any is made."""
    flat = isinstance(scenario.limb, SlabLimb) and scenario.engine == "layered"  # endless
    if not flat and (skin := parametric_skin(scenario)) is not None:
        ports_on(scenario, skin)


Triple = tuple[float, float, float]


def landed(what: str, xy: FloatArray, skin: Skin, remedy: str = "move it") -> tuple[Triple, Triple]:
    """Place and outward normal of the ``skin`` at ``xy`` (2,); GeometryError where it misses or is too steep, with the
    ``remedy``."""
    point, normal = (each[0] for each in skin(xy[None]))
    if not np.isfinite(point).all():
        raise GeometryError(
            f"{what} at ({xy[0] * 1e3:.4g}, {xy[1] * 1e3:.4g}) mm misses the limb; expected a place over its volar "
            f"skin: {remedy}"
        )
    if normal[2] < _STEEPEST:
        slope = np.degrees(np.arccos(normal[2]))
        raise GeometryError(
            f"{what} at ({xy[0] * 1e3:.4g}, {xy[1] * 1e3:.4g}) mm hangs over the limb's side: the skin there is "
            f"{slope:.0f} degrees from facing up, at most 60 are allowed; {remedy}"
        )
    x, y, z = (float(v) for v in point)
    nx, ny, nz = (float(v) for v in normal)
    return (x, y, z), (nx, ny, nz)


def _inwards(scenario: Scenario, kind: str) -> str:
    """Keys that move a port of a ``kind`` towards the middle."""
    if kind == "contact":
        rows = "reduce device.spacing or device.spacing_y"
        return rows if isinstance(scenario.device, Rows) else "move its place in device.contacts"
    even = isinstance(scenario.grid, GridRows)
    return "reduce grid.pitch or grid.pitch_y" if even else "move its place in grid.points"


def _larger(limb: Limb) -> str:
    """Keys that make room on a limb."""
    if isinstance(limb, ForearmLimb):
        return "enlarge limb.length or limb.circumference"
    if isinstance(limb, CylinderLimb):
        return "enlarge limb.length or limb.diameter"
    return "turn and move its files: x along the limb, +z volar, the device's middle over x = y = 0"


def _flat(xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    zero = np.zeros((len(xy), 1))
    return np.hstack([xy, zero]), np.hstack([0 * xy, zero + 1])


def true_skin(tube: Tube) -> Callable[[FloatArray], FloatArray]:
    """Function that returns points (n, 3) near the skin to the analytic skin."""
    return lambda points: tube.place(points[:, 0], tube.angle_of(points), 0.0)


# Where a grid may have been laid: places around each of its points, and how to read between them.

_REACH = 6e-3  # [m] to each side: 3.6 deviations of a corner of the thesis' grid, shifted and turned as priors have it
_COUNT = 7  # places along each side, 2 mm apart at most
_MOST = 2000  # places in all: their rows are kept with a model
_PLANES = ("symmetry x", "symmetry y")


@dataclass(frozen=True)
class GridPlaces:
    """A square of side 2 ``reach`` [m] around each of the ``centres`` (n, 2) [m] in the device's frame, with ``count``
    Chebyshev points along each side; read along the normals and, with ``turned``, from above as well."""

    centres: tuple[tuple[float, float], ...]
    reach: float = _REACH
    count: int = _COUNT
    turned: bool = False

    @property
    def places(self) -> FloatArray:
        """All places (n count^2, 2) [m] in the device's frame, those of the first centre first, along y first."""
        x, y = np.meshgrid(self._nodes, self._nodes, indexing="ij")
        around = self.reach * np.column_stack([x.ravel(), y.ravel()])
        return np.asarray((np.array(self.centres)[:, None] + around).reshape(-1, 2))

    def hold(self, scenario: Scenario) -> bool:
        """True if each point of a ``scenario``'s grid lies in the square of the centre of its number, and is read in a
        direction that is known."""
        if scenario.grid.direction == "vertical" and not self.turned:
            return False
        apart = self._apart(scenario)
        return apart is not None and bool(np.abs(apart).max() <= 1 + 1e-9)

    def shares(self, scenario: Scenario, degree: int) -> FloatArray:
        """Weights (n, count^2) of each centre's places in what the grid's points read.

        They are those of the polynomial of a ``degree``, below ``count``, in x and y that fits the places best: through
        all of them at the highest degree.
        """
        apart = self._apart(scenario)
        assert apart is not None, "a grid of as many points as there are centres"
        fitting = np.linalg.pinv(chebyshev.chebvander(self._nodes, degree))
        along = chebyshev.chebvander(apart, degree) @ fitting  # (n, 2, count)
        return np.asarray((along[:, 0, :, None] * along[:, 1, None, :]).reshape(len(apart), -1))

    @property
    def _nodes(self) -> FloatArray:
        return np.asarray(-np.cos(np.pi * (np.arange(self.count) + 0.5) / self.count))

    def _apart(self, scenario: Scenario) -> FloatArray | None:
        places = np.array(scenario.grid.places)
        return (places - np.array(self.centres)) / self.reach if places.shape == (len(self.centres), 2) else None


def grid_places(scenario: Scenario, mesh: TissueMesh) -> tuple[GridPlaces, tuple[Port, ...]] | None:
    """Around each point of the ``scenario``'s grid, with ports on the skin of the ``mesh`` that read the normal there,
    then on limbs that bend the vertical.

    None where some place is off the volar skin, where symmetry planes halve the limb, and for grids of more points than
    are worth keeping.
    """
    found = GridPlaces(tuple(scenario.grid.places), turned=not isinstance(scenario.limb, SlabLimb))
    if len(found.places) > _MOST or any(len(mesh.facets.get(name, ())) for name in _PLANES):
        return None
    skin = skin_of(scenario, mesh)
    try:
        ports = [landed("grid", xy, skin) for xy in turned(scenario, found.places)]
    except GeometryError:
        return None
    if found.turned:
        ports += [(place, (0.0, 0.0, 1.0)) for place, _ in ports]
    return found, tuple(Port(str(k + 1), "point", *places) for k, places in enumerate(ports))
