"""What a file of somebody else must say, or be told, before its numbers become a G: nothing is guessed silently."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from pydantic import Field

from ..errors import AccuracyWarning, DataError
from ..ports import Port
from ..scenario.base import Part, Positive
from ..scenario.measurement import Quantity
from ..transfer import TransferMatrix
from ..typing import BoolArray, ComplexArray, FloatArray
from .naming import placed_by_name, renamed, strange_names
from .reading import RecognitionWarning
from .units import parse_unit, to_displacement

Axis = Literal["frequency", "output", "input"]
Spectrum = Literal["one-sided", "two-sided"]
Sign = Literal["+iwt", "-iwt"]
_HERMITIAN = 1e-6  # of the largest value: how far a two-sided spectrum may be from G(-f) = conj G(f)
_SLOW = 5.0  # Hz: no sweep of skin ends below it
_SAME = 1e-6  # relative: frequencies closer than this are one, as where two G are compared


class PortDeclaration(Part):
    """A port of a measured G: its name and place [m]."""

    name: str
    position: tuple[float, float, float]
    radius: float = 0.0


class Declaration(Part):
    """What the user knows about a file. Left out: the file must say it itself, or a DataError asks."""

    quantity: Quantity | None = Field(
        default=None, description="what the numerator is; not needed where the unit says it"
    )
    unit: str | None = Field(default=None, description="motion over drive as stored, e.g. mm/V, (mm/s)/V, m/s^2/N")
    arbitrary_gain: bool = Field(
        default=False, description="the scale is unknown: shapes and S are meaningful, microns are not"
    )
    spectrum: Spectrum | None = Field(
        default=None, description="two-sided: FFT order, negative frequencies in the upper half"
    )
    sign: Sign | None = Field(default=None, description="time dependence; numpy's and MATLAB's fft give +iwt")
    axes: tuple[Axis, ...] | None = Field(default=None, description="order of the array's axes")
    variable: str | None = Field(default=None, description="name of the array in a MATLAB file")
    frequency_variable: str | None = Field(
        default=None, description="name of the frequency vector in a MATLAB file [Hz]"
    )
    valid_variable: str | None = Field(default=None, description="name of a mask of G's shape in a MATLAB file")
    sample_rate: Positive | None = Field(
        default=None, description="[Hz]; bin k lies at k sample_rate / bins (two-sided)"
    )
    band: tuple[Positive, Positive] | None = Field(default=None, description="keep these frequencies only [Hz]")
    outputs: tuple[PortDeclaration, ...] | None = None
    inputs: tuple[PortDeclaration, ...] | None = None


@dataclass(frozen=True, eq=False)
class RawMatrix:
    """A file's content before it is understood; whatever the file says about itself, None where it is silent.

    ``values`` in the order of ``axes``; ``frequency`` (n,) [Hz] as stored. ``deviation`` is in the file's unit.
    ``names`` (outputs, inputs) are what a file without ports calls its entries, which then come in the order
    (frequency, output, input); ``numbered`` where they are numbers of nodes.
    """

    name: str
    values: ComplexArray
    frequency: FloatArray | None = None
    axes: tuple[Axis, ...] | None = None
    unit: str | None = None
    quantity: Quantity | None = None
    spectrum: Spectrum | None = None
    sign: Sign | None = None
    outputs: tuple[Port, ...] | None = None
    inputs: tuple[Port, ...] | None = None
    valid: BoolArray | None = None
    deviation: FloatArray | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    names: tuple[tuple[str, ...], tuple[str, ...]] | None = None
    numbered: bool = False


Ports = tuple[tuple[Port, ...], tuple[Port, ...]]


def port_from(fields: Mapping[str, Any]) -> Port:
    """A port from its fields as JSON holds them (lists for tuples)."""
    plain: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in fields.items()}
    return Port(**plain)


def _rows(result: Any, rows: Any) -> dict[str, Any]:
    """The arrays over frequency of ``result`` at ``rows``."""
    return {k: None if (a := getattr(result, k)) is None else a[rows] for k in ("values", "valid", "deviation")}


def understand(raw: RawMatrix, declaration: Declaration, ports: Ports | None = None) -> TransferMatrix:
    """G in metres per drive from ``raw`` and what is declared about it.

    ``ports`` (outputs, inputs) serve where neither the file nor the declaration has any; a file that names its columns
    is then read by these names (:func:`.naming.placed_by_name`). Raises DataError for all that nobody says at once, and
    where file and declaration contradict each other.
    """
    _refuse_idle(raw, declaration)
    outputs = raw.outputs or _declared(declaration.outputs, "point") or (ports[0] if ports else None)
    inputs = raw.inputs or _declared(declaration.inputs, "contact") or (ports[1] if ports else None)
    known = None if outputs is None or inputs is None else (outputs, inputs)
    raw = raw if known is None else renamed(raw, *known)
    strange = "" if known is None else strange_names(raw, *known)
    if open_ends := [s for s in (strange, unsaid(raw, declaration, known)) if s]:
        raise DataError(f"{raw.name}: {'; it '.join(open_ends)}")
    assert outputs is not None
    assert inputs is not None
    named = placed_by_name(raw, outputs, inputs)
    ordered = _ordered(named, declaration, len(outputs), len(inputs))
    ordered, frequency = _united(ordered, _frequency(ordered, declaration))
    one_sided = _one_sided(ordered, frequency, _agreed(raw, declaration, "spectrum"))
    transfer = _metres(one_sided, declaration, outputs, inputs)
    low, high = declaration.band or (0.0, np.inf)
    keep = (transfer.frequency >= low - 1e-9) & (transfer.frequency <= high + 1e-9)
    if not keep.any():
        raise DataError(f"{raw.name}: no frequency lies in the declared band {low:g} to {high:g} Hz")
    cut = _rows(transfer, keep)
    if cut["valid"] is not None and not cut["valid"].any():
        raise DataError(f"{raw.name}: every entry is zero or not finite; the file holds no measurement")
    if odd := _odd(ordered, outputs, inputs):
        warnings.warn(f"{raw.name}: {odd}", AccuracyWarning, stacklevel=3)
    return replace(transfer, frequency=transfer.frequency[keep], **cut)


def _odd(raw: RawMatrix, outputs: tuple[Port, ...], inputs: tuple[Port, ...]) -> str:
    """What ``raw`` (frequency, output, input) can hardly be meant to be, and what then; "" for nothing."""
    if raw.frequency is not None and 0 < (last := float(np.max(raw.frequency))) < _SLOW:
        return f"its frequencies end at {last:g} Hz; if they are kilohertz, nothing that is made of this G holds"
    finite = np.nan_to_num(raw.values)
    real = finite.any(axis=0) & ~finite.imag.any(axis=0)
    if len(finite) < 2 or not real.any():
        return ""
    o, i = (int(k[0]) for k in np.nonzero(real))
    which = "every value"
    if real.sum() < finite.any(axis=0).sum():
        which += f" of {real.sum()} entries, of {outputs[o].name} <- {inputs[i].name} first,"
    return (
        f"{which} is real; if these are magnitudes or real parts alone, the phase is lost and nothing that is made of "
        "this G holds: export real and imaginary part"
    )


def _refuse_idle(raw: RawMatrix, declaration: Declaration) -> None:
    """DataError for what is declared and would change nothing."""
    named = [] if raw.provenance.get("format") == "MATLAB" else ["variable", "frequency_variable", "valid_variable"]
    known = [k for k, own in (("outputs", raw.outputs), ("inputs", raw.inputs), ("sample_rate", raw.frequency))
             if own is not None]  # fmt: skip
    for keys, why in ((named, "has no variables"), (known, "says that itself")):
        if idle := [k for k in keys if getattr(declaration, k) is not None]:
            raise DataError(f"{raw.name}: {why}, so that {idle[0]} has no effect; leave it out of the declaration")


def _agreed(raw: RawMatrix, declaration: Declaration, key: str) -> Any:
    """What the file says, or the declaration, or None; DataError if they differ."""
    said, declared = getattr(raw, key), getattr(declaration, key)
    both = said is not None and declared is not None
    if both and said != declared and not (key == "unit" and parse_unit(said) == parse_unit(declared)):
        raise DataError(
            f"{raw.name}: the file says {key} = {said}, the declaration {declared}; correct the declaration"
        )
    value = said if said is not None else declared
    if value is not None and value not in (allowed := _ALLOWED.get(key, (value,))):
        choices = " or ".join(map(repr, allowed))
        raise DataError(f"{raw.name}: says {key} = {value!r}, which is unknown; correct the file to {choices}")
    return value


_ALLOWED: Mapping[str, tuple[Any, ...]] = {
    "quantity": ("displacement", "velocity", "acceleration"),
    "spectrum": ("one-sided", "two-sided"),
    "sign": ("+iwt", "-iwt"),
}
_ASKED: Mapping[str, str] = MappingProxyType(  # of most files, in the order asked for
    {"unit": "'mm/V'", "sign": "'+iwt'", "spectrum": "'one-sided'"}
)
_ELSE: Mapping[str, str] = MappingProxyType(
    {"sign": "'-iwt'", "spectrum": "'two-sided'", "sample_rate": "frequency_variable"}
)


def unsaid(raw: RawMatrix, declaration: Declaration, ports: Ports | None) -> str:
    """All that neither ``raw`` nor ``declaration`` says, and what would say it; "" where nothing is open."""
    silent = left_open(raw, declaration)
    if ports is not None and (raw.axes or declaration.axes or axes_by_length(raw, *map(len, ports))) is None:
        silent["axes"] = declare("axes", "['output', 'input', 'frequency']")
    if raw.frequency is None and declaration.sample_rate is None:
        silent["sample_rate"] = declare("sample_rate", "10000")
    if ports is None:
        silent["points and actuators"] = "--scenario FILE"
    return asked(silent)


def left_open(said: RawMatrix | None, declaration: Declaration) -> dict[str, str]:
    """How to declare, by key, what every file must say and neither it (None: says nothing) nor ``declaration`` does."""
    silent = [k for k in _ASKED if getattr(said, k, None) is None and getattr(declaration, k) is None]
    return {k: declare(k, _ASKED[k]) for k in silent}


def asked(silent: Mapping[str, str]) -> str:
    """One sentence for all of ``silent``; "" for nothing."""
    others = ", ".join(v for k, v in _ELSE.items() if k in silent)
    where = "where true" + (f" (else {others})" if others else "")
    return f"does not say all of itself; add {' '.join(silent.values())} {where}" if silent else ""


def arbitrary_gain(provenance: Mapping[str, Any]) -> dict[str, str]:
    """What of ``provenance`` says that a G's scale is unknown: ``{"gain": "arbitrary"}``, or nothing."""
    return {"gain": "arbitrary"} if provenance.get("gain") == "arbitrary" else {}


def declare(key: str, value: str) -> str:
    """The option that declares ``key``, as it is typed."""
    return f'--declare "{key}={value}"'


@contextmanager
def declared_by(option: str) -> Iterator[None]:
    """Errors of the block name ``option`` in the place of ``--declare``."""
    try:
        yield
    except DataError as problem:
        raise DataError(str(problem).replace("--declare ", f"{option} ")) from None


def _declared(ports: tuple[PortDeclaration, ...] | None, kind: Literal["point", "contact"]) -> tuple[Port, ...] | None:
    if ports is None:
        return None
    return tuple(Port(p.name, kind, p.position, radius=p.radius) for p in ports)


def _ordered(raw: RawMatrix, declaration: Declaration, n_out: int, n_in: int) -> RawMatrix:
    """``raw`` in the order (frequency, output, input)."""
    axes = _agreed(raw, declaration, "axes")
    if axes is None:
        axes = axes_by_length(raw, n_out, n_in)
        assert axes is not None  # else asked for
        warnings.warn(RecognitionWarning(raw.name, f"axes of shape {raw.values.shape}", ", ".join(axes)), stacklevel=4)
    if sorted(axes) != ["frequency", "input", "output"] or raw.values.ndim != 3:
        raise DataError(
            f"{raw.name}: an array of shape {raw.values.shape} cannot have the axes {', '.join(axes)}; "
            "name frequency, output and input once each"
        )
    order = [axes.index(a) for a in ("frequency", "output", "input")]
    arrays: dict[str, Any] = {k: getattr(raw, k) for k in ("values", "valid", "deviation")}
    turned: dict[str, Any] = {
        k: a if a is None else np.ascontiguousarray(np.transpose(a, order)) for k, a in arrays.items()
    }
    result = replace(raw, axes=("frequency", "output", "input"), **turned)
    if result.values.shape[1:] != (n_out, n_in):
        raise DataError(
            f"{raw.name}: holds {result.values.shape[1]} outputs and {result.values.shape[2]} inputs, "
            f"expected {n_out} and {n_in}; declare other axes, or name the scenario that was measured"
        )
    return result


def axes_by_length(raw: RawMatrix, n_out: int, n_in: int) -> tuple[Axis, ...] | None:
    """Axes told from their lengths; None where these leave a choice."""
    shape = raw.values.shape
    n_frequency = max(shape, default=0) if raw.frequency is None else len(raw.frequency)
    wanted: dict[Axis, int] = {"frequency": n_frequency, "output": n_out, "input": n_in}
    found: list[Axis] = [a for length in shape for a in wanted if wanted[a] == length]
    return tuple(found) if len(shape) == len(found) == len(set(found)) == 3 else None


def _frequency(raw: RawMatrix, declaration: Declaration) -> FloatArray:
    n = len(raw.values)
    if raw.frequency is not None:
        frequency = np.asarray(raw.frequency, dtype=float).ravel()
        if len(frequency) != n:
            raise DataError(
                f"{raw.name}: {len(frequency)} frequencies for {n} matrices; the file is cut short or mixed up"
            )
        if not np.all(np.isfinite(frequency)):
            raise DataError(f"{raw.name}: some frequencies are not finite; repair the frequency vector")
        return frequency
    assert declaration.sample_rate is not None  # else asked for
    if _agreed(raw, declaration, "spectrum") == "two-sided":
        return np.arange(n) * declaration.sample_rate / n
    return np.arange(n) * declaration.sample_rate / (2 * (n - 1))


def _united(raw: RawMatrix, frequency: FloatArray) -> tuple[RawMatrix, FloatArray]:
    """Rows at frequencies that differ by rounding alone as one: entries measured with axes of their own have such.

    DataError where an entry is known in two of them.
    """
    step = np.diff(frequency)
    near = (step > 0) & (step < _SAME * frequency[1:])
    if not near.any():
        return raw, frequency
    row = np.concatenate([[0], np.cumsum(~near)])
    known = np.isfinite(raw.values) if raw.valid is None else raw.valid & np.isfinite(raw.values)
    shape = (row[-1] + 1, *raw.values.shape[1:])
    count = np.zeros(shape, dtype=int)
    np.add.at(count, row, known)
    if (count > 1).any():
        first = frequency[np.nonzero(row == np.nonzero((count > 1).any(axis=(1, 2)))[0][0])[0]]
        raise DataError(
            f"{raw.name}: {float(first[0])!r} and {float(first[1])!r} Hz are one frequency, and some entry is known at "
            "both; keep one of them"
        )
    at, o, i = np.nonzero(known)
    values, deviation = np.full(shape, np.nan + 0j), None if raw.deviation is None else np.full(shape, np.nan)
    values[row[at], o, i] = raw.values[at, o, i]
    if deviation is not None and raw.deviation is not None:
        deviation[row[at], o, i] = raw.deviation[at, o, i]
    firsts = np.concatenate([[True], ~near])
    return replace(raw, values=values, valid=count > 0, deviation=deviation), frequency[firsts]


def _one_sided(raw: RawMatrix, frequency: FloatArray, spectrum: Spectrum) -> RawMatrix:
    """The positive frequencies; a two-sided array must mirror itself, a one-sided one must not."""
    mirrored = _mirror_error(raw.values)
    if spectrum == "two-sided":
        if mirrored > _HERMITIAN:
            raise DataError(
                f"{raw.name}: declared two-sided, but its upper half is not the conjugate mirror of the lower one (off "
                f"by {mirrored:.1e}); it is one-sided, in another bin order, or damaged"
            )
        keep = slice(1, (len(frequency) + 1) // 2)
    else:
        if mirrored < _HERMITIAN and len(frequency) > 8:
            said = declare("spectrum", "'two-sided'")
            raise DataError(f"{raw.name}: declared one-sided, but its upper half mirrors the lower one; use {said}")
        keep = slice(int(frequency[0] == 0), None)
    kept = frequency[keep]
    if len(kept) == 0 or kept[0] <= 0 or np.any(np.diff(kept) <= 0):
        raise DataError(
            f"{raw.name}: the frequencies must be positive and increase; sort them, or declare the other spectrum"
        )
    return replace(raw, frequency=kept, **_rows(raw, keep))


def _mirror_error(values: ComplexArray) -> float:
    """max |G_k - conj G_(n-k)| / max |G|, 1 for nothing to compare."""
    finite = np.where(np.isfinite(values), values, 0)
    size = float(np.abs(finite).max(initial=0.0))
    if len(values) < 4 or size == 0:
        return 1.0
    return float(np.abs(finite[1:] - finite[:0:-1].conj()).max() / size)


def _metres(
    raw: RawMatrix, declaration: Declaration, outputs: tuple[Port, ...], inputs: tuple[Port, ...]
) -> TransferMatrix:
    assert raw.frequency is not None
    unit = parse_unit(_agreed(raw, declaration, "unit"))
    quantity = _agreed(raw, declaration, "quantity") or unit.quantity
    if quantity != unit.quantity:
        what = f"{'an' if quantity == 'acceleration' else 'a'} {quantity}"
        raise DataError(
            f"{raw.name}: {what} cannot have the unit '{raw.unit or declaration.unit}'; correct one of them"
        )
    sign = _agreed(raw, declaration, "sign")
    factor = unit.factor * to_displacement(raw.frequency, quantity)[:, None, None]
    finite = np.where(np.isfinite(raw.values), raw.values, np.nan)  # an infinite entry is as unmeasured as NaN
    values = (finite.conj() if sign == "-iwt" else finite) * factor
    deviation = None if raw.deviation is None else raw.deviation * np.abs(factor)
    # entries that are not finite, and frequencies at which all of G is zero, are never usable
    dark = ~np.isfinite(raw.values) | np.all(raw.values == 0, axis=(1, 2), keepdims=True)
    usable = ~dark if raw.valid is None else raw.valid & ~dark
    said = declaration.model_dump(mode="json", exclude_none=True, exclude={"outputs", "inputs"})
    gain = {"gain": "arbitrary"} if declaration.arbitrary_gain else {}
    return TransferMatrix(
        frequency=raw.frequency,
        values=values,
        outputs=outputs,
        inputs=inputs,
        unit=unit.si,
        valid=None if usable.all() and raw.valid is None else np.asarray(usable),
        deviation=deviation,
        provenance={"source": "file", "file": raw.name, "declared": said, **gain, **raw.provenance},
    )
