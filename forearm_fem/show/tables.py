"""The numbers of a figure as CSV beside it."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
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
        texts = []
        for column in map(np.asarray, self.columns.values()):
            form = "{:.10g}".format if np.issubdtype(column.dtype, np.floating) else str
            texts.append([form(v) for v in column.tolist()])
        writer.writerows(zip(*texts, strict=True))
        return stream.getvalue()


def stacked_rows(key: str, parts: Mapping[str, Mapping[str, Any]]) -> Table:
    """Tables below each other, told apart by a first column ``key``."""
    names = list(next(iter(parts.values())))
    lengths = {label: len(np.asarray(part[names[0]])) for label, part in parts.items()}
    columns: dict[str, Any] = {key: [label for label, n in lengths.items() for _ in range(n)]}
    for name in names:
        columns[name] = np.concatenate([np.asarray(part[name]) for part in parts.values()])
    return Table(columns)
