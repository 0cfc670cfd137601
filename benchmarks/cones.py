"""Rigid cones on slabs: what a second mesh, as limbs have it, states of finite elements, and what these err by, against
the layered model's rigid discs.

Run from the repository: python3 benchmarks/cones.py [folder] [--keep FOLDER] [--accuracy 0.3 0.1] [--diameter 2 7]

One line a scene and drive in cones.csv, kept after each scene; scenes that are there are not solved again. cones.md is
the table. One solve serves both drives: the device enters afterwards. What was solved stays in the folder of --keep:
with --again a changed rule of the estimate states all lines anew without a solve, unless the mesh changed, too.
"""

from __future__ import annotations

import argparse
import csv
import pickle
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from forearm_fem.accuracy.discretisation import discretisation_of
from forearm_fem.device import close_loop
from forearm_fem.engines.fem import Solved, second_compliance, second_mesh, solve
from forearm_fem.engines.layered import solve_layered
from forearm_fem.engines.simulation import with_device
from forearm_fem.geometry.build import build_mesh
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.transfer import Compliance, band_error, relative_error

STACKS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "thin": (("skin", 1.2e-3), ("fat", 3e-3)),
    "thick": (("skin", 1.8e-3), ("fat", 8e-3)),
    "bare": (("skin", 2.5e-3),),
}
DIAMETERS = 2, 3, 4, 7, 15  # mm
CONTACTS, DRIVES = ("bonded", "frictionless"), ("voltage", "displacement")
ACCURACIES = 0.3, 0.1, 0.05, 0.025
BINS = np.round(np.geomspace(150, 500, 12), 1).tolist()  # [Hz] below 150 Hz waves reach the sides of a slab this wide
POINTS = (0.010, 0.0), (0.014, 0.004), (0.020, 0.0), (0.0318, 0.0)  # [m]


@dataclass(frozen=True)
class Line:
    """Errors of one scene with one drive: band, share of bins stated below half the truth, and under the cone."""

    stack: str
    diameter_mm: float
    contact: str
    accuracy: float
    drive: str
    element: str
    unknowns: int
    ratio: float
    true_band: float
    stated_band: float
    true_worst: float
    stated_below_half: float
    least_single: float
    receptance: float
    seconds: float

    @property
    def effectivity(self) -> float:
        """Stated over true band error."""
        return self.stated_band / self.true_band


def scene(
    stack: str, diameter: float, contact: str, accuracy: float, mesh: Mapping[str, Any] | None = None
) -> Scenario:
    """A quarter slab with one cone in its middle."""
    layers = [{"tissue": t, "thickness": h} for t, h in STACKS[stack]]
    limb = {"shape": "slab", "length": 0.16, "width": 0.16, "depth": 0.06, "symmetry": ["x", "y"], "layers": layers}
    return parse_scenario(
        {
            "accuracy": accuracy,
            "limb": limb,
            "device": {"contacts": [[0.0, 0.0]], "cone": {"contact": contact, "radius": diameter * 5e-4}},
            "grid": {"points": [list(p) for p in POINTS]},
            "sweep": {"frequencies": BINS},
            "mesh": dict(mesh or {}),
        }
    )


@dataclass(frozen=True)
class Kept:
    """What a scene cost its time for: compliances on both meshes, the layered model's, and seconds."""

    digest: str
    solved: Solved
    coarse: Compliance
    exact: Compliance
    seconds: float


def solution(scenario: Scenario, first: TissueMesh, file: Path | None) -> Kept:
    """Solutions on the ``first`` mesh and the second one, from ``file`` where it holds those of that mesh."""
    kept = pickle.loads(file.read_bytes()) if file and file.is_file() else None
    if kept is not None and kept.digest == first.digest:
        return kept
    start, frequency = time.perf_counter(), frequencies(scenario.sweep)
    solved = solve(scenario, first, frequency, base=Path("."))
    light = replace(solved, modes=solved.modes[:0], states=solved.states[:0], skin=None)
    coarse = second_compliance(second_mesh(scenario, first, base=Path(".")), frequency)
    exact = solved.exact or solve_layered(scenario, frequency)
    kept = Kept(first.digest, light, coarse, exact, round(time.perf_counter() - start, 1))
    if file:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pickle.dumps(kept))
    return kept


def lines(stack: str, diameter: float, contact: str, accuracy: float, keep: Path | None = None) -> Iterator[Line]:
    """One scene, solved once or not at all, with either drive."""
    scenario = scene(stack, diameter, contact, accuracy)
    first = build_mesh(scenario)
    kept = solution(scenario, first, keep and keep / f"{stack}-{diameter:g}-{contact}-{accuracy:g}.pickle")
    solved, exact = kept.solved, kept.exact
    under = np.abs(solved.compliance.values[:, 0, 0] / exact.values[:, 0, 0] - 1)
    facts = solved.facts
    for drive in DRIVES:
        own = scenario.model_copy(update={"device": scenario.device.model_copy(update={"drive": drive})})
        found, truth = with_device(own, first, solved).transfer, close_loop(exact, own.device)
        stated = discretisation_of(found, close_loop(kept.coarse, own.device), own)
        error, single = relative_error(found.values, truth.values), np.array(stated.per_frequency)
        yield Line(
            stack, diameter, contact, accuracy, drive, scenario.element,
            facts.displacement_unknowns + facts.pressure_unknowns,
            float(kept.coarse.provenance["ratio"]), band_error(found.values, truth.values), stated.band,
            float(error.max()),
            float(np.mean(single < error / 2)), float(np.min(single / error)), float(under.max()), kept.seconds,
        )  # fmt: skip


def read(file: Path) -> list[Line]:
    """Lines of an earlier run."""
    if not file.exists():
        return []
    kinds = {"stack": str, "contact": str, "drive": str, "element": str, "unknowns": int}
    with file.open(newline="") as stream:
        return [
            Line(**{f.name: kinds.get(f.name, float)(row[f.name]) for f in fields(Line)})
            for row in csv.DictReader(stream)
        ]


def write(found: Sequence[Line], folder: Path) -> None:
    """cones.csv and cones.md."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "cones.csv").open("w", newline="") as stream:
        table = csv.DictWriter(stream, [f.name for f in fields(Line)])
        table.writeheader()
        table.writerows(asdict(line) for line in found)
    (folder / "cones.md").write_text(table_of(found), encoding="utf-8")


def table_of(found: Sequence[Line]) -> str:
    """A line a scene and drive, and what all of them come to."""
    asked = sorted({x.accuracy for x in found}, reverse=True)
    lead = (
        "Effectivity is stated over true e_band; receptance is that under the cone.\n\n"
        "| accuracy | lines | effectivity, least | median | largest | above 5 | bins below half | worst receptance |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- |\n"
        + "\n".join(_summary(a, [x for x in found if x.accuracy == a]) for a in asked)
        + "\n\n"
    )
    head = ["stack", "cone mm", "contact", "asked", "drive", "element", "unknowns", "true e_band", "stated"]
    head += ["effectivity", "bins below half", "least e(f) ratio", "receptance"]
    rows = [
        f"| {x.stack} | {x.diameter_mm:g} | {x.contact} | {x.accuracy:g} | {x.drive} | {x.element} | {x.unknowns} | "
        f"{x.true_band:.4f} | {x.stated_band:.4f} | {x.effectivity:.2f} | {100 * x.stated_below_half:.0f} % | "
        f"{x.least_single:.2f} | {100 * x.receptance:.2f} % |"
        for x in found
    ]
    return lead + "\n".join(["| " + " | ".join(head) + " |", "| --- " * len(head) + "|", *rows]) + "\n"


def _summary(accuracy: float, found: Sequence[Line]) -> str:
    values = [x.effectivity for x in found]
    below, worst = np.mean([x.stated_below_half for x in found]), max(x.receptance for x in found)
    return (
        f"| {accuracy:g} | {len(found)} | {min(values):.2f} | {np.median(values):.2f} | {max(values):.1f} | "
        f"{sum(v > 5 for v in values)} | {100 * below:.1f} % | {100 * worst:.2g} % |"
    )


def main() -> None:
    """Solve what was asked for and is not in the table yet, and write it."""
    ask = argparse.ArgumentParser(description=__doc__)
    ask.add_argument("folder", nargs="?", type=Path, default=Path("benchmarks/results"))
    ask.add_argument("--accuracy", nargs="*", type=float, default=ACCURACIES)
    ask.add_argument("--diameter", nargs="*", type=float, default=DIAMETERS)
    ask.add_argument("--stack", nargs="*", default=list(STACKS))
    ask.add_argument("--contact", nargs="*", default=CONTACTS)
    ask.add_argument("--keep", type=Path)
    ask.add_argument("--again", action="store_true", help="state the lines that are there anew")
    asked = ask.parse_args()
    found = [] if asked.again else read(asked.folder / "cones.csv")
    done = {(x.stack, x.diameter_mm, x.contact, x.accuracy) for x in found}
    for accuracy, diameter, contact, stack in product(asked.accuracy, asked.diameter, asked.contact, asked.stack):
        if (stack, diameter, contact, accuracy) not in done:
            found += lines(stack, diameter, contact, accuracy, asked.keep)
            write(found, asked.folder)
            print("\n".join(map(str, found[-2:])), flush=True)


if __name__ == "__main__":
    main()
