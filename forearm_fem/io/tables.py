"""CSV of the signal strength S: ``target,group,method,S``."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from ..errors import DataError
from ..metrics.strength import GROUPS
from ..typing import FloatArray
from .sidefile import read_with_side, write_with_side

_HEADER = ("target", "group", "method", "S")


class StrengthRow(NamedTuple):
    """One line: S [-] of ``method`` aimed at ``target``; ``group`` is middle, edges, corners or empty."""

    target: str
    group: str
    method: str
    S: float


def strength_rows(methods: Sequence[str], targets: Sequence[str], strengths: FloatArray) -> tuple[StrengthRow, ...]:
    """Lines for ``strengths`` (n_method, n_target), target by target; groups are those of a 3x3 grid."""
    groups = {t: label.split()[0].lower() for label, members in GROUPS for t in members}
    return tuple(
        StrengthRow(t, groups.get(t, ""), m, float(strengths[i, j]))
        for j, t in enumerate(targets)
        for i, m in enumerate(methods)
    )


def write_signal_strength_csv(path: str | Path, rows: Iterable[StrengthRow]) -> None:
    """Write ``rows`` with every digit of S, so that reading gives the same floats, and the checksum beside them."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_HEADER)
    writer.writerows((r.target, r.group, r.method, repr(float(r.S))) for r in rows)
    write_with_side(path, stream.getvalue().encode())


def read_signal_strength_csv(path: str | Path) -> tuple[StrengthRow, ...]:
    """The rows as written; DataError for a missing file, another header or a line that does not fit."""
    lines = list(csv.reader(io.StringIO(_read(path))))
    header = lines[0] if lines else []
    if tuple(header) != _HEADER:
        raise DataError(f"{path}: expected the header {','.join(_HEADER)}, got '{','.join(header)}'")
    return tuple(_row(path, number, line) for number, line in enumerate(lines[1:], start=2))


def _read(path: str | Path) -> str:
    try:
        return read_with_side(path).decode()
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise DataError(f"{path}: cannot be read as text ({problem})") from None


def _row(path: str | Path, number: int, line: list[str]) -> StrengthRow:
    try:
        target, group, method, strength = line
        return StrengthRow(target, group, method, float(strength))
    except ValueError:
        raise DataError(
            f"{path}, line {number}: expected target,group,method,S with S a number, got {','.join(line)}"
        ) from None
