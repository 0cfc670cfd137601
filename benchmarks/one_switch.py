"""What each cause between arm and Table I does to S, one at a time: a table of medians over drawn arms.

    python3 benchmarks/one_switch.py --arms 60

The same arms of the layered model each time. All but the first row change one thing of it: S is taken on the G that a
rig with that fault alone reports, as in Table I. Rows are kept in ``results/one_switch.json`` arm by arm.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from forearm_fem.device import close_loop
from forearm_fem.engines.layered import LayeredArm, flat_ports, without_bones
from forearm_fem.measurement.chain import reported
from forearm_fem.metrics.strength import thesis_table
from forearm_fem.ports import Port
from forearm_fem.questions.predict.draws import draw_inputs, expanded, load_priors, measured_of, scenario_of, taped
from forearm_fem.questions.predict.statistics import group_columns, group_means, joint_distance, log_score
from forearm_fem.rendering.job import RenderJob
from forearm_fem.scenario import Scenario, load_scenario
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.transfer import TransferMatrix, finite
from forearm_fem.typing import FloatArray

KEPT = Path("results/one_switch.json")
RIG = ("vibrometer noise", "arm motion", "entry gain", "entry phase", "laser aim", "device slip", "device slip, turn",
       "laser direction")  # fmt: skip
SWITCHES = {
    "vibrometer noise": ("vibrometer noise",), "motion of the arm": ("arm motion",),
    "gain and phase of each sweep": ("entry gain", "entry phase"),
    "aim and slip": ("laser aim", "device slip", "device slip, turn"), "laser from above": ("laser direction",),
}  # fmt: skip
# What the arm has -> row -> what its rig has
ROWS = {
    (): {"none": (), **SWITCHES}, ("tape",): {"tape": ()},
    ("fascia",): {"fascia": (), "fascia and all of the rig": RIG},
    ("fascia", "tape"): {"fascia, tape and all of the rig": RIG},
}  # fmt: skip


def main() -> None:
    """Draw the arms that are lacking, print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--arms", type=int, default=60)
    count = parser.parse_args().arms
    scenario = load_scenario("thesis", overrides=["engine=layered", "measurement.repeats=1"])
    known = json.loads(KEPT.read_text()) if KEPT.is_file() else {}
    KEPT.parent.mkdir(exist_ok=True)
    for number in range(count):
        if str(number) not in known:
            known[str(number)] = {row: s.tolist() for row, s in rows_of(scenario, number).items()}
            KEPT.write_text(json.dumps(known))
    print(table([known[str(n)] for n in range(count)]))


def rows_of(scenario: Scenario, number: int) -> dict[str, FloatArray]:
    """S (n_method, n_target) of one arm by row of the table."""
    model, f = LayeredArm(), frequencies(scenario.sweep)
    draw = draw_inputs(load_priors(), scenario, 0, number)
    draw = replace(draw, values={**draw.values, "laser direction": 1.0})
    out: dict[str, FloatArray] = {}
    for parts, rows in ROWS.items():
        scene = taped(scenario, ()) if "tape" in parts else scenario
        arm = without_bones(scenario_of(draw, scene, () if "fascia" in parts else expanded(("fascia",), scenario)))
        seen = {row: measured_of(draw, arm, set(RIG) - set(kept)) for row, kept in rows.items()}
        own = flat_ports(arm)
        contacts = tuple(p for p in own if p.kind == "contact")
        places = {s.grid: tuple(p for p in flat_ports(without_bones(s)) if p.kind == "point") for s in seen.values()}
        at, every = list[Port](contacts), dict[Any, list[int]]()
        for grid, points in places.items():
            every[grid] = [*range(len(contacts)), *range(len(at), len(at) + len(points))]
            at += points
        found = model._between(arm, tuple(at), f)
        job = None
        for row, of in seen.items():
            keep = every[of.grid]
            part = replace(found, values=found.values[:, keep][:, :, keep], ports=tuple(at[i] for i in keep))
            true = finite(close_loop(part, of.device))
            job = job or RenderJob.of(scenario, close_loop(model.compliance(scenario, f[:1]), scenario.device))
            g: TransferMatrix = reported(job.on_nominal_ports(true), of, draw.generator("rig"))
            out[row] = job.strengths(g, g)[0, 0]
            if row == "none":
                wide = scenario.changed({"rendering.funneling_distance": "diagonal"})
                out["D of eq. 6: the diagonal"] = RenderJob.of(wide, g).strengths(g, g)[0, 0]
    return out


def table(arms: list[dict[str, Any]]) -> str:
    """Markdown: medians of the nine entries, how many hold the thesis', joint distance, log score."""
    theirs, targets = thesis_table(), tuple(str(k) for k in range(1, 10))
    groups = group_columns(targets)
    point = theirs.mean.T
    lines = ["| changed | middle | edges | corners | inside of 9 | joint | log score |", "|" + " --- |" * 7,
             _row("the thesis", point, ["", "", ""])]  # fmt: skip
    for row in arms[0]:
        means = group_means(np.array([arm[row] for arm in arms]), groups)
        low, high = np.quantile(means, [0.05, 0.95], axis=0)
        flat, at = means.reshape(len(means), -1), point.ravel()
        inside = int(((low <= point) & (point <= high)).sum())
        judged = [str(inside), f"{joint_distance(flat, at)[0]:.1f}", f"{log_score(flat, at):.1f}"]
        lines.append(_row(row, np.median(means, axis=0), judged))
    return "\n".join(lines)


def _row(name: str, values: FloatArray, judged: list[str]) -> str:
    cells = [" / ".join(f"{x:.2f}" for x in column) for column in values.T]
    return f"| {' | '.join([name, *cells, *judged])} |"


if __name__ == "__main__":
    main()
