"""G as CSV, one line per frequency and entry: for spreadsheets, and for people without a library."""

from __future__ import annotations

import codecs
import csv
import io
import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import AccuracyWarning, DataError
from ..ports import Port
from ..store.folder import write_bytes
from ..transfer import TransferMatrix
from ..typing import FloatArray
from .declaration import RawMatrix, arbitrary_gain, port_from
from .reading import numbered_rows, refuse_no_file
from .seal import BLANK, MARK, check_seals, sealed

_COLUMNS = ("frequency_Hz", "output", "input", "real", "imag", "valid", "deviation")
_MARK = "# forearm_fem "
_EDITED = f"if you edited it on purpose, delete its lines that begin with '# {MARK.decode()}', else export it again"


def write_csv(path: str | Path, transfer: TransferMatrix) -> None:
    """One line per frequency, output and input with every digit of G; unit, ports and convention in the
    first line, checksums in the next two.

    NaN stands as ``nan``. Error estimates, ``contacts`` and provenance are not carried: transfer.nc has them.
    DataError for a name of several lines, which could not be read back.
    """
    if broken := [p.name for p in (*transfer.outputs, *transfer.inputs) if len(f"{p.name}.".splitlines()) > 1]:
        raise DataError(f"{path}: the name {broken[0]!r} has a line break, and a line of CSV has none; rename it")
    stream = io.StringIO()
    head = {
        "unit": transfer.unit,
        "quantity": "displacement",
        "sign": "+iwt",
        "spectrum": "one-sided",
        "masked": transfer.valid is not None,
        **arbitrary_gain(transfer.provenance),
        "outputs": [vars(p) for p in transfer.outputs],
        "inputs": [vars(p) for p in transfer.inputs],
    }
    stream.write(_MARK + json.dumps(head) + "\n" + f"# {BLANK.decode()}\n" * 2)
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS if transfer.deviation is not None else _COLUMNS[:-1])
    for (k, o, i), value in np.ndenumerate(transfer.values):
        valid = 1 if transfer.valid is None else int(transfer.valid[k, o, i])
        row = [
            _text(transfer.frequency[k]),
            transfer.outputs[o].name,
            transfer.inputs[i].name,
            _text(value.real),
            _text(value.imag),
        ]
        extra = [] if transfer.deviation is None else [_text(transfer.deviation[k, o, i])]
        writer.writerow([*row, valid, *extra])
    write_bytes(path, sealed(stream.getvalue().encode()))


def _text(value: Any) -> str:
    return repr(float(value))


def read_csv(path: str | Path) -> RawMatrix:
    """G from lines with the columns frequency_Hz, output, input and real, imag or magnitude, phase_rad (or
    phase_deg). Checksums are verified where there are any; who edits a file by hand deletes their lines.

    Lines may come in any order, columns separated by commas, semicolons or tabs; entries that are absent at a frequency
    are marked. Columns ``valid`` and ``deviation`` are read where present, others ignored, and so are blanks around
    what others wrote. Raises DataError with the number of the line that is wrong.
    """
    file = Path(path)
    try:
        head, header, lines = _split(file)
        table = _table(file, header, lines)
        frequency = np.unique(table["frequency_Hz"])
        names = [_in_order(head.get(k), table[k[:-1]]) for k in ("outputs", "inputs")]
        place = (
            np.searchsorted(frequency, table["frequency_Hz"]),
            np.array([names[0].index(n) for n in table["output"]]),
            np.array([names[1].index(n) for n in table["input"]]),
        )
        shape = (len(frequency), len(names[0]), len(names[1]))
        if len(np.unique(np.ravel_multi_index(place, shape))) != len(lines):
            raise DataError(f"{file}: some frequency, output and input occurs on two lines; keep one of them")
        raw = _raw(file, head, frequency, table, place, shape)
        return raw if head else replace(raw, names=(tuple(names[0]), tuple(names[1])))
    except (KeyError, TypeError, ValueError, AttributeError) as problem:
        raise DataError(f"{file}: its first line does not fit the rest or is damaged; export it again") from problem


def _split(file: Path) -> tuple[dict[str, Any], list[str], list[tuple[int, list[str]]]]:
    """Our first line if there is one, the header, and the rows with the numbers of their lines."""
    refuse_no_file(file)
    try:
        content = file.read_bytes().removeprefix(codecs.BOM_UTF8).replace(b"\r\n", b"\n")
        check_seals(content, _EDITED)
        text = content.decode()
    except DataError as problem:
        raise DataError(f"{file}: {problem}") from None
    except (OSError, UnicodeDecodeError):
        raise DataError(f"{file}: cannot be read as text in UTF-8; is it really CSV?") from None
    lines = text.splitlines()
    skipped = next((k for k, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines))
    head: dict[str, Any] = {}
    if lines and lines[0].startswith(_MARK):
        try:
            head = json.loads(lines[0][len(_MARK) :])
        except ValueError:
            raise DataError(f"{file}: its first line is damaged; export it again") from None
    # the names of columns hold neither tabs, semicolons nor commas
    separator = next((c for c in "\t;" if any(c in line for line in lines[skipped : skipped + 1])), ",")
    try:
        rows = numbered_rows(lines[skipped:], separator, skipped + 1)
    except csv.Error as problem:
        raise DataError(f"{file}: is no table ({problem}); is it really CSV?") from None
    if len(rows) < 2:
        raise DataError(f"{file}: has no lines of data; expected a header and one line per frequency and entry")
    (_, header), *body = rows
    if not head:  # names of ours keep their blanks
        body = [(number, [c.strip() for c in row]) for number, row in body]
    return head, [c.strip() for c in header], body


def _table(file: Path, header: list[str], lines: list[tuple[int, list[str]]]) -> dict[str, Any]:
    """Columns by name; numbers as float arrays."""
    missing = [c for c in ("frequency_Hz", "output", "input") if c not in header]
    pair = next((p for p in _PAIRS if all(c in header for c in p)), None)
    if missing or pair is None:
        raise DataError(
            f"{file}: expected the columns frequency_Hz, output, input and real, imag (or magnitude, phase_rad), got "
            f"{', '.join(header)[:120]}"
        )
    read = ("frequency_Hz", "output", "input", "valid", "deviation", *pair)
    _refuse_twice(file, header)
    table: dict[str, Any] = {c: [] for c in header if c in read}
    for number, line in lines:
        if len(line) != len(header):
            raise DataError(
                f"{file}, line {number}: {len(line)} cells, the header has "
                f"{len(header)}; the file is cut short, damaged or has decimal commas"
            )
        for column, cell in zip(header, line, strict=True):
            if column in table:
                table[column].append(cell if column in _NAMES else _number(file, number, column, cell))
    return {**{c: np.array(v) for c, v in table.items()}, "pair": pair}


_NAMES = ("output", "input")
_PAIRS = (("real", "imag"), ("magnitude", "phase_rad"), ("magnitude", "phase_deg"))


def _refuse_twice(file: Path, header: list[str]) -> None:
    """DataError where the header says a thing twice: whichever were read, the other might be meant."""
    pairs = [p for p in _PAIRS if all(c in header for c in p)]
    twice = [" and ".join(dict.fromkeys(c for p in pairs for c in p))] if len(pairs) > 1 else []
    twice += [f"{c} twice" for c in dict.fromkeys(header) if header.count(c) > 1 and c]
    if twice:
        raise DataError(f"{file}: has the columns {twice[0]}; keep those that are meant")


def _number(file: Path, line: int, column: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        if not cell:
            raise DataError(
                f"{file}, line {line}: column {column} is empty; write nan, or leave out lines that were not measured"
            ) from None
        raise DataError(
            f"{file}, line {line}: '{cell}' in column {column} is no number (decimal commas are not read)"
        ) from None
    if column in ("magnitude", "deviation") and value < 0:
        raise DataError(f"{file}, line {line}: {column} is {cell}, expected 0 or more in G's unit, not decibels")
    if column == "valid" and value not in (0, 1):
        raise DataError(f"{file}, line {line}: valid is {cell}, expected 1 or 0")
    return value


def _in_order(ports: Any, names: Any) -> list[str]:
    """Names in the file's own order of ports, or of first appearance."""
    return [p["name"] for p in ports] if ports else list(dict.fromkeys(str(n) for n in names))


def _raw(
    file: Path,
    head: dict[str, Any],
    frequency: FloatArray,
    table: dict[str, Any],
    place: Any,
    shape: tuple[int, int, int],
) -> RawMatrix:
    values, valid = np.full(shape, np.nan + 0j), np.zeros(shape, dtype=bool)
    first, second = (table[c] for c in table["pair"])
    if table["pair"][0] == "real":
        entries = np.empty(len(first), dtype=complex)
        entries.real, entries.imag = first, second
    else:
        degrees = table["pair"][1] == "phase_deg"
        entries = first * np.exp(1j * (np.deg2rad(second) if degrees else second))
        course = np.full(shape, np.nan)
        course[place] = second
        if odd := _other_angle(course, degrees):
            warnings.warn(f"{file}: {odd}", AccuracyWarning, stacklevel=4)
    values[place] = entries
    valid[place] = table["valid"] != 0 if "valid" in table else np.isfinite(values[place])
    deviation = None
    if "deviation" in table:
        deviation = np.full(shape, np.nan)
        deviation[place] = table["deviation"]
    return RawMatrix(
        name=str(file),
        values=values,
        frequency=frequency,
        axes=("frequency", "output", "input"),
        unit=head.get("unit"),
        quantity=head.get("quantity"),
        spectrum=head.get("spectrum"),
        sign=head.get("sign"),
        outputs=_ports(head.get("outputs")),
        inputs=_ports(head.get("inputs")),
        valid=valid if head.get("masked", True) else None,
        deviation=deviation,
        provenance={"format": "CSV", **arbitrary_gain(head)},
    )


def _other_angle(phase: FloatArray, degrees: bool) -> str:
    """What to say of ``phase`` (n_frequency, n_out, n_in) that is hardly in ``degrees``, or else in radians; "" for
    nothing.

    In radians it is wrapped into a turn, or changes by less than half a turn between frequencies. Degrees that fill a
    turn of 2 pi, and no more, are radians.
    """
    known = phase[np.isfinite(phase)]
    if not known.size:
        return ""
    turn, span = 2 * np.pi * 1.001, float(np.ptp(known))
    if degrees:
        filled = 0.85 * turn < span <= turn and float(np.abs(known).max()) <= turn
        return f"phase_deg spans {span:.3g} alone; if that is in radians, name the column phase_rad" if filled else ""
    for o, i in np.ndindex(*phase.shape[1:]):
        entry = phase[np.isfinite(phase[:, o, i]), o, i]
        if len(entry) > 1 and np.ptp(entry) > turn and np.abs(np.diff(entry)).max() > turn / 2:
            return (
                f"phase_rad jumps by {np.abs(np.diff(entry)).max():.3g}, and is not wrapped into a turn either; if it "
                "is in degrees, name the column phase_deg"
            )
    return ""


def _ports(fields: Any) -> tuple[Port, ...] | None:
    if fields is None:
        return None
    return tuple(port_from(f) for f in fields)
