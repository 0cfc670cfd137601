"""Drives towards targets, the displacements that follow, and S alone for studies over many G."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol, Self, runtime_checkable

import numpy as np

from ..errors import ScenarioError
from ..metrics.strength import plain_strength
from ..ports import Port
from ..transfer import TransferMatrix
from ..typing import ComplexArray, FloatArray
from .renderers import Combination, FixedZeros, Funneling, InverseFilter, Inversion, Renderer, control_of
from .signals import (
    BinnedTransfer,
    Record,
    Wavelet,
    Window,
    on_record_bins,
    respond,
    to_time,
    window_of,
)


@dataclass(frozen=True, eq=False)
class Drives:
    """Signals for the actuators.

    ``signals`` (n_in, n_t) in ``unit`` (V for a G in m/V) at ``time`` (n_t,) [s]; ``spectrum`` (n_bins, n_in)
    [unit/Hz] at ``frequency`` (n_bins,) [Hz], one-sided. ``lost`` [-] is the fraction of the wavelet's energy
    on bins where G is unknown, which are not driven. ``zeros`` names the zero points, ``inversion`` reports
    the inverse filter.
    """

    method: str
    target: str
    inputs: tuple[Port, ...]
    unit: str
    record: Record
    frequency: FloatArray
    spectrum: ComplexArray
    lost: float
    zeros: tuple[str, ...] = ()
    inversion: Inversion | None = None
    provenance: Mapping[str, object] = field(default_factory=dict)

    @property
    def time(self) -> FloatArray:
        """Time of the samples (n_t,) [s]; t = 0 is the wavelet's centre."""
        return self.record.time

    @cached_property
    def signals(self) -> FloatArray:
        """Signals (n_in, n_t) in ``unit``, worked out where they are asked for: S needs none."""
        return to_time(self.spectrum, np.rint(self.frequency / self.record.df).astype(int), self.record)


@dataclass(frozen=True, eq=False)
class Displacements:
    """Displacements ``values`` (n_out, n_t) [m] of the outputs at ``time`` (n_t,) [s].

    ``lost`` (n_out,) [-] is the fraction of the drive's energy on bins where G to that output is unknown;
    these bins are missing from its row. Where more than half is missing the row is NaN.
    """

    method: str
    target: str
    outputs: tuple[Port, ...]
    record: Record
    values: FloatArray
    lost: FloatArray

    @property
    def time(self) -> FloatArray:
        """Time of the samples (n_t,) [s]."""
        return self.record.time

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(p.name for p in self.outputs)

    @property
    def target_index(self) -> int:
        """Row of the target."""
        return self.names.index(self.target)


def drives(renderer: Renderer, transfer: TransferMatrix | BinnedTransfer, target: str, wavelet: Wavelet) -> Drives:
    """The drives with which ``renderer`` aims ``wavelet`` at output ``target``.

    ``transfer`` is G (n_frequency, n_out, n_in), or G already placed on the wavelet's bins (:func:`on_record_bins`,
    worth it for many targets). Only bins where G is known are driven; ``Drives.lost`` says what that costs. Raises
    ScenarioError for an unknown target, DataError for a G that cannot be used, GeometryError where the renderer needs a
    rectangle.
    """
    if not hasattr(renderer, "aim"):
        raise ScenarioError(f"expected a renderer such as Funneling(), got {str(renderer)[:60]!r}")
    placed = _placed(transfer, wavelet.record)
    spectrum = wavelet.spectrum
    aim = renderer.aim(placed, target, spectrum[placed.bins.index])
    energy = wavelet.energy
    return Drives(
        method=renderer.name,
        target=target,
        inputs=placed.inputs,
        unit=placed.unit.rpartition("/")[2],
        record=wavelet.record,
        frequency=placed.bins.frequency,
        spectrum=aim.spectrum,
        lost=float(np.clip(1 - energy[placed.bins.index[aim.used]].sum() / energy.sum(), 0, 1)),
        zeros=aim.zeros,
        inversion=aim.inversion,
        provenance={"wavelet": wavelet.name, "renderer": repr(renderer)},
    )


def _placed(transfer: TransferMatrix | BinnedTransfer, record: Record) -> BinnedTransfer:
    if isinstance(transfer, TransferMatrix):
        return on_record_bins(transfer, record)
    if transfer.record != record:
        raise ScenarioError(f"G is placed on the bins of {transfer.record}, the signal has {record}")
    return transfer


def displacements(transfer: TransferMatrix | BinnedTransfer, drives: Drives) -> Displacements:
    """Displacements of all outputs of ``transfer`` under ``drives``: U = G S (eq. 3), back in time.

    G may be another one than the drives were made for (a perturbed or a measured one): bins of the drive where it is
    unknown count as lost. Raises ScenarioError if the inputs differ in number, DataError if G cannot be used.
    """
    placed = _placed(transfer, drives.record)
    if len(placed.inputs) != len(drives.inputs):
        raise ScenarioError(f"G has {len(placed.inputs)} inputs, the drives {len(drives.inputs)}")
    own = np.rint(drives.frequency / drives.record.df).astype(int)
    spectrum, outside = drives.spectrum, 0.0
    if not np.array_equal(placed.bins.index, own):  # the spectra on G's bins, and the drive's energy on other bins
        _, here, there = np.intersect1d(placed.bins.index, own, return_indices=True)
        spectrum = np.zeros((len(placed.bins.index), len(drives.inputs)), dtype=complex)
        spectrum[here] = drives.spectrum[there]
        outside = float(np.sum(np.abs(drives.spectrum) ** 2)) - float(np.sum(np.abs(spectrum) ** 2))
    values = respond(placed, spectrum)
    lost = _unanswered(placed, spectrum, outside)
    values[lost > 0.5] = np.nan
    return Displacements(drives.method, drives.target, placed.outputs, drives.record, values, lost)


def _unanswered(placed: BinnedTransfer, spectrum: ComplexArray, outside: float) -> FloatArray:
    """Share (n_out,) of the drive's energy on bins where G to an output is unknown or that G has not."""
    if outside == 0 and placed.bins.valid.all():
        return np.zeros(len(placed.outputs))
    energy = np.abs(spectrum) ** 2
    missing = (~placed.bins.valid & (energy[:, None, :] > 0)).any(axis=2)
    total = energy.sum() + outside
    if total == 0:
        return np.zeros(len(placed.outputs))
    return np.asarray((energy.sum(axis=1) @ missing + max(outside, 0.0)) / total)


def thesis_renderers() -> tuple[Renderer, ...]:
    """Inverse filter, funneling and combination with their defaults (de Vlam 2022, III.B)."""
    return (InverseFilter(), Funneling(), Combination())


def as_targets(targets: Sequence[str] | None, transfer: TransferMatrix) -> tuple[str, ...]:
    """Names of outputs, by default all; one that is an output's is itself, not its letters: "12"."""
    known = tuple(p.name for p in transfer.outputs)
    if targets is None:
        return known
    if isinstance(targets, str):
        return (targets,) if targets in known else tuple(targets)
    if not isinstance(targets, list | tuple) or not all(isinstance(t, str) for t in targets):
        raise ScenarioError(f"targets: expected names of outputs such as ['5'], got {str(targets)[:60]!r}")
    return tuple(targets)


def as_renderers(methods: Sequence[Renderer] | Renderer | None) -> tuple[Renderer, ...]:
    """A list of renderers from one or several, by default the thesis' three."""
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
    names, renderers = as_targets(targets, transfer), as_renderers(methods)
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
