"""What can be said about a mesh before it is made, and why one failed: too many elements, too little room."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np

from ...errors import MeshError
from ...scenario import Scenario
from ...scenario.limb import CylinderLimb, ForearmLimb, SlabLimb
from .layout import Layout
from .sizing import SizeField

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
