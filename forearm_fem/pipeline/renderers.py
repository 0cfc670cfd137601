"""From a scenario's [rendering] table to renderer objects and a wavelet."""

from __future__ import annotations

from pathlib import Path

from ..rendering import (
    Combination,
    Funneling,
    InverseFilter,
    Regularisation,
    SearchedZeros,
    ThesisZeros,
    Wavelet,
    from_samples_file,
    ricker,
)
from ..rendering.drives import Renderer
from ..scenario.rendering import Rendering
from ..scenario.sweep import Sweep

MICROMETRE = 1e-6


def renderers(options: Rendering) -> list[Renderer]:
    """One renderer per method asked for, in the scenario's order."""
    zeros = _zeros(options)
    rule = Regularisation(kind=options.regularisation, value=options.regularisation_value)
    peak = options.amplitude * MICROMETRE
    known: dict[str, Renderer] = {
        "inverse filter": InverseFilter(zeros=zeros, regularisation=rule, peak=peak),
        "funneling": Funneling(amplitude=options.amplitude),
        "combination": Combination(zeros=zeros, regularisation=rule, amplitude=options.amplitude),
    }
    return [known[m] for m in options.methods]


def _zeros(options: Rendering) -> ThesisZeros | SearchedZeros | tuple[str, ...]:
    if options.zeros == "thesis":
        return ThesisZeros()
    return SearchedZeros() if options.zeros == "search" else tuple(options.zeros)


def wavelet(options: Rendering, sweep: Sweep, base: Path) -> Wavelet:
    """The Ricker wavelet, or the samples in the scenario's file, at the sweep's rate and duration."""
    if options.wavelet.file is not None:
        return from_samples_file(base / options.wavelet.file, sweep.sample_rate, sweep.duration)
    return ricker(options.wavelet.peak, sample_rate=sweep.sample_rate, duration=sweep.duration)
