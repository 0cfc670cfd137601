"""What is stated for arms on finite elements against arms that were solved for themselves: errors by pair, and S.

    python benchmarks/arms_of_finite_elements.py [--arms 20] [--kinds placement,thickness,...] [--kept FOLDER]
        [--out FOLDER]

On a cylinder of 54 mm with four actuators and nine points. Arms are drawn as `forearm-fem predict` draws them, of a
seed that the model has not seen; of their geometry only one kind is drawn at a time, or all. Each is solved by itself,
on a mesh of its own where its thickness or contact area is another. Writes ``arms.csv``: per arm and kind e_band with
the scene's geometry held, of the answer, and as stated by each source; which share of pairs and frequencies errs by
less than is stated for it, which of the 27 S lie within their intervals, and how wide these are, by shape and as they
would be with the errors as noise. Truths are kept in the folder ``--kept``.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from forearm_fem.device import close_loop
from forearm_fem.engines.fem import solve_fem
from forearm_fem.engines.layered import Answer
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.geometry.device.place import place_ports
from forearm_fem.questions.predict.arm import ReducedArm, arm_model, with_scene_geometry
from forearm_fem.questions.predict.draws import draw_inputs, expanded, load_priors, scenario_of
from forearm_fem.rendering import strengths
from forearm_fem.rendering.interval import interval
from forearm_fem.rendering.job import RenderJob
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.transfer import Compliance, TransferMatrix, band_error, total_error
from forearm_fem.typing import FloatArray

SCENE = {
    "name": "arms",
    "limb": {
        "shape": "cylinder", "length": 0.07, "diameter": 0.054,
        "layers": [{"tissue": "skin", "thickness": 1.2e-3}, {"tissue": "fat", "thickness": 3e-3}],
    },
    "device": {"spacing": 0.03, "cone": {"contact": "pressure"}},
    "grid": {"pitch": 0.009},
    "mesh": {"size_contact": 4e-3, "size_grid": 7e-3, "size_far": 12e-3, "sublayers": {"skin": 1, "fat": 1}},
    "sweep": {"duration": 0.4},
    "solver": {"discretisation_estimate": False},
}  # fmt: skip
KINDS = {
    "tissue": ("thickness", "placement", "contact"), "placement": ("thickness", "contact"),
    "thickness": ("placement", "contact"), "contact": ("thickness", "placement"), "all": (),
}  # fmt: skip
NEW_MESH = ("thickness", "contact", "all")
SEED = 2026
DRAWS = 6  # of the interval of S, as for an arm of a prediction


def main() -> None:
    """Make, draw, solve, compare, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--kept", type=Path, default=Path("results/arms"))
    asked = parser.parse_args()
    scene, began = parse_scenario(SCENE), time.process_time()
    arm = arm_model(scene, draws=[scene, *(drawn(scene, 0, k, KINDS["thickness"]) for k in range(200))])
    assert isinstance(arm, ReducedArm)
    print(f"made in {time.process_time() - began:.0f} s, factor {arm.model.factor:.2g}", flush=True)
    first = close_loop(arm.compliance(scene, frequencies(scene.sweep)[:1]), scene.device)
    job, rows = RenderJob.of(scene, first), []
    for kind in asked.kinds.split(","):
        for k in range(asked.first, asked.first + asked.arms):
            draw = drawn(scene, SEED, k, KINDS[kind])
            truth = solved(scene, draw, kind, asked.kept / f"{kind}-{k}.npz")
            if truth is not None:
                rows.append({"kind": kind, "arm": str(k), "law": str(draw.tissues.override["skin"].law),
                             **compared(arm, job, draw, truth)})  # fmt: skip
                print(rows[-1], flush=True)
    with (asked.out / "arms.csv").open("w", newline="", encoding="utf-8") as file:
        columns = dict.fromkeys(column for row in rows for column in row)
        writer = csv.DictWriter(file, columns, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def drawn(scene: Scenario, seed: int, number: int, held: tuple[str, ...]) -> Scenario:
    """An arm by the priors, but for what is held."""
    return scenario_of(draw_inputs(load_priors(), scene, seed, number), scene, expanded(held, scene))


def solved(scene: Scenario, draw: Scenario, kind: str, kept: Path) -> Compliance | None:
    """The arm's own compliance, on its own mesh where its geometry asks for one; None where it cannot be meshed."""
    frequency = frequencies(draw.sweep)
    mesh = cached_mesh(draw if kind in NEW_MESH else scene)
    if kept.is_file():
        return Compliance(frequency, np.load(kept)["values"], place_ports(draw, mesh))
    found = solve_fem(draw, mesh, frequency, tolerance=1e-4).compliance
    kept.parent.mkdir(parents=True, exist_ok=True)
    np.savez(kept, values=found.values)
    return found


def compared(arm: ReducedArm, job: RenderJob, draw: Scenario, truth: Compliance) -> Mapping[str, str]:
    """One arm: errors of its compliance and of its S, and what is stated for both."""
    answer = arm.answer(draw, truth.frequency)
    found = answer.compliance
    block, own = found.block("point", "contact"), truth.block("point", "contact")
    held = arm.compliance(with_scene_geometry(arm.scenario, draw), truth.frequency).block("point", "contact")
    g, true = (close_loop(c, draw.device) for c in (found, truth))
    others = [close_loop(c, draw.device) for c in answer.others]
    values, wanted = (
        strengths(x, job.targets, job.methods, job.wavelet, window=job.window) for x in (g, true)
    )
    noise = tuple(e for e in g.errors if e.source not in answer.shown)
    by_shape = spread_of(g, noise, job, others)
    by_noise = spread_of(g, g.errors, job, [])
    off = np.abs(np.log(values / wanted))
    return {
        "held_band": f"{band_error(held, own):.2e}",
        "true_band": f"{band_error(block, own):.2e}",
        **{f"stated_{e.source}": f"{e.band:.2e}" for e in found.errors},
        "g_true_band": f"{band_error(g.values, true.values):.2e}",
        "g_stated_band": f"{total_error(g.errors):.2e}",
        "pairs_within": f"{pairs_within(answer, truth):.3f}",
        "s_within": f"{np.mean(off <= by_shape):.3f}",
        "s_off_rms": f"{np.sqrt(np.mean(off**2)):.3f}",
        "s_half_width": f"{np.median(by_shape):.3f}",
        "s_within_noise": f"{np.mean(off <= by_noise):.3f}",
        "s_half_width_noise": f"{np.median(by_noise):.3f}",
    }


def spread_of(g: TransferMatrix, errors: tuple, job: RenderJob, others: list[TransferMatrix]) -> FloatArray:
    """Half widths of log S."""
    return interval(g, errors, job.targets, job.span, job.methods, job.wavelet, draws=DRAWS, others=others)


def pairs_within(answer: Answer, truth: Compliance) -> float:
    """Share of pairs of points and contacts at all frequencies whose error is within twice the rms of the others."""
    found = answer.compliance
    off = np.abs(found.block("point", "contact") - truth.block("point", "contact"))
    square = [np.abs(o.block("point", "contact") - found.block("point", "contact")) ** 2 for o in answer.others]
    return float(np.mean(off <= 2 * np.sqrt(np.mean(square, axis=0))))


if __name__ == "__main__":
    main()
