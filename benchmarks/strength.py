"""S with its interval against the layered model over flat slabs, and a limb against a finer mesh of it.

Run from the repository: python3 benchmarks/strength.py FOLDER [SCENE ...]; the table is FOLDER/strength.csv, and G of
each scene is kept beside it.
"""

from __future__ import annotations

import csv
import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np

from forearm_fem.engines.simulation import simulate
from forearm_fem.rendering.job import RenderJob, render_transfer
from forearm_fem.scenario import load_scenario, parse_scenario
from forearm_fem.transfer import band_error

THIN, THICK, BARE = (("skin", 1.2e-3), ("fat", 3e-3)), (("skin", 1.5e-3), ("fat", 6e-3)), (("skin", 2.5e-3),)
MID, LEAN = (("skin", 1.5e-3), ("fat", 4.5e-3)), (("skin", 1.0e-3), ("fat", 2e-3))
FINE, PLAIN = {"size_contact": 0.004, "size_far": 0.02}, {"size_contact": 0.005, "size_grid": 0.005, "size_far": 0.025}
NEAR = {**PLAIN, "size_contact": 0.004, "size_grid": 0.004}
PITCH = {45: 0.0133, 35: 0.0105, 30: 0.009}
QUICK = {"size_contact": 0.006, "size_grid": 0.005, "size_far": 0.03, "grading": 0.6}
LIMB = "limb: quick's forearm"
RIGID = {"size_contact": 0.004, "size_grid": 0.006, "size_far": 0.03, "element": "auto"}
# name: layers, preset, spacing, side and depth [mm], band [Hz], mesh; the factor and the share apart came of the first
SCENES: dict[str, tuple[Any, str, float, float, float, float, float, dict[str, Any]]] = {
    "thin": (THIN, "default", 45, 140, 40, 60, 250, FINE),
    "thick, 100-300 Hz": (THICK, "default", 45, 140, 40, 100, 300, FINE),
    "thin, 30 mm, 120-300 Hz": (THIN, "default", 30, 90, 25, 120, 300, NEAR),
    "bare, 60-200 Hz": (BARE, "default", 45, 130, 35, 60, 200, {**QUICK, "sublayers": {"skin": 1}}),
    "mid, springpot, 30 mm, 100-300 Hz": (MID, "springpot", 30, 90, 25, 100, 300, PLAIN),
    "unseen: thin, springpot": (THIN, "springpot", 45, 130, 35, 60, 250, {**QUICK, "sublayers": {"skin": 1, "fat": 1}}),
    "unseen: zhang": ((), "zhang", 45, 120, 35, 60, 250, PLAIN),
    "unseen: mid, 35 mm, 80-250 Hz": (MID, "default", 35, 110, 30, 80, 250, PLAIN),
    "unseen: lean, 100-250 Hz": (LEAN, "default", 45, 120, 30, 100, 250, PLAIN),
    "unseen: quick": (THIN, "default", 45, 150, 40, 50, 250, {**QUICK, "sublayers": {"skin": 1, "fat": 1}}),
    "rigid: bonded, thin": (THIN, "default", 45, 120, 35, 60, 250, RIGID),
    "rigid: bonded, mid, springpot, 35 mm": (MID, "springpot", 35, 110, 30, 80, 250, RIGID),
    "rigid: frictionless, lean, 30 mm": (LEAN, "default", 30, 100, 30, 100, 300, RIGID),
    "rigid: frictionless, zhang": ((), "zhang", 45, 120, 35, 60, 250, RIGID),
}  # fmt: skip


def contact_of(name: str) -> str:
    """Contact of the cones of a scene."""
    return next((c for c in ("bonded", "frictionless") if c in name), "pressure")


def limb(engine: str) -> Any:
    """A forearm with the sizes of ``quick``; in place of "layered" on a mesh two thirds as large, whose error is about
    a quarter."""
    scenario = load_scenario("quick").changed({"limb": {"shape": "forearm", "length": 0.15}, "sweep.duration": 0.5})
    finer = {"size_contact": 0.004, "size_grid": 0.004, "size_far": 0.014}
    sizes = {f"mesh.{key}": value for key, value in finer.items()}
    return scenario if engine == "fem" else scenario.changed({**sizes, "solver.discretisation_estimate": False})


def scene(name: str, engine: str) -> Any:
    """The scenario of a scene for either engine."""
    if name == LIMB:
        return limb(engine)
    layers, preset, spacing, side, depth, low, high, mesh = SCENES[name]
    return parse_scenario(
        {
            "name": "strength",
            "engine": engine,
            "accuracy": 0.2 if name == "thick, 100-300 Hz" else 0.3,
            "limb": {
                "shape": "slab", "length": 1e-3 * side, "width": 1e-3 * side, "depth": 1e-3 * depth,
                "layers": [{"tissue": t, "thickness": h} for t, h in layers],
            },
            "tissues": {"preset": preset},
            "device": {"spacing": 1e-3 * spacing, "cone": {"contact": contact_of(name)}},
            "grid": {"pitch": PITCH[spacing]},
            "sweep": {"f_min": low, "f_max": high, "duration": 0.5},
            "rendering": {"wavelet": {"peak": (low * high) ** 0.5}},
            "mesh": {"element": "P2", **mesh},
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


def judged(name: str, folder: Path) -> tuple[list[Any], Any, Any, Any]:
    """A row of the table; |log S / S layered model|, half widths, and |log S| played on the layered model, of all."""
    found = pair(name, folder)
    scenario, fine, layered = scene(name, "fem"), found["fine"], found["layered"]
    job = RenderJob.of(scenario, fine)
    account = render_transfer(scenario, fine).strength
    (own, played), (true,) = job.strengths(fine, fine, layered)[0], job.strengths(layered)[0]
    true, played = np.abs(np.log(own / true)), np.abs(np.log(own / played))
    half = np.log(account.high / account.low) / 2
    bands = {e.source: e.band for e in fine.errors}
    row = [
        name, bands["discretisation"], bands["truncation"], band_error(fine.values, layered.values),
        *judgement(true, half, played),
    ]  # fmt: skip
    return row, true, half, played


def judgement(true: Any, half: Any, played: Any) -> list[float]:
    """Figures of one scene or of several."""
    return [
        float(x)
        for x in ((true <= half).mean(), np.median(true), np.median(half), np.median(half / true),
                  (half < true / 2).sum(), (played <= half).mean())
    ]  # fmt: skip


HEADER = ["scene", "discretisation", "truncation", "true e_band", "within", "median error", "median half width",
          "median of half width over error", "half width below half the error", "within as played"]  # fmt: skip


if __name__ == "__main__":
    place = Path(sys.argv[1])
    place.mkdir(exist_ok=True)
    names = sys.argv[2:] or [*SCENES, LIMB]
    rows, *parts = zip(*(judged(name, place) for name in names), strict=True)
    for said in ("seen", "unseen", "rigid"):
        some = [i for i, name in enumerate(names) if (name.partition(":")[0] if ":" in name else "seen") == said]
        if some:
            flat = (np.concatenate([part[i].ravel() for i in some]) for part in parts)
            rows = (*rows, [said, "", "", "", *judgement(*flat)])
    with (place / "strength.csv").open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerows([HEADER, *([f"{x:.4g}" if not isinstance(x, str) else x for x in r] for r in rows)])
