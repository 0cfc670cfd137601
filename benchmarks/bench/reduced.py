"""The reduced sweep against direct solves at frequencies it did not use: error, and how much faster."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from forearm_fem.engines.fem import fem_model
from forearm_fem.fem.assembly.model import ForearmModel
from forearm_fem.fem.linear.direct import DirectSolver, make_solver
from forearm_fem.fem.reduction.sweep import SweepResult, reduced_sweep
from forearm_fem.geometry.build import build_mesh
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.transfer import relative_error
from forearm_fem.typing import ComplexArray, FloatArray

from .isolated import clock
from .scene import device, options

TIMED = 10
HELD_OUT = 40
MANY = 20_000


@dataclass(frozen=True)
class Reduced:
    """``seconds_...`` of one factorisation, one direct frequency (with 13 solves), the whole reduced sweep, the
    direct sweep (from ten solves), and 20,000 evaluations; e(f) at ``held_out`` frequencies not used."""

    unknowns: int
    ports: int
    bins: int
    factorisations: int
    reduced_size: int
    seconds_factorisation: float
    seconds_direct_frequency: float
    seconds_reduced_sweep: float
    seconds_direct_sweep: float
    seconds_many_evaluations: float
    held_out: int
    error_worst: float
    error_median: float
    solver: str = ""
    runs: int = 1

    @property
    def speed_ratio(self) -> float:
        """How many times faster than a direct solve per bin."""
        return self.seconds_direct_sweep / self.seconds_reduced_sweep

    @property
    def in_factorisations(self) -> float:
        """Wall time of the whole reduced sweep in factorisations."""
        return self.seconds_reduced_sweep / self.seconds_factorisation


def reduced(case: tuple[float, int]) -> Reduced:
    """Time and check the thesis' 981-bin sweep; ``case`` is (scale of the sizes, held-out solves)."""
    scale, held_out = case
    scenario = device(scale)
    bins = frequencies(scenario.sweep)
    model = fem_model(scenario, build_mesh(scenario, base=Path(".")))
    start = clock()
    sweep = reduced_sweep(model, bins, options("auto"))
    whole = clock() - start
    probes = held_out_bins(bins, sweep, held_out)
    solver = make_solver(model, options(), float(probes[0]))
    truth, seconds, factorisation = _direct(solver, probes)
    error = relative_error(_watched(model, sweep.values[np.searchsorted(bins, probes)]), _watched(model, truth))
    return Reduced(
        model.operator.n, len(model.ports), len(bins), sweep.factorisations,
        sweep.reduced.size if sweep.reduced else 0,
        factorisation, seconds, whole, seconds * len(bins), _many(sweep), len(probes), float(error.max()),
        float(np.median(error)), sweep.solver,
    )  # fmt: skip


def held_out_bins(bins: FloatArray, sweep: SweepResult, count: int) -> FloatArray:
    """``count`` bins spread over the band that neither expansion nor certificate used."""
    used = {*sweep.expansions, *(c.frequency for c in sweep.certificates)}
    free = np.array([f for f in bins if f not in used])
    return np.asarray(free[np.unique(np.linspace(0, len(free) - 1, count).round().astype(int))])


def _direct(solver: DirectSolver, probes: FloatArray) -> tuple[ComplexArray, float, float]:
    """Compliances (n, n_port, n_port), median seconds per frequency and per factorisation."""
    values, seconds, factorising = [], [], []
    for f in probes:
        start = clock()
        values.append(solver.compliance(solver.at(float(f))))
        seconds.append(clock() - start)
    for f in probes[:3]:
        data = solver.model.operator.data(2 * np.pi * float(f))
        start = clock()
        solver.factor.factorise(data)
        factorising.append(clock() - start)
    solver.factor.release()
    return np.array(values), float(np.median(seconds[:TIMED])), float(np.median(factorising))


def _watched(model: ForearmModel, values: ComplexArray) -> ComplexArray:
    """All displacements per contact force, the driving points among them."""
    contacts = [i for i, p in enumerate(model.ports) if p.kind == "contact"]
    return values[:, :, contacts]


def _many(sweep: SweepResult) -> float:
    """Seconds for MANY frequencies from what the sweep left: poles and residues where that is possible."""
    left = sweep.poles or sweep.reduced
    assert left is not None
    start = clock()
    left.compliance(np.linspace(10.0, 500.0, MANY))
    return clock() - start
