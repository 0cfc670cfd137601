"""Rows of the verification, and the blocks and quarter slabs that they are solved on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..engines.layered import flat_layers, flat_surface
from ..fem.assembly.model import ForearmModel, build_model
from ..fem.linear.factor import make_factor, refined_solve
from ..fem.reduction.sweep import direct_sweep
from ..geometry.build import build_mesh
from ..geometry.device.place import place_ports
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..laws import KelvinVoigt
from ..layered import Base, Disc, Layer, layered_compliance
from ..ports import Port
from ..scenario import Scenario, parse_scenario
from ..scenario.elements import FreeUnderside
from ..scenario.sweep import DirectSolve
from ..scenario.tissues import Membrane
from ..tissue import Tissue, resolve_tissues
from ..typing import ComplexArray, FloatArray
from .blocks import block_mesh

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


def layered_truth(scenario: Scenario, frequencies: Sequence[float], *, depth: float | None = None) -> ComplexArray:
    """The exact counterpart of :func:`slab_response`; a ``depth`` puts rigid ground under the core."""
    layers, base = flat_layers(scenario), "halfspace"
    if depth is not None:
        above = sum(x.thickness_m for x in layers[:-1])
        last = layers[-1]
        layers, base = [*layers[:-1], Layer(depth - above, last.density, last.modulus, last.bulk_modulus)], "rigid"
    cone, surface = scenario.device.cone, flat_surface(scenario.tissues)
    discs = [Disc(0.0, 0.0, cone.radius, cone.contact), *(Disc(x, y) for x, y in scenario.grid.places)]
    omega = 2 * np.pi * np.array(frequencies)
    choice: Base = "rigid" if base == "rigid" else "halfspace"
    result = layered_compliance(layers, omega, discs[:1], discs, base=choice, surface=surface, tolerance=1e-8)
    return result.values[:, :, 0]
