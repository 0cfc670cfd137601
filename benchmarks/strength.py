"""S with its interval against the layered model over flat slabs: benchmarks/results/strength.csv.

Run from the repository: python3 benchmarks/strength.py FOLDER [SCENE ...]; G of each scene is kept in FOLDER.
"""

from __future__ import annotations

import csv
import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np

from forearm_fem.engines.simulation import render_transfer, simulate
from forearm_fem.scenario import parse_scenario
from forearm_fem.transfer import band_error

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
    """G by finite elements with its errors and companions, and the layered model's, kept in ``folder``."""
    file = folder / f"{name.replace(' ', '_')}.pickle"
    if not file.is_file():
        found = simulate(scene(name, "fem"))
        layered = simulate(scene(name, "layered")).transfer
        file.write_bytes(pickle.dumps({"fine": found.transfer, "layered": layered}))
    return pickle.loads(file.read_bytes())


def judged(name: str, folder: Path) -> tuple[list[Any], Any, Any]:
    """A row of the table, and |log S / S layered model| and half widths of every entry."""
    found = pair(name, folder)
    scenario, fine, layered = scene(name, "fem"), found["fine"], found["layered"]
    rendering = render_transfer(scenario, fine)
    account = rendering.strength
    true = np.abs(np.log(account.value / render_transfer(scenario, layered).strengths))
    half = np.log(account.high / account.low) / 2
    bands = {e.source: e.band for e in fine.errors}
    row = [
        name, bands["discretisation"], bands["truncation"], band_error(fine.values, layered.values),
        float((true <= half).mean()), float(np.median(true)), float(np.median(half)),
        float(np.median(half / true)), float((half < true / 2).sum()),
    ]  # fmt: skip
    return row, true, half


HEADER = ["scene", "discretisation", "truncation", "true e_band", "within", "median error", "median half width",
          "median of half width over error", "half width below half the error"]  # fmt: skip


if __name__ == "__main__":
    place = Path(sys.argv[1])
    place.mkdir(exist_ok=True)
    rows, true, half = zip(*(judged(name, place) for name in sys.argv[2:] or SCENES), strict=True)
    e, h = (np.concatenate([x.ravel() for x in each]) for each in (true, half))
    total = ["all", "", "", "", (e <= h).mean(), np.median(e), np.median(h), np.median(h / e), (h < e / 2).sum()]
    with (Path(__file__).parent / "results" / "strength.csv").open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerows([HEADER, *([f"{x:.4g}" if not isinstance(x, str) else x for x in r] for r in (*rows, total))])
