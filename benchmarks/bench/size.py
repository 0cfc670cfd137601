"""Cost of each step against the number of unknowns, with the exponents of the growth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from forearm_fem.engines.forecast import Ledger
from forearm_fem.fem.linear.factor import make_factor, refined_solve
from forearm_fem.verification.scenes import slab_model

from .isolated import clock
from .scene import options, quarter

SCALES = (3.0, 2.0, 1.5, 1.2)
MORE = (1.0, 0.8, 0.65, 0.55, 0.48, 0.4, 0.33)  # 19 GB in double precision
FREQUENCY = 400.0  # Hz
STEPS = ("seconds_assembly", "seconds_analysis", "seconds_factorisation", "seconds_solve", "peak_bytes")


@dataclass(frozen=True)
class Sized:
    """One system of ``unknowns``: seconds of its steps (solve: all ports, refined), peak memory, residual."""

    precision: str
    scale: float
    unknowns: int
    seconds_assembly: float
    seconds_analysis: float
    seconds_factorisation: float
    seconds_solve: float
    peak_bytes: float
    residual: float
    solver: str = ""
    runs: int = 1


def sized(case: tuple[str, float]) -> Sized:
    """Mesh, assemble, analyse, factorise and solve once; ``case`` is (precision, scale)."""
    precision, scale = case
    ledger, marks = Ledger(), [clock()]
    with ledger.stage("all"):
        model = slab_model(quarter(), scale=scale)
        marks.append(clock())
        omega, single = 2 * np.pi * FREQUENCY, precision == "single"
        factor = make_factor(model.operator, omega, options().backend, single=single, matching=not single)
        data = model.operator.data(omega)
        marks.append(clock())
        factor.factorise(data)
        marks.append(clock())
        right = model.functionals.astype(complex)
        solution = refined_solve(factor, model.operator.matrix(data), right, tolerance=1e-9 if single else 1e-11)
        marks.append(clock())
    assembly, analysis, factorisation, solve = np.diff(marks).tolist()
    return Sized(
        precision, scale, model.operator.n, assembly, analysis, factorisation, solve,
        ledger.stages["all"].peak_memory_bytes, solution.residual, factor.name,
    )  # fmt: skip


def exponents(rows: Sequence[Sized]) -> dict[str, float]:
    """Step -> p of a fit seconds ~ n^p through the larger sizes: at least half of them, without the smallest."""
    ordered = sorted(rows, key=lambda r: r.unknowns)
    large = ordered[max(0, len(ordered) // 2 - 1) :]
    if len(large) < 2:
        return {}
    x = np.log([r.unknowns for r in large])
    return {s: float(np.polyfit(x, np.log([getattr(r, s) for r in large]), 1)[0]) for s in STEPS}
