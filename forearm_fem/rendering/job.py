"""One rendering job: methods, wavelet, window, limits and targets of a scenario, played on any G."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Self

import numpy as np
from scipy.io import wavfile

from ..errors import AccuracyWarning, DataError, GeometryError, ScenarioError
from ..geometry.device.layout import planform_ports
from ..metrics.strength import plain_strength, without_bound
from ..ports import Port, lattice_of
from ..progress import Progress, tell
from ..scenario import Scenario, load_scenario, parse_scenario
from ..scenario.model import read_overrides
from ..scenario.rendering import RenderingOptions, SampledWavelet
from ..scenario.sweep import Sweep, frequencies
from ..transfer import UNITS, TransferMatrix
from ..typing import FloatArray
from ..usercode import is_code, named
from .drives import as_renderers, as_targets, displacements, drives, played_strengths, prepared
from .interval import Rendered, Rendering
from .limits import Limits, check, limits_of
from .renderers import (
    LEAST_ERROR,
    AutoZeros,
    Combination,
    Funneling,
    InverseFilter,
    Regularisation,
    Renderer,
    ThesisZeros,
    funneling_weights,
)
from .search import SearchedZeros
from .signals import (
    Record,
    Wavelet,
    Window,
    bridged,
    on_record_bins,
    place_on_bins,
    ricker,
    window_of,
)

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

    ScenarioError if no method is left, a method of one's own is none, or there is no point beside the target. DataError
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

_MUCH_LOST = 0.1


def render_all(
    transfer: TransferMatrix,
    targets: Sequence[str] | None = None,
    methods: Sequence[Renderer] | Renderer | None = None,
    wavelet: Wavelet | None = None,
    limits: Limits | None = None,
    *,
    window: Window = "wavelet",
    play_on: TransferMatrix | None = None,
    progress: Progress | None = None,
) -> Rendering:
    """Every renderer of ``methods`` at every target: drives, displacements, S and the drives' report.

    ``targets`` are names of outputs (None: all), ``methods`` renderers (None: the thesis' three), ``wavelet`` the 250
    Hz Ricker unless given. S is taken over ``window``: seconds (start, end), "wavelet" (its own window), or "record",
    the thesis' sum over the whole record, which grows with it. Holes in G are :func:`bridged` first.

    Drives are played on ``play_on`` where it is given: what a device calibrated on ``transfer`` reaches on another G.
    ``progress`` is called after each. One name or one renderer is taken for a list of it. An AccuracyWarning tells that
    more than 10 % of the wavelet's energy falls on bins where G is unknown. So it does where nothing is known of an
    actuator, which is then left out, and where an S is made of rounding. Raises ScenarioError for two methods of one
    name or a target given twice, and as :func:`drives`.
    """
    targets = as_targets(targets, transfer)
    methods = as_renderers(methods)
    wavelet = wavelet or ricker()
    names = tuple(m.name for m in methods)
    for what, given in (("method", names), ("target", targets)):
        if len(set(given)) != len(given):
            raise ScenarioError(f"a {what} is given twice: {', '.join(given)}; give each its own name")
    seconds, holes = window_of(window, wavelet), bridged(transfer)
    placed = prepared(on_record_bins(holes.transfer, wavelet.record), methods, targets)[0]
    played = placed if play_on is None else on_record_bins(bridged(play_on).transfer, wavelet.record)
    results: dict[tuple[str, str], Rendered] = {}
    for method in methods:
        for target in targets:
            sent = drives(method, placed, target, wavelet)
            reached = displacements(played, sent)
            strength = plain_strength(reached.values, reached.target_index, time=reached.time, window=seconds)
            results[method.name, target] = Rendered(sent, reached, strength, check(sent, limits or Limits()))
            tell(progress, "render", len(results), len(methods) * len(targets))
    worst = max(results.values(), key=lambda r: r.drives.lost, default=None)
    if worst is not None and worst.drives.lost > _MUCH_LOST:
        warnings.warn(
            f"G is unknown on bins with {worst.drives.lost:.0%} of the wavelet's energy "
            f"({worst.drives.method} towards {worst.drives.target}): they are not driven",
            AccuracyWarning,
            stacklevel=2,
        )
    if results and holes.absent:
        warnings.warn(holes.said_of_absent, AccuracyWarning, stacklevel=2)
    own = (tuple(methods), wavelet) if play_on is None else ((), None)
    found = Rendering(names, targets, results, seconds, holes, limits or Limits(), *own)
    if results and (endless := without_bound(names, targets, found.strengths)):
        warnings.warn(endless, AccuracyWarning, stacklevel=2)
    return found


def from_samples_file(
    path: str | Path, sample_rate: float = 10000.0, duration: float = 2.0, *, normalise: bool = True
) -> Wavelet:
    """A wavelet from the samples in a CSV (one column, or time and value), WAV (one channel) or NPY (1-D) file.

    The samples are set into a record of ``duration`` [s] at ``sample_rate`` [Hz] with their largest |value| at t = 0.
    They are divided by it unless ``normalise`` is False. Raises
    DataError if the file cannot be read, is not finite, is all zero, is longer than the record or has another
    rate: nothing is resampled.
    """
    path = Path(path)
    samples, rate = _read(path)
    record = Record.of(sample_rate, duration)
    if rate is not None and abs(rate / sample_rate - 1) > 1e-3:
        raise DataError(f"{path.name} is sampled at {rate:g} Hz, expected {sample_rate:g} Hz; resample it first")
    if samples.ndim != 1 or samples.size < 2:
        raise DataError(f"{path.name}: expected one row of at least 2 samples, got an array of shape {samples.shape}")
    if not np.all(np.isfinite(samples)):
        raise DataError(f"{path.name}: {np.count_nonzero(~np.isfinite(samples))} samples are not finite")
    if not np.any(samples):
        raise DataError(f"{path.name}: all {samples.size} samples are zero")
    if samples.size > record.n:
        raise DataError(f"{path.name}: {samples.size} samples do not fit into the record of {record.n}")
    peak = int(np.argmax(np.abs(samples)))
    placed = np.zeros(record.n)
    placed[: samples.size] = samples
    placed = np.roll(placed, record.centre - peak)
    return Wavelet(placed / abs(samples[peak]) if normalise else placed, record, path.name)


def _read(path: Path) -> tuple[FloatArray, float | None]:
    readers: dict[str, Callable[[Path], tuple[FloatArray, float | None]]] = {
        ".csv": _read_csv,
        ".txt": _read_csv,
        ".wav": _read_wav,
        ".npy": _read_npy,
    }
    if path.suffix.lower() not in readers:
        raise DataError(f"{path}: expected a wavelet's file that ends in {', '.join(readers)}")
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    try:
        return readers[path.suffix.lower()](path)
    except (ValueError, OSError, EOFError) as error:
        raise DataError(f"{path.name} cannot be read as {path.suffix[1:].upper()}: {error}") from error


def _read_csv(path: Path) -> tuple[FloatArray, float | None]:
    lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip() and line[0] != "#"]
    try:
        float(lines[0].split(",")[0])
    except (ValueError, IndexError):  # names of the columns, or nothing
        lines = lines[1:]
    if not lines:
        raise ValueError("it holds no numbers")
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    if table.shape[1] == 1:
        return table[:, 0], None
    if table.shape[1] != 2:
        raise ValueError(f"expected 1 or 2 columns, got {table.shape[1]}")
    steps = np.diff(table[:, 0])
    if steps.size == 0 or steps.min() <= 0 or np.ptp(steps) > 1e-3 * steps.mean():
        raise ValueError("its first column is not an evenly increasing time")
    return table[:, 1], float(1 / steps.mean())


def _read_wav(path: Path) -> tuple[FloatArray, float | None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error", wavfile.WavFileWarning)  # scipy only warns of files that are cut short
        warnings.filterwarnings("ignore", message="Chunk .*not understood")
        try:
            rate, samples = wavfile.read(path)
        except wavfile.WavFileWarning as problem:
            raise ValueError(str(problem)) from None
    silence = 128.0 if samples.dtype == np.uint8 else 0.0  # 8 bits have no sign
    return np.asarray(samples, dtype=float) - silence, float(rate)


def _read_npy(path: Path) -> tuple[FloatArray, float | None]:
    array = np.load(path, allow_pickle=False)
    if not np.issubdtype(array.dtype, np.floating) and not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"expected real numbers, got {array.dtype}")
    return np.asarray(array, dtype=float), None
