"""The semi-analytic engine: the same ports on a flat layered half-space."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..errors import ScenarioError
from ..layered import Disc, Layer, Surface, layered_compliance
from ..ports import Port
from ..scenario import Scenario
from ..scenario.limb import MeshLimb, SurfacesLimb
from ..tissue import resolve_tissues
from ..transfer import Compliance, ErrorEstimate
from ..typing import FloatArray


def solve_layered(
    scenario: Scenario, frequency: FloatArray, *, progress: Callable[[str, int, int], None] | None = None
) -> Compliance:
    """Compliance of the scenario's ports on its layers, flat and without end, at ``frequency`` (n,) [Hz].

    Leaves out curvature, bones, ends, supports, and the rigidity of the cones (uniform pressure instead).
    """
    ports = flat_ports(scenario)
    discs = [Disc(p.position[0], p.position[1], p.radius) for p in ports]

    def tell(fraction: float) -> None:
        if progress is not None:
            progress("layered half-space", round(100 * fraction), 100)

    result = layered_compliance(
        _layers(scenario),
        2 * np.pi * frequency,
        discs,
        discs,
        surface=_surface(scenario),
        tolerance=1e-7,
        progress=tell,
    )
    error = np.asarray(result.error)
    estimate = ErrorEstimate(
        "quadrature", float(error.max()), "Hankel quadrature's own control, relative to the largest entry",
        tuple(frequency.tolist()), tuple(error.tolist()),
    )  # fmt: skip
    return Compliance(frequency, result.values, ports, (estimate,))


def flat_ports(scenario: Scenario) -> tuple[Port, ...]:
    """Contacts and grid points of the scenario on the plane z = 0."""
    turn = scenario.device.rotation
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def place(xy: tuple[float, float]) -> tuple[float, float, float]:
        x, y = rotation @ np.array(xy)
        return float(x), float(y), 0.0

    radius = scenario.device.cone.radius
    contacts = [Port(f"A{i + 1}", "contact", place(c), radius=radius) for i, c in enumerate(scenario.device.centres)]
    points = [Port(str(i + 1), "point", place(p)) for i, p in enumerate(scenario.grid.places)]
    return (*contacts, *points)


def _layers(scenario: Scenario) -> list[Layer]:
    limb, tissues = scenario.limb, resolve_tissues(scenario)
    if isinstance(limb, MeshLimb | SurfacesLimb):
        raise ScenarioError(f"engine: 'layered' needs layers, but limb.shape is '{limb.shape}'; use engine = 'fem'")
    stack = [(layer.tissue, layer.thickness) for layer in limb.layers] + [(limb.core, math.inf)]
    return [Layer(h, tissues[t].density, tissues[t].modulus.at, tissues[t].bulk) for t, h in stack]


def _surface(scenario: Scenario) -> Surface | None:
    skin = scenario.tissues.membrane
    if not (skin.tension or skin.mass or skin.stiffness):
        return None
    return Surface(tension=skin.tension, membrane=4 * skin.stiffness, mass=skin.mass)
