"""Other people's answers: a table with its own column names, read by a declared mapping."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ..errors import DataError
from ..ports import Port
from .run import typed

_NEEDED = ("participant", "method", "target", "response")


def foreign_table(file: Path, columns: Sequence[str], grid: Sequence[Port]) -> pd.DataFrame:
    """Answers in a CSV or TSV, with the columns that the analysis needs.

    ``columns`` are "ours=theirs". Needed are participant, method, target and response (points, separated by spaces), or
    response_x and response_y [m] for the last. DataError in one sentence for what is missing or unknown.
    """
    try:
        table = pd.read_csv(file, sep="\t" if file.suffix.lower() == ".tsv" else ",", dtype=str, keep_default_na=False)
    except (OSError, UnicodeDecodeError, pd.errors.ParserError, pd.errors.EmptyDataError) as problem:
        raise DataError(f"{file}: cannot be read as a table ({type(problem).__name__})") from None
    names = {}
    for item in columns:
        ours, separator, theirs = item.partition("=")
        if not separator or theirs not in table:
            raise DataError(f"--column {item}: expected ours=theirs, theirs among {', '.join(table)}"[:300])
        names[theirs] = ours
    table = table.rename(columns=names)
    placed = {"response_x", "response_y"} <= set(table)
    if missing := [n for n in _NEEDED if n not in table and not (n == "response" and placed)]:
        raise DataError(f"{file}: no column is called '{missing[0]}'; name theirs with --column {missing[0]}=THEIRS")
    defaults = {"phase": "main", "response": "n/a", "late": "0", "response_time": "n/a"}
    for name, value in defaults.items():
        if name not in table:
            table[name] = value
    if placed:
        return typed(table)
    places, centres = {p.name: np.array(p.position[:2]) for p in grid}, []
    for line, response in enumerate(table["response"], start=2):
        chosen = str(response).split()
        if unknown := [c for c in chosen if c not in places]:
            raise DataError(f"{file}, line {line}: '{unknown[0][:20]}' is no grid point ({', '.join(places)})"[:300])
        centres.append(np.mean([places[c] for c in chosen], axis=0) if chosen else np.full(2, np.nan))
    x, y = np.array(centres).T.astype(str)
    return typed(table.assign(response_x=x, response_y=y).replace("nan", "n/a"))
