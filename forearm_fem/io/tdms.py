"""TDMS, LabVIEW's format, through npTDMS: G, and raw sweeps as an NI program records them."""

from __future__ import annotations

import importlib
import io
import json
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..arguments import checked
from ..errors import DataError, optional
from ..measurement.recording import Recording
from ..store.folder import atomic_path, write_bytes
from ..transfer import TransferMatrix
from ..typing import ComplexArray, FloatArray
from .declaration import RawMatrix, arbitrary_gain, port_from
from .reading import reading
from .seal import BLANK, check_seals, sealed

_GROUP = "G"
_SIMULTANEOUS = 0.01  # of a sample between the beginnings of two channels of one clock
_EXACT, _NOISY = 1e-6, 0.5  # of a drive's size: how far its periods may differ, as sent and as measured


def write_tdms(path: str | Path, transfer: TransferMatrix) -> None:
    """Group ``G``: ``frequency`` and per entry the channels re, im, valid and deviation, named output<-input; exact.

    Unit, convention and ports stand in the group's properties. Error estimates, ``contacts`` and provenance
    are not carried: transfer.nc has them. What is written is read back and compared.
    """
    tdms = _nptdms()
    ports = {"outputs": [vars(p) for p in transfer.outputs], "inputs": [vars(p) for p in transfer.inputs]}
    properties = {
        "unit": transfer.unit,
        "quantity": "displacement",
        "sign": "+iwt",
        "spectrum": "one-sided",
        "ports": json.dumps(ports),
        "masked": int(transfer.valid is not None),
        **arbitrary_gain(transfer.provenance),
        "sha256": BLANK.decode(),
    }
    parts = [
        tdms.GroupObject(_GROUP, properties=properties),
        _channel(tdms, "frequency", transfer.frequency, "Hz"),
    ]
    for o, i in np.ndindex(*transfer.values.shape[1:]):
        name, value = f"{o + 1}<-{i + 1}", transfer.values[:, o, i]
        parts.append(_channel(tdms, f"{name} re", value.real, transfer.unit))
        parts.append(_channel(tdms, f"{name} im", value.imag, transfer.unit))
        if transfer.valid is not None:
            parts.append(_channel(tdms, f"{name} valid", transfer.valid[:, o, i].astype(np.uint8), ""))
        if transfer.deviation is not None:
            parts.append(_channel(tdms, f"{name} deviation", transfer.deviation[:, o, i], transfer.unit))
    content = _sealed(tdms, _GROUP, parts)
    with atomic_path(path) as beside:
        beside.write_bytes(content)
        back = _read(beside)
        if not np.array_equal(back.values, transfer.values, equal_nan=True):
            raise DataError(f"{path}: reading back gave something else than was written; nothing was saved")


def _sealed(tdms: Any, group: str, parts: list[Any]) -> bytes:
    """``parts`` as a file; its last channel ``sha256`` holds the bytes of a seal."""
    memory = io.BytesIO()
    end = tdms.ChannelObject(group, "sha256", np.frombuffer(BLANK, dtype=np.uint8))
    with tdms.TdmsWriter(memory) as writer:
        writer.write_segment([*parts, end])
    return sealed(memory.getvalue())


def _channel(tdms: Any, name: str, data: Any, unit: str) -> Any:
    return tdms.ChannelObject(_GROUP, name, np.ascontiguousarray(data), properties={"unit_string": unit})


def read_tdms(path: str | Path) -> RawMatrix:
    """G as :func:`write_tdms` lays it out; DataError if missing, damaged, cut short or of another layout."""
    raw: RawMatrix = _guarded(Path(path), _read)
    return raw


def _guarded(file: Path, read: Any) -> Any:
    told = "damaged, cut short or not a TDMS file; copy it again"
    with reading(file, told, seals=False), warnings.catch_warnings():
        warnings.simplefilter("error")
        return read(file)


@contextmanager
def _complaints() -> Iterator[list[logging.LogRecord]]:
    """What npTDMS only logs, and prints: among it that a file is cut short."""
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


def _nptdms() -> Any:
    return optional("nptdms", "tdms", "reading and writing TDMS files", package="npTDMS")


def _open(file: Path) -> Any:
    whole = file.read_bytes()
    if whole[:4] != b"TDSm":
        raise DataError(f"{file}: is not a TDMS file; its first bytes are not 'TDSm'")
    try:
        check_seals(whole)
    except DataError as problem:
        raise DataError(f"{file}: {problem}") from None
    tdms = _nptdms()
    with _complaints() as complaints:
        content = tdms.TdmsFile.read(str(file))
    if complaints:
        raise DataError(f"{file}: is cut short or damaged; copy it again, or record it again")
    return content


def _read(file: Path) -> RawMatrix:
    content = _open(file)
    if _GROUP not in content or "ports" not in content[_GROUP].properties:
        raise DataError(
            f"{file}: holds no G of forearm_fem (groups {', '.join(g.name for g in content.groups())[:80]}); "
            "of other programs, bring G as .csv or .mat, and raw sweeps by read_sweep_tdms"
        )
    group = content[_GROUP]
    says = group.properties
    ports = {k: tuple(port_from(p) for p in v) for k, v in json.loads(says["ports"]).items()}
    shape = (len(group["frequency"]), len(ports["outputs"]), len(ports["inputs"]))
    values = np.empty(shape, dtype=complex)
    values.real, values.imag = _cube(group, shape, "re"), _cube(group, shape, "im")
    return RawMatrix(
        name=str(file),
        values=values,
        frequency=group["frequency"][:],
        axes=("frequency", "output", "input"),
        unit=says["unit"],
        quantity=says["quantity"],
        spectrum=says["spectrum"],
        sign=says["sign"],
        valid=_cube(group, shape, "valid") != 0 if says["masked"] else None,
        deviation=_cube(group, shape, "deviation") if "1<-1 deviation" in group else None,
        outputs=ports["outputs"],
        inputs=ports["inputs"],
        provenance={"format": "TDMS", **arbitrary_gain(says)},
    )


def _cube(group: Any, shape: tuple[int, int, int], part: str) -> FloatArray:
    out = np.empty(shape)
    for o, i in np.ndindex(*shape[1:]):
        column = group[f"{o + 1}<-{i + 1} {part}"][:]
        if len(column) != shape[0]:
            raise ValueError(f"entry {o + 1} <- {i + 1} has {len(column)} of {shape[0]} values")
        out[:, o, i] = column
    return out


@checked
def read_sweep_tdms(
    path: str | Path,
    *,
    drive: str,
    response: str,
    output: str,
    input: str,
    period: int,
    drive_is_measured: bool = False,
    full_scale: float = float("inf"),
) -> Recording:
    """A raw sweep as a Recording: ``drive`` and ``response`` are "group/channel" [V], ``period`` samples long each.

    The first whole periods are taken as they come: leave a lead-in period out when recording, or cut it. With
    ``drive_is_measured`` the drive channel is a loopback. Both channels must have the same increment and beginning
    (``wf_increment``, ``wf_start_offset`` and ``wf_start_time``, which npTDMS keeps), be in volts where they name a
    unit, and the drive must repeat itself after ``period``; DataError otherwise.
    """

    def read(file: Path) -> Recording:
        """The recording of one file; DataError where its two channels are not of one clock or of no whole repeat."""
        content = _open(file)
        (x, dx, begun), (y, dy, begun_y) = (_waveform(file, content, name) for name in (drive, response))
        if (late := abs(begun_y - begun)) > _SIMULTANEOUS * dx:
            raise DataError(
                f"{file}: '{response}' begins {late:.3g} s apart from '{drive}', which would turn every phase; record "
                "them by one trigger, or cut both to the same beginning"
            )
        if dx != dy or len(x) != len(y):
            raise DataError(
                f"{file}: '{drive}' has {len(x)} samples every {dx:g} s, '{response}' {len(y)} every {dy:g} s; they "
                "must be recorded on one clock"
            )
        repeats = len(x) // period if period > 0 else 0
        if repeats < 1:
            raise DataError(f"{file}: {len(x)} samples hold no whole period of {period}; declare the sweep's length")
        rows = [a[: repeats * period].reshape(repeats, period) for a in (x, y)]
        _check_periodic(file, drive, rows[0], drive_is_measured)
        loopback = rows[0] if drive_is_measured else None
        return Recording(
            output,
            input,
            round(1 / dx, 6),
            rows[0][0],
            rows[1],
            loopback,
            full_scale,
            provenance={"file": str(file)},
        )

    recording: Recording = _guarded(Path(path), read)
    return recording


def _check_periodic(file: Path, name: str, rows: FloatArray, measured: bool) -> None:
    """DataError for a drive (n_repeat, n) that is another in some period: of another length, or begun late."""
    off = np.linalg.norm(rows - rows[0], axis=1).max() / max(float(np.linalg.norm(rows[0])), np.finfo(float).tiny)
    if off > (_NOISY if measured else _EXACT):
        raise DataError(
            f"{file}: '{name}' does not repeat itself every {rows.shape[1]} samples (off by {off:.2g} of its size); "
            "declare the sweep's length, cut what comes before the first whole period, or say drive_is_measured"
        )


def _waveform(file: Path, content: Any, name: str) -> tuple[FloatArray, float, float]:
    """Samples [V], their spacing [s] and when they begin [s]."""
    group, _, channel = name.partition("/")
    if group not in content or channel not in content[group]:
        known = ", ".join(f"{g.name}/{c.name}" for g in content.groups() for c in g.channels())
        raise DataError(f"{file}: has no channel '{name}'; it has {known[:160]}")
    found = content[group][channel]
    step = found.properties.get("wf_increment")
    if not step or step <= 0:
        raise DataError(
            f"{file}: channel '{name}' does not say its sample rate (wf_increment); record it as a waveform"
        )
    unit = str(found.properties.get("unit_string", "")).strip()
    if unit.lower() not in ("", "v", "volt", "volts"):
        raise DataError(f"{file}: channel '{name}' is in '{unit}', expected volts; save it unscaled, in V")
    samples = found[:]
    if samples.dtype.kind in "iub":
        raise DataError(
            f"{file}: channel '{name}' holds whole numbers of the converter without a scale, which are no volts; save "
            "it scaled, or as floating-point numbers"
        )
    start = np.datetime64(found.properties.get("wf_start_time", 0), "ns").astype("int64") * 1e-9
    return np.asarray(samples, dtype=float), float(step), float(start + found.properties.get("wf_start_offset", 0.0))


def write_sweep_tdms(path: str | Path, recording: Recording) -> None:
    """Group ``sweep``: channels ``drive`` (or ``loopback``) and ``response`` of all repeats [V], as waveforms; exact.
    """
    tdms = _nptdms()
    properties = {"wf_increment": 1 / recording.sample_rate, "wf_start_offset": 0.0, "unit_string": "V"}
    drive: ComplexArray | FloatArray = np.tile(recording.sent, len(recording.response))
    pairs = {"drive": drive, "response": recording.response.ravel()}
    if recording.loopback is not None:
        pairs["loopback"] = recording.loopback.ravel()
    channels = [
        tdms.ChannelObject("sweep", name, np.ascontiguousarray(a), properties=properties) for name, a in pairs.items()
    ]
    group = tdms.GroupObject("sweep", properties={"sha256": BLANK.decode()})
    write_bytes(path, _sealed(tdms, "sweep", [group, *channels]))
