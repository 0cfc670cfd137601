"""Content of a foreign file, entries at their ports by name, and how it becomes G; and the base of readers."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Literal

import numpy as np

from ..errors import AccuracyWarning, DataError
from ..ports import Port
from ..scenario.measurement import Quantity, parse_unit, to_displacement
from ..transfer import ErrorEstimate, TransferMatrix
from ..typing import BoolArray, ComplexArray, FloatArray
from .declaration import (
    EVERY,
    FOI,
    SWEEPS,
    Axis,
    Declaration,
    PortDeclaration,
    Ports,
    RecognitionWarning,
    Sign,
    Spectrum,
    declare,
)


@dataclass(frozen=True)
class Need:
    """One thing that a file must say or be told: how to declare it, what ``else`` is common, whether it is open."""

    key: str
    option: str
    otherwise: str
    is_open: Callable[[RawMatrix, Declaration, Ports | None], bool]


def _silent(key: str) -> Callable[[RawMatrix, Declaration, Ports | None], bool]:
    return lambda raw, said, ports: getattr(raw, key) is None and getattr(said, key) is None


def _axes_open(raw: RawMatrix, said: Declaration, ports: Ports | None) -> bool:
    return ports is not None and (raw.axes or said.axes or axes_by_length(raw, *map(len, ports))) is None


def _frequency_open(raw: RawMatrix, said: Declaration, ports: Ports | None) -> bool:
    return raw.frequency is None and said.sample_rate is None


NEEDS = (
    Need("unit", declare("unit", "'mm/V'"), "", _silent("unit")),
    Need("sign", declare("sign", "'+iwt'"), "'-iwt'", _silent("sign")),
    Need("spectrum", declare("spectrum", "'one-sided'"), "'two-sided'", _silent("spectrum")),
    Need("axes", declare("axes", "['output', 'input', 'frequency']"), "", _axes_open),
    Need("sample_rate", declare("sample_rate", "10000"), "frequency_variable or frequency_file", _frequency_open),
    Need("ports", "--scenario FILE", "", lambda raw, said, ports: ports is None),
)


def unsaid(raw: RawMatrix, said: Declaration, ports: Ports | None) -> str:
    """Sentence on what neither ``raw`` nor ``said`` says, and what would say it; "" where nothing is open."""
    return asked([need for need in NEEDS if need.is_open(raw, said, ports)])


def asked(needs: list[Need], first: str = "") -> str:
    """One sentence that asks for all of ``needs``, and for an option ``first``; "" for nothing."""
    others = ", ".join(need.otherwise for need in needs if need.otherwise)
    where = "where true" + (f" (else {others})" if others else "")
    options = [*([first] if first else []), *(need.option for need in needs)]
    return f"does not say all of itself; add {' '.join(options)} {where}" if options else ""


def axes_by_length(raw: RawMatrix, n_out: int, n_in: int) -> tuple[Axis, ...] | None:
    """Axes told from their lengths; None where these leave a choice."""
    shape = raw.values.shape
    n_frequency = max(shape, default=0) if raw.frequency is None else len(raw.frequency)
    wanted: dict[Axis, int] = {"frequency": n_frequency, "output": n_out, "input": n_in}
    if n_out == n_in == 1 < n_frequency and sorted(shape) == [1, 1, n_frequency]:  # either way round is the same
        order: list[Axis] = ["output", "input"]
        order.insert(shape.index(n_frequency), "frequency")
        return tuple(order)
    found: list[Axis] = [a for length in shape for a in wanted if wanted[a] == length]
    return tuple(found) if len(shape) == len(found) == len(set(found)) == 3 else None


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
    errors: tuple[ErrorEstimate, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)
    names: tuple[tuple[str, ...], tuple[str, ...]] | None = None
    numbered: bool = False


# Entries of a file of somebody else, put where their names belong among the points and actuators of a scenario.

_SHOWN = 6  # names of a list in a sentence
_NUMBER = re.compile(r"^(.*?)0*(\d+)(?:\.0*)?$")


def as_named(word: str, names: Sequence[str], numbered: bool = False) -> str:
    """``word`` as one of ``names``: a number as other programs write it ("1.0", "01"; "A01") is the name that is that
    number, where just one is; any other word stays as it is. The number of a node (``numbered``) is that of a name
    which ends in it, as A3 does."""
    if word in names:
        return word
    alike = [n for n in names if n.lower() == word.lower()]
    if not alike and (mine := _NUMBER.match(word)):
        parts = {n: m for n in names if (m := _NUMBER.match(n))}
        alike = [n for n, m in parts.items() if (m[1].lower(), m[2]) == (mine[1].lower(), mine[2])]
        if not alike and numbered and not mine[1] and len({m[1] for m in parts.values()}) == 1:
            alike = [n for n, m in parts.items() if m[2] == mine[2]]
    return alike[0] if len(alike) == 1 else word


def renamed(raw: RawMatrix, declaration: Declaration, outputs: Sequence[Port], inputs: Sequence[Port]) -> RawMatrix:
    """``raw`` with the names of its columns as declared, else :func:`as_named`; columns that ``points`` or
    ``actuators`` leave out are left out."""
    if raw.names is None:
        if declaration.points or declaration.actuators:
            raise DataError(
                f"{raw.name}: names no points and actuators, so that a map of names has no effect; leave it out"
            )
        return raw
    found, kept = list[tuple[str, ...]](), list[list[int]]()
    maps = (declaration.points, declaration.actuators)
    for own, given, ports in zip(raw.names, maps, (outputs, inputs), strict=True):
        known = [p.name for p in ports]
        told = [_told(n, given, known, raw.numbered) for n in own]
        keep = [k for k, n in enumerate(told) if n is not None]
        names = tuple(n for n in told if n is not None)
        found.append(names if len(set(names)) == len(names) else tuple(own[k] for k in keep))
        kept.append(keep)
    at = np.ix_(*kept)
    arrays = {k: None if (a := getattr(raw, k)) is None else a[:, *at] for k in ("values", "valid", "deviation")}
    changed: dict[str, Any] = {**arrays, "names": (found[0], found[1])}
    return replace(raw, **changed)


def _told(name: str, given: Mapping[str, str] | None, known: Sequence[str], numbered: bool) -> str | None:
    """The port's name of a column; None for a column that is left out."""
    if given is None:
        return as_named(name, known, numbered)
    return next((port for own, port in given.items() if as_named(name, [own]) == own), None)


def unknown_names(named: Sequence[RawMatrix], declaration: Declaration, raws: Sequence[RawMatrix]) -> None:
    """DataError where ``points`` or ``actuators`` map a name that no file has: a slip would leave a port unmeasured."""
    side = [1, 0] if declaration.roving == "hammer" else [0, 1]
    for k, key in zip(side, ("points", "actuators"), strict=True):
        there = {n for raw in raws if raw.names is not None for n in raw.names[k]}
        if lost := [own for own in getattr(declaration, key) or {} if all(as_named(n, [own]) != own for n in there)]:
            raise DataError(
                f"{raws[0].name}: {key} maps '{lost[0]}', which the file does not have; it has {_list(sorted(there))}"
            )


def placed_by_name(raw: RawMatrix, outputs: Sequence[Port], inputs: Sequence[Port]) -> RawMatrix:
    """``raw`` (frequency, output, input) in the order of ``outputs`` and ``inputs``, by the names that the file uses.

    A port that the file lacks is not measured: NaN, marked. Every name is a port's (:func:`strange_names`), or numbers
    of nodes are taken in their order, with a RecognitionWarning. A file that names no ports is returned as it is.
    """
    if raw.names is None:
        return raw
    columns = [
        _columns(raw, kind, named, [p.name for p in ports])
        for kind, named, ports in zip(("output", "input"), raw.names, (outputs, inputs), strict=True)
    ]
    shape = (len(raw.values), len(outputs), len(inputs))
    measured = np.isfinite(raw.values) if raw.valid is None else raw.valid
    return replace(
        raw,
        values=_spread(raw.values, columns, np.full(shape, np.nan + 0j)),
        valid=_spread(measured, columns, np.zeros(shape, dtype=bool)),
        deviation=None if raw.deviation is None else _spread(raw.deviation, columns, np.full(shape, np.nan)),
    )


def strange_names(raw: RawMatrix, outputs: Sequence[Port], inputs: Sequence[Port]) -> str:
    """Complaint of names in the file that no port has; "" for none.

    Numbers of nodes (``raw.numbered``) none of which is a port's name are none, where there are as many as ports.
    """
    keys = ("points", "actuators")
    for kind, key, named, ports in zip(
        ("output", "input"), keys, raw.names or ((), ()), (outputs, inputs), strict=True
    ):
        known = [p.name for p in ports]
        strange = [n for n in named if n not in known]
        if strange and not (raw.numbered and len(strange) == len(named) == len(known)):
            return (
                f"names the {kind}s {_list(strange)}, which are none of {_list(known)}; rename them, name the scenario "
                f"measured, or add --declare \"{key}.{strange[0]}='{known[0]}'\" for each"
            )
    return ""


def _columns(raw: RawMatrix, kind: str, named: Sequence[str], known: Sequence[str]) -> list[int]:
    """Positions of the file's names among the ports' names ``known``."""
    if all(n in known for n in named):
        return [known.index(n) for n in named]
    order = ", ".join(f"{a} as {b}" for a, b in zip(named, known, strict=True))
    warnings.warn(RecognitionWarning(raw.name, f"{kind} nodes, in the order of their numbers,", order), stacklevel=6)
    return list(range(len(known)))


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def _spread(array: ComplexArray | BoolArray | Any, columns: Sequence[list[int]], into: Any) -> Any:
    """``array`` written into the columns of ``into`` that are its own."""
    into[:, np.array(columns[0])[:, None], np.array(columns[1])] = array
    return into

# From a file's content and what is declared of it to G in metres per drive, each entry at its port.

_HERMITIAN = 1e-6  # of the largest value: how far a two-sided spectrum may be from G(-f) = conj G(f)
_SLOW = 5.0  # Hz: no sweep of skin ends below it
_SAME = 1e-6  # relative: frequencies closer than this are one, as where two G are compared
_ARRAYS = ("values", "valid", "deviation")
_ALLOWED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "quantity": ("displacement", "velocity", "acceleration"),
        "spectrum": ("one-sided", "two-sided"),
        "sign": ("+iwt", "-iwt"),
    }
)


def understand(
    raws: RawMatrix | Sequence[RawMatrix], declaration: Declaration, ports: Ports | None = None
) -> TransferMatrix:
    """G in metres per drive from what one file holds, or several that make one G, and what is declared about it.

    ``ports`` (outputs, inputs) serve where neither the file nor the declaration has any; a file that names its columns
    is then read by these names (:func:`placed_by_name`). Raises DataError for all that nobody says at once, and
    where file and declaration contradict each other.
    """
    several = [raws] if isinstance(raws, RawMatrix) else list(raws)
    known = _known_ports(several[0], declaration, ports)
    named = [_named(raw, declaration, known) for raw in several]
    if known is not None:
        unknown_names(named, declaration, several)
    for raw in named:
        strange = "" if known is None else strange_names(raw, *known)
        if open_ends := [s for s in (strange, unsaid(raw, declaration, known)) if s]:
            raise DataError(f"{raw.name}: {'; it '.join(open_ends)}")
    assert known is not None  # else asked for
    parts = [_part(raw, declaration, known) for raw in named]
    transfer = parts[0] if len(parts) == 1 else _joined(parts)
    low, high = declaration.band or (0.0, np.inf)
    keep = (transfer.frequency >= low - 1e-9) & (transfer.frequency <= high + 1e-9)
    name = several[0].name
    if not keep.any():
        raise DataError(f"{name}: no frequency lies in the declared band {low:g} to {high:g} Hz")
    cut = _rows(transfer, keep)
    if cut["valid"] is not None and not cut["valid"].any():
        raise DataError(f"{name}: every entry is zero or not finite; the file holds no measurement")
    return replace(transfer, frequency=transfer.frequency[keep], **cut)


def _known_ports(raw: RawMatrix, declaration: Declaration, ports: Ports | None) -> Ports | None:
    outputs = raw.outputs or _declared(declaration.outputs, "point") or (ports[0] if ports else None)
    inputs = raw.inputs or _declared(declaration.inputs, "contact") or (ports[1] if ports else None)
    return None if outputs is None or inputs is None else (outputs, inputs)


def _declared(ports: tuple[PortDeclaration, ...] | None, kind: Literal["point", "contact"]) -> tuple[Port, ...] | None:
    if ports is None:
        return None
    return tuple(Port(p.name, kind, p.position, radius=p.radius) for p in ports)


def _named(raw: RawMatrix, declaration: Declaration, known: Ports | None) -> RawMatrix:
    """``raw`` turned where the hammer roved, and with its columns called as the ports are."""
    if declaration.roving == "hammer":
        raw = _reciprocal(raw, declaration)
    return raw if known is None else renamed(raw, declaration, *known)


def _reciprocal(raw: RawMatrix, declaration: Declaration) -> RawMatrix:
    """``raw`` with responses and drives exchanged: where the hammer hit is where the skin would move, as displacement
    per force is the same either way. DataError for a drive that is no force."""
    unit = raw.unit or declaration.unit
    if unit is not None and parse_unit(unit).si != "m/N":
        raise DataError(
            f"{raw.name}: roving = 'hammer' takes G by reciprocity, which holds between force and motion, but its unit "
            f"is {unit}; leave it out"
        )
    axes = raw.axes or declaration.axes
    if axes is None or sorted(axes) != sorted(FOI) or raw.values.ndim != 3:
        return raw  # told from their lengths later, by the ports they will be of, or refused there
    swapped = tuple({"output": "input", "input": "output"}.get(a, a) for a in axes)
    order = [swapped.index(a) for a in FOI]
    arrays = {k: None if (a := getattr(raw, k)) is None else np.transpose(a, order) for k in _ARRAYS}
    names = None if raw.names is None else (raw.names[1], raw.names[0])
    changed: dict[str, Any] = {**arrays, "names": names, "axes": FOI}
    return replace(raw, provenance={**raw.provenance, "reciprocity": "the hammer roved"}, **changed)


def _part(raw: RawMatrix, declaration: Declaration, known: Ports) -> TransferMatrix:
    """G of one file on all ``known`` ports; what it lacks is marked."""
    outputs, inputs = known
    if declaration.roving == "hammer":  # its axes were put in order
        declaration = declaration.model_copy(update={"axes": None} if raw.axes is not None else {})
    named = placed_by_name(raw, outputs, inputs)
    ordered = _ordered(named, declaration, len(outputs), len(inputs))
    ordered, frequency = _united(ordered, _frequency(ordered, declaration))
    one_sided = _one_sided(ordered, frequency, _agreed(raw, declaration, "spectrum"))
    part = _metres(one_sided, declaration, outputs, inputs)
    if odd := _odd(ordered, outputs, inputs):
        warnings.warn(f"{raw.name}: {odd}", AccuracyWarning, stacklevel=4)
    return part


def _rows(result: Any, rows: Any) -> dict[str, Any]:
    """The arrays over frequency of ``result`` at ``rows``."""
    return {k: None if (a := getattr(result, k)) is None else a[rows] for k in _ARRAYS}


def _odd(raw: RawMatrix, outputs: tuple[Port, ...], inputs: tuple[Port, ...]) -> str:
    """Doubt of the meaning of ``raw`` (frequency, output, input), and the likelier one; "" for none."""
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


def _agreed(raw: RawMatrix, declaration: Declaration, key: str) -> Any:
    """Value by the file, or the declaration, or None; DataError if they differ."""
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


def _ordered(raw: RawMatrix, declaration: Declaration, n_out: int, n_in: int) -> RawMatrix:
    """``raw`` in the order (frequency, output, input)."""
    axes = _agreed(raw, declaration, "axes")
    if axes is None:
        axes = axes_by_length(raw, n_out, n_in)
        assert axes is not None  # else asked for
        warnings.warn(RecognitionWarning(raw.name, f"axes of shape {raw.values.shape}", ", ".join(axes)), stacklevel=5)
    if sorted(axes) != sorted(FOI) or raw.values.ndim != 3:
        raise DataError(
            f"{raw.name}: an array of shape {raw.values.shape} cannot have the axes {', '.join(axes)}; "
            "name frequency, output and input once each"
        )
    order = [axes.index(a) for a in FOI]
    turned: dict[str, Any] = {
        k: a if (a := getattr(raw, k)) is None else np.ascontiguousarray(np.transpose(a, order)) for k in _ARRAYS
    }
    result = replace(raw, axes=FOI, **turned)
    if result.values.shape[1:] != (n_out, n_in):
        raise DataError(
            f"{raw.name}: holds {result.values.shape[1]} outputs and {result.values.shape[2]} inputs, "
            f"expected {n_out} and {n_in}; declare other axes, or name the scenario that was measured"
        )
    return result


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
        if raw.spectrum is None and mirrored < _HERMITIAN and len(frequency) > 8:
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
    dark = ~np.isfinite(raw.values) | np.all(np.nan_to_num(raw.values) == 0, axis=(1, 2), keepdims=True)
    usable = ~dark if raw.valid is None else raw.valid & ~dark
    said = declaration.model_dump(mode="json", exclude_none=True, exclude_defaults=True, exclude={"outputs", "inputs"})
    gain = {"gain": "arbitrary"} if declaration.arbitrary_gain else {}
    return TransferMatrix(
        frequency=raw.frequency,
        values=values,
        outputs=outputs,
        inputs=inputs,
        unit=unit.si,
        valid=None if usable.all() and raw.valid is None else np.asarray(usable),
        deviation=deviation,
        errors=raw.errors,
        provenance={"source": "file", "file": raw.name, "declared": said, **gain, **raw.provenance},
    )


def _joined(parts: Sequence[TransferMatrix]) -> TransferMatrix:
    """One G of several that hold entries of it, on all their frequencies; DataError for an entry known to two."""
    if len(units := {p.unit for p in parts}) > 1:
        raise DataError(f"the files to be joined have different units ({', '.join(sorted(units))}); export all in one")
    every = np.unique(np.concatenate([p.frequency for p in parts]))
    frequency = every[np.concatenate([[True], np.diff(every) >= _SAME * every[1:]])]
    shape = (len(frequency), *parts[0].values.shape[1:])
    values, valid, owner = np.full(shape, np.nan + 0j), np.zeros(shape, bool), np.full(shape, -1)
    deviation = np.full(shape, np.nan) if any(p.deviation is not None for p in parts) else None
    for k, part in enumerate(parts):
        rows = np.searchsorted(frequency, part.frequency * (1 - _SAME / 2))
        known = np.isfinite(part.values) if part.valid is None else part.valid
        present = known | np.isfinite(part.values)
        here = owner[rows]
        if (twice := present & (here >= 0)).any():
            at, o, i = (int(a[0]) for a in np.nonzero(twice))
            names = [str(parts[j].provenance["file"]) for j in (int(here[at, o, i]), k)]
            raise DataError(
                f"{names[1]}: {part.outputs[o].name} <- {part.inputs[i].name} is in {names[0]} too; keep one of them"
            )
        owner[rows] = np.where(present, k, here)
        values[rows] = np.where(present, part.values, values[rows])
        valid[rows] |= known
        if deviation is not None and part.deviation is not None:
            deviation[rows] = np.where(present, part.deviation, deviation[rows])
    files = [str(p.provenance["file"]) for p in parts]
    return replace(
        parts[0], frequency=frequency, values=values, valid=None if valid.all() else valid, deviation=deviation,
        errors=(), provenance={**parts[0].provenance, "file": files[0], "files": files},
    )  # fmt: skip


# A kind of file: its endings, what may be declared of it, and how its content becomes a matrix.

class Reader:
    """Reader of one kind of file.

    ``kind`` names it in sentences, ``endings`` are its files', ``takes`` what may be declared of it beyond
    :data:`.declaration.EVERY`. What a file must say or be told is in :data:`NEEDS`.
    """

    kind: ClassVar[str]
    endings: ClassVar[tuple[str, ...]]
    takes: ClassVar[frozenset[str]] = frozenset()

    def raw(self, file: Path, said: Declaration) -> RawMatrix:
        """The content of ``file``; DataError in one sentence for what is wrong with it."""
        raise NotImplementedError

    def read(self, file: Path, said: Declaration, ports: Ports | None) -> TransferMatrix:
        """G in ``file``, of ``ports`` (outputs, inputs) where it names none."""
        return understand(self.checked(file, said), said, ports)

    def checked(self, file: Path, said: Declaration) -> RawMatrix:
        """:meth:`raw`, where all that is declared has an effect; DataError otherwise."""
        self.refuse_idle(file, said)
        raw = self.raw(file, said)
        known = {"outputs": raw.outputs, "inputs": raw.inputs, "sample_rate": raw.frequency}
        if idle := [k for k, own in known.items() if own is not None and getattr(said, k) is not None]:
            raise DataError(
                f"{raw.name}: says that itself, so that {idle[0]} has no effect; leave it out of the declaration"
            )
        return raw

    def refuse_idle(self, file: Path, said: Declaration) -> None:
        """DataError for what is declared and would change nothing of this kind of file."""
        plain = Declaration()
        given = [k for k in Declaration.model_fields if getattr(said, k) != getattr(plain, k)]
        if idle := [k for k in given if k not in EVERY | self.takes]:
            more = ""
            if idle[0] in SWEEPS:
                more = " (it is of raw sweeps: TDMS, LVM, WAV, or tables in time)"
            raise DataError(
                f"{file}: {idle[0]} has no effect on {self.kind}{more}; leave it out of the declaration"
            )
