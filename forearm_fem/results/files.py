"""Files of a run: G, drives, displacements, S and the wavefield."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..errors import DataError
from ..metrics.strength import GROUPS, seconds_of
from ..store.folder import write_text
from ..store.record import dims, load, save
from ..transfer import Compliance, TransferMatrix
from ..typing import ComplexArray, FloatArray

__all__ = [
    "Signals", "StrengthRow", "read_compliance", "read_displacements", "read_drives", "read_signal_strength_csv",
    "read_transfer", "stack", "strength_rows", "write_displacements", "write_drives", "write_signal_strength_csv",
    "write_transfer",
]  # fmt: skip

_HEADER = ("target", "group", "method", "S", "S_low", "S_high", "S_record", "window")


@dataclass(frozen=True)
class TransferFile:
    """``transfer.nc``: G (frequency, output, input), and the compliance (frequency, port, loaded_port) it follows from.

    G's other variables begin with ``G_``, those of the compliance with ``compliance_``.
    """

    kind: ClassVar[str] = "transfer"
    version: ClassVar[int] = 1

    transfer: TransferMatrix | None = field(metadata=dims(name=""))
    compliance: Compliance | None = None


def write_transfer(path: str | Path, transfer: TransferMatrix, compliance: Compliance | None = None) -> None:
    """Write ``transfer``, and ``compliance`` on the same frequencies if given."""
    if compliance is not None and not np.array_equal(compliance.frequency, transfer.frequency):
        raise DataError(f"{path}: G and the compliance have different frequencies; write them to two files")
    save(path, TransferFile(transfer, compliance))


def read_transfer(path: str | Path) -> TransferMatrix:
    """G exactly as written; DataError if the file is missing, damaged or holds no G."""
    if (found := load(path, TransferFile).transfer) is None:
        raise DataError(f"{path}: the file holds a compliance but no G; close the loop with a device first")
    return found


def read_compliance(path: str | Path) -> Compliance:
    """The compliance exactly as written; DataError if the file is missing, damaged or holds none."""
    if (found := load(path, TransferFile).compliance) is None:
        raise DataError(f"{path}: the file holds G but no compliance; measured files have none")
    return found


def refuse_other_g(file: Path, *, measured: bool) -> None:
    """DataError where ``file`` holds a G of the other kind, measured or of a run, which is not to be replaced.

    That of a run names its scenario. What cannot be read is no G.
    """
    try:
        of_run = "scenario" in read_transfer(file).provenance
    except DataError:
        return
    if of_run == measured:
        what = "G of a run" if of_run else "measured G"
        raise DataError(f"{file}: holds a {what}, which is not replaced; name another folder with --out")


@dataclass(frozen=True, eq=False)
class Signals:
    """``values`` (n_method, n_target, n_channel, n_time) in ``unit`` at ``time`` (n_time,) [s].

    A channel is an actuator or a grid point, at ``positions`` (n_channel, 3) [m] where known.
    """

    values: FloatArray
    methods: tuple[str, ...] = field(metadata=dims("method", name="method"))
    targets: tuple[str, ...] = field(metadata=dims("target", name="target", long_name="grid point aimed at"))
    channels: tuple[str, ...]
    time: FloatArray = field(metadata=dims("time", units="s"))
    unit: str
    positions: FloatArray | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        expected = tuple(len(each) for each in (self.methods, self.targets, self.channels, self.time))
        if np.shape(self.values) != expected:
            raise DataError(f"signals have the shape {np.shape(self.values)}, their labels say {expected}")


@dataclass(frozen=True, eq=False)
class Drives(Signals):
    """``drives.nc``: signals of actuators."""

    kind: ClassVar[str] = "drives"
    version: ClassVar[int] = 1

    values: FloatArray = field(metadata=dims("method target actuator time", name="drives", units="=unit"))
    channels: tuple[str, ...] = field(metadata=dims("actuator", name="actuator"))
    positions: FloatArray | None = field(
        default=None, metadata=dims("actuator xyz", name="actuator_position", units="m")
    )


@dataclass(frozen=True, eq=False)
class Motion(Signals):
    """``displacements.nc``: signals of grid points."""

    kind: ClassVar[str] = "displacements"
    version: ClassVar[int] = 1

    values: FloatArray = field(metadata=dims("method target point time", name="displacements", units="=unit"))
    channels: tuple[str, ...] = field(metadata=dims("point", name="point"))
    positions: FloatArray | None = field(default=None, metadata=dims("point xyz", name="point_position", units="m"))


def stack(
    results: Mapping[tuple[str, str], FloatArray], channels: tuple[str, ...], time: FloatArray, unit: str
) -> Signals:
    """Signals from (method, target) -> (n_channel, n_time); every method must have every target."""
    methods, targets = (tuple(dict.fromkeys(key[i] for key in results)) for i in (0, 1))
    if missing := [(m, t) for m in methods for t in targets if (m, t) not in results]:
        raise DataError(f"no result for method '{missing[0][0]}' at target '{missing[0][1]}'")
    values = np.array([[results[m, t] for t in targets] for m in methods], dtype=float)
    return Signals(values, methods, targets, channels, time, unit)


def write_drives(path: str | Path, signals: Signals) -> None:
    """Write ``drives`` (method, target, actuator, time)."""
    save(path, Drives(**{f.name: getattr(signals, f.name) for f in fields(Signals)}))


def write_displacements(path: str | Path, signals: Signals) -> None:
    """Write ``displacements`` (method, target, point, time)."""
    save(path, Motion(**{f.name: getattr(signals, f.name) for f in fields(Signals)}))


def read_drives(path: str | Path) -> Drives:
    """Drives exactly as written; DataError if missing, damaged or something else."""
    return load(path, Drives)


def read_displacements(path: str | Path) -> Motion:
    """Displacements exactly as written; DataError if missing, damaged or something else."""
    return load(path, Motion)


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
    """Write ``rows`` with every digit of S, so that reading gives the same floats."""
    import pandas as pd

    table = pd.DataFrame(rows, columns=list(_HEADER))
    write_text(path, str(table.to_csv(index=False, lineterminator="\n", na_rep="nan")))


def read_signal_strength_csv(path: str | Path) -> tuple[StrengthRow, ...]:
    """The rows as written; DataError for a missing file, another header or a line that does not fit."""
    try:
        lines = list(csv.reader(io.StringIO(Path(path).read_bytes().decode())))
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise DataError(f"{path}: cannot be read as text ({problem})") from None
    except csv.Error as problem:
        raise DataError(f"{path}: cannot be read as a table ({problem})") from None
    header = lines[0] if lines else []
    if tuple(header) != _HEADER:
        raise DataError(f"{path}: expected the header {','.join(_HEADER)}, got '{','.join(header)}'")
    return tuple(_row(path, number, line) for number, line in enumerate(lines[1:], start=2))


def _row(path: str | Path, number: int, line: list[str]) -> StrengthRow:
    try:
        target, group, method, *numbers = line
        strength, low, high, record, window = numbers
        return StrengthRow(target, group, method, float(strength), float(low), float(high), float(record), window)
    except ValueError:
        raise DataError(
            f"{path}, line {number}: expected {','.join(_HEADER)} with S a number, got {','.join(line)}"
        ) from None


# Displacement of the whole limb from the reduced basis: any drive, frequency or instant, no new solve.

@dataclass(frozen=True, eq=False)
class Wavefield:
    """Modes at the mesh vertices and in the middles of the skin's edges, and their amplitudes per drive.

    ``modes`` (n_point, 3, r) [-]; ``amplitudes`` (n_frequency, r, n_input) [m per unit drive], device included;
    ``frequency`` (n_frequency,) [Hz]. Between these points nothing is kept. In its file ``wavefield.nc`` the
    last two are in single precision: 1e-7, far below the model's own error.
    """

    kind: ClassVar[str] = "wavefield"
    version: ClassVar[int] = 1

    frequency: FloatArray = field(metadata=dims("frequency", units="Hz"))
    modes: FloatArray = field(metadata=dims("point xyz mode", single=True))
    amplitudes: ComplexArray = field(metadata=dims("frequency mode input", single=True))

    def in_time(self, spectrum: ComplexArray, times: FloatArray) -> FloatArray:
        """Displacement (n_time, n_point, 3) [m] at ``times`` [s].

        ``spectrum`` (n_input, n_frequency) holds Fourier-series amplitudes of the drives on this object's bins: the
        drive is Re sum_f 2 spectrum_f exp(2 pi i f t), as irfft(spectrum * n) gives.
        """
        states = np.einsum("fri,if->fr", self.amplitudes, spectrum)
        phases = np.exp(2j * np.pi * np.outer(times, self.frequency))
        return np.asarray(np.einsum("pcr,tr->tpc", self.modes, 2 * (phases @ states).real, optimize=True))
