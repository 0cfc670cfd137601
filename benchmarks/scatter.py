"""Error of a curved limb's mesh without any reference: on a round limb mirror images must have equal receptances.

    python benchmarks/scatter.py [--size 1.0 1.3]

A cylinder with two bones, four contacts and nine points is symmetric about x = 0 and y = 0, its tetrahedra are not.
What mirror images of one entry differ by comes from the mesh alone. Prints and writes the largest difference from their
mean, relative to the largest receptance of a point, and the same under the contacts. What all share is not seen.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

from forearm_fem.engines.fem import fem_model
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.geometry.build import build_mesh
from forearm_fem.ports import Port
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.typing import ComplexArray

FREQUENCIES = (60.0, 125.0, 200.0, 250.0, 300.0, 400.0)
RESULTS = Path(__file__).parent / "results" / "scatter.csv"


def round_limb() -> Scenario:
    """The default section without taper, its bones at equal depths."""
    bones = [{"name": n, "y": y, "depth": 0.025, "diameter": 0.014} for n, y in (("radius", -0.014), ("ulna", 0.014))]
    limb = {"shape": "cylinder", "length": 0.14, "diameter": 0.0723, "bones": bones}
    return parse_scenario({"name": "round-limb", "accuracy": 0.05, "limb": limb})


def images(ports: tuple[Port, ...]) -> list[tuple[list[int], list[int], str]]:
    """Outputs, inputs and output's kind of each set of entries that are mirror images of one another."""
    sets = defaultdict(list)
    for i, out in enumerate(ports):
        for j, source in enumerate(ports):
            if source.kind == "contact":
                signs = np.sign(source.position[:2])
                place = tuple(np.round(np.array(out.position[:2]) * signs * 1e4).astype(int))
                sets[out.kind, place].append((i, j))
    return [([i for i, _ in pairs], [j for _, j in pairs], kind) for (kind, _), pairs in sets.items() if len(pairs) > 1]


def scatter(values: ComplexArray, ports: tuple[Port, ...]) -> dict[str, list[float]]:
    """Largest difference from the mean of mirror images per kind of output, relative to the largest of that kind."""
    worst: dict[str, list[float]] = {"point": [0.0] * len(values), "contact": [0.0] * len(values)}
    inputs = [j for j, p in enumerate(ports) if p.kind == "contact"]
    for outputs, sources, kind in images(ports):
        entries = values[:, outputs, sources]
        away = np.abs(entries - entries.mean(axis=1, keepdims=True)).max(axis=1)
        same = [i for i, p in enumerate(ports) if p.kind == kind]
        largest = np.abs(values[:, same][:, :, inputs]).max(axis=(1, 2))
        worst[kind] = [max(a, float(b)) for a, b in zip(worst[kind], away / largest, strict=True)]
    return worst


def main() -> None:
    """One line per mesh and kind of output."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=float, nargs="+", default=[1.0, 1.3], help="factors on all element sizes")
    scenario, rows = round_limb(), []
    for size in parser.parse_args().size:
        start = time.perf_counter()
        mesh = build_mesh(scenario, scale=size)
        model = fem_model(scenario, mesh)
        values = direct_sweep(model, np.array(FREQUENCIES), scenario.solver).values
        for kind, found in scatter(values, model.ports).items():
            figures = [f"{x:.4f}" for x in found]
            rows.append([size, model.operator.n, kind, *figures, f"{time.perf_counter() - start:.0f}"])
            print(*rows[-1], flush=True)
    with RESULTS.open("w", newline="") as file:
        csv.writer(file).writerows(
            [["size", "unknowns", "outputs", *(f"{f:g} Hz" for f in FREQUENCIES), "seconds"], *rows]
        )


if __name__ == "__main__":
    main()
