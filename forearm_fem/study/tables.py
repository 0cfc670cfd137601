"""Other people's answers: a table with its own column names, read by a declared mapping."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ..errors import DataError
from ..files.naming import as_named
from ..files.tables import numbered_rows
from ..ports import Port
from .run import typed

_NEEDED = ("participant", "method", "target", "response")
_FARTHEST = 1.0  # m: no place on a forearm is as far from the grid's middle


def foreign_table(file: Path, columns: Sequence[str], grid: Sequence[Port]) -> pd.DataFrame:
    """Answers in a CSV or TSV, with the columns that the analysis needs.

    ``columns`` are "ours=theirs". Needed are participant, method, target and response (points, separated by spaces), or
    response_x and response_y [m] for the last. DataError in one sentence for what is missing, unknown or no answer.
    """
    header, lines, numbers = _cells(file)
    names = {}
    for item in columns:
        ours, separator, theirs = item.partition("=")
        if not separator or theirs not in header:
            raise DataError(f"--column {item}: expected ours=theirs, theirs among {', '.join(header)}"[:300])
        names[theirs] = ours
    header = [names.get(name, name) for name in header]
    if twice := sorted({name for name in header if name and header.count(name) > 1}):
        raise DataError(f"{file}: two columns are called '{twice[0][:40]}'; leave the one out that is not meant")
    table = pd.DataFrame(lines, columns=header, dtype=str)
    points = [p.name for p in grid]
    for name in (n for n in ("target", "response") if n in table):
        table[name] = [" ".join(as_named(word, points) for word in cell.split()) for cell in table[name]]
    placed = {"response_x", "response_y"} <= set(table)
    if missing := [n for n in _NEEDED if n not in table and not (n == "response" and placed)]:
        raise DataError(f"{file}: no column is called '{missing[0]}'; name theirs with --column {missing[0]}=THEIRS")
    for name in _NEEDED[:3]:
        if (blank := np.flatnonzero(table[name] == "")).size:
            raise DataError(f"{file}, line {numbers[blank[0]]}: {name} is blank; say whose answer it is, and to what")
    defaults = {"phase": "main", "response": "n/a", "late": "0", "response_time": "n/a"}
    for name, value in defaults.items():
        if name not in table:
            table[name] = value
    if placed:
        result = typed(table.replace("", "n/a"))
        if (far := float(np.nanmax(np.abs(result[["response_x", "response_y"]]), initial=0.0))) > _FARTHEST:
            raise DataError(f"{file}: response_x and response_y, in metres, reach {far:.3g} m; are they millimetres?")
        return result
    places, centres = {p.name: np.array(p.position[:2]) for p in grid}, []
    for line, response in zip(numbers, table["response"], strict=True):
        chosen = str(response).split()
        if unknown := [c for c in chosen if c not in places]:
            raise DataError(f"{file}, line {line}: '{unknown[0][:20]}' is no grid point ({', '.join(places)})"[:300])
        centres.append(np.mean([places[c] for c in chosen], axis=0) if chosen else np.full(2, np.nan))
    x, y = np.array(centres).T.astype(str)
    return typed(table.assign(response_x=x, response_y=y).replace(["nan", ""], "n/a"))


def _cells(file: Path) -> tuple[list[str], list[list[str]], list[int]]:
    """Header and lines of a table of tabs, semicolons or commas, without blanks around cells, and the numbers of these
    lines in the file; DataError where a line is no line of the header's."""
    try:
        text = file.read_text(encoding="utf-8-sig").splitlines()
        mark = next((c for c in "\t;" if c in next((line for line in text if line.strip()), "")), ",")
        rows = numbered_rows(text, mark)
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        raise DataError(f"{file}: cannot be read as a table ({type(problem).__name__})") from None
    (_, header), *lines = [(number, [cell.strip() for cell in row]) for number, row in rows] or [(0, [])]
    found = list[list[str]]()
    for number, line in lines:
        if len(line) < len(header) or any(line[len(header) :]):
            raise DataError(
                f"{file}, line {number}: {len(line)} cells, the header has {len(header)}; commas within numbers or "
                "texts need quotes"
            )
        found.append(line[: len(header)])
    if not found:
        raise DataError(f"{file}: holds no answers")
    return header, found, [number for number, _ in lines]
