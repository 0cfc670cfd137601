"""One rendering job: methods, wavelet, window, limits and targets set up once from a scenario."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Self

import numpy as np

from ..errors import AccuracyWarning, DataError, GeometryError, ScenarioError
from ..geometry.device.layout import planform_ports
from ..ports import Port
from ..progress import Progress
from ..scenario import Scenario, load_scenario, parse_scenario
from ..scenario.load import read_overrides
from ..scenario.rendering import RenderingOptions, SampledWavelet
from ..scenario.sweep import Sweep, frequencies
from ..transfer import UNITS, TransferMatrix
from ..typing import FloatArray
from ..usercode import is_code, named
from .bridging import bridged
from .drives import Limits, Renderer, limits_of
from .funneling import Funneling, funneling_weights, lattice_of
from .inverse_filter import (
    LEAST_ERROR,
    AutoZeros,
    Combination,
    InverseFilter,
    Regularisation,
    SearchedZeros,
    ThesisZeros,
)
from .rendered import Rendering, played_strengths, render_all
from .signals import Record, Wavelet, Window, from_samples_file, on_record_bins, place_on_bins, ricker, window_of

# RenderJob: renderers, wavelet, targets, window and limits of a scenario, set up once and played on any G.

MICROMETRE = 1e-6
_PER_PEAK = 16.0  # samples per period of the wavelet's peak frequency


@dataclass(frozen=True, eq=False)
class RenderJob:
    """Renderers of a scenario with all that they need, for any G with the same ports.

    methods : renderers in the scenario's order
    wavelet : the stimulus on its record
    targets : names of the outputs that are aimed at
    window : what S is taken over: "wavelet", "record", or seconds
    limits : of the actuators; none where the drive is no voltage
    left_out : by method that cannot serve the ports, a sentence with cause and remedy
    ports : outputs and inputs of the G that the job was set up for
    """

    methods: tuple[Renderer, ...]
    wavelet: Wavelet
    targets: tuple[str, ...]
    window: Window = "wavelet"
    limits: Limits = field(default_factory=Limits)
    left_out: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    ports: tuple[tuple[Port, ...], tuple[Port, ...]] = ((), ())

    @classmethod
    def of(
        cls, scenario: Scenario, g: TransferMatrix, *, base: str | Path = ".", targets: Sequence[str] | None = None,
        shape: Wavelet | None = None, progress: Progress | None = None,
    ) -> Self:  # fmt: skip
        """The scenario's renderers for the ports and the unit of ``g``; ``base`` is seen by the wavelet's file.

        ``targets`` and the wavelet ``shape`` replace the scenario's. ScenarioError where no method serves the ports.
        """
        wanted = scenario.rendering
        shape = wavelet(wanted, scenario.sweep, Path(base)) if shape is None else shape
        aims = targets_of(scenario, g.outputs) if targets is None else tuple(targets)
        left_out = unsuited(wanted, g.outputs, g.inputs, aims)
        if len(left_out) == len(wanted.methods):
            raise ScenarioError(f"rendering: {next(iter(left_out.values()), 'rendering.methods is empty; name one')}")
        limits = (limits_of(scenario.device) if g.unit == "m/V" else None) or Limits()
        methods = tuple(renderers(scenario, shape, frozenset(left_out), progress))
        return cls(methods, shape, aims, wanted.window, limits, MappingProxyType(left_out), (g.outputs, g.inputs))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the methods."""
        return tuple(m.name for m in self.methods)

    @property
    def span(self) -> tuple[float, float] | None:
        """The window in seconds (start, end), None for the whole record."""
        return window_of(self.window, self.wavelet)

    def on_nominal_ports(self, g: TransferMatrix) -> TransferMatrix:
        """The same ``g`` with the ports where the experimenter takes them to be: renderers aim by these places."""
        return replace(g, outputs=self.ports[0], inputs=self.ports[1])

    def warn(self) -> None:
        """An AccuracyWarning for each method that is left out."""
        for sentence in self.left_out.values():
            warnings.warn(sentence, AccuracyWarning, stacklevel=3)

    def play(
        self, design_on: TransferMatrix, play_on: TransferMatrix | None = None, *, progress: Progress | None = None
    ) -> Rendering:
        """Drives, displacements and S: aimed by ``design_on`` and played through it, or through ``play_on``.

        Holes of either are bridged. Errors and warnings as of :func:`render_all`.
        """
        return render_all(
            design_on, self.targets, self.methods, self.wavelet, self.limits, window=self.window, play_on=play_on,
            progress=progress,
        )  # fmt: skip

    def strengths(
        self, design_on: TransferMatrix, *play_on: TransferMatrix, windows: Sequence[Window] = ()
    ) -> FloatArray:
        """S (n_window, n_play, n_method, n_target) of drives aimed by ``design_on``, as played on each of ``play_on``.

        Keeps no signals and bridges no holes: for studies over many G. S is over the job's own window unless
        ``windows`` name others.
        """
        spans = [window_of(w, self.wavelet) for w in windows or (self.window,)]
        return played_strengths(design_on, play_on or (design_on,), self.targets, self.methods, self.wavelet, spans)


def render_transfer(
    scenario: Scenario, transfer: TransferMatrix, *, base: str | Path = ".", progress: Progress | None = None
) -> Rendering:
    """The scenario's renderers on any G, simulated or measured.

    Methods that cannot serve its ports are left out with an AccuracyWarning that names the remedy; ScenarioError if
    none is left.
    """
    job = RenderJob.of(scenario, transfer, base=base, progress=progress)
    job.warn()
    return job.play(transfer, progress=progress)


def targets_of(scenario: Scenario, outputs: Sequence[Port]) -> tuple[str, ...]:
    """Names of the outputs that the scenario aims at."""
    wanted = scenario.rendering.targets
    return tuple(p.name for p in outputs) if wanted == "all" else tuple(wanted)


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
        "funneling": Funneling(amplitude=options.amplitude, distance=options.funneling_distance),
        "combination": Combination(
            zeros=zeros,
            regularisation=rule,
            amplitude=options.amplitude,
            distance=options.funneling_distance,
            least_error=least,
        ),
    }
    return [known[m] if m in known else user_renderer(m, scenario) for m in options.methods if m not in left_out]


def user_renderer(code: str, scenario: Scenario) -> Renderer:
    """The renderer of the user's own class ``code``: ``Class.of(scenario)`` where it has that, else ``Class()``.

    ScenarioError where it has no ``name`` or no ``aim(placed, target, wavelet)``.
    """
    made = named(code, "rendering.methods")
    renderer = made.of(scenario) if hasattr(made, "of") else made()
    if lacking := [what for what in ("name", "aim") if not hasattr(renderer, what)]:
        raise ScenarioError(f"rendering.methods: {code} has no {lacking[0]}; a renderer has a name and an aim")
    return renderer  # type: ignore[no-any-return]


def least_error(scenario: Scenario) -> float:
    """e(f) [-] that drives of more than four actuators are damped for at least."""
    return max(LEAST_ERROR, scenario.accuracy)


def wavelet(options: RenderingOptions, sweep: Sweep, base: Path) -> Wavelet:
    """The Ricker wavelet, or the samples in the scenario's file, at the sweep's rate and duration."""
    if isinstance(options.wavelet, SampledWavelet):
        return from_samples_file(base / options.wavelet.file, sweep.sample_rate, sweep.duration)
    return ricker(options.wavelet.peak, sample_rate=sweep.sample_rate, duration=sweep.duration)


def unsuited(
    options: RenderingOptions, outputs: tuple[Port, ...], inputs: tuple[Port, ...], targets: Sequence[str]
) -> dict[str, str]:
    """Methods that cannot serve these ports, each with a sentence that names cause and remedy."""
    by_name = {p.name: p for p in outputs}
    found: dict[str, str] = {}
    for method in (m for m in options.methods if not is_code(m)):
        try:
            if method != "inverse filter":
                for target in (by_name[t] for t in targets if t in by_name):
                    funneling_weights(inputs, target, options.funneling_distance)
            if method != "funneling" and options.zeros == "thesis":
                lattice_of(outputs, "zero points by the corner rule, outputs")
        except GeometryError as problem:
            remedy = "add an actuator, or use the inverse filter"
            if "funneling_distance" in str(problem):
                remedy = "the default is 'spacing'"
            elif "corner rule" in str(problem):
                remedy = "set rendering.zeros = 'auto', or name the points"
            elif "outside" in str(problem):
                remedy = "name rendering.targets between the actuators, or lower grid.pitch or raise device.spacing"
            found[method] = f"{method} is left out: {problem}; {remedy}"
    return found


def check_servable(scenario: Scenario) -> dict[str, str]:
    """:func:`unsuited` seen from above, before anything is solved.

    ScenarioError if no method is left, a method of one's own is none, or there is no point beside the target, DataError
    if none of the record's bins would have a G.
    """
    options, sweep = scenario.rendering, scenario.sweep
    for code in filter(is_code, options.methods):
        user_renderer(code, scenario)
    if options.methods:
        band = frequencies(sweep)
        place_on_bins(band, np.zeros((len(band), 1), dtype=complex), sweep.sample_rate, sweep.duration)
    outputs, inputs = planform_ports(scenario)
    if options.methods and len(outputs) < 2:
        raise ScenarioError(
            "grid: S holds the target's motion against that of the other points, and there is one point; add points, "
            "or set rendering.methods = []"
        )
    found = unsuited(options, outputs, inputs, targets_of(scenario, outputs))
    if options.methods and len(found) == len(options.methods):
        raise ScenarioError(f"rendering: {next(iter(found.values()))}")
    return found


def is_on_bins(frequency: FloatArray, duration: float) -> bool:
    """True if ``frequency`` (n,) [Hz] are bins of a record of ``duration`` [s], to a thousandth of one."""
    place = frequency * duration
    return bool(np.allclose(place, np.rint(place), rtol=0, atol=1e-3))


def wavelet_for(frequency: FloatArray, peak: float = 250.0) -> Wavelet:
    """A Ricker wavelet of ``peak`` [Hz] in a record whose bins hold ``frequency`` (n,) [Hz] where these are evenly
    spaced from 0; else the thesis' record of 2 s at 10 kHz, onto whose bins G is interpolated where that is safe."""
    if len(frequency) < 2:
        raise DataError("rendering needs at least two frequencies")
    df = float(np.median(np.diff(frequency)))
    k = frequency / df
    if not np.allclose(k, np.rint(k), atol=1e-6 * k.max()):
        return ricker(peak)
    n = 2 * math.ceil(max(_PER_PEAK * peak, 4 * float(frequency[-1])) / df / 2)
    return ricker(peak, sample_rate=n * df, duration=1 / df)


# The scenario that a given G is rendered by: the one asked for, the one that G names, or the thesis'.

DEFAULT = "thesis"
UNASKED = (
    "no scenario is named, by --scenario or by this G: methods, wavelet, window and limits are the thesis', places are "
    "G's own; name the scenario that was measured"
)
_HIGHEST = 5000.0  # Hz, of a sweep


def scenario_for(
    g: TransferMatrix, asked: Scenario | None = None, overrides: Sequence[str] = ()
) -> tuple[Scenario, tuple[str, ...]]:
    """The scenario that renders ``g``, with ``overrides`` (``key.path=value``) set, and notes on its choice.

    It is ``asked`` or, failing that, the one in G's provenance, else the thesis' with the places of G. Where G cannot
    be placed on the bins of its record, it gets one whose bins G is on. DataError where G has other counts of ports.
    """
    notes = list[str]()
    if asked is not None:
        _refuse_other_counts(asked, g)
        scenario = asked
    elif (named := named_by(g)) is not None:
        scenario = named
    else:
        scenario = _thesis_with_places_of(g)
        notes.append(UNASKED)
    scenario = scenario.changed(read_overrides(overrides)) if overrides else scenario
    placed, note = on_own_bins(g, scenario)
    return placed, (*notes, *([note] if note else []))


def on_own_bins(g: TransferMatrix, scenario: Scenario) -> tuple[Scenario, str]:
    """``scenario`` and "", or with a record whose bins ``g`` is on and a note, where ``g`` fits no bins of its own."""
    shape = scenario.rendering.wavelet
    if isinstance(shape, SampledWavelet) or _lies_on(g, scenario):
        return scenario, ""
    own = wavelet_for(g.frequency, shape.peak).record
    if not is_on_bins(g.frequency, 1 / own.df):
        return scenario, ""
    sweep = {
        "sweep.f_min": float(g.frequency[0]), "sweep.f_max": float(min(g.frequency[-1], _HIGHEST)),
        "sweep.duration": 1 / own.df, "sweep.sample_rate": own.sample_rate,
    }  # fmt: skip
    return scenario.changed(sweep), (
        f"the record is {1 / own.df:.4g} s at {own.sample_rate:.6g} Hz, whose bins are this G's frequencies: it is not "
        f"known closely enough for the scenario's ({scenario.sweep.duration:g} s)"
    )


def _lies_on(g: TransferMatrix, scenario: Scenario) -> bool:
    """True if G is known on the bins of the scenario's record, or closely enough beside them."""
    try:
        on_record_bins(bridged(g).transfer, Record.of(scenario.sweep.sample_rate, scenario.sweep.duration))
    except DataError:
        return False
    return True


def named_by(g: TransferMatrix) -> Scenario | None:
    """The scenario in G's provenance; None where there is none that this version reads."""
    known = g.provenance.get("scenario")
    try:
        return parse_scenario(known) if isinstance(known, Mapping) else None
    except ScenarioError:
        return None


def _refuse_other_counts(asked: Scenario, g: TransferMatrix) -> None:
    """DataError where the scenario measured has another number of points or actuators than G."""
    theirs = len(asked.grid.places), len(asked.device.centres)
    if theirs != (len(g.outputs), len(g.inputs)):
        raise DataError(
            f"G has {len(g.outputs)} points and {len(g.inputs)} actuators, scenario '{asked.name}' has {theirs[0]} and "
            f"{theirs[1]}; name the scenario that was measured, or none"
        )


def _thesis_with_places_of(g: TransferMatrix) -> Scenario:
    """The thesis' scenario, its device and grid where G's ports are."""
    centre = np.mean([p.position[:2] for p in g.inputs], axis=0)
    return load_scenario(DEFAULT).changed({
        "name": "measured", "description": "", "device.drive": next(k for k, u in UNITS.items() if u == g.unit),
        "device.contacts": _places(g.inputs, centre), "grid.points": _places(g.outputs, centre),
    })  # fmt: skip


def _places(ports: Sequence[Port], centre: np.ndarray) -> list[list[float]]:
    """Places of ``ports`` relative to ``centre``, in metres to the nanometre."""
    return [[round(float(v), 9) for v in np.array(p.position[:2]) - centre] for p in ports]
