"""What fibres along the limb do to S: shear stiffer along x than across, on two slabs.

    python3 benchmarks/anisotropy.py [default|lean]

Muscle has 5.8 and 1.9 kPa along and across (PMC8754054), skin 24.9 and 13.6 (ultrasound of 40 MHz, five people); here
the ratios count, about the isotropic modulus as geometric mean.
"""

from __future__ import annotations

import sys

from forearm_fem.device import close_loop
from forearm_fem.engines.fem import solve_fem
from forearm_fem.geometry.build import build_mesh
from forearm_fem.metrics.strength import signal_strength_table
from forearm_fem.rendering.job import RenderJob
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.transfer import finite
from forearm_fem.typing import FloatArray

RATIOS = {"muscle": 5.8 / 1.9, "skin": 24.9 / 13.6}
SCENE = {
    "limb": {"shape": "slab", "length": 0.13, "width": 0.11, "depth": 0.03},
    "device": {"cone": {"contact": "pressure"}},
    "sweep": {"duration": 0.06},
    "mesh": {"element": "P2", "size_grid": 3.5e-3, "size_contact": 2.3e-3, "size_far": 1e-2},
    "rendering": {"window": [-0.03, 0.02]},
}
LEAN = {
    "limb": {
        **SCENE["limb"], "length": 0.11, "width": 0.1, "depth": 0.025,
        "layers": [{"tissue": "skin", "thickness": 1.5e-3}, {"tissue": "fat", "thickness": 1e-3}],
    },
    "mesh": {"element": "P2", "size_grid": 5.5e-3, "size_contact": 3.5e-3, "size_far": 1.4e-2},
}  # fmt: skip
STACKS = {"default": SCENE, "lean": {**SCENE, **LEAN}}  # the same fibres on another arm, and a coarser mesh


def strength(scenario: Scenario) -> FloatArray:
    """S (n_method, n_group)."""
    found = solve_fem(scenario, build_mesh(scenario), frequencies(scenario.sweep), tolerance=1e-3).compliance
    g = finite(close_loop(found, scenario.device))
    job = RenderJob.of(scenario, g)
    return signal_strength_table(job.names, job.targets, job.strengths(g, g)[0, 0]).mean.T


def main() -> None:
    """The table."""
    scenario = parse_scenario(STACKS[(sys.argv[1:] or ["default"])[0]])
    print("| fibres | middle | edges | corners |\n| --- | --- | --- | --- |")
    for name, changes in (("none", {}), *((t, {f"tissues.override.{t}.fibres": r}) for t, r in RATIOS.items())):
        s = strength(scenario.changed(changes))
        print(f"| {name} | {' | '.join(' / '.join(f'{x:.2f}' for x in column) for column in s.T)} |", flush=True)


if __name__ == "__main__":
    main()
