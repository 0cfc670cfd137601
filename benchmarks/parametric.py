"""The parametric model against full solves of draws that it has not seen.

    python benchmarks/parametric.py [SCENARIO] [--draws 20] [--pool 200] [--solves N] [--checks N] [--second]
        [--truths FOLDER] [--out FOLDER]

Makes the model from a pool of arms as `forearm-fem predict` draws them, answers draws of another seed at all bins, and
solves each directly at eight of them; ``--truths`` keeps these solutions for another time. Writes ``parametric.csv``:
per draw its law, true and stated e_band and largest e(f), and the processor's seconds of one answer and of the 27 S on
it; and ``parametric-making.csv``: the processor's seconds of the model beside those of one sweep of the scene, with
``--second`` those of the model on the scene's second mesh, too. Without a scenario a small slab with the thesis' device
is taken.
"""

from __future__ import annotations

import argparse
import csv
import resource
import time
from pathlib import Path

import numpy as np

from forearm_fem.device import close_loop
from forearm_fem.engines.fem import fem_model, second_mesh, solve_fem
from forearm_fem.engines.parametric import ParametricModel, parametric_model
from forearm_fem.engines.simulation import render_transfer
from forearm_fem.fem.reduction.parametric_greedy import Growth
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh
from forearm_fem.questions.predict.draws import draw_inputs, expanded, load_priors, scenario_of
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.transfer import band_error, relative_error
from forearm_fem.typing import ComplexArray, FloatArray

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
    parser.add_argument("--second", action="store_true")
    parser.add_argument("--truths", type=Path)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    asked = parser.parse_args()
    scenario = load_scenario(asked.scenario) if asked.scenario else parse_scenario(SLAB)
    pool, unseen = arms(scenario, asked.pool, 0), arms(scenario, asked.draws, 2026)
    growth = Growth(solves=asked.solves, checks=asked.checks)
    model, making = made(scenario, pool, growth, second=asked.second)
    rows = [compared(model, d, asked.truths and asked.truths / f"{scenario.name}-{k}.npz")
            for k, d in enumerate(unseen)]  # fmt: skip
    making["peak_gb"] = f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f}"
    for name, found in (("parametric.csv", rows), ("parametric-making.csv", [making])):
        with (asked.out / name).open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, found[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(found)
    true, stated = (np.array([float(r[k]) for r in rows]) for k in ("true_band", "stated_band"))
    covered = np.mean(stated >= true)
    print(f"true e_band: median {np.median(true):.2g}, worst {true.max():.2g}; stated covers {covered:.0%}")
    print(making)


def arms(scenario: Scenario, count: int, seed: int) -> list[Scenario]:
    """Arms by the priors but for what needs another mesh."""
    held = expanded(("thickness", "placement", "contact"), scenario)
    return [scenario_of(draw_inputs(load_priors(), scenario, seed, k), scenario, held) for k in range(count)]


def made(
    scenario: Scenario, pool: list[Scenario], growth: Growth, *, second: bool
) -> tuple[ParametricModel, dict[str, str]]:
    """The model, and what making it took beside one sweep of the same scene."""
    mesh, band = cached_mesh(scenario), frequencies(scenario.sweep)
    other = second_mesh(scenario, mesh, base=Path()) if second else None
    start = time.process_time()
    unknowns = solve_fem(scenario, mesh, band).model.operator.n
    sweep = time.process_time() - start
    model, first = timed(scenario, pool, growth, mesh)
    coarser = timed(other.scenario, pool, growth, other.mesh)[1] if other else float("nan")
    for trial in (*model.trials, *model.checks):
        print(trial)
    return model, {
        "scenario": scenario.name, "unknowns": str(unknowns), "sweep_s": f"{sweep:.1f}", "model_s": f"{first:.1f}",
        "over_sweep": f"{first / sweep:.1f}", "second_mesh_s": f"{coarser:.1f}", "factorisations": str(model.solves),
        "factor": f"{model.factor:.2g}", "directions": " ".join(str(p.whole.size) for p in model.pieces),
    }  # fmt: skip


def timed(
    scenario: Scenario, pool: list[Scenario], growth: Growth, mesh: TissueMesh
) -> tuple[ParametricModel, float]:
    """A model and the processor's seconds that it took."""
    start = time.process_time()
    model = parametric_model(
        scenario, draws=pool, growth=growth, mesh=mesh, progress=lambda *said: print(*said, flush=True)
    )
    return model, time.process_time() - start


def compared(model: ParametricModel, draw: Scenario, kept: Path | None) -> dict[str, str]:
    """One draw: truth, which may be ``kept`` in a file, answer, statement and seconds."""
    start = time.process_time()
    answer = model.compliance(draw, frequencies(draw.sweep))
    solved = time.process_time()
    render_transfer(draw, close_loop(answer, draw.device))
    end = time.process_time()
    some = np.unique((np.linspace(0, 1, PROBES) ** 1.5 * (len(answer.frequency) - 1)).astype(int))
    rows, columns = answer.indices("point"), answer.indices("contact")
    block = np.ix_(range(len(some)), rows, columns)
    truth = truth_of(draw, answer.frequency[some], kept)[block]
    found = answer.values[some][block]
    row = {
        "law": draw.tissues.override["skin"].law or "",
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


def truth_of(draw: Scenario, frequency: FloatArray, kept: Path | None) -> ComplexArray:
    """Compliance (n, n_port, n_port) by direct solves at ``frequency`` (n,) [Hz], from the ``kept`` file if it is."""
    if kept and kept.is_file():
        known = np.load(kept)
        assert np.allclose(known["frequency"], frequency), f"{kept} has other frequencies; remove it"
        return np.asarray(known["values"])
    values = direct_sweep(fem_model(draw, cached_mesh(draw)), frequency, draw.solver).values
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
        np.savez(kept, frequency=frequency, values=values)
    return np.asarray(values)


if __name__ == "__main__":
    main()
