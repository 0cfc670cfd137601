"""``transfer.nc``: G between drives and grid points, and the skin's compliance between all ports.

Variables ``G`` (frequency, output, input) complex128 [m/V, m/N or m/m], ``compliance`` (frequency, port,
loaded_port) complex128 [m/N], coordinates in Hz and metres, error estimates, provenance as JSON. Any
HDF5 reader opens it; complex numbers are the compound (r, i) that h5py, xarray and nc-complex know.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import xarray as xr

from ..arguments import checked
from ..errors import DataError
from ..transfer import Compliance, ErrorEstimate, ErrorSource, TransferMatrix
from ..typing import FloatArray
from .dataset import Variables, labels, load, port_variables, ports_of, provenance_json, save, text

_CONTENT = "transfer"


@checked
def write_transfer(path: str | Path, transfer: TransferMatrix, compliance: Compliance | None = None) -> None:
    """Write ``transfer``, and ``compliance`` on the same frequencies if given; see the module's heading."""
    if compliance is not None and not np.array_equal(compliance.frequency, transfer.frequency):
        raise DataError(f"{path}: G and the compliance have different frequencies; write them to two files")
    dims, units = ("frequency", "output", "input"), {"units": transfer.unit}
    optional = {
        "G_contacts": (("frequency", "cone", "input"), transfer.contacts, units),
        "G_valid": (dims, transfer.valid, {"long_name": "entries that may be used"}),
        "G_deviation": (dims, transfer.deviation, {**units, "long_name": "standard deviation"}),
    }
    variables: Variables = {
        "frequency": _frequency(transfer.frequency),
        **port_variables("output", transfer.outputs),
        **port_variables("input", transfer.inputs),
        "G": (dims, transfer.values, {**units, "long_name": "displacement per unit drive"}),
        **{name: parts for name, parts in optional.items() if parts[1] is not None},
        **_error_variables("G", transfer.errors, dims[1:]),
        **(_compliance_variables(compliance) if compliance else {}),
    }
    provenance = {"G_provenance": provenance_json(transfer.provenance)}
    save(path, variables, {**_compliance_attributes(compliance), **provenance, "content": _CONTENT})


@checked
def write_compliance(path: str | Path, compliance: Compliance) -> None:
    """Write ``compliance`` alone: the expensive half, from which any device can be closed."""
    save(path, _compliance_variables(compliance), {**_compliance_attributes(compliance), "content": _CONTENT})


@checked
def read_transfer(path: str | Path) -> TransferMatrix:
    """G exactly as written; DataError if the file is missing, damaged or holds no G."""
    return load(path, _CONTENT, _unpack_transfer)


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


@checked
def read_compliance(path: str | Path) -> Compliance:
    """The compliance exactly as written; DataError if the file is missing, damaged or holds none."""
    return load(path, _CONTENT, _unpack_compliance)


def _compliance_variables(compliance: Compliance) -> Variables:
    note = {"units": "m/N", "long_name": "displacement per unit force; NaN for a point force under itself"}
    return {
        "frequency": _frequency(compliance.frequency),
        **port_variables("port", compliance.ports),
        "compliance": (("frequency", "port", "loaded_port"), compliance.values, note),
        **_error_variables("compliance", compliance.errors, ("port", "loaded_port")),
    }


def _compliance_attributes(compliance: Compliance | None) -> dict[str, str]:
    if compliance is None:
        return {}
    return {"compliance_provenance": provenance_json(compliance.provenance)}


def _frequency(frequency: FloatArray) -> tuple[tuple[str, ...], Any, dict[str, str]]:
    return ("frequency",), frequency, {"units": "Hz"}


def _error_variables(of: str, errors: tuple[ErrorEstimate, ...], pair: tuple[str, str]) -> Variables:
    """Estimates as rows: source, band norm, method, and e(f) on its own frequencies (NaN-padded), of each ``pair`` of
    ports where one tells them apart."""
    if not errors:
        return {}
    row, bins = f"{of}_error", (f"{of}_error", f"{of}_error_bin")
    variables = {
        f"{of}_error_source": ((row,), labels(tuple(e.source for e in errors)), {}),
        f"{of}_error_method": ((row,), labels(tuple(e.method for e in errors)), {}),
        f"{of}_error_band": ((row,), np.array([e.band for e in errors]), {"units": "1"}),
        f"{of}_error_frequency": (bins, _padded([e.frequency for e in errors]), {"units": "Hz"}),
        f"{of}_error_per_frequency": (
            bins,
            _padded([e.per_frequency for e in errors]),
            {"units": "1", "long_name": "e(f)"},
        ),
    }
    if known := [e.per_pair for e in errors if e.per_pair is not None]:
        values = np.full((len(errors), max(len(e.frequency) for e in errors), *known[0].shape[1:]), np.nan, np.float32)
        for row_of, e in zip(values, errors, strict=True):
            if e.per_pair is not None:
                row_of[: len(e.per_pair)] = e.per_pair
        note = {"units": "1", "long_name": "|dG_ij| over the largest |G_ij|"}
        variables[f"{of}_error_per_pair"] = ((*bins, *pair), values, note)
    return variables


def _padded(rows: list[tuple[float, ...]]) -> FloatArray:
    width = max(map(len, rows))
    return np.array([[*row, *[np.nan] * (width - len(row))] for row in rows], dtype=float).reshape(len(rows), width)


def _errors_of(dataset: xr.Dataset, of: str) -> tuple[ErrorEstimate, ...]:
    if f"{of}_error_band" not in dataset:
        return ()
    names = text(dataset[f"{of}_error_source"].values), text(dataset[f"{of}_error_method"].values)
    numbers = (dataset[f"{of}_error_{key}"].values for key in ("band", "frequency", "per_frequency"))
    pairs = dataset[f"{of}_error_per_pair"].values if f"{of}_error_per_pair" in dataset else [None] * len(names[0])
    errors = list[ErrorEstimate]()
    rows: Iterable[Any] = zip(*names, *numbers, pairs, strict=True)
    for source, method, band, frequency, size, per_pair in rows:
        if source not in get_args(ErrorSource):
            raise ValueError(f"unknown error source '{source}'")
        used = ~np.isnan(frequency)
        bins, sizes = (tuple(a[used].tolist()) for a in (frequency, size))
        known = per_pair is not None and not np.isnan(per_pair[used]).all()
        of_pairs = np.asarray(per_pair[used], dtype=float) if known else None
        errors.append(ErrorEstimate(source, float(band), method, bins, sizes, of_pairs))
    return tuple(errors)


def _unpack_transfer(dataset: xr.Dataset) -> TransferMatrix:
    if "G" not in dataset:
        raise DataError("the file holds a compliance but no G; close the loop with a device first")
    names = ("contacts", "valid", "deviation")
    optional = {n: dataset[f"G_{n}"].values if f"G_{n}" in dataset else None for n in names}
    return TransferMatrix(
        frequency=dataset["frequency"].values,
        values=dataset["G"].values,
        outputs=ports_of(dataset, "output"),
        inputs=ports_of(dataset, "input"),
        unit=str(dataset["G"].attrs["units"]),
        errors=_errors_of(dataset, "G"),
        provenance=json.loads(dataset.attrs["G_provenance"]),
        **optional,
    )


def _unpack_compliance(dataset: xr.Dataset) -> Compliance:
    if "compliance" not in dataset:
        raise DataError("the file holds G but no compliance; measured files have none")
    return Compliance(
        frequency=dataset["frequency"].values,
        values=dataset["compliance"].values,
        ports=ports_of(dataset, "port"),
        errors=_errors_of(dataset, "compliance"),
        provenance=json.loads(dataset.attrs["compliance_provenance"]),
    )
