"""Coverage of a fit's 95 % intervals: arms of finite elements with noise, fitted on the reduced finite elements.

    python benchmarks/recovery.py [--arms 4] [--seeds 25] [--noise 0.02] [--out benchmarks/results]

Each arm is solved directly (not by the reduced model that fits it) and measured ``seeds`` times with white noise of
``noise`` times the rms of G. Writes ``recovery.csv``: per parameter the share of intervals that hold the truth, their
half width (x/÷), the spread of (fitted - true) over the deviation stated, and its mean, which is the reduction's bias.
"""

from __future__ import annotations

import argparse
import csv
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from forearm_fem.device import close_loop
from forearm_fem.engines.fem import fem_model
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.questions.compare.fit import FitResult, fit
from forearm_fem.questions.compare.parameters import (
    Parameter,
    ScenarioModel,
    common_parameters,
    fem_model_for,
)
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.transfer import Compliance, TransferMatrix

SCENE = {
    "name": "recovery",
    "limb": {
        "shape": "slab", "length": 0.05, "width": 0.04, "depth": 0.012,
        "layers": [{"tissue": "skin", "thickness": 1.2e-3}, {"tissue": "fat", "thickness": 3e-3}],
    },
    "device": {"contacts": [[-0.012, 0.0], [0.012, 0.004]], "cone": {"contact": "pressure"}},
    "grid": {"points": [[0.0, 0.003], [0.002, -0.009]]},
    "mesh": {"size_contact": 4.5e-3, "size_grid": 8e-3, "size_far": 12e-3, "sublayers": {"skin": 1, "fat": 1}},
    "solver": {"discretisation_estimate": False},
    "sweep": {"f_min": 20.0, "f_max": 500.0},
}  # fmt: skip
FITTED = ("skin.mu", "fat.mu", "muscle.mu", "muscle.eta")
BAND = np.array([20.0, 45.0, 70.0, 100.0, 130.0, 170.0, 210.0, 260.0, 320.0, 390.0, 470.0])
REACH = 1.8  # times or divided by: of the true values about the start


def main() -> None:
    """Make, solve, fit, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=4)
    parser.add_argument("--seeds", type=int, default=25)
    parser.add_argument("--noise", type=float, default=0.02)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    asked = parser.parse_args()
    scene = parse_scenario(SCENE)
    chosen = common_parameters(scene, FITTED)
    start = time.process_time()
    answer = ScenarioModel(scene, fem_model_for(scene, chosen), BAND, memory=256)
    print(f"the model took {time.process_time() - start:.0f} s of the processor", flush=True)
    rng, found = np.random.default_rng(0), list[tuple[dict[str, float], FitResult]]()
    for _ in range(asked.arms):
        true = {p.name: p.start * REACH ** float(rng.uniform(-1, 1)) for p in chosen}
        clean = solved(answer.scenario(true))
        sigma = asked.noise * float(np.sqrt(np.mean(np.abs(clean.values) ** 2)))
        for _ in range(asked.seeds):
            found.append((true, fit(answer, measured(clean, sigma, rng), chosen, tolerance=1e-5)))
        print(f"{len(found)} fits, {time.process_time() - start:.0f} s", flush=True)
    rows = [row_of(p, found) for p in chosen]
    with (asked.out / "recovery.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    print(f"reduced chi^2 {np.median([r.chi2 for _, r in found]):.2f} in the median")


def solved(arm: Scenario) -> TransferMatrix:
    """G of an arm by direct solves."""
    whole = fem_model(arm, cached_mesh(arm))
    values = direct_sweep(whole, BAND, arm.solver).values
    return close_loop(Compliance(BAND, values, whole.ports), arm.device)


def measured(clean: TransferMatrix, sigma: float, rng: np.random.Generator) -> TransferMatrix:
    """G with circular white noise of standard deviation ``sigma`` per entry."""
    noise = rng.standard_normal((2, *clean.values.shape)) * sigma / np.sqrt(2)
    known = np.full(clean.values.shape, sigma)
    return replace(clean, values=clean.values + noise[0] + 1j * noise[1], deviation=known, contacts=None, errors=())


def row_of(parameter: Parameter, found: list[tuple[dict[str, float], FitResult]]) -> dict[str, str]:
    """One parameter's coverage, width and z scores, in the fitted coordinate (its logarithm)."""
    name, inside, z, width = parameter.name, [], [], []
    for true, result in found:
        low, high = result.interval[name]
        inside.append(low <= true[name] <= high)
        half = np.log(high / low) / 2
        z.append(np.log(result.values[name] / true[name]) / (half / 1.96))
        width.append(half)
    row = {
        "parameter": name, "fits": str(len(found)), "covered": f"{np.mean(inside):.2f}",
        "half_width": f"{np.exp(np.median(width)):.3f}", "z_spread": f"{np.std(z):.2f}", "z_mean": f"{np.mean(z):.2f}",
    }  # fmt: skip
    print(row, flush=True)
    return row


if __name__ == "__main__":
    main()
