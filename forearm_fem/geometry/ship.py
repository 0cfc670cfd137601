"""Make the meshes that come with the program: ``python -m forearm_fem.geometry.ship scenarios/thesis.toml``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..scenario import Scenario, load_scenario
from .cache import ship_mesh
from .mesh.quality import mesh_quality


def main(arguments: list[str] | None = None) -> None:
    """Build the meshes of a scenario (of the default one if none is named) at the scales asked for."""
    parser = argparse.ArgumentParser(prog="python -m forearm_fem.geometry.ship", description=__doc__)
    parser.add_argument("scenario", nargs="?", help="TOML file; without it the default scenario")
    parser.add_argument("--scale", type=float, nargs="+", default=[1.0], help="factors on all element sizes")
    parser.add_argument("--folder", type=Path, default=Path("meshes"))
    chosen = parser.parse_args(arguments)
    file = Path(chosen.scenario) if chosen.scenario else None
    scenario = load_scenario(file) if file else Scenario()
    for scale in chosen.scale:
        name = (file.stem if file else "default") + ("" if scale == 1 else f"-x{scale:g}")
        command = " ".join(
            ["python -m forearm_fem.geometry.ship", *([str(file)] if file else []), f"--scale {scale:g}"]
        )
        mesh = ship_mesh(
            scenario, chosen.folder, name, base=file.parent if file else Path(), scale=scale, command=command
        )
        print(name, mesh_quality(mesh))


if __name__ == "__main__":
    main()
