"""Scenes of the verification: blocks, shells, slabs, and a row of its table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..engines.layered import flat_layers, flat_membrane, flat_sheet
from ..fem.assembly.model import ForearmModel, build_model
from ..fem.linear.factor import make_factor, refined_solve
from ..fem.reduction.sweep import direct_sweep
from ..geometry.build import build_mesh
from ..geometry.device.place import place_ports
from ..geometry.limb.filling import oriented, stack_prisms
from ..geometry.mesh.tissue_mesh import EDGES, Bends, TissueMesh, boundary_faces
from ..layered import Disc, layered_compliance
from ..ports import Port
from ..scenario import Scenario, parse_scenario
from ..scenario.limb import FreeUnderside, Membrane
from ..scenario.model import resolve_tissues
from ..scenario.sweep import DirectSolve
from ..tissue import KelvinVoigt, Tissue
from ..typing import ComplexArray, FloatArray, IntArray

# Structured blocks and spherical shells of tetrahedra for verification.

def block_mesh(
    counts: Sequence[int],
    size: Sequence[float],
    *,
    facets: Mapping[str, Sequence[str]],
    regions: Sequence[str] = ("block",),
    bend: float = 0.0,
) -> TissueMesh:
    """Box [0, size] cut into ``counts`` cells per axis, six tetrahedra each.

    ``facets`` names boundaries as unions of :data:`FACES`; "skin" defaults to "z1". Several ``regions`` divide the
    box into equal slices along x. ``bend`` moves inner nodes smoothly (0.1 = a tenth of the box), so that
    tetrahedra are not all alike.
    """
    x, y, z = (np.linspace(0, 1, n + 1) for n in counts)
    xy = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    low = np.arange((len(x) - 1) * len(y)).reshape(len(x) - 1, len(y))[:, :-1].ravel()
    triangles = np.vstack(
        [np.column_stack([low, low + 1, low + len(y) + 1]), np.column_stack([low, low + len(y), low + len(y) + 1])]
    )
    levels = np.arange(len(xy)) + len(xy) * np.arange(len(z))[:, None]
    unit = np.column_stack([np.tile(xy, (len(z), 1)), np.repeat(z, len(xy))])
    tetrahedra = stack_prisms(triangles, levels)[0]  # not yet oriented
    region = np.minimum((unit[tetrahedra].mean(axis=1)[:, 0] * len(regions)).astype(int), len(regions) - 1)
    faces, _ = boundary_faces(oriented(unit, tetrahedra))
    named, corner = {}, unit[faces]
    for name, sides in {"skin": ("z1",), **facets}.items():
        chosen = np.zeros(len(faces), dtype=bool)
        for side in sides:
            chosen |= (corner[:, :, "xyz".index(side[0])] == float(side[1])).all(axis=1)
        named[name] = faces[chosen]
    bump = bend * np.prod(np.sin(np.pi * unit), axis=1)[:, None]  # smooth, and nothing on the boundary
    points = (unit + bump * np.array([1.0, -0.7, 0.5])) * np.asarray(size)
    return TissueMesh(points, oriented(points, tetrahedra), region, tuple(regions), named)


def shell_mesh(radii: FloatArray, splits: int, *, curved: bool = False) -> TissueMesh:
    """Quarter (x, y > 0) of the space between spheres: "contact A1" inside, "end" outside, symmetry planes.

    ``radii`` (k,) [m] are the radial levels; each of the two octahedron faces is split ``splits`` times per edge. The
    vertices lie on the spheres; unless edges are ``curved`` slightly outwards, so that the polyhedron has the sphere's
    volume.
    """
    directions, triangles = _quarter_sphere(splits)
    volume = np.abs(np.linalg.det(directions[triangles])).sum() / 6  # pi / 3 of a quarter ball
    unit = directions * (1.0 if curved else float((np.pi / 3 / volume) ** (1 / 3)))
    levels = np.arange(len(unit)) + len(unit) * np.arange(len(radii))[:, None]
    points = (np.asarray(radii)[:, None, None] * unit).reshape(-1, 3)
    tetrahedra = oriented(points, stack_prisms(triangles, levels)[0])
    faces, _ = boundary_faces(tetrahedra)
    corner = points[faces]
    depth = faces // len(unit)
    planes = {f"symmetry {'xy'[i]}": faces[(corner[:, :, i] == 0).all(axis=1)] for i in range(2)}
    inner, outer = faces[(depth == 0).all(axis=1)], faces[(depth == len(radii) - 1).all(axis=1)]
    facets = {**planes, "contact A1": inner, "end": outer, "skin": inner}
    bends = _around_origin(points, tetrahedra) if curved else Bends()
    return TissueMesh(points, tetrahedra, np.zeros(len(tetrahedra), dtype=int), ("block",), facets, bends)


def _around_origin(points: FloatArray, tetrahedra: IntArray) -> Bends:
    """Bends that put the middle of each edge as far from the origin as its ends are on average."""
    edges = np.unique(np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1), axis=0)
    chord = points[edges].mean(axis=1)
    away = np.linalg.norm(points[edges], axis=2).mean(axis=1)
    return Bends(edges, chord * (away / np.linalg.norm(chord, axis=1) - 1)[:, None])


def _quarter_sphere(splits: int) -> tuple[FloatArray, IntArray]:
    """Unit directions (n, 3) and triangles of the quarter sphere x, y >= 0."""
    points: dict[tuple[int, int, int], int] = {}
    triangles = []
    for sign in (1, -1):
        for i in range(splits):
            for j in range(splits - i):
                cells = [((i, j), (i + 1, j), (i, j + 1))]
                if i + j < splits - 1:
                    cells.append(((i + 1, j), (i + 1, j + 1), (i, j + 1)))
                for cell in cells:
                    keys = [(a, b, sign * (splits - a - b)) for a, b in cell]
                    triangles.append([points.setdefault(k, len(points)) for k in keys])
    lattice = np.array(list(points), dtype=float)
    return lattice / np.linalg.norm(lattice, axis=1)[:, None], np.array(triangles)


# Rows of the verification, and the blocks and quarter slabs that they are solved on.

RADIUS = 3.5e-3
DIRECT = DirectSolve()


@dataclass(frozen=True)
class Row:
    """One checked number: ``error`` must not exceed ``tolerance``, for the ``reason`` given.

    ``error`` is relative unless ``quantity`` says otherwise; ``seconds`` is the whole case's wall time.
    """

    case: str
    reference: str
    quantity: str
    error: float
    tolerance: float
    reason: str
    seconds: float = 0.0

    @property
    def met(self) -> bool:
        """True if the error is a number and within its tolerance."""
        return math.isfinite(self.error) and self.error <= self.tolerance


def flesh(mu: float = 7860.0, eta: float = 5.03, *, bulk: float = math.inf, density: float = 1050.0) -> Tissue:
    """A homogeneous Kelvin-Voigt tissue called "block"; default: Zhang's skin."""
    return Tissue("block", density, KelvinVoigt(mu, eta), bulk)


_POINTS = ((0.004, 0.003), (0.02, 0.004), (0.021, 0.014))


def held_block(
    n: int = 3, *, element: str = "P2", tissue: Tissue | None = None, ends: str = "fixed", contact: str = "pressure"
) -> ForearmModel:
    """A 24 x 16 x 8 mm block held at x = 0 with a 4 mm square contact and three points on its top."""
    size = (0.024, 0.016, 0.008)
    mesh = block_mesh((3 * n, 4 * ((n + 1) // 2), n), size, facets={"end": ("x0",)}, bend=0.05)
    corner, tiny = mesh.points[mesh.facets["skin"]][:, :, :2], 1e-9
    low, high = np.array((0.008, 0.004)) - tiny, np.array((0.016, 0.012)) + tiny
    under = mesh.facets["skin"][((corner >= low) & (corner <= high)).all(axis=(1, 2))]
    mesh = replace(mesh, facets={**mesh.facets, "contact A1": under})
    ports = (
        Port("A1", "contact", (0.012, 0.008, 0.008), radius=0.004, contact=contact),  # type: ignore[arg-type]
        *(Port(str(i), "point", (x, y, 0.008)) for i, (x, y) in enumerate(_POINTS)),
    )
    supports = FreeUnderside(ends=ends)
    return build_model(mesh, ports, {"block": tissue or flesh()}, supports, Membrane(), element=element)


def solved_with(model: ForearmModel, frequency: float, load: ComplexArray | FloatArray) -> ComplexArray:
    """Solutions (n, k) of A(2 pi f) x = load (n, k)."""
    omega = 2 * np.pi * frequency
    factor = make_factor(model.operator, omega, "auto", single=False)
    data = model.operator.data(omega)
    factor.factorise(data)
    x = refined_solve(factor, model.operator.matrix(data), load.astype(complex)).values
    factor.release()
    return x


def quarter_slab(
    radii: Sequence[float],
    *,
    side: float = 0.12,
    depth: float = 0.04,
    layers: Sequence[tuple[str, float]] = (),
    preset: str = "zhang",
    mesh: Mapping[str, Any] | None = None,
    frequencies: Sequence[float] = (100.0,),
    ends: str = "absorb",
    contact: str = "pressure",
    override: Mapping[str, Any] | None = None,
    membrane: Mapping[str, float] | None = None,
) -> Scenario:
    """Scenario of one disc in the middle of a square slab, a quarter of it modelled, points at ``radii`` along x."""
    limb = {
        "shape": "slab", "length": side, "width": side, "depth": depth, "symmetry": ["x", "y"],
        "layers": [{"tissue": t, "thickness": h} for t, h in layers],
    }  # fmt: skip
    return parse_scenario(
        {
            "limb": limb,
            "tissues": {"preset": preset, "override": dict(override or {}), "membrane": dict(membrane or {})},
            "supports": {"ends": ends},
            "device": {"contacts": [[0.0, 0.0]], "cone": {"contact": contact, "radius": RADIUS}},
            "grid": {"points": [[r, 0.0] for r in radii]},
            "sweep": {"frequencies": list(frequencies)},
            "mesh": dict(mesh or {}),
        }
    )


def slab_model(scenario: Scenario, *, scale: float = 1.0, mesh: TissueMesh | None = None) -> ForearmModel:
    """Assemble a slab scenario on its ``mesh``, or on one with every element size multiplied by ``scale``."""
    mesh = mesh or build_mesh(scenario, scale=scale)
    tissues, ports, sheets = resolve_tissues(scenario), place_ports(scenario, mesh), scenario.tissues
    return build_model(
        mesh, ports, tissues, scenario.supports, sheets.membrane, element=scenario.element, patch=sheets.patch
    )


def slab_response(model: ForearmModel, frequencies: Sequence[float]) -> ComplexArray:
    """Mean under the disc, then the points: displacement per force on the disc (n_frequency, 1 + n_point) [m/N]."""
    return direct_sweep(model, np.array(frequencies), DIRECT).values[:, :, 0]


def layered_truth(scenario: Scenario, frequencies: Sequence[float]) -> ComplexArray:
    """The exact counterpart of :func:`slab_response`."""
    cone, surface = scenario.device.cone, flat_membrane(scenario.tissues)
    discs = [Disc(0.0, 0.0, cone.radius, cone.contact), *(Disc(x, y) for x, y in scenario.grid.places)]
    omega = 2 * np.pi * np.array(frequencies)
    result = layered_compliance(flat_layers(scenario), omega, discs[:1], discs, surface=surface, tolerance=1e-8,
                                sheet=flat_sheet(scenario.tissues))  # fmt: skip
    return result.values[:, :, 0]
