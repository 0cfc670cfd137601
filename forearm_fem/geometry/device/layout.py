"""Layout of contacts and grid points in the plane, and layers of a limb."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from ...errors import GeometryError
from ...ports import Port
from ...scenario import Scenario
from ...scenario.device import Rows
from ...scenario.limb import CylinderLimb, ForearmLimb, LayerThickness, Limb, SlabLimb
from ...typing import FloatArray

RIGID = ("bonded", "frictionless")


@dataclass(frozen=True)
class Layout:
    """Contact centres (n, 2) and grid points (m, 2) [m] in limb coordinates, and the contacts' radius [m]."""

    contacts: FloatArray
    points: FloatArray
    radius: float

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the contacts: A1, A2, ..."""
        return tuple(f"A{i + 1}" for i in range(len(self.contacts)))


def layout_of(scenario: Scenario) -> Layout:
    """Contacts and points of the device, rotated by its angle; raises when two contacts overlap."""
    device = scenario.device
    contacts, points = (turned(scenario, p) for p in (device.centres, scenario.grid.places))
    layout = Layout(contacts, points, device.cone.radius)
    for (a, pa), (b, pb) in combinations(zip(layout.names, layout.contacts, strict=True), 2):
        apart = float(np.linalg.norm(pa - pb))
        if apart < 2.1 * layout.radius:
            apart_by = "increase device.spacing" if isinstance(device, Rows) else "move one in device.contacts"
            raise GeometryError(
                f"contacts {a} and {b} are {apart * 1e3:.3g} mm apart, but discs of radius {layout.radius * 1e3:.3g} "
                f"mm need {2.1 * layout.radius * 1e3:.3g} mm; {apart_by} or reduce device.cone.radius"
            )
    return layout


def turned(scenario: Scenario, places: ArrayLike) -> FloatArray:
    """Limb coordinates (n, 2) [m] of ``places`` in the device's frame."""
    c, s = np.cos(scenario.device.rotation), np.sin(scenario.device.rotation)
    turn = np.array([[c, s], [-s, c]])  # row vectors times this: counter-clockwise seen from above
    xy = np.array(places, dtype=float).reshape(-1, 2) @ turn
    return np.where(np.abs(xy) < 1e-12, 0.0, xy)  # rounding leaves 1e-18 m; symmetry planes want exact zeros


def planform_ports(scenario: Scenario) -> tuple[tuple[Port, ...], tuple[Port, ...]]:
    """Outputs and inputs seen from above (z = 0), where names and places count and the limb's surface does not."""
    layout, contact = layout_of(scenario), scenario.device.cone.contact
    outputs = tuple(Port(str(k + 1), "point", (float(x), float(y), 0.0)) for k, (x, y) in enumerate(layout.points))
    inputs = tuple(
        Port(name, "contact", (float(x), float(y), 0.0), radius=layout.radius, contact=contact)
        for name, (x, y) in zip(layout.names, layout.contacts, strict=True)
    )
    return outputs, inputs


def layers_of(limb: Limb) -> tuple[LayerThickness, ...]:
    """Layers of a parametric limb from the skin inwards; none for the user's own surfaces or mesh."""
    return limb.layers if isinstance(limb, ForearmLimb | CylinderLimb | SlabLimb) else ()
