"""Arms that a prediction's reduced model has not seen against full solves, tape, fascia and layers drawn.

    python benchmarks/unseen_arms.py [SCENARIO] [--first 0] [--count 10] [--hold tape]

Of `benchmarks/arms.toml` where no scenario is given, taped as `forearm-fem validate` does it. The model is the one that
`validate` makes, from the cache if it is there; arms are of another seed. Each is solved on the mesh stretched for it
at four frequencies; place and contact area stay, as they need other meshes. Prints e_band, true and as stated, and the
same at each frequency.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from forearm_fem.engines.fem import fem_model
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.geometry.limb.thickness import stretched
from forearm_fem.questions.predict.arm import arm_model
from forearm_fem.questions.predict.draws import draw_inputs, expanded, load_priors, scenario_of, taped
from forearm_fem.questions.predict.run import Question, pool
from forearm_fem.scenario import load_scenario
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.transfer import band_error, relative_error

SEED = 2026
PROBES = 4


def main() -> None:
    """Make, answer, solve, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", type=Path, default=Path("benchmarks/arms.toml"))
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--hold", action="append", default=[])
    asked = parser.parse_args()
    scene = taped(load_scenario(asked.scenario, overrides=["measurement.repeats=1"]), asked.hold)
    question = Question(scene, asked.scenario.parent, held=tuple(asked.hold))
    arm = arm_model(scene, base=question.base, draws=pool(question), progress=lambda *said: print(*said, flush=True))
    mesh, held = cached_mesh(scene, base=question.base), expanded((*asked.hold, "placement", "contact"), scene)
    every = frequencies(scene.sweep)
    some = np.unique((np.linspace(0, 1, PROBES + 1)[1:] ** 1.5 * (len(every) - 1)).astype(int))
    print("law, layers [mm], true e_band, stated; e(f) true, stated; processor's seconds of answer, solve")
    for number in range(asked.first, asked.first + asked.count):
        draw = scenario_of(draw_inputs(load_priors(), scene, SEED, number), scene, held)
        start = time.process_time()
        found = arm.compliance(draw, every)
        answered = time.process_time()
        own = fem_model(draw, stretched(mesh, scene.limb, draw.limb))
        values = direct_sweep(own, every[some], draw.solver).values
        block = np.ix_(range(len(some)), found.indices("point"), found.indices("contact"))
        mine, true, said = found.values[some][block], values[block], found.errors[0]
        at = np.interp(every[some], said.frequency, said.per_frequency)
        print(
            draw.tissues.override["skin"].law,
            [round(1e3 * part.thickness, 2) for part in getattr(draw.limb, "layers", ())],
            f"{band_error(mine, true):.3f} {said.band:.3f};", relative_error(mine, true).round(3), at.round(3),
            f"{answered - start:.2f} {time.process_time() - answered:.1f}", flush=True,
        )  # fmt: skip


if __name__ == "__main__":
    main()
