"""CSV of the signal strength S: ``target,group,method,S,S_low,S_high,S_record,window``.

As other programs must read such tables as they are, their checksums lie beside them: ``NAME.sha256``, as sha256sum
writes it.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..arguments import checked
from ..errors import DataError
from ..metrics.strength import GROUPS, seconds_of
from ..store.folder import atomic_path, write_bytes
from ..typing import FloatArray

_HEADER = ("target", "group", "method", "S", "S_low", "S_high", "S_record", "window")
_OLDER = _HEADER[:4]  # until 0.13.1


class StrengthRow(NamedTuple):
    """One line: S [-] of ``method`` aimed at ``target``; ``group`` is middle, edges, corners or empty.

    ``S_low`` to ``S_high`` is its numerical interval (NaN where unknown), ``S_record`` S over the whole record as in
    the thesis, ``window`` what S is taken over: "record", or seconds "start to end".
    """

    target: str
    group: str
    method: str
    S: float
    S_low: float = math.nan
    S_high: float = math.nan
    S_record: float = math.nan
    window: str = ""


@checked
def strength_rows(
    methods: Sequence[str],
    targets: Sequence[str],
    strengths: FloatArray,
    interval: tuple[FloatArray, FloatArray] | None = None,
    record: FloatArray | None = None,
    window: tuple[float, float] | None = None,
    *,
    grouped: bool = True,
) -> tuple[StrengthRow, ...]:
    """Lines for ``strengths`` (n_method, n_target), target by target; groups are those of a 3x3 grid if ``grouped``.

    ``interval`` low and high and S over the ``record`` have the same shape; ``window`` [s], None for the record.
    """
    unknown = np.full((len(methods), len(targets)), np.nan)
    low, high = interval or (unknown, unknown)
    whole = unknown if record is None else record
    if any(np.shape(given) != unknown.shape for given in (strengths, low, high, whole)):
        raise DataError(
            f"S of {len(methods)} methods at {len(targets)} targets has the shape {unknown.shape}, got "
            f"{np.shape(strengths)}; its interval and S over the record have the same"
        )
    over = "record" if window is None else "{:g} to {:g} s".format(*seconds_of(window))
    groups = {t: label.split()[0].lower() for label, members in GROUPS for t in members} if grouped else {}
    return tuple(
        StrengthRow(
            t, groups.get(t, ""), m, float(strengths[i, j]), float(low[i, j]), float(high[i, j]),
            float(whole[i, j]), over,
        )
        for j, t in enumerate(targets)
        for i, m in enumerate(methods)
    )


def write_signal_strength_csv(path: str | Path, rows: Iterable[StrengthRow]) -> None:
    """Write ``rows`` with every digit of S, so that reading gives the same floats, and the checksum beside them."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_HEADER)
    for r in rows:
        writer.writerow((*r[:3], *(repr(float(s)) for s in (r.S, r.S_low, r.S_high, r.S_record)), r.window))
    write_with_side(path, stream.getvalue().encode())


@checked
def read_signal_strength_csv(path: str | Path) -> tuple[StrengthRow, ...]:
    """The rows as written; DataError for a missing file, another header or a line that does not fit."""
    try:
        lines = list(csv.reader(io.StringIO(read_with_side(path).decode())))
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise DataError(f"{path}: cannot be read as text ({problem})") from None
    except csv.Error as problem:
        raise DataError(f"{path}: cannot be read as a table ({problem})") from None
    header = lines[0] if lines else []
    if tuple(header) not in (_HEADER, _OLDER):
        raise DataError(f"{path}: expected the header {','.join(_HEADER)}, got '{','.join(header)}'")
    return tuple(_row(path, number, line) for number, line in enumerate(lines[1:], start=2))


def _row(path: str | Path, number: int, line: list[str]) -> StrengthRow:
    try:
        target, group, method, *numbers = line
        if len(numbers) == 1:
            return StrengthRow(target, group, method, float(numbers[0]))
        strength, low, high, record, window = numbers
        return StrengthRow(target, group, method, float(strength), float(low), float(high), float(record), window)
    except ValueError:
        raise DataError(
            f"{path}, line {number}: expected {','.join(_HEADER)} with S a number, got {','.join(line)}"
        ) from None


def write_with_side(path: str | Path, content: bytes) -> None:
    """``content``, and its checksum beside it: both or neither."""
    digest = hashlib.sha256(content).hexdigest()
    with atomic_path(_side(Path(path))) as side:
        side.write_bytes(f"{digest}  {Path(path).name}\n".encode())
        write_bytes(path, content)


def read_with_side(path: str | Path) -> bytes:
    """The file's bytes; DataError where they do not match the checksum beside them, if there is one.

    Raises OSError for a file that cannot be read. A copy without its checksum is taken as it is.
    """
    content, side = Path(path).read_bytes(), _side(Path(path))
    if side.is_file() and side.read_bytes().split()[:1] != [hashlib.sha256(content).hexdigest().encode()]:
        raise DataError(
            f"{path}: its contents do not match its checksum: cut short, damaged or edited; make it again, or delete "
            f"{side.name} if you edited it on purpose"
        )
    return content


def _side(file: Path) -> Path:
    return file.with_name(f"{file.name}.sha256")
