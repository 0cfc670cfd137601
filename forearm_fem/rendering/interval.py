"""Results of renderers: drives and displacements by method and target, and S with its interval."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import notebook
from ..errors import DataError
from ..metrics import perturbed
from ..metrics.strength import StrengthTable, plain_strength, signal_strength_table, without_bound
from ..ports import is_thesis_grid
from ..store.text import plain
from ..transfer import ErrorEstimate, TransferMatrix, between, error_of_pairs, relative_error_at, total_error
from ..typing import BoolArray, FloatArray
from .drives import Displacements, Drives, precomputed_for_targets, strengths
from .limits import DriveReport, Limits, beyond_limits, counted_points
from .renderers import FixedZeros, Renderer
from .search import SearchedZeros
from .signals import (
    Bridged,
    Wavelet,
    Window,
    known_of,
    on_record_bins,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import FigureBase


@dataclass(frozen=True, eq=False)
class Rendered:
    """One method at one target: drives, displacements, S [-] (eq. 9), and the drives against the limits."""

    drives: Drives
    displacements: Displacements
    strength: float
    report: DriveReport


@dataclass(frozen=True, eq=False, repr=False)
class Rendering(Mapping[tuple[str, str], Rendered]):
    """Results by (method, target), e.g. ``rendering["funneling", "5"]``.

    ``window`` [s] is what S was taken over, None for the whole record; ``bridged`` is the G that was used.
    """

    methods: tuple[str, ...]
    targets: tuple[str, ...]
    results: Mapping[tuple[str, str], Rendered]
    window: tuple[float, float] | None
    bridged: Bridged
    limits: Limits
    renderers: tuple[Renderer, ...] = ()
    wavelet: Wavelet | None = None

    def __repr__(self) -> str:
        return f"<Rendering of {', '.join(self.methods)} at {len(self.targets)} targets>"

    def _repr_html_(self) -> str:
        return self.strength._repr_html_()

    @cached_property
    def strength(self) -> Strength:
        """S with its interval; DataError for drives that were played on another G than they were designed on."""
        from .interval import strength_of

        if self.wavelet is None:
            raise DataError("drives were played on another G than their own, so there is no interval of S")
        g = self.bridged.transfer
        measured = any(e.source == "measurement" for e in g.errors) or g.deviation is not None
        return strength_of(self, self.renderers, self.wavelet, measured)

    def sel(self, method: str, target: str) -> Rendered:
        """Drives and displacements of a method at a target; DataError for other names."""
        m = notebook.place(self.methods, method, "method")
        t = notebook.place(self.targets, target, "target")
        return self.results[self.methods[m], self.targets[t]]

    def to_xarray(self) -> xr.Dataset:
        """Drives and displacements by method, target, channel and time."""
        return notebook.xarray_of_rendering(self)

    def plot(self) -> FigureBase:
        """S by target with its interval."""
        return self.strength.plot()

    def save(self, path: str | Path) -> None:
        """Write drives and displacements as netCDF."""
        self.to_xarray().to_netcdf(path, engine="h5netcdf")

    def __getitem__(self, key: tuple[str, str]) -> Rendered:
        if key not in self.results:
            methods, targets = (", ".join(map(repr, names)) for names in (self.methods, self.targets))
            raise KeyError(f"{key}: methods are {methods}, targets {targets}")
        return self.results[key]

    def __iter__(self) -> Iterator[tuple[str, str]]:
        return iter(self.results)

    def __len__(self) -> int:
        return len(self.results)

    @property
    def strengths(self) -> FloatArray:
        """S (n_method, n_target) [-]."""
        return np.array([[self.results[m, t].strength for t in self.targets] for m in self.methods])

    @property
    def counted(self) -> BoolArray:
        """True where a target (n_target,) is in means of S: none under or within the default clearance of a motor
        is."""
        g = self.bridged.transfer
        by_name = {p.name: p for p in g.outputs}
        return counted_points([by_name[t] for t in self.targets], g.inputs)

    @property
    def exceeded(self) -> tuple[str, ...]:
        """A sentence per method and limit exceeded: how often, the worst case, and the remedy."""
        first = next(iter(self.values()), None)
        if first is None or not first.report.checked:
            return ()
        peak, power = (
            np.array([[getattr(self[m, t].report, what) for t in self.targets] for m in self.methods])
            for what in ("peak", "power")
        )
        channels = tuple(p.name for p in first.drives.inputs)
        return beyond_limits(self.methods, self.targets, channels, peak, power, self.limits)

    def table(self) -> StrengthTable:
        """S of points that count in the layout of the thesis' Table I.

        DataError for any other grid than 3 x 3 points "1" to "9" and for no targets or methods.
        """
        first = next(iter(self.results.values()), None)
        if first is None:
            raise DataError("nothing was rendered, so there is no Table I: give targets and methods")
        if not is_thesis_grid(first.displacements.outputs):
            raise DataError("Table I (middle, edges, corners) is for the thesis' 3 x 3 grid only; see strengths")
        return signal_strength_table(self.methods, self.targets, self.strengths, self.counted)

_DRAWS, _SEED = 12, 0
_MARGIN = 2.0  # the ends that are missing may count for more than their neighbours
_CORRELATION = 50.0  # Hz: errors of meshes and ends are smooth over about that much
# rms changes of log S: 9 of 10 true errors lie within for errors as they are stated, which is more than they are
# (decision 0027); a measurement's random ones are as large as its deviation says
_HALF_WIDTH, _OF_RANDOM = 1.5, 2.0
_LOST = 2.0  # by how much the statement of two meshes outgrows their error, per e_band
_RANDOM_ONLY = "the interval of S holds the random error of G (its deviation) alone: no systematic one is stated"
_MOST_WITHOUT = 0.5  # of the values: with fewer deviations than that the random error is unknown
_LEAST_SPAN = 4.0  # of the window: the record that draws are made on


@dataclass(frozen=True, eq=False)
class StrengthEntry:
    """One S with its interval [-]; NaN where unknown."""

    value: float
    low: float
    high: float

    def __repr__(self) -> str:
        return f"<S {self.value:.3g} ({self.low:.3g} to {self.high:.3g})>"


@dataclass(frozen=True, eq=False, repr=False)
class Strength:
    """S with its interval: arrays (n_method, n_target) [-], NaN where unknown.

    value, low, high : S and its interval
    record : S over the whole record
    edges : change of S with tapered band edges
    holes : cost of holes of G and missing ends of its band, 0 without any
    window : [s] that S is taken over, None for the record
    zeros : zero points by method and target
    unknown : reason that there is no interval, or what an interval leaves out
    counted : (n_target,) targets that are in means, None for all
    """

    methods: tuple[str, ...]
    targets: tuple[str, ...]
    window: tuple[float, float] | None
    value: FloatArray
    low: FloatArray
    high: FloatArray
    record: FloatArray
    edges: FloatArray
    holes: FloatArray
    zeros: Mapping[str, Mapping[str, tuple[str, ...]]]
    unknown: str = ""
    counted: BoolArray | None = None

    def __repr__(self) -> str:
        return notebook.line_of_s(self)

    def _repr_html_(self) -> str:
        return notebook.html_of_s(self)

    def sel(self, method: str, target: str) -> StrengthEntry:
        """S of a method at a target, e.g. ``s.sel("funneling", "5")``; DataError for other names."""
        m = notebook.place(self.methods, method, "method")
        t = notebook.place(self.targets, target, "target")
        return StrengthEntry(*(float(part[m, t]) for part in (self.value, self.low, self.high)))

    def __getitem__(self, key: tuple[str, str]) -> StrengthEntry:
        return self.sel(*key)

    def to_xarray(self) -> xr.Dataset:
        """Value, low, high, record, edges and holes by method and target."""
        return notebook.xarray_of_s(self)

    def plot(self) -> FigureBase:
        """S by target with its interval."""
        return notebook.plot_of_s(self)

    def save(self, path: str | Path) -> None:
        """Write ``signal_strength.csv``, as a run does."""
        notebook.save_s(self, path)

    def as_json(self) -> dict[str, Any]:
        """By method and target, in plain numbers; None where unknown."""
        columns = ("value", "low", "high", "record", "edges", "holes")
        table = {
            m: {t: {c: plain(getattr(self, c)[i, j]) for c in columns} for j, t in enumerate(self.targets)}
            for i, m in enumerate(self.methods)
        }
        return {"window": self.window, "unknown": self.unknown, "methods": table, "zeros": self.zeros}


def finer_than_known(account: Strength, errors: Sequence[ErrorEstimate]) -> str:
    """A sentence where some S holds the other points more still than G is known by its ``errors``, else empty.

    1/S is their mean motion over the target's: drives that were made on this G cannot keep it on one that differs by
    more. The interval of S does not say so, as it aims anew at each G.
    """
    if endless := without_bound(account.methods, account.targets, account.value):
        return endless
    error, best = total_error(errors), float(np.nanmax(account.value, initial=0.0))
    if not error > 0 or not best * error > 1:
        return ""
    m, t = np.unravel_index(int(np.nanargmax(account.value)), account.value.shape)
    return (
        f"S of {account.methods[m]} towards {account.targets[t]} is {best:.3g}: the others are held stiller "
        f"({1 / best:.2g} of the target's motion) than G is known ({error:.2g}). On the arm's own G these drives keep "
        "less: play them on another one to see how much (`forearm-fem compare`)"
    )


def strength_of(
    rendering: Rendering, methods: Sequence[Renderer], wavelet: Wavelet, measured: bool = False
) -> Strength:
    """Account of the S of ``rendering`` by ``methods`` (its renderers) with ``wavelet``.

    The interval is for the errors stated for G and its ``deviation``, bridged holes included; that the systematic
    errors of a ``measured`` G are in none of these is said. Where G has a deviation, the error by "measurement" says
    the same of its worst entry, and is not drawn a second time. Renderers aim anew in each draw, with zero points as
    found for the G printed.
    """
    kept = tuple(_with_found_zeros(m, rendering) for m in methods)
    holes = rendering.bridged
    window: Window = rendering.window if rendering.window is not None else "record"

    def strength(g: TransferMatrix, shape: Wavelet = wavelet) -> FloatArray:
        """S of the same renderers on another G, or of another wavelet."""
        return strengths(g, rendering.targets, kept, shape, window=window)

    g, value = holes.transfer, rendering.strengths
    cost = np.zeros_like(value)
    if holes.guess is not None:
        cost = _pooled(strength(holes.guess) - value, value)
    if holes.ends:
        cost = np.hypot(cost, _cost_of_ends(strength, g, value))
    errors = (*g.errors, *((holes.error,) if holes.error is not None else ()))
    random = _random_error(g)
    known = bool(g.errors) or random is not None
    unknown = _unknown_reason(errors, known, measured)
    asked = rendering.targets, rendering.window
    smooth = errors if random is None else tuple(e for e in errors if e.source != "measurement")
    spread = np.full(value.shape, np.nan) if unknown else interval(g, smooth, *asked, kept, wavelet, random)
    unknown = unknown or ("" if any(e.source != "measurement" for e in g.errors) else _RANDOM_ONLY)
    tapered = wavelet.tapered(float(g.frequency[0]), float(g.frequency[-1]))
    moved = [[rendering[m, t].displacements for t in rendering.targets] for m in rendering.methods]
    record = np.array([[plain_strength(u.values, u.target_index) for u in row] for row in moved])
    return Strength(
        rendering.methods, rendering.targets, rendering.window, value,
        value * np.exp(-spread) - cost, value * np.exp(spread) + cost, record,
        strength(g, tapered) - value, cost,
        {m: {t: rendering[m, t].drives.zeros for t in rendering.targets} for m in rendering.methods}, unknown,
        rendering.counted,
    )  # fmt: skip


def _cost_of_ends(strength: Callable[[TransferMatrix], FloatArray], g: TransferMatrix, value: FloatArray) -> FloatArray:
    """Cost in S of the ends that G misses: twice that of leaving out as much again beside them."""
    try:
        return _MARGIN * _pooled(strength(with_wider_ends(g)) - value, value)
    except DataError:  # no bin is left on which all control points are known
        return np.full(value.shape, np.nan)


def with_wider_ends(transfer: TransferMatrix) -> TransferMatrix:
    """G without as many values again as each entry misses at either end of its band, half of the known ones at most:
    what that does to S tells what the missing ones may do."""
    known = known_of(transfer)
    first, last = known.argmax(axis=0), len(known) - 1 - known[::-1].argmax(axis=0)
    room = (last - first + 1) // 4
    start, stop = first + np.minimum(first, room), last - np.minimum(len(known) - 1 - last, room)
    row = np.arange(len(known))[:, None, None]
    return replace(transfer, valid=known & (row >= start) & (row <= stop))


def _pooled(change: FloatArray, value: FloatArray) -> FloatArray:
    """Size of a ``change`` of S ``value``, both (n_method, n_target), none below the method's rms over all: single
    ones cancel by chance."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = change / value
        pooled = np.sqrt(np.mean(share**2, axis=1, keepdims=True, where=np.isfinite(share)))
        return np.asarray(np.fmax(np.abs(change), pooled * value)) + 0 * change


def _with_found_zeros(method: Renderer, rendering: Rendering) -> Renderer:
    """The renderer with the zero points that a search found: searching anew in each draw would take hours."""
    if not isinstance(getattr(method, "zeros", None), SearchedZeros):
        return method
    found = {t: rendering[method.name, t].drives.zeros for t in rendering.targets}
    return method.with_zeros(FixedZeros(found))  # type: ignore[attr-defined,no-any-return]


def _random_error(g: TransferMatrix) -> FloatArray | None:
    """Standard deviation (n, n_out, n_in) of G, zero at bridged and unknown values; None unless the others have one."""
    if g.deviation is None:
        return None
    known = np.isfinite(g.deviation)
    lacking = ~known & np.isfinite(g.values) & (g.values != 0) & (True if g.valid is None else g.valid)
    return None if lacking.mean() > _MOST_WITHOUT or not known.any() else np.where(known, g.deviation, 0.0)


def _unknown_reason(errors: tuple[ErrorEstimate, ...], known: bool, measured: bool) -> str:
    if not known:
        kind = "a measured G states neither an error nor a deviation" if measured else "G carries no error estimate"
        return f"{kind}, so the interval of S is unknown"
    lost = [e.source for e in errors if not np.isfinite(e.band)]
    return f"the error by {', '.join(lost)} is unknown, and so is the interval of S" if lost else ""


def interval(
    transfer: TransferMatrix,
    errors: tuple[ErrorEstimate, ...],
    targets: Sequence[str],
    span: tuple[float, float] | None,
    methods: Sequence[Renderer],
    wavelet: Wavelet,
    random: FloatArray | None = None,
    draws: int = _DRAWS,
    others: Sequence[TransferMatrix] = (),
) -> FloatArray:
    """Half width (n_method, n_target) of the interval of log S: 1.5 rms of its changes over ``draws`` of G's errors.

    S is taken over the ``span`` [s] of :attr:`.Rendering.window`.

    Each draw adds to G independent complex noise of every source (:func:`perturbed`), smooth over 50 Hz, that of the
    mesh :func:`as_drawn`, and aims anew. It starts from the ``others`` in turn where there are such: G as it may be by
    an error that is not among ``errors``, since its shape is known. Random errors of a measurement, of standard
    deviation ``random`` (n, n_out, n_in) in G's unit, are independent at each entry and frequency; they make S fall,
    and that mean fall is added to two rms. Draws cancel at single targets by chance, so none gets less than the
    method's rms over all.
    """
    window: Window = span if span is not None else "record"
    # on every k-th bin, white noise would have k times its energy within the window
    whole = random is not None
    g, shape = (transfer, wavelet) if whole else _shorter(transfer, wavelet, span)
    sources = tuple(as_drawn(e, g.frequency) if e.source == "discretisation" else e for e in errors)
    methods = precomputed_for_targets(methods, on_record_bins(g, shape.record), targets)
    base = strengths(g, targets, methods, shape, window=window)
    rng = np.random.default_rng(_SEED)
    square, fall = np.zeros(base.shape), np.zeros(base.shape)
    starts = [x if whole else _shorter(x, wavelet, span)[0] for x in others] or [g]
    for k in range(draws):
        other = perturbed(starts[k % len(starts)], sources, rng, _CORRELATION)
        if random is not None:
            noise = rng.normal(size=(2, *random.shape)) / np.sqrt(2)
            other = replace(other, values=other.values + random * (noise[0] + 1j * noise[1]))
        drawn = strengths(other, targets, methods, shape, window=window)
        square += np.log(drawn / base) ** 2 / draws
        fall += np.log(base / drawn) / draws
    pooled = square.mean(axis=1, keepdims=True)
    half = (_HALF_WIDTH if random is None else _OF_RANDOM) * np.sqrt(np.maximum(square, pooled))
    return np.asarray(half if random is None else half + np.abs(fall))


def as_drawn(error: ErrorEstimate, frequency: FloatArray) -> ErrorEstimate:
    """The estimate by two meshes at ``frequency`` (n,) [Hz]: e(f) raised to its band value, as they agree by chance;
    where it tells what entries do together, all of it over 1 + 2 e_band.

    Where the two differ much, the coarser one carries no waves: what is stated is then 1.4 to 2.6 times the error.
    An exact error stays as it is.
    """
    if error.exact:
        return error
    share = 1.0 if error.together is None else 1 / (1 + _LOST * error.band)
    own = relative_error_at(error, frequency)
    size = np.maximum(own, error.band)
    pairs = error_of_pairs(error, frequency)
    if pairs is not None:
        pairs = share * pairs * np.divide(size, own, out=np.ones_like(own), where=own > 0)[:, None, None]
    together = None if error.together is None else share * between(error, error.together, frequency)
    raised = tuple(frequency.tolist()), tuple((share * size).tolist())
    return replace(error, frequency=raised[0], per_frequency=raised[1], per_pair=pairs, together=together)


def _shorter(
    transfer: TransferMatrix, wavelet: Wavelet, window: tuple[float, float] | None
) -> tuple[TransferMatrix, Wavelet]:
    """G on the bins of a shorter record that still holds four windows about t = 0, and the wavelet in it.

    S over a window hardly depends on the record, and a draw on a quarter of the bins costs a quarter. A window that
    lies aside, or is shorter than the wavelet's own, needs a record that reaches to it and in which waves die away.
    """
    record = wavelet.record
    ends = (*window, *wavelet.window) if window is not None else (record.n / record.sample_rate / 2,)
    span = 2 * max(abs(end) for end in ends)
    most = int(record.n / record.sample_rate / (_LEAST_SPAN * span))
    place = np.rint(transfer.frequency / record.df)
    on_bins = np.allclose(place * record.df, transfer.frequency, rtol=0, atol=1e-3 * record.df)
    fits = [m for m in range(2, most + 1) if record.n % (2 * m) == 0]
    if not fits or not on_bins:
        return transfer, wavelet
    step = fits[-1]
    rows = np.nonzero(place % step == 0)[0]
    if len(rows) < 2:
        return transfer, wavelet
    n, middle = record.n // step, record.centre
    cut = wavelet.samples[middle - n // 2 : middle - n // 2 + n]
    if np.abs(cut).max() < np.abs(wavelet.samples).max():
        return transfer, wavelet
    thin = replace(
        transfer, frequency=transfer.frequency[rows], values=transfer.values[rows],
        valid=None if transfer.valid is None else transfer.valid[rows], contacts=None, deviation=None,
    )  # fmt: skip
    return thin, replace(wavelet, samples=cut, record=replace(record, n=n))
