"""The two frequency-domain results: skin-only ``Compliance`` [m/N] and ``TransferMatrix`` G.

Arrays are ordered (frequency, output, input); time dependence e^{+i omega t}.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

import numpy as np

from . import notebook
from .errors import DataError, SolverError
from .ports import Port
from .store.record import dims
from .typing import BoolArray, ComplexArray, FloatArray

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import FigureBase

__all__ = [
    "Compliance",
    "ErrorEstimate",
    "TransferMatrix",
    "band_error",
    "between",
    "entry_band_errors",
    "entry_errors",
    "error_of_pairs",
    "error_words",
    "finite",
    "percent",
    "refuse_non_finite",
    "relative_error",
    "relative_error_at",
    "size_words",
    "total_error",
]

UNITS: Mapping[str, str] = MappingProxyType({"voltage": "m/V", "force": "m/N", "displacement": "m/m"})
"""The unit of G by what drives it."""

_KINDS = {"frequency": "fiu", "values": "cfiu", "contacts": "cfiu", "valid": "biu", "deviation": "fiu"}
_WORDS = {
    "frequency": "real numbers", "values": "numbers", "contacts": "numbers", "valid": "true and false, or 1 and 0",
    "deviation": "real numbers",
}  # fmt: skip

ErrorSource = Literal[
    "discretisation", "truncation", "reduction", "linear solve", "measurement", "quadrature", "bridging",
    "interpolation", "contact",
]  # fmt: skip

Values = TypeVar("Values", FloatArray, ComplexArray)


@dataclass(frozen=True)
class ErrorEstimate:
    """An estimated error of one source.

    ``per_frequency`` [-] is e(f) = max_ij |dG_ij| / max_ij |G_ij| at ``frequency`` [Hz]; ``band`` is
    ||dG||_F / ||G||_F over the band and the matrix; ``method`` says in one sentence how it was found. An estimate
    that was asked for and could not be made has ``band`` NaN, and ``method`` says why and what to do. ``per_pair``
    (n_frequency, n_out, n_in) [-] is |dG_ij| / max_ij |G_ij| at ``frequency``, with e(f) its largest; None where all
    pairs may err by e(f). ``together`` (n_frequency, n_out, n_in) [-] is dG_ij / max_ij |G_ij| of all entries at once,
    up to one complex factor: errors of meshes and ends move entries alike. Estimates that are equal may differ in both.
    Where the error is ``exact``, a difference from a known G, that factor is one.
    DataError for frequencies that do not increase, and for another number of errors than of frequencies.
    """

    source: ErrorSource
    band: float
    method: str
    frequency: tuple[float, ...] = field(default=(), metadata=dims("frequency", units="Hz"))
    per_frequency: tuple[float, ...] = field(default=(), metadata=dims("frequency", units="1", long_name="e(f)"))
    per_pair: FloatArray | None = field(
        default=None, compare=False, repr=False,
        metadata=dims("frequency output input", single=True, units="1", long_name="|dG_ij| over the largest |G_ij|"),
    )  # fmt: skip
    together: ComplexArray | None = field(
        default=None, compare=False, repr=False,
        metadata=dims("frequency output input", single=True, units="1", long_name="dG_ij over the largest |G_ij|"),
    )  # fmt: skip
    exact: bool = False

    def __post_init__(self) -> None:
        for name in ("frequency", "per_frequency"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if len(self.per_frequency) not in (0, len(self.frequency)) or np.any(np.diff(self.frequency) <= 0):
            raise DataError(
                f"the error by {self.source}: expected e(f) at increasing frequencies, one at each, got "
                f"{len(self.per_frequency)} at {len(self.frequency)}; sort them together"
            )

    @property
    def worst(self) -> float:
        """Largest e(f), NaN where one is unknown, or the band value where no frequencies are given."""
        return float(np.max(self.per_frequency)) if self.per_frequency else self.band

    @property
    def known(self) -> bool:
        """True if the estimate could be made."""
        return bool(np.isfinite(self.band))


def total_error(errors: Iterable[ErrorEstimate]) -> float:
    """e_band of all sources together, sqrt(sum of band^2); NaN where there is none or one of them is unknown."""
    bands = [e.band for e in errors]
    return float(np.sqrt(np.sum(np.square(bands)))) if bands else float("nan")


def error_words(errors: Iterable[ErrorEstimate]) -> str:
    """Error over the band of all sources: "error 2.1 %", "error below 0.01 %", "error unknown"; a measurement's own
    scatter is called that."""
    known = list(errors)
    size = percent(total_error(known))
    alone = bool(known) and all(e.source == "measurement" for e in known)
    return f"scatter {size}, systematic error unknown" if alone else f"error {size}"


def percent(share: float) -> str:
    """E.g. ``2.1 %``, ``below 0.01 %``, ``unknown``."""
    if not np.isfinite(share):
        return "unknown"
    return "below 0.01 %" if share < 1e-4 else f"{100 * share:.2g} %" if share < 1 else f"{100 * share:.0f} %"


def size_words(size: float, form: str = ".1e") -> str:
    """An estimated error as a number, or "unknown"."""
    return f"{size:{form}}" if np.isfinite(size) else "unknown"


@dataclass(frozen=True, repr=False)
class Compliance:
    """Displacements of all ports per unit force on each, without the actuators.

    ``values`` (n_frequency, n_port, n_port) [m/N], symmetric by reciprocity. The diagonal entries of point
    ports are NaN: a point force under itself is infinite. ``frequency`` [Hz] is increasing and positive.
    """

    kind: ClassVar[str] = "compliance"
    version: ClassVar[int] = 1

    frequency: FloatArray = field(metadata=dims("frequency", units="Hz"))
    values: ComplexArray = field(
        metadata=dims(
            "frequency port loaded_port", name="", units="m/N",
            long_name="displacement per unit force; NaN for a point force under itself",
        )
    )  # fmt: skip
    ports: tuple[Port, ...] = field(metadata=dims("port"))
    errors: tuple[ErrorEstimate, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        n, p = len(self.frequency), len(self.ports)
        return f"<Compliance {n} frequencies, {p} ports; m/N; {error_words(self.errors)}>"

    def to_xarray(self) -> xr.DataArray:
        """Values (frequency, output, input) [m/N] with the ports' names."""
        return notebook.xarray_of_g(self)

    def indices(self, kind: str) -> list[int]:
        """Positions in ``ports`` of the ports of a kind ("contact" or "point")."""
        return [i for i, p in enumerate(self.ports) if p.kind == kind]

    def block(self, outputs: str, inputs: str) -> ComplexArray:
        """Sub-matrix between two kinds of ports (n_frequency, n_out, n_in) [m/N]."""
        return self.values[:, self.indices(outputs)][:, :, self.indices(inputs)]


def masked(values: ComplexArray, ports: Sequence[Port]) -> ComplexArray:
    """Compliance with the self terms of points (infinite for a point force) set to NaN."""
    result, points = np.array(values, dtype=complex), [i for i, p in enumerate(ports) if p.kind == "point"]
    result[:, points, points] = np.nan
    return result


@dataclass(frozen=True, repr=False)
class TransferMatrix:
    """Displacement of each output per unit drive of each input: simulated or measured, nothing downstream knows.

    ``values`` (n_frequency, n_out, n_in) in ``unit`` (m/V for voltage drive, m/N for plain forces, m/m for
    prescribed displacement). ``contacts`` (n_frequency, n_in, n_in) is the displacement of the cones
    themselves in the same unit, where known (driving points on its diagonal). ``valid`` marks entries that may be used
    (None = all); ``deviation`` is a standard deviation per entry (None = unknown). Names of outputs and of inputs are
    unique, ``frequency`` [Hz] is positive and increasing. DataError for arrays of other shapes or kinds, for negative
    deviations, and for a unit that is none of m/V, m/N and m/m.
    """

    frequency: FloatArray = field(metadata=dims("frequency", units="Hz"))
    values: ComplexArray = field(
        metadata=dims("frequency output input", name="G", units="=unit", long_name="displacement per unit drive")
    )
    outputs: tuple[Port, ...] = field(metadata=dims("output"))
    inputs: tuple[Port, ...] = field(metadata=dims("input"))
    unit: str = "m/V"
    contacts: ComplexArray | None = field(
        default=None, metadata=dims("frequency cone input", name="G_contacts", units="=unit")
    )
    valid: BoolArray | None = field(
        default=None, metadata=dims("frequency output input", name="G_valid", long_name="entries that may be used")
    )
    deviation: FloatArray | None = field(
        default=None,
        metadata=dims(
            "frequency output input", name="G_deviation", units="=unit", long_name="standard deviation"
        ),
    )  # fmt: skip
    errors: tuple[ErrorEstimate, ...] = field(default=(), metadata=dims(name="G_errors"))
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n, outputs, inputs = len(self.frequency), len(self.outputs), len(self.inputs)
        for name, shape in (
            ("frequency", (n,)), ("values", (n, outputs, inputs)), ("contacts", (n, inputs, inputs)),
            ("valid", (n, outputs, inputs)), ("deviation", (n, outputs, inputs)),
        ):  # fmt: skip
            given = getattr(self, name)
            if given is not None and (not isinstance(given, np.ndarray) or given.shape != shape):
                came = given.shape if isinstance(given, np.ndarray) else type(given).__name__
                raise DataError(
                    f"G's {name}: expected {shape}, a numpy array, as there are {n} frequencies, {outputs} outputs "
                    f"and {inputs} inputs, got {came}"
                )
            if given is not None and given.dtype.kind not in _KINDS[name]:
                raise DataError(f"G's {name}: expected {_WORDS[name]}, got {given.dtype}; convert them")
        if self.valid is not None:
            object.__setattr__(self, "valid", self.valid.astype(bool, copy=False))
        if self.deviation is not None and np.any(self.deviation < 0):
            raise DataError("G's deviation: expected standard deviations, not negative, or NaN; correct them")
        rising = np.isfinite(self.frequency) & (np.diff(self.frequency, prepend=0.0) > 0)
        if not rising.all():
            raise DataError(
                f"G's frequency: expected positive and increasing ones, got {self.frequency[~rising][0]:g} Hz as "
                f"number {int(np.argmin(rising)) + 1} of {n}; sort them with their matrices"
            )
        for what, ports in (("outputs", self.outputs), ("inputs", self.inputs)):
            if len({p.name for p in ports}) < len(ports):
                raise DataError(f"two of G's {what} have the same name; give each its own")
        if self.unit not in UNITS.values():
            raise DataError(f"G's unit is one of {', '.join(UNITS.values())}, got {self.unit}; convert the values")
        for e in self.errors:
            wanted = (len(e.frequency), *self.values.shape[1:])
            for part in (e.per_pair, e.together):
                if part is not None and part.shape != wanted:
                    raise DataError(
                        f"the error by {e.source} is of pairs {part.shape}, G's are {wanted}; take the same pairs of "
                        "its per_pair and together, or None"
                    )

    def __repr__(self) -> str:
        return notebook.line_of_g(self)

    def _repr_html_(self) -> str:
        return notebook.html_of_g(self)

    def sel(self, output: str, input: str) -> ComplexArray:
        """G (n_frequency,) of one point by one actuator, e.g. ``g.sel("5", "A1")``; DataError for other names."""
        o = notebook.place([p.name for p in self.outputs], output, "point")
        i = notebook.place([p.name for p in self.inputs], input, "actuator")
        return np.asarray(self.values[:, o, i])

    def to_xarray(self) -> xr.DataArray:
        """Values (frequency, output, input) with the ports' names and the unit."""
        return notebook.xarray_of_g(self)

    def plot(self) -> FigureBase:
        """Size and phase of each entry, within its stated error."""
        return notebook.plot_of_g(self)

    @property
    def omega(self) -> FloatArray:
        """Angular frequency [rad/s]."""
        return 2 * np.pi * self.frequency

    def save(self, path: str | Path) -> None:
        """Write G in the format of the path's ending: .nc (everything), .csv or .mat."""
        notebook.save_g(self, path)


def finite(transfer: TransferMatrix) -> TransferMatrix:
    """The same G; raises :class:`SolverError` where an entry is no finite number."""
    refuse_non_finite("G", transfer.frequency, transfer.values)
    return transfer


def refuse_non_finite(what: str, frequency: FloatArray, values: ComplexArray) -> None:
    """Raise :class:`SolverError` unless all ``values`` (n_frequency, ...) are finite."""
    bad = ~np.isfinite(values)
    if bad.any():
        first = frequency[bad.reshape(len(frequency), -1).any(axis=1)][0]
        raise SolverError(
            f"{what}: {int(bad.sum())} of {bad.size} values came out as no finite number, the first at {first:g} Hz; "
            "nothing of it was kept. Look for extreme tissues, sizes or contacts in the scenario"
        )


def relative_error(estimate: ComplexArray, truth: ComplexArray) -> FloatArray:
    """e(f) = max_ij |estimate - truth| / max_ij |truth| per frequency (n_frequency,).

    Of the entries that both know, NaN where there are none and where these are all zero. DataError for other shapes.
    """
    off, size = _known_to_both(estimate, truth)
    return _over(off.max(axis=(1, 2)), size.max(axis=(1, 2)))


def band_error(estimate: ComplexArray, truth: ComplexArray) -> float:
    """e_band = ||estimate - truth||_F / ||truth||_F over all frequencies and entries.

    Of the entries that both know, NaN where there are none and where these are all zero. DataError for other shapes.
    """
    off, size = _known_to_both(estimate, truth)
    return float(_over(np.asarray(np.linalg.norm(off)), np.asarray(np.linalg.norm(size))))


def _over(off: FloatArray, size: FloatArray) -> FloatArray:
    """``off`` over ``size``; NaN where that is zero."""
    return np.asarray(np.divide(off, size, out=np.full(np.shape(size), np.nan), where=size > 0))


def _known_to_both(estimate: ComplexArray, truth: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """|estimate - truth| and |truth|, both zero where either is unknown: a norm of the truth that holds entries without
    an estimate would make the error small.

    DataError for matrices of different shapes: what numpy would repeat is no comparison.
    """
    if estimate.shape != truth.shape or truth.ndim != 3 or truth.size == 0:
        raise DataError(
            f"two G are compared on one shape (frequency, output, input), got {estimate.shape} and {truth.shape}"
        )
    known = ~(np.isnan(estimate) | np.isnan(truth))
    return np.abs(np.where(known, estimate - truth, 0)), np.abs(np.where(known, truth, 0))


def relative_error_at(estimate: ErrorEstimate, frequency: FloatArray) -> FloatArray:
    """e(f) (n,) [-] at ``frequency`` (n,) [Hz]: linear between the estimate's own, its ends beyond, or its band value.

    NaN throughout for an estimate that could not be made.
    """
    if not estimate.per_frequency or not np.isfinite(estimate.band):
        return np.full(len(frequency), estimate.band)
    return np.interp(frequency, estimate.frequency, estimate.per_frequency)


def error_of_pairs(estimate: ErrorEstimate, frequency: FloatArray) -> FloatArray | None:
    """|dG_ij| / max_ij |G_ij| (n, n_out, n_in) [-] at ``frequency`` (n,) [Hz], as :func:`relative_error_at` takes e(f);
    NaN throughout for an estimate that could not be made, None where one does not tell pairs apart."""
    if estimate.per_pair is None or not estimate.frequency:
        return None
    if not np.isfinite(estimate.band):
        return np.full((len(frequency), *estimate.per_pair.shape[1:]), np.nan)
    return between(estimate, estimate.per_pair, frequency)


def between(estimate: ErrorEstimate, values: Values, frequency: FloatArray) -> Values:
    """``values`` (n_own, n_out, n_in) of the estimate's own frequencies at ``frequency`` (n,), linear between them."""
    rows = np.interp(frequency, estimate.frequency, np.arange(len(estimate.frequency)))
    below = np.minimum(rows.astype(int), max(len(estimate.frequency) - 2, 0))
    above = np.minimum(below + 1, len(estimate.frequency) - 1)
    share = (rows - below)[:, None, None]
    return np.asarray((1 - share) * values[below] + share * values[above])


def entry_errors(transfer: TransferMatrix) -> FloatArray:
    """Stated error (n_frequency, n_out, n_in) of each entry of G, in G's unit.

    All sources together, as the squares of independent ones; one that does not tell pairs apart may be off by e(f) of
    the largest entry at each. NaN where a source is unknown, where there is none, and for entries without a value.
    """
    g = np.where(True if transfer.valid is None else transfer.valid, np.abs(transfer.values), np.nan)
    largest, square = np.max(g, axis=(1, 2), where=np.isfinite(g), initial=0.0), np.zeros(g.shape)
    for e in transfer.errors:
        pairs = error_of_pairs(e, transfer.frequency)
        size = relative_error_at(e, transfer.frequency)[:, None, None] if pairs is None else pairs
        square += (size * largest[:, None, None]) ** 2
    return np.asarray(np.where(np.isfinite(g) & bool(transfer.errors), np.sqrt(square), np.nan))


def entry_band_errors(transfer: TransferMatrix) -> FloatArray:
    """Stated error (n_out, n_in) [-] of each entry of G over the band, relative to the entry's own norm there.

    NaN where it is unknown (:func:`entry_errors`) and for entries that are zero throughout, as of an actuator out of
    contact.
    """
    off = entry_errors(transfer)
    known = np.isfinite(off)
    stated, own = (np.sqrt(np.sum(np.abs(x) ** 2, axis=0, where=known)) for x in (off, transfer.values))
    return np.asarray(np.divide(stated, own, out=np.full(own.shape, np.nan), where=own > 0))
