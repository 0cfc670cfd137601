"""G as a table, one line per frequency and entry: for spreadsheets, and for people without a library."""

from __future__ import annotations

import csv
import json
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ..errors import AccuracyWarning, DataError, ForearmError
from ..ports import Port
from ..store.folder import write_bytes
from ..transfer import TransferMatrix
from ..typing import FloatArray
from .declaration import (
    FOI,
    Declaration,
    RecognitionWarning,
    arbitrary_gain,
    errors_from,
    plain_errors,
    port_from,
    text_in,
)
from .reader import RawMatrix, Reader

_COLUMNS = ("frequency_Hz", "output", "input", "real", "imag", "valid", "deviation")
_MARK = "# forearm_fem "
_STATED = {"unit", "quantity", "spectrum", "sign"}  # keys of a declaration that a first comment may say
_NAMES = ("output", "input")
_PAIRS = (("real", "imag"), ("magnitude", "phase_rad"), ("magnitude", "phase_deg"))
_COMMENT = ("#", "%", "!", "//")
_ALIASES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {  # without blanks, brackets, dots and underscores, in small letters
        "frequency_Hz": ("frequency", "freq", "frequenz", "frequencyhz", "freqhz", "fhz", "f", "hz", "frequenzhz"),
        "output": ("output", "point", "response", "responsenode", "out", "punkt"),
        "input": ("input", "actuator", "reference", "referencenode", "in", "aktor"),
        "real": ("real", "re", "realpart", "realteil"),
        "imag": ("imag", "im", "imaginary", "imaginarypart", "imaginarteil", "imaginärteil"),
        "magnitude": ("magnitude", "mag", "amplitude", "abs", "betrag"),
        "phase_deg": ("phasedeg", "phase°", "phasedegree", "phasedegrees", "phasegrad"),
        "phase_rad": ("phaserad", "phaseradian", "phaseradians"),
        "valid": ("valid",),
        "deviation": ("deviation", "standarddeviation", "std"),
        "time": ("time", "times", "t", "ts", "zeit", "zeits"),
    }
)
_OTHER_UNITS = ("khz", "rads", "mhz", "rpm", "db")
_COMMA = re.compile(r"^[+-]?\d*,\d+(?:[eE][+-]?\d+)?$")
_THOUSANDS = re.compile(r"^[+-]?\d{1,3}(?:[.,']\d{3})+(?:[.,]\d+)?$")


def write_csv(path: str | Path, transfer: TransferMatrix) -> None:
    """One line per frequency, output and input with every digit of G; unit, ports and convention in the first line.

    NaN stands as ``nan``. The first line tells the errors by source, too, not how pairs share them; that, ``contacts``
    and provenance are not carried: netCDF has them.
    DataError for a name of several lines, which could not be read back.
    """
    import pandas as pd

    if broken := [p.name for p in (*transfer.outputs, *transfer.inputs) if len(f"{p.name}.".splitlines()) > 1]:
        raise DataError(f"{path}: the name {broken[0]!r} has a line break, and a line of CSV has none; rename it")
    head = {
        "unit": transfer.unit,
        "quantity": "displacement",
        "sign": "+iwt",
        "spectrum": "one-sided",
        "masked": transfer.valid is not None,
        **arbitrary_gain(transfer.provenance),
        "errors": plain_errors(transfer.errors),
        "outputs": [vars(p) for p in transfer.outputs],
        "inputs": [vars(p) for p in transfer.inputs],
    }
    k, o, i = (index.ravel() for index in np.indices(transfer.values.shape))
    names = [np.array([p.name for p in ports], dtype=object) for ports in (transfer.outputs, transfer.inputs)]
    valid = np.ones(transfer.values.shape) if transfer.valid is None else transfer.valid
    columns = [transfer.frequency[k], names[0][o], names[1][i], transfer.values.real.ravel(),
               transfer.values.imag.ravel(), valid.ravel().astype(int)]  # fmt: skip
    columns += [] if transfer.deviation is None else [transfer.deviation.ravel()]
    table = pd.DataFrame(dict(zip(_COLUMNS, columns, strict=False)))
    text = str(table.to_csv(index=False, lineterminator="\n", na_rep="nan"))
    write_bytes(path, f"{_MARK}{json.dumps(head)}\n{text}".encode())


@dataclass(frozen=True)
class Table:
    """Cells of a table: our own first line, the names of the columns, and rows with the numbers of their lines.

    ``said`` is what a first comment of JSON, ``# {"unit": "mm/V", "sign": "+iwt"}``, says of the numbers.
    """

    own: dict[str, Any]
    header: list[str]
    rows: list[tuple[int, list[str]]]
    said: Declaration = field(default_factory=Declaration)


class TableReader(Reader):
    """G from lines with the columns frequency_Hz, output, input and real, imag or magnitude, phase_rad (or phase_deg).

    Lines may come in any order, columns separated by commas, semicolons or tabs, with decimal commas where columns are
    not separated by commas; entries that are absent at a frequency are marked. A table without the columns output and
    input is of one entry. Columns ``valid`` and ``deviation`` are read where present, others ignored.
    """

    kind: ClassVar[str] = "a table"
    endings: ClassVar[tuple[str, ...]] = (".csv", ".tsv", ".txt", ".asc")

    def raw(self, file: Path, said: Declaration) -> RawMatrix:
        """See :meth:`.Reader.raw`; what is wrong with a row is said with the number of its line."""
        table = read_table(file)
        if "time" in table.header:
            raise DataError(
                f"{file}: is in time; name its channels with --declare drive=... and response=..., and "
                "`forearm-fem convert` makes G of it"
            )
        columns = _columns(file, table)
        try:
            frequency = np.unique(columns["frequency_Hz"])
            single = "output" not in columns
            names = [[""], [""]] if single else [
                _in_order(table.own.get(k), columns[k[:-1]]) for k in ("outputs", "inputs")
            ]  # fmt: skip
            zeros = np.zeros(len(table.rows), dtype=int)
            place = (
                np.searchsorted(frequency, columns["frequency_Hz"]),
                zeros if single else np.array([names[0].index(n) for n in columns["output"]]),
                zeros if single else np.array([names[1].index(n) for n in columns["input"]]),
            )
            shape = (len(frequency), len(names[0]), len(names[1]))
            if len(np.unique(np.ravel_multi_index(place, shape))) != len(table.rows):
                what = "frequency" if single else "frequency, output and input"
                raise DataError(f"{file}: some {what} occurs on two lines; keep one of them")
            stated = table.own or table.said.model_dump(exclude_none=True, include=_STATED)
            raw = _raw(file, stated, frequency, columns, place, shape)
            return raw if table.own or single else replace(raw, names=(tuple(names[0]), tuple(names[1])))
        except (KeyError, TypeError, ValueError, AttributeError) as problem:
            raise DataError(
                f"{file}: its first line does not fit the rest or is damaged; export it again"
            ) from problem


def read_table(file: Path) -> Table:
    """The table in ``file``, with the columns that are known by other names called ours; DataError if it is none."""
    lines = text_in(file).split("\n")
    own: dict[str, Any] = {}
    if lines and lines[0].startswith(_MARK):
        try:
            own = json.loads(lines[0][len(_MARK) :])
        except ValueError:
            raise DataError(f"{file}: its first line is damaged; export it again") from None
    start = next((k for k, line in enumerate(lines) if line.strip() and not _passed_over(line)), len(lines))
    separator = _separator(lines[start : start + 1], lines[:start])
    try:
        rows = numbered_rows(lines[start:], separator, start + 1)
    except csv.Error as problem:
        raise DataError(f"{file}: is no table ({problem}); is it really CSV?") from None
    # numpy.savetxt writes the header as a comment
    if rows and not own and any(_is_number(c.strip()) for c in rows[0][1]):
        rows = [*_commented_header(lines[:start], separator, len(rows[0][1])), *rows]
    if len(rows) < 2:
        raise DataError(f"{file}: has no lines of data; expected a header and one line per frequency and entry")
    (_, header), *body = rows
    if own:
        return Table(own, [c.strip() for c in header], body)
    body = [(number, [c.strip() for c in row]) for number, row in body]
    header, body = _trimmed([c.strip() for c in header], body)
    said = _stated(file, lines[0] if start else "")
    return Table({}, _known_names(file, header), _points_for_commas(file, header, body, separator), said)


def _stated(file: Path, line: str) -> Declaration:
    """Declaration in a first ``line`` of JSON behind a comment's sign; an empty one where there is none."""
    text = line.lstrip("".join(_COMMENT)).strip()
    try:
        found = json.loads(text)
    except ValueError:  # any other comment
        return Declaration()
    try:
        return Declaration(**{k: v for k, v in found.items() if k in _STATED} if isinstance(found, dict) else {})
    except ForearmError as problem:
        why = f"states what is no declaration; correct it or take it out ({problem})"
        raise DataError(f"{file}, line 1: {why}") from None


def _passed_over(line: str) -> bool:
    """True if a ``line`` before the header is a comment, or what a spreadsheet says of its separator."""
    return line.startswith(_COMMENT) or line.strip().strip('"').lower().startswith("sep=")


def _separator(header: Sequence[str], before: Sequence[str]) -> str:
    """Separator of columns: names of columns hold neither tabs, semicolons nor commas."""
    for found in (re.fullmatch(r'"?sep=(.)"?', line.strip("\n\r "), re.IGNORECASE) for line in before):
        if found and any(found[1] in line for line in header):
            return found[1]
    return next((c for c in "\t;" if any(c in line for line in header)), ",")


def _commented_header(before: Sequence[str], separator: str, count: int) -> list[tuple[int, list[str]]]:
    """The last comment that has as many cells as there are columns, as the header; [] for none."""
    for number in range(len(before), 0, -1):
        line = before[number - 1]
        if not line.startswith(_COMMENT):
            continue
        cells = next(csv.reader([line.lstrip("".join(_COMMENT))], delimiter=separator), [])
        if len(cells) == count and not _all_numbers(cells):
            return [(number, cells)]
    return []


def _all_numbers(cells: Sequence[str]) -> bool:
    return all(_is_number(c.strip()) or not c.strip() for c in cells)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _trimmed(
    header: list[str], body: list[tuple[int, list[str]]]
) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Without the empty columns at the end that programs leave which end each line with a separator."""
    width = max([k + 1 for k, c in enumerate(header) if c], default=0)
    if all(not any(row[width:]) for _, row in body):
        return header[:width], [(number, row[:width]) for number, row in body]
    return header, body


def _known_names(file: Path, header: list[str]) -> list[str]:
    """Names of columns as ours, where another word for one is clear; each is said."""
    named = list(header)
    for name, words in _ALIASES.items():
        if name in header:
            continue
        found = [k for k, c in enumerate(header) if c not in _ALIASES and _plain(c) in words]
        if len(found) == 1:
            named[found[0]] = name
            warnings.warn(RecognitionWarning(str(file), f"column '{header[found[0]]}'", name), stacklevel=4)
    for cell, plain in ((c, _plain(c)) for c in header):
        if "frequency_Hz" not in named and plain.startswith("f") and plain.endswith(_OTHER_UNITS):
            raise DataError(f"{file}: its frequencies are in '{cell}', expected Hz; convert them, or export them so")
    return named


def _plain(word: str) -> str:
    return re.sub(r"[\s()\[\]{}._/-]", "", word).lower()


def _points_for_commas(
    file: Path, header: list[str], body: list[tuple[int, list[str]]], separator: str
) -> list[tuple[int, list[str]]]:
    """Rows with decimal points where numbers have decimal commas; DataError where both are in one table."""
    if separator == ",":
        return body
    cells = [(number, c) for number, row in body for c in row]
    commas = [(n, c) for n, c in cells if _COMMA.match(c)]
    if not commas:
        return body
    mixed = [(n, c) for n, c in cells if ("," in c and "." in c and _THOUSANDS.match(c))]
    points = [(n, c) for n, c in cells if re.match(r"^[+-]?\d*\.\d+(?:[eE][+-]?\d+)?$", c)]
    if mixed or points:
        line, cell = (mixed or points)[0]
        raise DataError(
            f"{file}, line {line}: '{cell}' has a decimal point, line {commas[0][0]} has '{commas[0][1]}' with a "
            "comma; export all numbers one way, without marks of thousands"
        )
    return [(n, [c.replace(",", ".") if _COMMA.match(c) else c for c in row]) for n, row in body]


def numbered_rows(lines: Iterable[str], delimiter: str, first: int = 1) -> list[tuple[int, list[str]]]:
    """Rows of a table that say something, each with the number of the file's line that it begins on; ``first`` is that
    of the first of the ``lines``. Blank lines and rows of separators alone are left out, and counted: a sentence about
    a row is looked up in the file. Raises csv.Error as the reader does."""
    reader = csv.reader(lines, delimiter=delimiter)
    found, begins = list[tuple[int, list[str]]](), first
    for row in reader:
        if any(cell.strip() for cell in row):
            found.append((begins, row))
        begins = first + reader.line_num
    return found


def _columns(file: Path, table: Table) -> dict[str, Any]:
    """Columns by name; numbers as float arrays."""
    header = table.header
    missing = [c for c in ("frequency_Hz", *_NAMES) if c not in header]
    pair = next((p for p in _PAIRS if all(c in header for c in p)), None)
    if missing not in ([], [*_NAMES]) or pair is None:
        raise DataError(
            f"{file}: expected the columns frequency_Hz, output, input and real, imag (or magnitude, phase_rad), got "
            f"{', '.join(header)[:120]}"
        )
    read = ("frequency_Hz", "output", "input", "valid", "deviation", *pair)
    _refuse_twice(file, header)
    columns: dict[str, Any] = {c: [] for c in header if c in read}
    for number, line in table.rows:
        if len(line) != len(header):
            why = "the file is cut short or damaged"
            if len(line) > len(header):
                why = "decimal commas cannot be told from commas between columns: export with semicolons, or points"
            raise DataError(f"{file}, line {number}: {len(line)} cells, the header has {len(header)}; {why}")
        for column, cell in zip(header, line, strict=True):
            if column in columns:
                columns[column].append(cell if column in _NAMES else _number(file, number, column, cell))
    return {**{c: np.array(v) for c, v in columns.items()}, "pair": pair}


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
        hint = "; write it without marks of thousands" if _THOUSANDS.match(cell) else ""
        raise DataError(f"{file}, line {line}: '{cell[:40]}' in column {column} is no number{hint}") from None
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
    own: dict[str, Any],
    frequency: FloatArray,
    columns: dict[str, Any],
    place: Any,
    shape: tuple[int, int, int],
) -> RawMatrix:
    values, valid = np.full(shape, np.nan + 0j), np.zeros(shape, dtype=bool)
    first, second = (columns[c] for c in columns["pair"])
    if columns["pair"][0] == "real":
        entries = np.empty(len(first), dtype=complex)
        entries.real, entries.imag = first, second
    else:
        degrees = columns["pair"][1] == "phase_deg"
        entries = first * np.exp(1j * (np.deg2rad(second) if degrees else second))
        course = np.full(shape, np.nan)
        course[place] = second
        if odd := _other_angle(course, degrees):
            warnings.warn(f"{file}: {odd}", AccuracyWarning, stacklevel=4)
    values[place] = entries
    valid[place] = columns["valid"] != 0 if "valid" in columns else np.isfinite(values[place])
    deviation = None
    if "deviation" in columns:
        deviation = np.full(shape, np.nan)
        deviation[place] = columns["deviation"]
    return RawMatrix(
        name=str(file),
        values=values,
        frequency=frequency,
        axes=FOI,
        unit=own.get("unit"),
        quantity=own.get("quantity"),
        spectrum=own.get("spectrum"),
        sign=own.get("sign"),
        outputs=_ports(own.get("outputs")),
        inputs=_ports(own.get("inputs")),
        valid=valid if own.get("masked", True) else None,
        deviation=deviation,
        errors=errors_from(own.get("errors", ())),
        provenance={"format": "CSV", **arbitrary_gain(own)},
    )


def _other_angle(phase: FloatArray, degrees: bool) -> str:
    """Doubt of ``phase`` (n_frequency, n_out, n_in) that is hardly in ``degrees``, or else in radians; "" for none.

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
