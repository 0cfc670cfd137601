"""The whole reduced sweep beside direct solves and double-precision factorisations of the same system, in one process.

    python3 benchmarks/ratio.py scenarios/thesis.toml

Machines vary while they work, so direct bins and factorisations are timed before and after the sweep. Writes
benchmarks/results/ratio.csv and prints the sweep's seconds in each. Assembly, which both kinds of sweep need, and the
coarser mesh of the error estimate are left out of all three.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np

from forearm_fem.engines.fem import fem_model
from forearm_fem.fem.assembly.model import ForearmModel
from forearm_fem.fem.kernels.compiled import freed_memory_kept
from forearm_fem.fem.linear.direct import make_solver
from forearm_fem.fem.reduction.sweep import reduced_sweep
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.scenario import Scenario, load_scenario
from forearm_fem.scenario.sweep import frequencies
from thesis import factorisation_seconds

BINS = (25.0, 60.0, 150.0, 240.0, 420.0)


def direct_seconds(model: ForearmModel, scenario: Scenario) -> list[float]:
    """Wall time of each of few direct frequencies, the analysis left out."""
    solver = make_solver(model, scenario.solver, BINS[-1])
    seconds = []
    for f in BINS:
        start = time.perf_counter()
        solver.compliance(solver.at(f))
        seconds.append(time.perf_counter() - start)
    solver.factor.release()
    return seconds


def sweep_seconds(model: ForearmModel, scenario: Scenario) -> tuple[float, float, int]:
    """Wall time of the whole sweep, the error it states, and how often it factorised."""
    start = time.perf_counter()
    band = frequencies(scenario.sweep)
    result = reduced_sweep(model, band, scenario.solver, tolerance=scenario.reduction_tolerance)
    return time.perf_counter() - start, result.reduction_error, result.factorisations


def measure(scenario: Scenario, base: Path) -> dict[str, float]:
    """Medians of what was timed before and after the sweep."""
    model = fem_model(scenario, cached_mesh(scenario, base=base))
    single, double = direct_seconds(model, scenario), [factorisation_seconds(model, 300.0)]
    sweep, stated, count = sweep_seconds(model, scenario)
    single, double = single + direct_seconds(model, scenario), [*double, factorisation_seconds(model, 150.0)]
    return {
        "unknowns": model.operator.n,
        "bins": len(frequencies(scenario.sweep)),
        "sweep_seconds": sweep,
        "factorisations": count,
        "stated_error": stated,
        "direct_bin_seconds": float(np.median(single)),
        "double_factorisation_seconds": float(np.median(double)),
    }


def main() -> None:
    """Measure, keep, and say what came out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", type=Path)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "ratio.csv")
    asked = parser.parse_args()
    with freed_memory_kept():
        row = measure(load_scenario(asked.scenario), asked.scenario.parent)
    with asked.out.open("w", newline="") as stream:
        table = csv.DictWriter(stream, row, lineterminator="\n")
        table.writeheader()
        table.writerow({k: f"{v:.6g}" for k, v in row.items()})
    print(row)
    print(f"{row['sweep_seconds'] / row['double_factorisation_seconds']:.1f} double-precision factorisations")
    for what, one in (("refined single", row["direct_bin_seconds"]), ("double", row["double_factorisation_seconds"])):
        print(f"{row['bins'] * one / row['sweep_seconds']:.0f} times faster than direct solves in {what} precision")


if __name__ == "__main__":
    main()
