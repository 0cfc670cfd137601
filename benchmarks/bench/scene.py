"""The scenes that are timed: a quarter of a layered slab with an exact solution, and the thesis' device on a slab."""

from __future__ import annotations

from typing import Any

import numpy as np

from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.typing import ComplexArray, FloatArray
from forearm_fem.verification.scenes import layered_truth, quarter_slab

RADII = (0.0, 0.010, 0.020)  # m; the points read, and the mean under the disc
BAND = np.arange(80.0, 401.0, 2.0)  # Hz: below, the cut ends of a slab this small are seen
SIZES = {"size_contact": 1.4e-3, "size_grid": 2.0e-3, "size_far": 12e-3}
LAYERS = (("skin", 1.2e-3), ("fat", 3.0e-3))


def quarter(element: str = "P2") -> Scenario:
    """One 7 mm disc of uniform pressure on skin, fat and muscle (preset O), a quarter of 160 x 160 x 80 mm."""
    return quarter_slab(
        RADII, side=0.16, depth=0.08, layers=LAYERS, preset="default", mesh={**SIZES, "element": element},
        frequencies=tuple(BAND.tolist()),
    )  # fmt: skip


def knob(accuracy: float) -> Scenario:
    """:func:`quarter` with mesh sizes that follow from ``accuracy`` alone."""
    scenario = quarter("auto")
    free = scenario.mesh.model_copy(update=dict.fromkeys(SIZES))
    return scenario.model_copy(update={"accuracy": accuracy, "mesh": free})


def exact(frequency: FloatArray) -> ComplexArray:
    """Compliances of :func:`quarter` on an endless half-space (n, 4, 1) [m/N], Hankel quadrature to 1e-8."""
    return np.asarray(layered_truth(quarter(), tuple(frequency.tolist()))[:, :, None])


def device(scale: float = 1.0) -> Scenario:
    """Four discs and nine points (13 ports) on a 90 x 90 x 20 mm slab, 981 bins of 10-500 Hz."""
    sizes = {"size_contact": 4.5e-3 * scale, "size_grid": 7e-3 * scale, "size_far": 12e-3 * scale}
    data: dict[str, Any] = {
        "limb": {"shape": "slab", "length": 0.09, "width": 0.09, "depth": 0.02},
        "mesh": {**sizes, "sublayers": {"skin": 1, "fat": 1}},
        "device": {"cone": {"contact": "pressure"}},
    }
    return parse_scenario(data)


def options(precision: str = "double") -> ReducedSolve:
    """Solver options of a method."""
    return ReducedSolve.model_validate({"precision": precision})
