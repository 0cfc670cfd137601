"""The parametric model against full solves of draws that it has not seen.

    python benchmarks/parametric.py [SCENARIO] [--draws 20] [--pool 200] [--solves N] [--checks N] [--out FOLDER]

Makes the model from a pool of arms as `forearm-fem predict` draws them (its seconds beside those of one sweep of the
same scene), answers draws of another seed at all bins, and solves each directly at eight of them. Writes
``parametric.csv``: per draw its law, true and stated e_band and largest e(f), and the processor's seconds of one answer
and of the 27 S on it. Without a scenario a small slab with the thesis' device is taken.
"""

from __future__ import annotations

import argparse
import csv
import resource
import time
from pathlib import Path

import numpy as np

from forearm_fem.device import close_loop
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.fem.reduction.united import Growth
from forearm_fem.geometry.cache import cached_mesh
from forearm_fem.pipeline.fem_engine import fem_model, solve_fem
from forearm_fem.pipeline.frequencies import frequencies
from forearm_fem.pipeline.parametric import ParametricModel, parametric_model
from forearm_fem.pipeline.simulation import render_transfer
from forearm_fem.prediction.draws import draw_inputs, scenario_of
from forearm_fem.prediction.priors import load_priors
from forearm_fem.prediction.run import expanded
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario
from forearm_fem.transfer import band_error, relative_error

SLAB = {
    "name": "parametric",
    "limb": {
        "shape": "slab", "length": 0.08, "width": 0.08, "depth": 0.02,
        "layers": [{"tissue": "skin", "thickness": 1.2e-3}, {"tissue": "fat", "thickness": 3e-3}],
    },
    "device": {"cone": {"contact": "pressure"}},
    "mesh": {"size_contact": 4e-3, "size_grid": 7e-3, "size_far": 12e-3, "sublayers": {"skin": 1, "fat": 1}},
}  # fmt: skip
PROBES = 8


def main() -> None:
    """Make, answer, compare, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?")
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--pool", type=int, default=200)
    parser.add_argument("--solves", type=int, default=Growth().solves)
    parser.add_argument("--checks", type=int, default=Growth().checks)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    asked = parser.parse_args()
    scenario = load_scenario(asked.scenario) if asked.scenario else parse_scenario(SLAB)
    pool, unseen = arms(scenario, asked.pool, 0), arms(scenario, asked.draws, 2026)
    model = made(scenario, pool, Growth(solves=asked.solves, checks=asked.checks))
    rows = [compared(model, d) for d in unseen]
    with (asked.out / "parametric.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    true, stated = (np.array([float(r[k]) for r in rows]) for k in ("true_band", "stated_band"))
    covered = np.mean(stated >= true)
    print(f"true e_band: median {np.median(true):.2g}, worst {true.max():.2g}; stated covers {covered:.0%}")
    print(f"memory at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB")


def arms(scenario: Scenario, count: int, seed: int) -> list[Scenario]:
    """Arms by the priors but for what needs another mesh."""
    held = expanded(("thickness", "placement", "contact"))
    return [scenario_of(draw_inputs(load_priors(), scenario, seed, k), scenario, held) for k in range(count)]


def made(scenario: Scenario, pool: list[Scenario], growth: Growth) -> ParametricModel:
    """The model, its seconds and those of one sweep of the same scene told."""
    mesh, band = cached_mesh(scenario), frequencies(scenario.sweep)
    start = time.process_time()
    unknowns = solve_fem(scenario, mesh, band).model.operator.n
    middle = time.process_time()
    model = parametric_model(scenario, draws=pool, growth=growth, progress=lambda *said: print(*said, flush=True))
    end = time.process_time()
    print(f"{unknowns} unknowns; sweep {middle - start:.1f} s, parametric model {end - middle:.1f} s")
    for piece in model.pieces:
        print(f"to {piece.high:g} Hz {piece.whole.size} directions, {piece.core.size} in the core")
    print(f"{model.solves} factorisations; factor {model.factor:.2g}")
    for trial in (*model.trials, *model.checks):
        print(trial)
    return model


def compared(model: ParametricModel, draw: Scenario) -> dict[str, str]:
    """One draw: truth, answer, statement and seconds."""
    start = time.process_time()
    answer = model.compliance(draw, frequencies(draw.sweep))
    solved = time.process_time()
    render_transfer(draw, close_loop(answer, draw.device))
    end = time.process_time()
    some = np.unique((np.linspace(0, 1, PROBES) ** 1.5 * (len(answer.frequency) - 1)).astype(int))
    whole = fem_model(draw, cached_mesh(draw))
    rows, columns = answer.indices("point"), answer.indices("contact")
    block = np.ix_(range(len(some)), rows, columns)
    truth = direct_sweep(whole, answer.frequency[some], draw.solver).values[block]
    found = answer.values[some][block]
    row = {
        "law": draw.tissues.override["skin"].model or "",
        "tension": f"{draw.tissues.membrane.tension:.0f}",
        "true_band": f"{band_error(found, truth):.2e}",
        "stated_band": f"{answer.errors[0].band:.2e}",
        "true_worst": f"{relative_error(found, truth).max():.2e}",
        "stated_worst": f"{answer.errors[0].worst:.2e}",
        "seconds_compliance": f"{solved - start:.2f}",
        "seconds_g_and_s": f"{end - solved:.2f}",
    }
    print(row, flush=True)
    return row


if __name__ == "__main__":
    main()
