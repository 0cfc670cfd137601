"""Meshes that come with the package, and those kept for the next run."""

from __future__ import annotations

import argparse
import json
import logging
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..errors import DataError, MeshError
from ..progress import Progress
from ..scenario import Scenario, load_scenario
from ..scenario.limb import MeshLimb, MeshOptions, SurfacesLimb
from ..scenario.load import contents, limb_files
from ..store.folder import default_cache_dir, write_text
from ..store.text import digest_of
from .build import build_mesh
from .device.layout import RIGID, layout_of
from .device.sizing import SizeField, element_sizes, refuse_if_too_many, size_growth
from .limb.tube import with_bends
from .mesh.files import read_mesh, write_mesh
from .mesh.quality import check_count, mesh_quality
from .mesh.tissue_mesh import TissueMesh

# Meshes are found before they are made: shipped with the scenario, in the user's cache, else built.

_QUALITY = MeshOptions().min_quality
GENERATOR = 7  # raise when the same scenario would give another mesh
_log = logging.getLogger("forearm_fem.geometry")


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
        "grading": size_growth(scenario, scale=scale),
        # to a micrometre: rounding of the last bit must not miss a mesh
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


# Make the meshes that come with the program: ``python -m forearm_fem.geometry.cache scenarios/thesis.toml``.


def main(arguments: list[str] | None = None) -> None:
    """Build the meshes of a scenario (of the default one if none is named) at the scales asked for."""
    parser = argparse.ArgumentParser(prog="python -m forearm_fem.geometry.cache", description=__doc__)
    parser.add_argument("scenario", nargs="?", help="TOML file; without it the default scenario")
    parser.add_argument("--scale", type=float, nargs="+", default=[1.0], help="factors on all element sizes")
    parser.add_argument("--folder", type=Path, default=Path("meshes"))
    chosen = parser.parse_args(arguments)
    file = Path(chosen.scenario) if chosen.scenario else None
    scenario = load_scenario(file) if file else Scenario()
    for scale in chosen.scale:
        name = (file.stem if file else "default") + ("" if scale == 1 else f"-x{scale:g}")
        command = " ".join(
            ["python -m forearm_fem.geometry.cache", *([str(file)] if file else []), f"--scale {scale:g}"]
        )
        mesh = ship_mesh(
            scenario, chosen.folder, name, base=file.parent if file else Path(), scale=scale, command=command
        )
        print(name, mesh_quality(mesh))


if __name__ == "__main__":
    main()
