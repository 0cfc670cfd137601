"""S with its interval against the layered twin over flat slabs: benchmarks/results/strength.csv.

Run from the repository: python3 benchmarks/strength.py FOLDER [SCENE ...]; G of each scene is kept in FOLDER.
"""

from __future__ import annotations

import pickle
import sys
import time
from pathlib import Path
from typing import Any

from forearm_fem.pipeline.simulation import simulate
from forearm_fem.scenario import parse_scenario

THIN, THICK = (("skin", 1.2e-3), ("fat", 3e-3)), (("skin", 1.5e-3), ("fat", 6e-3))
# name: spacing of the actuators and pitch of the grid [m], layers, preset, accuracy
SCENES: dict[str, tuple[float, float, Any, str, float]] = {
    "thesis 0.3": (0.045, 0.0133, THIN, "default", 0.3),
    "thesis 0.1": (0.045, 0.0133, THIN, "default", 0.1),
    "20 mm 0.3": (0.020, 0.006, THIN, "default", 0.3),
    "20 mm 0.1": (0.020, 0.006, THIN, "default", 0.1),
    "thick fat 0.3": (0.045, 0.0133, THICK, "default", 0.3),
    "thick fat 20 mm 0.3": (0.020, 0.006, THICK, "default", 0.3),
    "30 mm 0.3": (0.030, 0.009, THIN, "default", 0.3),
    "30 mm 0.1": (0.030, 0.009, THIN, "default", 0.1),
    "zhang 0.3": (0.045, 0.0133, (), "zhang", 0.3),
    "zhang 30 mm 0.3": (0.030, 0.009, (), "zhang", 0.3),
}


def scene(name: str, engine: str) -> Any:
    """The scenario of a scene for either engine."""
    spacing, pitch, layers, preset, accuracy = SCENES[name]
    return parse_scenario(
        {
            "name": "strength",
            "engine": engine,
            "accuracy": accuracy,
            "limb": {
                "shape": "slab", "length": 0.05 + 1.4 * spacing, "width": 0.05 + 1.4 * spacing, "depth": 0.02,
                "layers": [{"tissue": t, "thickness": h} for t, h in layers],
            },
            "tissues": {"preset": preset},
            "device": {"spacing": spacing, "cone": {"contact": "pressure"}},
            "grid": {"pitch": pitch},
            "sweep": {"duration": 0.5},
        }
    )  # fmt: skip


def pair(name: str, folder: Path) -> dict[str, Any]:
    """G by finite elements with its errors and companions, and the twin's, kept in ``folder``."""
    file = folder / f"{name.replace(' ', '_')}.pickle"
    if not file.is_file():
        start = time.perf_counter()
        found = simulate(scene(name, "fem"))
        kept = {"fine": found.transfer, "coarse": found.coarse, "notes": found.notes,
                "twin": simulate(scene(name, "layered")).transfer}  # fmt: skip
        if found.solved is not None and found.solved.other_ends is not None:
            from forearm_fem.device import close_loop

            kept["other"] = close_loop(found.solved.other_ends, found.scenario.device)
        kept["seconds"] = time.perf_counter() - start
        file.write_bytes(pickle.dumps(kept))
    return pickle.loads(file.read_bytes())


if __name__ == "__main__":
    place = Path(sys.argv[1])
    place.mkdir(exist_ok=True)
    for wanted in sys.argv[2:] or SCENES:
        found = pair(wanted, place)
        print(wanted, round(found["seconds"]), [(e.source, round(e.band, 4)) for e in found["fine"].errors], flush=True)
