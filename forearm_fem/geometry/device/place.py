"""Where the device meets the limb: ports from contacts and grid points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...errors import GeometryError
from ...ports import Port
from ...scenario import Scenario
from ...scenario.device import GridRows, Rows
from ...scenario.limb import CylinderLimb, ForearmLimb, Limb, SlabLimb
from ...typing import FloatArray
from ..limb.slab import check_slab
from ..limb.tube import Tube, tube_of
from ..mesh.tissue_mesh import TissueMesh
from .landing import FacetSkin
from .layout import layout_of

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
    """Which keys move a port of a ``kind`` towards the middle."""
    if kind == "contact":
        rows = "reduce device.spacing or device.spacing_y"
        return rows if isinstance(scenario.device, Rows) else "move its place in device.contacts"
    even = isinstance(scenario.grid, GridRows)
    return "reduce grid.pitch or grid.pitch_y" if even else "move its place in grid.points"


def _larger(limb: Limb) -> str:
    """Which keys make room on a limb."""
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
