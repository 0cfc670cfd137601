"""The numbers of a figure as CSV beside it."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Table:
    """Columns of one length; names carry the unit, e.g. ``frequency_Hz``."""

    columns: Mapping[str, Any]

    def as_csv(self, source: str = "") -> str:
        """Header and rows with ten digits; ``source`` in a first line starting with #."""
        stream = io.StringIO()
        if source:
            stream.write(f"# {source}\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(zip(*(_texts(c) for c in self.columns.values()), strict=True))
        return stream.getvalue()


def _texts(column: Iterable[Any]) -> list[str]:
    values = np.asarray(column)
    if np.issubdtype(values.dtype, np.floating):
        return [f"{v:.10g}" for v in values.tolist()]
    return [str(v) for v in values.tolist()]


def stacked_rows(key: str, parts: Mapping[str, Mapping[str, Any]]) -> Table:
    """Tables below each other, told apart by a first column ``key``."""
    names = list(next(iter(parts.values())))
    lengths = {label: len(np.asarray(part[names[0]])) for label, part in parts.items()}
    columns: dict[str, Any] = {key: [label for label, n in lengths.items() for _ in range(n)]}
    for name in names:
        columns[name] = np.concatenate([np.asarray(part[name]) for part in parts.values()])
    return Table(columns)
