"""Raw sweeps as other programs record them: TDMS, LVM, WAV, and vectors in time of tables, MATLAB, numpy, HDF5."""

from __future__ import annotations

import importlib
import logging
import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ..errors import DataError, optional
from ..measurement.recording import Recording
from ..scenario.measurement import parse_unit
from ..typing import FloatArray
from .arrays import ArrayReader, Hdf5Reader, MatReader, NpzReader
from .declaration import SWEEPS, Declaration, RecognitionWarning, declare, reading, refuse_stand_in, text_in
from .reader import RawMatrix, Reader
from .tables import read_table
from .wav import wav_samples

_SIMULTANEOUS = 0.01  # of a sample between the beginnings of two channels of one clock
_EXACT, _NOISY = 1e-6, 0.5  # of a drive's size: how far its periods may differ, as sent and as measured
_EVEN = 1e-3  # of a step: how far printed times may be off an even clock, and the mean of all by far less
_DIGITS = 1e-3  # relative: what six digits of a spacing near a millisecond leave off
_LATTICE = 1e-2  # of a step: how far samples of one converter are off its multiples, by rounding
_SILENT = 1e-9  # of a drive's largest period: less is none
_SCALES = re.compile(r"(?P<of>[nuµμmk]?)(?P<unit>V|Volts?|volts?|v|N|Newtons?|newtons?)")
_PREFIXED: Mapping[str, float] = MappingProxyType({"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3,
                                                   "k": 1e3})  # fmt: skip
_BRACKETS = re.compile(r"[(\[]([^()\[\]]+)[)\]]\s*$")
_RATES = frozenset({"fs", "sample_rate", "samplerate", "sampling_rate", "srate", "fsamp"})
_TIMES = frozenset({"t", "time", "times", "t_s", "time_s"})
_GUESSED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"drive": ("drive", "excitation", "ao", "ao0", "output", "sent", "input voltage"),
     "response": ("response", "laser", "vibrometer", "ldv", "velocity", "ai", "ai0", "sensor")}
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Waveform:
    """One channel: ``samples`` (n,), their spacing ``step`` [s] (0 = not said), when they begin [s], and their unit."""

    samples: FloatArray
    step: float
    begins: float = 0.0
    unit: str = ""


class SweepReader(Reader):
    """Raw sweeps: no G before they are estimated, which `forearm-fem convert` does."""

    kind: ClassVar[str] = "raw sweeps"
    endings: ClassVar[tuple[str, ...]] = (".tdms", ".lvm", ".wav")
    takes = SWEEPS | {"sample_rate", "pattern"}

    def raw(self, file: Path, said: Declaration) -> RawMatrix:
        """Always a DataError that says which channels there are, and how G comes of them."""
        channels = waveforms(file, said)
        raise DataError(
            f"{file}: holds raw signals ({_listed(channels)}), and no G; `forearm-fem convert {file.name} G.nc "
            f"--scenario FILE {declare('drive', repr(next(iter(channels))))} --declare \"response='...'\"` makes one"
        )


def waveforms(file: Path, said: Declaration) -> dict[str, Waveform]:
    """All channels of ``file`` by name; "group/channel" in TDMS, "1", "2" in WAV."""
    refuse_stand_in(file)
    kinds = {".tdms": _tdms, ".lvm": _lvm, ".wav": _wav, ".mat": _vectors, ".npz": _vectors, ".h5": _vectors,
             ".hdf5": _vectors}  # fmt: skip
    found = kinds.get(file.suffix.lower(), _table)(file, said)
    plain = {_spaced(name): w for name, w in found.items()}  # as a terminal shows them
    return plain if len(plain) == len(found) else found


def _spaced(name: str) -> str:
    return " ".join(name.split())


def meaning_of(unit: str) -> tuple[str, float] | None:
    """Quantity of a channel in ``unit``, "V", "N" or one of motion, and its factor to SI; None for others."""
    plain = unit.strip()
    if not plain:
        return "V", 1.0
    if scaled := _SCALES.fullmatch(plain):
        return scaled["unit"][0].upper(), _PREFIXED[scaled["of"]]
    try:
        known = parse_unit(f"({plain})/V")
    except DataError:
        return None
    return known.quantity, known.factor


def read_sweep(
    path: str | Path,
    *,
    drive: str,
    response: str,
    output: str,
    input: str,
    period: int,
    drive_is_measured: bool = False,
    full_scale: float = float("inf"),
    skip: float = 0.0,
    said: Declaration | None = None,
) -> Recording:
    """A raw sweep as a Recording: ``drive`` and ``response`` are channels, ``period`` samples long each.

    A drive is in volts or newtons, a response in volts or a motion, as their units say (volts where they say nothing);
    ``provenance`` of the Recording names those that are no volts: ``drive`` = N, ``response`` = a quantity, in SI.
    The first whole periods after ``skip`` [s] are taken as they come: leave a lead-in period out when recording, or
    skip it. With ``drive_is_measured`` the drive channel is a loopback. Both channels must have the same increment and
    beginning, and the drive must repeat itself after ``period``; DataError otherwise. ``said`` holds the full scale of
    WAV files and the rate of files that do not say it.
    """
    file = Path(path)
    channels = waveforms(file, said or Declaration())
    drive, response = _spaced(drive), _spaced(response)
    x, y = (_of_name(file, channels, name) for name in (drive, response))
    (drives, x), (moves, y) = _in_si(file, drive, x, driven=True), _in_si(file, response, y, driven=False)
    step = x.step
    if (late := abs(y.begins - x.begins)) > _SIMULTANEOUS * step:
        raise DataError(
            f"{file}: '{response}' begins {late:.3g} s apart from '{drive}', which would turn every phase; record "
            "them by one trigger, or cut both to the same beginning"
        )
    if step != y.step or len(x.samples) != len(y.samples):
        raise DataError(
            f"{file}: '{drive}' has {len(x.samples)} samples every {step:g} s, '{response}' {len(y.samples)} every "
            f"{y.step:g} s; they must be recorded on one clock"
        )
    start = round(skip / step)
    repeats = (len(x.samples) - start) // period if period > 0 else 0
    if repeats < 1:
        raise DataError(
            f"{file}: {max(len(x.samples) - start, 0)} samples hold no whole period of {period}; the scenario's "
            "sweep.duration is one period of the drive"
        )
    rows = [w.samples[start : start + repeats * period].reshape(repeats, period) for w in (x, y)]
    for name, a in ((drive, rows[0]), (response, rows[1])):
        if not np.isfinite(a).all():
            raise DataError(f"{file}: '{name}' holds {np.count_nonzero(~np.isfinite(a))} samples that are no numbers")
    _check_periodic(file, drive, rows[0], drive_is_measured, step)
    loopback = rows[0] if drive_is_measured else None
    rate = round(1 / step, 6)
    return Recording(
        output, input, rate, rows[0][0], rows[1], loopback, full_scale, _resolution(rows[1]),
        provenance={"file": str(file), **({"drive": drives} if drives != "V" else {}),
                    **({"response": moves} if moves != "V" else {})},
    )  # fmt: skip


def _resolution(samples: FloatArray) -> float:
    """The step whose multiples all ``samples`` are apart, as a converter or printed digits leave it; 0 for none."""
    gaps = np.diff(np.unique(samples))
    if len(gaps) < 2:
        return 0.0
    least = float(gaps.min())
    places = gaps / least
    return least if float(np.abs(places - np.rint(places)).max()) < _LATTICE else 0.0


def _in_si(file: Path, name: str, found: Waveform, *, driven: bool) -> tuple[str, Waveform]:
    """Quantity of a channel, and its samples in SI; DataError for a unit that no drive, or no response, has."""
    meant = meaning_of(found.unit)
    if meant is None or (meant[0] not in ("V", "N") if driven else meant[0] == "N"):
        expected = "volts or newtons" if driven else "volts, or a motion such as m/s^2, g, mm/s or um"
        raise DataError(
            f"{file}: channel '{name}' is in '{found.unit}', expected {expected}; correct its unit, or export it in V"
        )
    return meant[0], replace(found, samples=found.samples * meant[1]) if meant[1] != 1 else found


def channels_of(file: Path, said: Declaration) -> tuple[str, str]:
    """The channels of drive and response in ``file``: as declared, else by usual names, each with a warning."""
    if said.drive is not None and said.response is not None:
        return _spaced(said.drive), _spaced(said.response)
    channels = waveforms(file, said)
    found = dict[str, str]()
    for what, words in _GUESSED.items():
        if (given := getattr(said, what)) is not None:
            found[what] = _spaced(given)
            continue
        alike = [c for c in channels if c.rpartition("/")[2].strip().lower() in words]
        if len(alike) == 1:
            found[what] = alike[0]
            warnings.warn(RecognitionWarning(str(file), f"channel of the {what}", f"'{alike[0]}'"), stacklevel=3)
    if missing := [what for what in _GUESSED if what not in found]:
        options = " ".join(declare(what, "'...'") for what in missing)
        raise DataError(f"{file}: does not say which channel is the {' and the '.join(missing)}; add {options} of its "
                        f"channels {_listed(channels)}")  # fmt: skip
    return found["drive"], found["response"]


def _of_name(file: Path, channels: Mapping[str, Waveform], name: str) -> Waveform:
    if name not in channels:
        raise DataError(f"{file}: has no channel '{name}'; it has {_listed(channels)}")
    found = channels[name]
    if found.step <= 0:
        raise DataError(
            f"{file}: channel '{name}' does not say its sample rate (wf_increment); add {declare('sample_rate', '...')}"
        )
    if found.samples.dtype.kind in "iub":
        raise DataError(
            f"{file}: channel '{name}' holds whole numbers of the converter without a scale, which are no volts; save "
            "it scaled, or as floating-point numbers"
        )
    return found


def _listed(names: Mapping[str, Any] | Sequence[str]) -> str:
    text = ", ".join(f"'{n}'" for n in names)
    return text if len(text) < 140 else f"{text[:140]}..."


def _check_periodic(file: Path, name: str, rows: FloatArray, measured: bool, step: float) -> None:
    """DataError for a drive (n_repeat, n) that is another in some period: of another length, silent, or begun late."""
    size = np.linalg.norm(rows, axis=1)
    largest = float(size.max())
    if largest == 0:
        raise DataError(f"{file}: '{name}' is silent throughout; is it the channel of the drive?")
    loud = size > _SILENT * largest
    if not loud.all():
        n, period = rows.shape[1], rows.shape[1] * step
        if not loud[0]:
            first = int(np.argmax(loud))
            cure = f"begin behind it with {declare('skip', f'{first * period:g}')}"
            raise DataError(
                f"{file}: '{name}' is silent in its first {'period' if first == 1 else f'{first} periods'} of {n} "
                f"samples; {cure}"
            )
        raise DataError(
            f"{file}: '{name}' is silent from period {int(np.argmin(loud)) + 1} of {n} samples on; cut the recording "
            "there"
        )
    off = float(np.linalg.norm(rows - rows[0], axis=1).max()) / float(size[0])
    if off > (_NOISY if measured else _EXACT):
        raise DataError(
            f"{file}: '{name}' does not repeat itself every {rows.shape[1]} samples (off by {off:.2g} of its size); "
            "correct the sweep's duration, skip what comes before the first whole period, or say drive_is_measured"
        )


def _tdms(file: Path, said: Declaration) -> dict[str, Waveform]:
    """Channels of a TDMS file; those that hold text or dates are left out."""
    nptdms = optional("nptdms", "tdms", "reading TDMS files", package="npTDMS")
    if file.read_bytes()[:4] != b"TDSm":
        raise DataError(f"{file}: is not a TDMS file; its first bytes are not 'TDSm'")
    with reading(file, "damaged, cut short or not a TDMS file ({why}); copy it again"), warnings.catch_warnings():
        warnings.simplefilter("error")
        with _complaints() as complaints:
            content = nptdms.TdmsFile.read(str(file))
        if complaints:
            raise DataError(f"{file}: is cut short or damaged; copy it again, or record it again")
        found = {}
        for group in content.groups():
            for channel in group.channels():
                samples = channel[:]
                if samples.dtype.kind not in "fiub":
                    continue
                says = channel.properties
                start = np.datetime64(says.get("wf_start_time", 0), "ns").astype("int64") * 1e-9
                found[f"{group.name}/{channel.name}"] = Waveform(
                    samples if samples.dtype.kind in "iub" else np.asarray(samples, dtype=float),
                    float(says.get("wf_increment", 0) or 0) or _step(said),
                    float(start + says.get("wf_start_offset", 0.0)),
                    str(says.get("unit_string", "")).strip(),
                )
    if not found:
        raise DataError(
            f"{file}: holds no channels of numbers; its groups are {_listed([g.name for g in content.groups()])}"
        )
    return found


@contextmanager
def _complaints() -> Iterator[list[logging.LogRecord]]:
    """Log records of npTDMS, which only logs, for instance, that a file is cut short."""
    heard: list[logging.LogRecord] = []

    class Listener(logging.Filter):
        """Keeps what is logged from the terminal."""

        def filter(self, record: logging.LogRecord) -> bool:
            """Keep the ``record``, and pass it on to nobody."""
            heard.append(record)
            return False

    listener = Listener()
    loggers = importlib.import_module("nptdms.log").log_manager.loggers.values()
    for logger in loggers:
        logger.addFilter(listener)
    try:
        yield heard
    finally:
        for logger in loggers:
            logger.removeFilter(listener)


def _step(said: Declaration) -> float:
    return 0.0 if said.sample_rate is None else 1 / said.sample_rate


def _wav(file: Path, said: Declaration) -> dict[str, Waveform]:
    """Channels "1", "2", ... of a WAV file; whole numbers are volts by ``full_scale``."""
    rate, samples = wav_samples(file)
    columns = samples.reshape(len(samples), -1).T
    if not np.issubdtype(columns.dtype, np.floating):
        if said.full_scale is None:
            raise DataError(
                f"{file}: has integer samples, which are no volts; add {declare('full_scale', '10')} where full scale "
                "is 10 V"
            )
        middle = 128 if columns.dtype == np.uint8 else 0
        most = 128 if columns.dtype == np.uint8 else -float(np.iinfo(columns.dtype.name).min)
        columns = (columns.astype(float) - middle) / most * said.full_scale
    elif said.full_scale is not None:
        columns = columns.astype(float) * said.full_scale
    return {str(k + 1): Waveform(np.asarray(c, dtype=float), 1 / rate) for k, c in enumerate(columns)}


def _table(file: Path, said: Declaration) -> dict[str, Waveform]:
    """Columns of a table beside the one of times [s]."""
    table = read_table(file)
    if "time" not in table.header:
        raise DataError(f"{file}: has no column 'time' (in s), so that it holds no raw sweep")
    try:
        cells = np.array([[float(c) if c else math.nan for c in row] for _, row in table.rows])
    except ValueError:
        bad = next((n, c) for n, row in table.rows for c in row if c and not _is_float(c))
        raise DataError(f"{file}, line {bad[0]}: '{bad[1][:40]}' is no number") from None
    times = cells[:, table.header.index("time")]
    step = _clock(file, times)
    return {
        name: Waveform(cells[:, k], step, float(times[0]), _bracketed(name)) for k, name in enumerate(table.header)
        if name and name != "time"
    }  # fmt: skip


def _bracketed(name: str) -> str:
    """The unit in brackets at a column's end; "" for other words in brackets."""
    found = _BRACKETS.search(name)
    return found[1] if found and meaning_of(found[1]) else ""


def _vectors(file: Path, said: Declaration) -> dict[str, Waveform]:
    """Vectors of MATLAB, numpy or HDF5 beside one of times [s] or a rate [Hz], which may be declared."""
    readers: dict[str, ArrayReader] = {".mat": MatReader(), ".npz": NpzReader()}
    arrays = readers.get(file.suffix.lower(), Hdf5Reader()).variables(file)
    last = {name: re.split(r"[./]", name)[-1].lower() for name in arrays}
    rates = [float(np.real(a.ravel()[0])) for name, a in arrays.items() if a.size == 1 and last[name] in _RATES]
    found = {name: np.ravel(a) for name, a in arrays.items() if a.size > 1 and a.size == max(a.shape)
             and not np.iscomplexobj(a)}  # fmt: skip
    clocks = [name for name in found if last[name] in _TIMES]
    begins, step = 0.0, _step(said) or (1 / rates[0] if len(rates) == 1 and rates[0] > 0 else 0.0)
    if not step and len(clocks) == 1:
        times = np.asarray(found[clocks[0]], dtype=float)
        begins, step = float(times[0]), _clock(file, times)
    channels = {n: Waveform(np.asarray(a, dtype=float), step, begins) for n, a in found.items() if n not in clocks}
    if not channels:
        raise DataError(f"{file}: holds no vectors of samples; it has {_listed(arrays)}")
    return channels


def _is_float(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _clock(file: Path, times: FloatArray) -> float:
    """Spacing [s] of ``times`` (n,); DataError where they are not even."""
    if len(times) < 2 or not np.isfinite(times).all():
        raise DataError(f"{file}: has {len(times)} times, or some that are no numbers")
    step = float(times[-1] - times[0]) / (len(times) - 1)
    printed = 10.0 ** (math.floor(math.log10(max(float(np.abs(times).max()), 1e-300))) - 5)
    off = float(np.abs(times - times[0] - step * np.arange(len(times))).max())
    if step <= 0 or off > max(_EVEN * step, 2 * printed):
        raise DataError(
            f"{file}: its times are not even (off by {off:.2g} s); record on one clock, or export all lines"
        )
    rate = 1 / step
    return 1 / round(rate) if abs(rate - round(rate)) < 1e-4 * rate and rate > 1 else step


def _lvm(file: Path, said: Declaration) -> dict[str, Waveform]:
    """Channels of LabVIEW's measurement file in text; of several segments the first alone must be the only one."""
    lines = text_in(file).split("\n")
    if not lines or not lines[0].startswith("LabVIEW Measurement"):
        raise DataError(f"{file}: does not begin with 'LabVIEW Measurement'; is it really an .lvm file?")
    ends = [k for k, line in enumerate(lines) if line.strip().startswith("***End_of_Header***")]
    if len(ends) < 2:
        raise DataError(
            f"{file}: has {len(ends)} ends of a header, expected two; it is cut short, or of another program"
        )
    if len(ends) > 2:
        raise DataError(
            f"{file}: holds {len(ends) - 1} segments, expected one; save each recording to a file of its own"
        )
    head = lines[: ends[1]]
    separator = {"Comma": ","}.get(_said(head, "Separator", "\t"), "\t")
    names = [n.strip() for n in lines[ends[1] + 1].split(separator)] if len(lines) > ends[1] + 1 else []
    rows = [line.split(separator) for line in lines[ends[1] + 2 :] if line.strip(separator + " ")]
    places = [k for k, n in enumerate(names) if n and n not in ("X_Value", "Comment")]
    if len(places) != (count := int(_said(head, "Channels", "1"))):
        raise DataError(
            f"{file}: its header tells of {count} channels, its columns are {_listed(names)}; export it again"
        )
    told = {k: w for k, w in enumerate(_row(head, "Samples", separator), start=1) if w.strip()}
    steps, begins, units = (_row(head, key, separator) for key in ("Delta_X", "X0", "Y_Unit_Label"))
    found = {}
    for place in places:
        cells = [r[place].strip() if place < len(r) else "" for r in rows]
        if not any(cells):
            continue
        samples = _column(file, names[place], cells)
        size = int(_float(told.get(place, "0")))
        if size and len(samples) % size:  # several runs may follow each other
            raise DataError(
                f"{file}: '{names[place]}' has {len(samples)} samples, its header says {size}; it is cut short, "
                "or lines were left out, and its clock no longer holds: export it again"
            )
        step = _float(steps[place - 1]) if place <= len(steps) and steps[place - 1].strip() else 0.0
        if said.sample_rate is not None and (not step or abs(step * said.sample_rate - 1) < _DIGITS):
            step = 1 / said.sample_rate  # the header prints six digits
        start = _float(begins[place - 1]) if place <= len(begins) and begins[place - 1].strip() else 0.0
        unit = units[place - 1].strip() if place <= len(units) else ""
        name = names[place] if names[place] not in found else f"{names[place]} {place}"
        found[name] = Waveform(samples, step, start, unit)
    if not found:
        raise DataError(f"{file}: has no samples below its header; it is cut short")
    return found


def _column(file: Path, name: str, cells: Sequence[str]) -> FloatArray:
    """Samples of a channel; cells that are empty are NaN."""
    try:
        return np.array([_float(c) if c else math.nan for c in cells])
    except ValueError:
        bad = next(c for c in cells if c and not _is_float(c.replace(",", ".")))
        raise DataError(f"{file}: '{bad[:40]}' in channel '{name}' is no number") from None


def _float(word: str) -> float:
    return float(word.strip().replace(",", "."))


def _said(head: Sequence[str], key: str, otherwise: str) -> str:
    """Word of the header under ``key``."""
    for line in head:
        if found := re.match(rf"^{key}[\t, ]+(\S.*?)\s*$", line):
            return found[1].strip(",") if found[1] != "," else ","
    return otherwise


def _row(head: Sequence[str], key: str, separator: str) -> list[str]:
    """Words of the header under ``key``, one a channel."""
    return next((line.rstrip("\n").split(separator)[1:] for line in reversed(head)
                 if line.split(separator)[0].strip() == key), [])  # fmt: skip
