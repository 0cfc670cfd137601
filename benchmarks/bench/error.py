"""Seconds and peak memory from scenario to the whole G against its true error, method by method."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import perf_counter, process_time

import numpy as np
from scipy.interpolate import BarycentricInterpolator

from forearm_fem.engines.forecast import Ledger
from forearm_fem.engines.layered import flat_layers
from forearm_fem.fem.reduction.sweep import direct_sweep, reduced_sweep
from forearm_fem.layered import Disc, layered_compliance
from forearm_fem.transfer import band_error, relative_error
from forearm_fem.typing import ComplexArray, FloatArray
from forearm_fem.verification.scenes import slab_model

from .isolated import isolated, median, repeated
from .scene import BAND, RADII, exact, options, quarter

NODES = 11  # Chebyshev frequencies of the interpolated sweep


@dataclass(frozen=True)
class Case:
    """A method on a mesh whose element sizes are ``scale`` times those of the scene."""

    method: str
    element: str = "P2"
    precision: str = "double"
    scale: float = 1.0


@dataclass(frozen=True)
class Timed:
    """From scenario to G at all bins: ``seconds`` of wall time (``_cpu``: of processors), ``peak_bytes`` of the
    process, error against the exact solution; what is imported is not timed."""

    method: str
    element: str
    precision: str
    scale: float
    unknowns: int
    seconds: float
    seconds_cpu: float
    peak_bytes: float
    error_worst: float
    error_band: float
    solver: str = ""
    runs: int = 1


SCALES = {"P1": (2.0, 1.4, 1.0, 0.8), "P2": (3.0, 2.0, 1.5, 1.2), "P3": (5.0, 4.0)}
MORE = {"P1": (0.65, 0.5), "P2": (1.0, 0.8), "P3": (3.0, 2.5)}


def cases(*, full: bool) -> list[Case]:
    """All runs: reduced as shipped for P1, P2 and P3, P2 in double precision, reduced and direct, and the twin."""
    scales = {e: SCALES[e] + (MORE[e] if full else ()) for e in SCALES}
    found = [Case("reduced", e, "auto", s) for e in SCALES for s in scales[e]]
    found += [Case("reduced", "P2", "double", s) for s in scales["P2"]]
    found += [Case("direct", "P2", "double", s) for s in scales["P2"]]
    return found + [Case("twin", "-", "double", 10.0**-k) for k in (2, 4, 6)]


def timed(case: Case) -> Iterator[Timed]:
    """Medians of runs in processes of their own; a direct case gives the interpolated sweep too."""
    runs = repeated(_WORK[case.method], case)
    for same in zip(*runs, strict=True):
        yield median(same)


def _reduced(case: Case) -> list[Timed]:
    ledger, cpu = Ledger(), process_time()
    with ledger.stage("all"):
        model = slab_model(quarter(case.element), scale=case.scale)
        sweep = reduced_sweep(model, BAND, options(case.precision))
    return [_row(case, model.operator.n, ledger, process_time() - cpu, sweep.values[:, :, :1], BAND, sweep.solver)]


def _direct(case: Case) -> list[Timed]:
    """NODES direct solves: interpolated in between, and extrapolated to one solve per bin."""
    ledger, cpu = Ledger(), process_time()
    with ledger.stage("all"):
        start = perf_counter()
        model = slab_model(quarter(case.element), scale=case.scale)
        setup = perf_counter() - start
        sweep = direct_sweep(model, nodes(), options(case.precision))
        values = sweep.values[:, :, :1]
        between = interpolated(nodes(), values, BAND)
    direct = _row(case, model.operator.n, ledger, process_time() - cpu, values, nodes(), sweep.solver)
    grown = (setup + (direct.seconds - setup) * len(BAND) / NODES) / direct.seconds
    every = replace(direct, seconds=direct.seconds * grown, seconds_cpu=direct.seconds_cpu * grown)
    truth = exact(BAND)
    worst, band = float(relative_error(between, truth).max()), band_error(between, truth)
    return [every, replace(direct, method="interpolated", error_worst=worst, error_band=band)]


def nodes() -> FloatArray:
    """Chebyshev points of the band [Hz], ends included."""
    middle, half = (BAND[-1] + BAND[0]) / 2, (BAND[-1] - BAND[0]) / 2
    return np.asarray(middle - half * np.cos(np.pi * np.arange(NODES) / (NODES - 1)))


def interpolated(at: FloatArray, values: ComplexArray, wanted: FloatArray) -> ComplexArray:
    """Polynomial through ``values`` (n, ...) at Chebyshev points, at ``wanted`` (m,)."""
    return np.asarray(BarycentricInterpolator(at, values)(wanted))


def _twin(case: Case) -> list[Timed]:
    """The layered solution itself, asked for ``scale`` as tolerance, against a tighter one."""
    ledger, cpu, discs = Ledger(), process_time(), [Disc(0.0, 0.0, 3.5e-3), *(Disc(r, 0.0) for r in RADII)]
    with ledger.stage("all"):
        result = layered_compliance(flat_layers(quarter()), 2 * np.pi * BAND, discs[:1], discs, tolerance=case.scale)
    return [_row(case, 0, ledger, process_time() - cpu, result.values, BAND, "Hankel quadrature")]


_WORK = {"reduced": _reduced, "direct": _direct, "twin": _twin}


def _row(
    case: Case, unknowns: int, ledger: Ledger, cpu: float, values: ComplexArray, at: FloatArray, solver: str
) -> Timed:
    spent, truth = ledger.stages["all"], exact(at)
    return Timed(
        case.method, case.element, case.precision, case.scale, unknowns, spent.seconds, cpu,
        spent.peak_memory_bytes,
        float(relative_error(values, truth).max()), band_error(values, truth), solver,
    )  # fmt: skip


__all__ = ["Case", "Timed", "cases", "isolated", "timed"]
