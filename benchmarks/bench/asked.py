"""The master knob: mesh sizes follow from ``accuracy`` alone; what the answer's error then is, and what it cost."""

from __future__ import annotations

from dataclasses import dataclass
from time import process_time

from forearm_fem.accuracy.discretisation import COARSER, estimated_errors, order_of
from forearm_fem.engines.forecast import Ledger
from forearm_fem.fem.assembly.model import ForearmModel
from forearm_fem.fem.reduction.sweep import reduced_sweep
from forearm_fem.geometry.device.sizing import element_sizes
from forearm_fem.transfer import band_error, relative_error
from forearm_fem.typing import ComplexArray
from forearm_fem.verification.scenes import slab_model

from .scene import BAND, knob, options
from .scene import exact as exact_solution

ACCURACIES = (0.1, 0.01)
MORE = (0.3, 0.03, 0.003, 0.001)  # the last: 273 045 unknowns, 9.3 GB, 20 minutes
_POINTS = 2  # outputs from here on are 10 and 20 mm away


@dataclass(frozen=True)
class Asked:
    """From scenario to G at all bins; e_band of all outputs and of the points beside the contact, true and estimated.

    ``seconds`` of wall time, ``seconds_cpu`` of processors, ``seconds_estimate`` (of processors) for the coarser mesh
    that the estimate needs.
    """

    accuracy: float
    size: float
    unknowns: int
    seconds: float
    seconds_cpu: float
    seconds_estimate: float
    peak_bytes: float
    estimated_band: float
    error_band: float
    error_points: float
    error_worst: float
    runs: int = 1


def asked(accuracy: float) -> Asked:
    """Mesh, solve and compare with the exact solution; raises SolverError where memory would not do."""
    scenario, ledger, start = knob(accuracy), Ledger(), process_time()
    with ledger.stage("all"):
        model = slab_model(scenario)
        values = _swept(model, scenario.reduction_tolerance)
    spent = process_time() - start
    coarse = _swept(slab_model(scenario, scale=COARSER), None)
    more = process_time() - start - spent
    truth, stage = exact_solution(BAND), ledger.stages["all"]
    stated = estimated_errors(coarse, values, BAND, COARSER, order_of(scenario)).band
    return Asked(
        accuracy, element_sizes(scenario).grid, model.operator.n, stage.seconds, spent, more,
        stage.peak_memory_bytes, stated, band_error(values, truth),
        band_error(values[:, _POINTS:], truth[:, _POINTS:]), float(relative_error(values, truth).max()),
    )  # fmt: skip


def _swept(model: ForearmModel, tolerance: float | None) -> ComplexArray:
    return reduced_sweep(model, BAND, options("auto"), tolerance=tolerance).values[:, :, :1]
