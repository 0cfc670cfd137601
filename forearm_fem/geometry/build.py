"""From a scenario to its mesh: made, shipped with the package, or kept for the next run."""

from __future__ import annotations

import argparse
import json
import logging
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError, MeshError, MeshTooLarge
from ..ports import Port
from ..progress import Progress, tell
from ..scenario import Scenario, load_scenario
from ..scenario.limb import CylinderLimb, ForearmLimb, MeshLimb, MeshOptions, SlabLimb, SurfacesLimb
from ..scenario.text import contents, limb_files
from ..store.folder import default_cache_dir, write_text
from ..store.text import digest_of
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
from .device.sizing import WIDEST, SizeField, SpaceField, element_sizes, refuse_if_too_many, size_growth, why_cramped
from .limb.core import limb_mesh, underside
from .limb.slab import slab_mesh
from .limb.tube import Tube, bent_middles, tube_of, with_bends
from .mesh.files import read_mesh, write_mesh
from .mesh.quality import check_count, check_mesh, mesh_quality
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


# Meshes that come with the package, and those kept for the next run.

# Meshes are found before they are made: shipped with the scenario, in the user's cache, else built.

_QUALITY = MeshOptions().min_quality
GENERATOR = 7  # raise when the same scenario would give another mesh


def cached_mesh(
    scenario: Scenario,
    *,
    base: Path = Path("."),
    scale: float = 1.0,
    cache_dir: Path | None = None,
    shipped_dir: Path | None = None,
    progress: Progress | None = None,
) -> TissueMesh:
    """The scenario's mesh from ``shipped_dir``, else from ``cache_dir``, else built and kept there.

    ``base`` is the scenario file's folder. A file that cannot be read or whose contents changed is logged and
    passed over. Meshes come out the same each time, but for the user's surfaces: fTetWild is not repeatable.
    """
    sizes = element_sizes(scenario, scale=scale)
    refuse_if_too_many(scenario, SizeField.around(layout_of(scenario), sizes, size_growth(scenario, scale=scale)))
    key = mesh_key(scenario, base=base, scale=scale)
    for folder in shipped_folders(base, shipped_dir):
        notes = sorted(folder.glob("*.json")) if folder.is_dir() else []
        matching = (_read(note, key) for note in notes if _note(note).get("key") == key)
        if (found := next((mesh for mesh in matching if mesh is not None), None)) is not None:
            return _usable(scenario, found)
    home = cache_dir or default_cache_dir()
    if (found := _read(home / f"{key}.json", key)) is not None:
        return _usable(scenario, found)
    mesh = build_mesh(scenario, base=base, scale=scale, progress=progress)
    path = home / f"{key}.vtu"
    try:
        store_mesh(mesh, path, key)
    except DataError as problem:
        _log.warning("the mesh could not be kept in the cache %s (%s); it will be built again", path.parent, problem)
    return mesh


def _usable(scenario: Scenario, mesh: TissueMesh) -> TissueMesh:
    """A mesh that was found, bent, after the checks that a fresh one undergoes and its key knows nothing of."""
    check_count(mesh, scenario.mesh.max_elements)
    return with_bends(scenario, mesh)


def mesh_key(scenario: Scenario, *, base: Path = Path("."), scale: float = 1.0) -> str:
    """SHA-256 of everything the mesh depends on, user files' contents included."""
    layout = layout_of(scenario)
    limb = scenario.limb
    sizes = element_sizes(scenario, scale=scale)
    depends = {
        "generator": GENERATOR,
        "limb": scenario.limb.model_dump(mode="json"),
        "files": contents(limb_files(limb), base),
        "contacts": layout.contacts.tolist(),
        "radius": layout.radius,
        "rigid": scenario.device.cone.contact in RIGID or ["pressure", scale],
        "points": layout.points.tolist(),
        # to a micrometre: rounding of the last bit must not miss a mesh
        "grading": round(size_growth(scenario, scale=scale), 6),
        "sizes": {k: round(v, 6) if isinstance(v, float) else v for k, v in asdict(sizes).items()},
        "bone": scenario.supports.bone,
    }
    if isinstance(scenario.limb, MeshLimb | SurfacesLimb):
        depends["scale"] = scale
    if scenario.mesh.min_quality != _QUALITY:  # it may decide at which attempt a mesh is good enough
        depends["min_quality"] = scenario.mesh.min_quality
    return digest_of(depends)


def shipped_folders(base: Path, given: Path | None = None) -> tuple[Path, ...]:
    """Folders of meshes that came with the program: ``given``, else ../meshes of the scenario and ./meshes."""
    return (given,) if given is not None else (base / ".." / "meshes", Path("meshes"))


def store_mesh(mesh: TissueMesh, path: Path, key: str, *, command: str = "") -> None:
    """Write ``mesh`` to ``path`` (.vtu), and beside it a .json with its key, digest and the command that makes it."""
    write_mesh(mesh, path)
    note = {
        "key": key,
        "digest": mesh.digest,
        "tetrahedra": len(mesh.tetrahedra),
        "generator": GENERATOR,
        "command": command,
    }
    write_text(path.with_suffix(".json"), json.dumps(note, indent=2) + "\n")


def ship_mesh(
    scenario: Scenario, folder: Path, name: str, *, base: Path, scale: float = 1.0, command: str
) -> TissueMesh:
    """Build the scenario's mesh and keep it as ``folder``/``name``.vtu with its note."""
    mesh = build_mesh(scenario, base=base, scale=scale)
    store_mesh(mesh, folder / f"{name}.vtu", mesh_key(scenario, base=base, scale=scale), command=command)
    return mesh


def _note(file: Path) -> dict[str, Any]:
    try:
        note = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return note if isinstance(note, dict) else {}


def _read(file: Path, key: str) -> TissueMesh | None:
    """The mesh beside the note ``file`` if both are whole and carry ``key``."""
    if not file.exists():
        return None
    note = _note(file)
    try:
        mesh = read_mesh(file.with_suffix(".vtu"))
    except MeshError as problem:
        _log.warning("cached mesh passed over, it will be built again: %s", problem)
        return None
    if note.get("key") != key or note.get("digest") != mesh.digest:
        _log.warning("cached mesh %s does not match its note; it will be built again", file.with_suffix(".vtu"))
        return None
    return mesh


# Make the meshes that come with the program: ``python -m forearm_fem.geometry.build scenarios/thesis.toml``.


def main(arguments: list[str] | None = None) -> None:
    """Build the meshes of a scenario (of the default one if none is named) at the scales asked for."""
    parser = argparse.ArgumentParser(prog="python -m forearm_fem.geometry.build", description=__doc__)
    parser.add_argument("scenario", nargs="?", help="TOML file; without it the default scenario")
    parser.add_argument("--scale", type=float, nargs="+", default=[1.0], help="factors on all element sizes")
    parser.add_argument("--folder", type=Path, default=Path("meshes"))
    chosen = parser.parse_args(arguments)
    file = Path(chosen.scenario) if chosen.scenario else None
    scenario = load_scenario(file) if file else Scenario()
    for scale in chosen.scale:
        name = (file.stem if file else "default") + ("" if scale == 1 else f"-x{scale:g}")
        command = " ".join(
            ["python -m forearm_fem.geometry.build", *([str(file)] if file else []), f"--scale {scale:g}"]
        )
        mesh = ship_mesh(
            scenario, chosen.folder, name, base=file.parent if file else Path(), scale=scale, command=command
        )
        print(name, mesh_quality(mesh))


if __name__ == "__main__":
    main()
