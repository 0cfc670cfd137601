"""Hard cases of solvers and of the reduced sweep."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from ..fem.assembly.model import ForearmModel
from ..fem.reduction.sweep import direct_sweep, reduced_sweep
from ..scenario.sweep import DirectSolve, ReducedSolve
from ..transfer import relative_error
from ..typing import FloatArray
from .rows import HardCase, HardResult
from .scenes import DIRECT, flesh, held_block


def single_precision() -> Iterator[HardResult]:
    """Refined single precision against double where the bulk modulus makes the system stiffest."""
    model, band = held_block(3, tissue=flesh(bulk=1e12)), np.array([0.5, 150.0, 2000.0])
    single, double = (direct_sweep(model, band, DirectSolve(precision=p)) for p in ("single", "double"))
    error = float(relative_error(single.values, double.values).max())
    yield HardResult("", f"residual {single.residual:.1e}", error, 1e-7)


def resonances(options: ReducedSolve) -> Iterator[HardResult]:
    """Sharp resonances (loss 0.3 % at 100 Hz) by a reduced model, against direct solves."""
    model, band = held_block(2, tissue=flesh(eta=0.04, bulk=2.2e9)), np.linspace(10.0, 500.0, 491)
    yield _swept(model, band, options, f"reduced sweep, {options.expansions} of {options.max_expansions} expansions")


def repeated_expansions() -> Iterator[HardResult]:
    """Twelve expansions within 2 Hz, 0.2 Hz apart: their solutions and derivatives span nearly the same space."""
    model, band = held_block(2, tissue=flesh(eta=0.04, bulk=2.2e9)), np.linspace(99.0, 101.0, 41)
    yield _swept(
        model,
        band,
        ReducedSolve(start="frequencies", expansions=12, max_expansions=13),
        "reduced sweep, 12 expansions in 2 Hz",
    )


def _swept(model: ForearmModel, band: FloatArray, options: ReducedSolve, what: str) -> HardResult:
    """True e(f) at seven bins, the peak and its neighbours among them; allowed is five times what was stated."""
    swept = reduced_sweep(model, band, options, tolerance=1e-4)
    peak = int(np.argmax(np.abs(swept.values[:, 0, 0])))
    shares = (np.array([0.0, 0.5, 0.8, 1.0]) * (len(band) - 1)).astype(int)
    where = np.unique(np.clip([*shares, peak - 1, peak, peak + 1], 0, len(band) - 1))
    truth = direct_sweep(model, band[where], DIRECT).values
    error = float(relative_error(swept.values[where][:, 1:, :1], truth[:, 1:, :1]).max())
    stated = swept.reduction_error if swept.certificates else 0.0
    met = "met" if swept.certificates and swept.certificates[-1].bound <= 1e-4 else "not met, and says so"
    result = f"stated {stated:.1e} after {len(swept.expansions)} expansions: 1e-4 {met}"
    result = result if swept.certificates else f"{len(swept.expansions)} expansions, nothing stated"
    return HardResult(f"{what}, peak at {band[peak]:g} Hz", result, error, max(1e-4, 5 * stated))


_SHARP = "reduced model at a resonance"
SOLVERS: tuple[HardCase, ...] = (
    HardCase("single precision", "bulk 1e12 Pa, 0.5-2000 Hz", single_precision),
    HardCase(_SHARP, "4 of 8 expansions", partial(resonances, ReducedSolve())),
    HardCase(_SHARP, "1 of 1 expansions", partial(resonances, ReducedSolve(expansions=1, max_expansions=1))),
    HardCase(_SHARP, "12 of 12 expansions", partial(resonances, ReducedSolve(expansions=12, max_expansions=12))),
    HardCase(_SHARP, "12 of 40 expansions", partial(resonances, ReducedSolve(expansions=12, max_expansions=40))),
    HardCase("reduced model, repeated expansions", "nearly the same frequency again and again", repeated_expansions),
)
