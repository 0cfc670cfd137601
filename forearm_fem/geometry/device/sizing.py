"""Element sizes and orders around the ports from the accuracy asked for, and the room that contacts need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from ...errors import MeshError
from ...ports import Port
from ...scenario import Scenario
from ...scenario.limb import CylinderLimb, ForearmLimb, SlabLimb
from ...typing import BoolArray, FloatArray, IntArray
from ..mesh.tissue_mesh import EDGES, SIDES, TissueMesh, edge_lengths, edges_of
from .layout import RIGID, Layout, layers_of

# The part of a mesh that waves pass on their way from contacts to points, and the order of elements there.

REACH, DEPTH = 0.03, 0.025  # [m] what third order gains beyond them on the forearm is in decision 0002
_UNIFORM = {"P1": 1, "P2": 2, "P3": 3}
# Longest edge, relative to the usual edge between ports, up to which second order is enough: in the outermost tissue,
# the one beneath, all deeper ones. Second order needs edges half as long as third; fat's waves are 1.4 times shorter.
# At 0.95 and 1.42 points beside a rigid disc on a slab were 10 % off at 500 Hz, whatever the accuracy asked for, and
# the second mesh was off by nearly the same.
_SMALL = (0.0, 0.5, 0.7)


def tetrahedron_orders(mesh: TissueMesh, ports: tuple[Port, ...], element: str) -> IntArray:
    """Order of displacements (n_tet,) in each tetrahedron: with "P2/P3" third around the ports, second elsewhere."""
    if element in _UNIFORM:
        return np.full(len(mesh.region), _UNIFORM[element])
    third = near_ports(mesh, ports, REACH, DEPTH)
    if any(p.contact in RIGID for p in ports):  # their rims made tetrahedra beneath smaller than waves ask
        corners = mesh.points[mesh.tetrahedra]
        longest = np.max([np.linalg.norm(corners[:, a] - corners[:, b], axis=1) for a, b in EDGES], axis=0)
        depth = np.minimum(tissue_depths(mesh), len(_SMALL) - 1)[mesh.region]
        third &= ~(longest < usual_edge(mesh, ports) * np.array(_SMALL)[depth])
    return np.where(third, 3, 2)


def near_ports(mesh: TissueMesh, ports: tuple[Port, ...], reach: float, depth: float) -> BoolArray:
    """Tetrahedra (n_tet,) around the ports: seen along z at most about ``reach`` [m] outside the hull of all contacts
    and points, and at most ``depth`` [m] below the lowest of them."""
    centre = mesh.points[mesh.tetrahedra].mean(axis=1)
    if not ports:
        return np.zeros(len(centre), dtype=bool)
    places = np.array([p.position[:2] for p in ports])
    planes = half_planes(places, np.array([p.radius for p in ports]) + reach)
    around = (centre[:, :2] @ planes[:, :2].T + planes[:, 2] <= 0).all(axis=1)
    return np.asarray(around & (centre[:, 2] >= min(p.position[2] for p in ports) - depth))


def tissue_depths(mesh: TissueMesh) -> IntArray:
    """Number of tissues between each tissue and the skin's surface, (n_region,)."""
    depth = np.full(len(mesh.region_names), len(mesh.region_names))
    touched, here = np.isin(mesh.tetrahedra, mesh.facets["skin"]).sum(axis=1) >= 3, 0
    while touched.any():
        depth[np.unique(mesh.region[touched])] = here
        reached = np.isin(mesh.tetrahedra, mesh.tetrahedra[depth[mesh.region] <= here]).any(axis=1)
        touched, here = reached & (depth[mesh.region] > here), here + 1
    return depth


def usual_edge(mesh: TissueMesh, ports: tuple[Port, ...]) -> float:
    """Median edge [m] of the skin between the ports, away from contacts; zero where nothing is."""
    edges = edges_of(mesh.facets["skin"], SIDES)
    middle = mesh.points[edges].mean(axis=1)
    xy, volar = middle[:, :2], middle[:, 2] > min(p.position[2] for p in ports) - DEPTH
    planes = half_planes(np.array([p.position[:2] for p in ports]), np.array([p.radius for p in ports]))
    chosen = volar & (xy @ planes[:, :2].T + planes[:, 2] <= 0).all(axis=1)
    for port in (p for p in ports if p.kind == "contact"):
        chosen &= np.linalg.norm(xy - port.position[:2], axis=1) > 2 * port.radius
    lengths = edge_lengths(mesh.points, edges[chosen])
    return float(np.median(lengths)) if len(lengths) else 0.0


def half_planes(places: FloatArray, radii: FloatArray) -> FloatArray:
    """Half planes (k, 3) a x + b y + c <= 0 around the hull of circles of ``radii`` (n,) about ``places`` (n, 2)."""
    turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    around = [p + r * circle for p, r in zip(places, radii, strict=True)]
    return np.asarray(ConvexHull(np.vstack(around)).equations) if around else np.zeros((0, 3))


# Element sizes: from the scenario's accuracy, its highest frequency and its slowest shear wave.

DEFAULT_SHEAR_SPEED = 2.2  # [m/s] slowest default tissue (fat, low end) at 500 Hz, physics_data.md 6
_CONTACT, _FAR = 0.8, 6.0  # relative to the size between contacts and grid
_FARTHEST = 20e-3  # [m] in slabs: larger elements left 4 % at 100 Hz, and slivers in the columns under a contact
# Rigid cones, third order: G errs less than was asked of these sizes, and is stated within it.
_EASED = 1.85
_AT = 0.05  # accuracy; below, they and rims shrink with its fourth root: points 20 mm away felt the far elements first
_FACET, _WIDEST_FACET = 0.4, 2 * np.pi / 9  # [rad] at accuracy 0.05, and at most
WIDEST = 0.6  # elements under a contact are at most this many radii
_INTO_CORE = 2.2  # the core lies under the layers, where fields are smooth: sizes grow faster there
# Slabs under rigid cones, third order: at sizes of .43 radii whatever the accuracy, receptance kept an error of 1.5 %.
_CRUDE_AT = 0.14  # accuracy at which elements under a cone are as wide; below, they shrink with its fourth root
_RIM_OF_WIDEST = 0.8  # rims shorter than what stands there: bisection halves them
_WAVE = 0.25  # elements that lead waves away from a rim need not be finer than this much of the size to the grid
_THROUGH = 0.8  # a sublayer is at most about this much of the size between contacts and grid


@dataclass(frozen=True)
class _Rule:
    """Mesh sizes by element pair.

    Elements per shear wavelength, under contacts (in radii), at rigid rims (relative to the size between contacts
    and grid, and in radii at most), on the limb's wall (facets relative to a bone's), and :attr:`Sizes.rim_lead`.
    """

    per_wavelength: float
    widest: float
    rim: float
    widest_rim: float
    wall: float
    rim_lead: float


SECOND = _Rule(0.885, WIDEST, 0.45, 0.3, 1.0, 0.03)  # default forearm: 0.885 * 4.4 mm * 0.05**(1/4) = 1.84 mm
GRADED = _Rule(1.8, 0.43, 0.4, 0.43, 1.25, 0.025)  # third order around the ports: elements twice as large


@dataclass(frozen=True)
class Sizes:
    """Edge lengths [m] under contacts, between contacts and grid, far away and at rigid rims.

    ``sublayers`` counts the element layers through each tissue layer, from the skin inwards; ``facet`` is the angle
    [rad] that one facet of a bone spans at most where it is near, ``wall`` one of the limb's wall. A rigid disc is
    drawn in by ``rim_lead`` times its rim's edges.
    """

    contact: float
    grid: float
    far: float
    rim: float
    facet: float = _FACET
    wall: float = _FACET
    rim_lead: float = SECOND.rim_lead
    sublayers: tuple[int, ...] = ()


def element_sizes(scenario: Scenario, *, scale: float = 1.0) -> Sizes:
    """Sizes for ``scenario``; explicit mesh options win, ``scale`` multiplies every size: what two meshes share their
    difference does not show.

    Outputs of P2 elements converge like h^4, hence h = 0.885 lambda_min accuracy^(1/4), and twice that with third order
    around the ports; lambda_min is that of waves at :data:`DEFAULT_SHEAR_SPEED`, whatever the tissues. The ``accuracy``
    meant is :data:`_EASED` times the scenario's under rigid cones.
    """
    options, radius = scenario.mesh, scenario.device.cone.radius
    rule = GRADED if scenario.element == "P2/P3" else SECOND
    eased = rule is GRADED and scenario.device.cone.contact in RIGID
    accuracy = scenario.accuracy * (_EASED if eased else 1.0)
    f_max = scenario.sweep.span[1]
    grid = float(np.clip(rule.per_wavelength * DEFAULT_SHEAR_SPEED / f_max * accuracy**0.25, 0.4e-3, 6e-3))
    grid = scale * (options.size_grid or grid)
    contact = min(_CONTACT * grid, scale * rule.widest * radius)
    contact = scale * options.size_contact if options.size_contact else contact
    finest = min(1.0, (accuracy / _AT) ** 0.25)
    coarsest = _FARTHEST * finest
    farthest = scale * coarsest if isinstance(scenario.limb, SlabLimb) else np.inf
    far = scale * options.size_far if options.size_far else min(_FAR * grid, farthest)
    rim = min(rule.rim * grid, contact, scale * finest * rule.widest_rim * radius)
    if rule is GRADED and _cone_on_slab(scenario):
        asked = scale * rule.widest * radius * min(1.0, (accuracy / _CRUDE_AT) ** 0.25)
        contact = contact if options.size_contact else min(contact, max(asked, _WAVE * grid))
        rim = min(rim, contact, _RIM_OF_WIDEST * asked)
    counts = _counts(scenario, grid, scale)
    facet = min(_FACET * (accuracy / _AT) ** 0.25, _WIDEST_FACET)
    wall = min(rule.wall * facet, _WIDEST_FACET)
    return Sizes(contact, grid, max(far, grid), rim, scale * facet, scale * wall, rule.rim_lead, counts)


def size_growth(scenario: Scenario, *, scale: float = 1.0) -> float:
    """Growth of sizes per metre away from ports [m/m]; it follows ``scale`` as sizes do.

    Elements that grow alike away from a small contact are as large on both meshes, and their error shows in no change.
    """
    return scenario.mesh.grading * scale


def _cone_on_slab(scenario: Scenario) -> bool:
    """True if rigid cones press a slab: meshes of other limbs keep the sizes that theirs were shipped with."""
    return scenario.device.cone.contact in RIGID and isinstance(scenario.limb, SlabLimb)


def _counts(scenario: Scenario, grid: float, scale: float) -> tuple[int, ...]:
    """Element layers through each tissue layer; under a rigid disc none thicker than its field is wide there."""
    cone, options = scenario.device.cone, scenario.mesh
    rigid, depth = cone.contact in RIGID, 0.0
    counts: list[int] = []
    least = 2 if _cone_on_slab(scenario) else 1  # no change shows the error of one on both meshes
    for layer in layers_of(scenario.limb):
        size = 0.5 * grid if rigid and not counts else grid  # a rigid rim needs two elements through the skin
        size = min(size, 0.9 * scale * (cone.radius + depth)) if rigid else size
        asked = options.sublayers.get(layer.tissue)
        count = asked / scale if asked else max(layer.thickness / (_THROUGH * size), least / scale)
        counts.append(max(1, round(count)))
        depth += layer.thickness
    return tuple(counts)


@dataclass(frozen=True)
class SizeField:
    """Edge length wanted at a place given by (x, y) and depth below the skin [m]."""

    sizes: Sizes
    layout: Layout
    grading: float
    half_planes: FloatArray

    @classmethod
    def around(cls, layout: Layout, sizes: Sizes, grading: float) -> SizeField:
        """Field that is fine near contacts and inside the hull of all ports, and grows away from them."""
        radii = [layout.radius + sizes.grid] * len(layout.contacts) + [sizes.grid] * len(layout.points)
        return cls(sizes, layout, grading, half_planes(np.vstack([layout.contacts, layout.points]), np.array(radii)))

    def with_facets(self, factor: float) -> SizeField:
        """The same with facets of bones and walls ``factor`` times as wide."""
        sizes = replace(self.sizes, facet=factor * self.sizes.facet, wall=factor * self.sizes.wall)
        return replace(self, sizes=sizes)

    def with_contact(self, factor: float) -> SizeField:
        """The same with elements and rims of contacts ``factor`` times as large."""
        sizes = replace(self.sizes, contact=factor * self.sizes.contact, rim=factor * self.sizes.rim)
        return replace(self, sizes=sizes)

    def __call__(self, xy: FloatArray, depth: FloatArray | float = 0.0) -> FloatArray:
        """Wanted edge length (n,) at ``xy`` (n, 2) and ``depth`` (n,) below the skin."""
        s = self.sizes
        outside = np.max(xy @ self.half_planes[:, :2].T + self.half_planes[:, 2], axis=1, initial=-np.inf)
        near = s.grid + self.grading * np.hypot(np.maximum(outside, 0), depth)
        for centre in self.layout.contacts:
            away = np.maximum(np.linalg.norm(xy - centre, axis=1) - self.layout.radius - 0.5 * s.contact, 0)
            near = np.minimum(near, s.contact + self.grading * np.hypot(away, depth))
        return np.asarray(np.minimum(near, s.far))


@dataclass(frozen=True)
class SpaceField:
    """Edge length wanted at points in space: fine near contacts and the patch of ports, growing away from them."""

    sizes: Sizes
    grading: float
    contacts: cKDTree
    patch: cKDTree

    @classmethod
    def on(cls, field: SizeField, surface: Callable[[FloatArray], FloatArray]) -> SpaceField:
        """Field around the ports' places on ``surface``, a map from (x, y) (n, 2) to points (n, 3) or NaN."""
        layout, grid = field.layout, field.sizes.grid
        side = np.linspace(-1, 1, 13)
        disc = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
        disc = disc[np.linalg.norm(disc, axis=1) <= 1]
        discs = np.vstack([c + layout.radius * disc for c in layout.contacts])
        places, reach = np.vstack([layout.contacts, layout.points]), layout.radius + grid
        ends = zip(places.min(axis=0) - reach, places.max(axis=0) + reach, strict=True)
        x, y = (np.linspace(a, b, max(2, int((b - a) / (grid / 2)))) for a, b in ends)  # at most one size apart
        patch = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        patch = patch[(patch @ field.half_planes[:, :2].T + field.half_planes[:, 2] <= 0).all(axis=1)]
        return cls(field.sizes, _INTO_CORE * field.grading, _tree(surface(discs)), _tree(surface(patch)))

    def __call__(self, points: FloatArray) -> FloatArray:
        """Wanted edge length (n,) at ``points`` (n, 3)."""
        s = self.sizes
        near = s.grid + self.grading * np.maximum(self.patch.query(points)[0] - 0.5 * s.grid, 0)
        under = s.contact + self.grading * np.maximum(self.contacts.query(points)[0] - 0.5 * s.contact, 0)
        return np.asarray(np.minimum(np.minimum(near, under), s.far))


def _tree(points: FloatArray) -> cKDTree:
    # Large, plain leaves: half of the time of a search for most of a limb, which is far away, and the same distances.
    finite = points[np.isfinite(points).all(axis=1)]
    return cKDTree(finite, leafsize=32, compact_nodes=False, balanced_tree=False)


# Forecast of a mesh's size, and reasons why one failed: too many elements, too little room.

_PER_CUBE = 6 * np.sqrt(2)  # regular tetrahedra in the volume h^3
_CERTAIN = 1.5  # meshes of slabs and limbs had 1.05 to 5 times as many as counted: this many too many are certain
_NARROW = 0.3  # radii: a strip of skin that no good tetrahedron fits


def refuse_if_too_many(scenario: Scenario, size: SizeField) -> None:
    """Raise MeshError where the wanted sizes surely need more elements than ``mesh.max_elements``."""
    count = expected_tetrahedra(scenario, size)
    if count > _CERTAIN * scenario.mesh.max_elements:
        raise MeshError(
            f"the sizes asked for need about {count:.2g} tetrahedra, mesh.max_elements allows "
            f"{scenario.mesh.max_elements:g}; enlarge mesh.size_contact, size_grid or size_far, or raise it"
        )


def expected_tetrahedra(scenario: Scenario, size: SizeField) -> float:
    """Rough number of tetrahedra: the integral of 6 sqrt(2) / h^3 over the limb, whose sizes h are ``size``.

    A slab's columns are as wide all the way down as at the skin.
    Of the user's surfaces and meshes only the block under the ports is counted.
    """
    (x, y), depth = _extent(scenario, size.layout)
    axes = (np.linspace(*x, 41), np.linspace(*y, 41), np.linspace(0, depth, 21))
    places = np.stack(np.meshgrid(*((a[1:] + a[:-1]) / 2 for a in axes), indexing="ij"), axis=-1).reshape(-1, 3)
    cell = np.prod([a[1] - a[0] for a in axes])
    deep = size(places[:, :2], places[:, 2])
    wide = size(places[:, :2]) if isinstance(scenario.limb, SlabLimb) else deep  # columns keep their width
    return float(np.sum(_PER_CUBE * cell / (wide**2 * deep)))


def why_cramped(scenario: Scenario, layout: Layout) -> str:
    """The narrowest strip beside a contact in words, where it is too narrow for good tetrahedra; else empty."""
    radius = layout.radius
    strips = [
        (float(np.linalg.norm(layout.contacts[i] - layout.contacts[j])) - 2 * radius, f"{a} and {b}", "between them")
        for (i, a), (j, b) in combinations(enumerate(layout.names), 2)
    ]
    if isinstance(scenario.limb, SlabLimb):
        half = np.array([scenario.limb.length, scenario.limb.width]) / 2
        strips += [
            (float(half[axis] - abs(layout.contacts[i, axis])) - radius, a, "to the slab's side")
            for (i, a), axis in product(enumerate(layout.names), (0, 1))
        ]
    gap, who, where = min(strips, default=(np.inf, "", ""))
    if gap >= _NARROW * radius:
        return ""
    return (
        f"contact {who}: the disc of radius {radius * 1e3:.3g} mm leaves {gap * 1e3:.2g} mm {where}, too narrow for "
        "the mesh; move it or reduce device.cone.radius"
    )


def _extent(scenario: Scenario, layout: Layout) -> tuple[tuple[tuple[float, float], tuple[float, float]], float]:
    """Ranges of x and y, and the depth [m], of the block that the limb fills."""
    limb = scenario.limb
    if isinstance(limb, SlabLimb):
        low_x, low_y = ((0.0 if axis in limb.symmetry else -1.0) for axis in ("x", "y"))
        x, y = limb.length / 2, limb.width / 2
        return ((low_x * x, x), (low_y * y, y)), limb.depth
    if isinstance(limb, ForearmLimb | CylinderLimb):
        around = min(c for _, c in limb.circumference) if isinstance(limb, ForearmLimb) else np.pi * limb.diameter
        side = around / np.pi * np.sqrt(np.pi) / 2  # of the square as large as the round section
        return ((-limb.length / 2, limb.length / 2), (-side / 2, side / 2)), side
    places = np.vstack([layout.contacts, layout.points])
    low, high = places.min(axis=0) - layout.radius, places.max(axis=0) + layout.radius
    return ((float(low[0]), float(high[0])), (float(low[1]), float(high[1]))), layout.radius
