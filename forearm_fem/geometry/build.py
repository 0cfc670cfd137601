"""From a scenario to its mesh."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import MeshError, MeshTooLarge
from ..ports import Port
from ..progress import Progress, tell
from ..scenario import Scenario
from ..scenario.limb import CylinderLimb, ForearmLimb, MeshLimb, SlabLimb, SurfacesLimb
from ..typing import FloatArray
from .device.imprint import imprint
from .device.layout import RIGID, layout_of
from .device.place import (
    FacetSkin,
    check_contact_areas,
    place_ports,
    ports_on,
    true_skin,
    with_contacts,
    with_true_rims,
)
from .device.sizing import WIDEST, SizeField, SpaceField, element_sizes, size_growth, why_cramped
from .limb.core import limb_mesh, underside
from .limb.slab import slab_mesh
from .limb.tube import Tube, bent_middles, tube_of, with_bends
from .mesh.quality import check_count, check_mesh
from .mesh.refinement import midpoints, refine_near, refine_rims, refine_skin
from .mesh.tissue_mesh import TissueMesh
from .user.checks import check_room
from .user.meshes import user_mesh
from .user.surfaces import read_surfaces, surfaces_mesh
from .user.volume import MeshTimeout

_ATTEMPTS = 3  # meshes of curved limbs begin with random numbers: others may succeed where some did not
_CONTACT_SIZES = 1.0, 0.7, 0.5, 1.4  # sizes under contacts that are tried in turn on a user's mesh
_FINER = 0.75  # with facets so much narrower each time: few wide ones may not enclose what lies inside
_log = logging.getLogger("forearm_fem.geometry")


def build_mesh(
    scenario: Scenario,
    *,
    base: Path = Path("."),
    scale: float = 1.0,
    progress: Progress | None = None,
) -> TissueMesh:
    """Tetrahedra of the scenario's limb, bent along its walls; ``scale`` multiplies every element size."""
    sizes = element_sizes(scenario, scale=scale)
    size = SizeField.around(layout_of(scenario), sizes, size_growth(scenario, scale=scale))
    if isinstance(scenario.limb, MeshLimb):
        return _on_users_mesh(scenario, scenario.limb, base, size, progress, scale)
    for attempt in range(1, _ATTEMPTS + 1):
        try:
            mesh = _unmarked(scenario, base, size.with_facets(_FINER ** (attempt - 1)), progress, attempt)
            return with_bends(scenario, _marked(scenario, mesh, size, progress, scale))
        except MeshError as problem:
            if attempt == _ATTEMPTS or isinstance(scenario.limb, SlabLimb) or isinstance(problem, MeshTimeout):
                why = why_cramped(scenario, size.layout)
                raise (MeshError(why) if why else problem) from None
            _log.info("attempt %d at the mesh failed (%s); the next one will differ", attempt, problem)
    raise AssertionError("unreachable")


def _on_users_mesh(
    scenario: Scenario, limb: MeshLimb, base: Path, size: SizeField, progress: Progress | None, scale: float
) -> TissueMesh:
    """The user's mesh with the contacts in it; what our own refinement spoils is tried with other sizes, then told."""
    keep_bone = scenario.supports.bone == "elastic"
    mesh = user_mesh(limb, base, size.layout, scenario.mesh.min_quality, keep_bone=keep_bone)
    problem: MeshError | None = None
    for factor in _CONTACT_SIZES:
        try:
            return with_bends(scenario, _marked(scenario, mesh, size.with_contact(factor), progress, scale))
        except MeshTooLarge:
            raise
        except MeshError as found:
            problem = problem or found
    raise MeshError(
        "the mesh itself is sound, but following the contacts' rims in it makes elements flat or inverted; "
        + _remedy(mesh, place_ports(scenario, mesh))
    ) from problem


def _remedy(mesh: TissueMesh, ports: tuple[Port, ...]) -> str:
    """Remedy where rims cannot be followed: no size asked for makes up for skin edges far longer than a radius."""
    middles, edges = mesh.points[mesh.facets["skin"]].mean(axis=1), mesh.points[mesh.facets["skin"]]
    for port in (p for p in ports if p.kind == "contact"):
        under = edges[np.argmin(np.linalg.norm(middles - np.asarray(port.position), axis=1))]
        length = float(np.linalg.norm(under - np.roll(under, 1, axis=0), axis=1).min())
        if length > 2 * port.radius:
            return (
                f"the skin's edges under contact {port.name} are {1e3 * length:.3g} mm and longer, its radius is "
                f"{1e3 * port.radius:.3g} mm: remesh there with edges shorter than the radius"
            )
    return (
        "set mesh.size_contact near the length of the skin's edges there, use smaller ones, or lower mesh.min_quality"
    )


def _unmarked(scenario: Scenario, base: Path, size: SizeField, progress: Progress | None, attempt: int) -> TissueMesh:
    """The limb's mesh before contacts are pressed into it."""
    limb, keep_bone = scenario.limb, scenario.supports.bone == "elastic"
    if isinstance(limb, SlabLimb):
        return slab_mesh(limb, size.layout, size)
    if isinstance(limb, ForearmLimb | CylinderLimb):
        tube = tube_of(limb)
        ports_on(scenario, tube.volar)  # complain about misplaced ports before the long work
        tell(progress, "meshing the core", 0, 0)
        field = SpaceField.on(size, lambda xy: _core_surface(tube, xy))
        return limb_mesh(tube, field, size.sizes, size.layout, elastic_bones=keep_bone, seed=attempt)
    assert isinstance(limb, SurfacesLimb)
    tell(progress, "reading and checking the surfaces", 0, 0)
    surfaces = read_surfaces(limb, base)
    check_room(base / limb.surfaces[surfaces[0].tissue], surfaces[0].vertices, size.layout, limb.unit)
    outer = FacetSkin(surfaces[0].vertices, surfaces[0].faces)
    ports_on(scenario, outer)  # complain early here, too
    tell(progress, "meshing the outer surface (minutes for fine sizes)", 0, 0)
    field = SpaceField.on(size, lambda xy: outer(xy)[0])
    return surfaces_mesh(surfaces, field, size.sizes.far, scenario.mesh.max_elements, progress, keep_bone=keep_bone)


def _marked(
    scenario: Scenario, mesh: TissueMesh, size: SizeField, progress: Progress | None, scale: float
) -> TissueMesh:
    """With rims followed by edges, refined where the cone is rigid, and contacts named; checked."""
    limb, cone, sizes = scenario.limb, scenario.device.cone, size.sizes
    tube = tube_of(limb) if isinstance(limb, ForearmLimb | CylinderLimb) else None
    ports = tuple(p for p in place_ports(scenario, mesh) if p.kind == "contact")
    tell(progress, "following and refining the contact rims", 0, 0)
    if not isinstance(limb, SlabLimb):
        skin = tube.volar if tube else FacetSkin.of(mesh)
        if not isinstance(limb, MeshLimb):
            mesh = refine_skin(mesh, SpaceField.on(size, lambda xy: skin(xy)[0]))
        if tube is None:  # tubes have rings of vertices under the contacts already
            mesh = refine_near(mesh, ports, min(sizes.contact, scale * WIDEST * cone.radius))
        for port in ports:
            mesh = imprint(mesh, port, true_skin(tube) if tube else FacetSkin.of(mesh).lift)
        if len(found := underside(mesh.points, mesh.facets["skin"])):
            mesh = replace(mesh, facets={**mesh.facets, "underside": found})
    # rigid discs have a stress singularity at the rim; a uniform pressure only needs its area
    rigid = cone.contact in RIGID
    rim = sizes.rim if rigid else max(0.5 * sizes.contact, 0.25 * scale * cone.radius)
    mesh = refine_rims(with_contacts(mesh, ports), ports, rim, middle=bent_middles(tube) if tube else midpoints)
    mesh = with_true_rims(mesh, ports, sizes.rim_lead if rigid else 0.0)
    check_count(mesh, scenario.mesh.max_elements)
    check_contact_areas(mesh, ports)
    check_mesh(mesh, scenario.mesh.min_quality)
    return mesh


def limb_volume(scenario: Scenario) -> float | None:
    """Exact volume [m^3] of what a parametric limb's mesh fills (a slab's quarter too); None for user limbs."""
    limb, elastic = scenario.limb, scenario.supports.bone == "elastic"
    if isinstance(limb, SlabLimb):
        return float(limb.length * limb.width * limb.depth / 2 ** len(set(limb.symmetry)))
    if isinstance(limb, ForearmLimb | CylinderLimb):
        return sum(tube_of(limb).volumes(bones_kept=elastic).values())
    return None


def _core_surface(tube: Tube, xy: FloatArray) -> FloatArray:
    """Points (n, 3) of the core's surface under the skin at ``xy`` (n, 2)."""
    skin, _ = tube.volar(xy)
    return tube.place(skin[:, 0], np.where(np.isfinite(skin[:, 1]), tube.angle_of(skin), np.nan), tube.thickness)
