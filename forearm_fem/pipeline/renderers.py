"""From a scenario's [rendering] table to renderer objects and a wavelet."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import GeometryError, ScenarioError
from ..geometry.device.layout import planform_ports
from ..ports import Port
from ..progress import Progress
from ..rendering import (
    AutoZeros,
    Combination,
    Funneling,
    InverseFilter,
    Regularisation,
    SearchedZeros,
    ThesisZeros,
    Wavelet,
    from_samples_file,
    funneling_weights,
    ricker,
    window_of,
)
from ..rendering.drives import Renderer
from ..rendering.inverse_filter import LEAST_ERROR
from ..rendering.lattice import lattice_of
from ..rendering.spectrum import place_on_bins
from ..scenario import Scenario
from ..scenario.rendering import RenderingOptions, SampledWavelet
from ..scenario.sweep import Sweep
from .frequencies import frequencies

MICROMETRE = 1e-6


def renderers(
    scenario: Scenario,
    shape: Wavelet,
    left_out: frozenset[str] = frozenset(),
    progress: Progress | None = None,
) -> list[Renderer]:
    """One renderer per method asked for and not ``left_out``, in the scenario's order.

    A search for zero points maximises S over the scenario's window of the wavelet ``shape`` and tells ``progress``.
    More than four actuators are damped for the accuracy that the scenario asks of G: two runs of one device are driven
    alike, whatever each states of its own error.
    """
    options = scenario.rendering
    zeros: AutoZeros | ThesisZeros | SearchedZeros | tuple[str, ...] = AutoZeros()
    if options.zeros == "search":
        zeros = SearchedZeros(window=window_of(options.window, shape), progress=progress)
    elif options.zeros != "auto":
        zeros = ThesisZeros() if options.zeros == "thesis" else options.zeros
    rule = None
    if options.regularisation != "auto":
        rule = Regularisation(kind=options.regularisation, value=options.regularisation_value)
    peak, least = options.amplitude * MICROMETRE, least_error(scenario)
    known: dict[str, Renderer] = {
        "inverse filter": InverseFilter(zeros=zeros, regularisation=rule, peak=peak, least_error=least),
        "funneling": Funneling(amplitude=options.amplitude),
        "combination": Combination(zeros=zeros, regularisation=rule, amplitude=options.amplitude, least_error=least),
    }
    return [known[m] for m in options.methods if m not in left_out]


def least_error(scenario: Scenario) -> float:
    """e(f) [-] that drives of more than four actuators are damped for at least."""
    return max(LEAST_ERROR, scenario.accuracy)


def wavelet(options: RenderingOptions, sweep: Sweep, base: Path) -> Wavelet:
    """The Ricker wavelet, or the samples in the scenario's file, at the sweep's rate and duration."""
    if isinstance(options.wavelet, SampledWavelet):
        return from_samples_file(base / options.wavelet.file, sweep.sample_rate, sweep.duration)
    return ricker(options.wavelet.peak, sample_rate=sweep.sample_rate, duration=sweep.duration)


def unsuited(
    options: RenderingOptions, outputs: tuple[Port, ...], inputs: tuple[Port, ...], targets: list[str]
) -> dict[str, str]:
    """Methods that cannot serve these ports, each with a sentence that names cause and remedy."""
    by_name = {p.name: p for p in outputs}
    found: dict[str, str] = {}
    for method in options.methods:
        try:
            if method != "inverse filter":
                for target in (by_name[t] for t in targets if t in by_name):
                    funneling_weights(inputs, target)
            if method != "funneling" and options.zeros == "thesis":
                lattice_of(outputs, "zero points by the corner rule, outputs")
        except GeometryError as problem:
            remedy = "add an actuator, or use the inverse filter"
            if "corner rule" in str(problem):
                remedy = "set rendering.zeros = 'auto', or name the points"
            elif "outside" in str(problem):
                remedy = "name rendering.targets between the actuators, or lower grid.pitch or raise device.spacing"
            found[method] = f"{method} is left out: {problem}; {remedy}"
    return found


def check_servable(scenario: Scenario) -> dict[str, str]:
    """:func:`unsuited` seen from above, before anything is solved.

    ScenarioError if no method is left or there is no point beside the target, DataError if none of the record's bins
    would have a G.
    """
    options, sweep = scenario.rendering, scenario.sweep
    if options.methods:
        band = frequencies(sweep)
        place_on_bins(band, np.zeros((len(band), 1), dtype=complex), sweep.sample_rate, sweep.duration)
    outputs, inputs = planform_ports(scenario)
    if options.methods and len(outputs) < 2:
        raise ScenarioError(
            "grid: S holds the target's motion against that of the other points, and there is one point; add points, "
            "or set rendering.methods = []"
        )
    targets = [p.name for p in outputs] if options.targets == "all" else list(options.targets)
    found = unsuited(options, outputs, inputs, targets)
    if options.methods and len(found) == len(options.methods):
        raise ScenarioError(f"rendering: {next(iter(found.values()))}")
    return found
