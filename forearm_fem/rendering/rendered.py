"""All renderers at all targets."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self, runtime_checkable

import numpy as np

from .. import notebook
from ..errors import AccuracyWarning, DataError, ScenarioError
from ..metrics.strength import StrengthTable, plain_strength, signal_strength_table, without_bound
from ..progress import Progress, tell
from ..transfer import TransferMatrix
from ..typing import BoolArray, FloatArray
from .bridging import Bridged, bridged
from .drives import (
    Displacements,
    DriveReport,
    Drives,
    Limits,
    Renderer,
    beyond_limits,
    check,
    counted_points,
    displacements,
    drives,
)
from .funneling import Funneling, is_thesis_grid
from .inverse_filter import Combination, FixedZeros, InverseFilter, control_of
from .signals import BinnedTransfer, Wavelet, Window, on_record_bins, ricker, window_of

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import FigureBase

    from .interval import Strength

_MUCH_LOST = 0.1


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


def thesis_renderers() -> tuple[Renderer, ...]:
    """Inverse filter, funneling and combination with their defaults (de Vlam 2022, III.B)."""
    return (InverseFilter(), Funneling(), Combination())


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
    ``progress`` is called after each. One name or one renderer is taken for a list of it. Warns (AccuracyWarning) when
    more than 10 % of the wavelet's energy falls on bins where G is unknown, where nothing is known of an actuator,
    which is then left out, and where an S is made of rounding. Raises ScenarioError for two methods of one name or a
    target given twice, and as :func:`drives`.
    """
    targets = _as_targets(targets, transfer)
    methods = _as_renderers(methods)
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


def _as_targets(targets: Sequence[str] | None, transfer: TransferMatrix) -> tuple[str, ...]:
    """Names of outputs, by default all; one that is an output's is itself, not its letters: "12"."""
    known = tuple(p.name for p in transfer.outputs)
    if targets is None:
        return known
    if isinstance(targets, str):
        return (targets,) if targets in known else tuple(targets)
    if not isinstance(targets, list | tuple) or not all(isinstance(t, str) for t in targets):
        raise ScenarioError(f"targets: expected names of outputs such as ['5'], got {str(targets)[:60]!r}")
    return tuple(targets)


def _as_renderers(methods: Sequence[Renderer] | Renderer | None) -> tuple[Renderer, ...]:
    if methods is None:
        return thesis_renderers()
    found = methods if isinstance(methods, list | tuple) else (methods,)
    if strange := [m for m in found if not hasattr(m, "aim")]:
        raise ScenarioError(
            f"methods: expected renderers such as Funneling(), got {strange[0]!r}; of a scenario: render(SIMULATION)"
        )
    return tuple(found)


def strengths(
    transfer: TransferMatrix,
    targets: Sequence[str],
    methods: Sequence[Renderer],
    wavelet: Wavelet,
    *,
    window: Window = "wavelet",
) -> FloatArray:
    """S (n_method, n_target) only, keeping no signals: for studies over many G.

    Holes are not bridged. Raises as :func:`render_all`.
    """
    names, renderers = _as_targets(targets, transfer), _as_renderers(methods)
    found = played_strengths(transfer, (transfer,), names, renderers, wavelet, (window_of(window, wavelet),))
    return np.asarray(found[0, 0])


def played_strengths(
    design_on: TransferMatrix,
    play_on: Sequence[TransferMatrix],
    targets: Sequence[str],
    methods: Sequence[Renderer],
    wavelet: Wavelet,
    spans: Sequence[tuple[float, float] | None],
) -> FloatArray:
    """S (n_span, n_play, n_method, n_target) of drives aimed by ``design_on``, as played on each of ``play_on``.

    S is taken over each of the ``spans`` [s], None: the whole record. Keeps no signals and bridges no holes.
    """
    placed, methods = prepared(on_record_bins(design_on, wavelet.record), methods, targets)
    played = [placed if g is design_on else on_record_bins(g, wavelet.record) for g in play_on]
    out = np.empty((len(spans), len(played), len(methods), len(targets)))
    for m, method in enumerate(methods):
        for t, target in enumerate(targets):
            sent = drives(method, placed, target, wavelet)
            for p, where in enumerate(played):
                moved, row = displacements(where, sent), where.row(target)
                for s, span in enumerate(spans):
                    out[s, p, m, t] = plain_strength(moved.values, row, time=moved.time, window=span)
    return out


# Precomputation shared by several aims: by places for any G of theirs, by G for all its targets.

@runtime_checkable
class Settling(Renderer, Protocol):
    """A renderer that can say beforehand what it takes from places."""

    def precomputed_for_targets(self, placed: BinnedTransfer, targets: Sequence[str]) -> Self:
        """The same renderer with all that follows from where ports are found for ``targets``."""


def prepared(
    placed: BinnedTransfer, methods: Iterable[Renderer], targets: Sequence[str]
) -> tuple[BinnedTransfer, tuple[Renderer, ...]]:
    """G and renderers with all that aims at ``targets`` share: :func:`precomputed_for_targets`, then
    :func:`with_controls`."""
    found = precomputed_for_targets(methods, placed, targets)
    return with_controls(placed, found, targets), found


def precomputed_for_targets(
    methods: Iterable[Renderer], placed: BinnedTransfer, targets: Sequence[str]
) -> tuple[Renderer, ...]:
    """The same renderers with zero points and shares of funneling found for ``targets``, so that draws of G find them
    there; for any G with the ports of ``placed`` whose inputs are known as there.

    Zero points that are searched stay a search. Raises as :meth:`.Renderer.aim` for ports that a renderer cannot serve.
    """
    return tuple(m.precomputed_for_targets(placed, targets) if isinstance(m, Settling) else m for m in methods)


def with_controls(placed: BinnedTransfer, methods: Iterable[Renderer], targets: Sequence[str]) -> BinnedTransfer:
    """The same G with each set of control points by which precomputed_for_targets ``methods`` aim at ``targets``
    decomposed once.

    Corners of the thesis' grid have the control points of its middle, and where all other points are held still every
    target has the same. Drives are the same to the last bit. Raises as :func:`.control_of`.
    """
    sets = dict.fromkeys(
        frozenset((target, *zeros)) for m in methods for target in targets if (zeros := _zeros(m, target)) is not None
    )
    controls = (control_of(placed, names) for names in sets)
    return replace(placed, controls={c.rows: c for c in controls})


def _zeros(method: Renderer, target: str) -> tuple[str, ...] | None:
    """Zero points that are known before the renderer aims."""
    zeros = getattr(method, "zeros", None)
    return zeros.by_target.get(target) if isinstance(zeros, FixedZeros) else zeros if isinstance(zeros, tuple) else None
