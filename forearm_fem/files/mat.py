"""G as a MATLAB file: the thesis' [9, 4, 20000], two-sided and zero outside the band, or its own frequencies alone."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, savemat

from ..errors import DataError
from ..ports import Port, positions
from ..store.folder import write_bytes
from ..store.record import TIME_CONVENTION, labels, plain_json
from ..transfer import TransferMatrix
from ..typing import BoolArray, ComplexArray, IntArray
from .arrays import check_elements
from .declaration import errors_from, plain_errors, reading

_NOTE = (
    "G(output, input, bin): bin k has frequency_Hz(k). Bins above sample_rate_Hz/2 are the negative "
    "frequencies frequency_Hz - sample_rate_Hz and hold the conjugates, so ifft(G, [], 3) is real: the "
    "impulse response times the sample interval. Bins where excited is 0 carry no information and are 0."
)


_ONE_SIDED = (
    "G(output, input, k) at frequency_Hz(k), positive frequencies alone; deviation is a standard deviation, and where "
    "valid is 0 an entry may not be used."
)


def write_thesis_mat(
    path: str | Path, transfer: TransferMatrix, sample_rate: float | None = 1e4, duration: float = 2.0
) -> None:
    """Write G (n_out, n_in, sample_rate * duration) with its axes and units; [9, 4, 20000] by default.

    ``sample_rate`` [Hz], ``duration`` [s]; without a rate G (n_out, n_in, n_frequency) at its own frequencies, exact.
    Entries of ``transfer`` marked invalid are written as 0 in the first and named in ``valid`` (n_out, n_in, excited
    positive bin). ``errors`` are those by source as JSON, without their shares over pairs, which netCDF has. Raises
    DataError where a frequency lies on no bin of 1 / duration, or is not within 0 to sample_rate / 2.
    """
    valid = np.ones(transfer.values.shape, dtype=bool) if transfer.valid is None else transfer.valid
    content = {
        "units": transfer.unit,
        "time_convention": TIME_CONVENTION,
        "valid": np.moveaxis(valid, 0, 2),
        "provenance": plain_json(transfer.provenance),
        "errors": json.dumps(plain_errors(transfer.errors)),
        **_axes("grid", transfer.outputs),
        **_axes("actuator", transfer.inputs),
    }
    if sample_rate is None:
        deviation = transfer.deviation
        body = {
            "G": np.moveaxis(transfer.values, 0, 2), "frequency_Hz": transfer.frequency, "note": _ONE_SIDED,
            "masked": transfer.valid is not None,
            **({} if deviation is None else {"deviation": np.moveaxis(deviation, 0, 2)}),
        }  # fmt: skip
    else:
        body = _on_bins(transfer, valid, sample_rate, duration)
    stream = io.BytesIO()
    savemat(stream, {**body, **content}, do_compression=True)
    write_bytes(path, stream.getvalue())


def _on_bins(transfer: TransferMatrix, valid: BoolArray, sample_rate: float, duration: float) -> dict[str, Any]:
    n = round(sample_rate * duration)
    exact = transfer.frequency * duration
    bins = np.round(exact).astype(int)
    if np.abs(exact - bins).max() > 1e-6:
        raise DataError(
            f"MATLAB export: {transfer.frequency[np.argmax(np.abs(exact - bins))]:g} Hz is no multiple of 1/duration "
            f"= {1 / duration:g} Hz; sweep on these bins or choose another duration"
        )
    if bins.min() < 1 or 2 * bins.max() >= n:
        nyquist = n / duration / 2
        raise DataError(f"MATLAB export: frequencies must lie between 0 and {nyquist:g} Hz, both excluded")
    return {
        "G": two_sided(np.where(valid, transfer.values, 0), bins, n),
        "frequency_Hz": np.arange(n) / duration,
        "excited": np.isin(np.arange(n), np.concatenate([bins, n - bins])),
        "sample_rate_Hz": sample_rate,
        "duration_s": duration,
        "note": _NOTE,
    }


def read_thesis_mat(path: str | Path) -> TransferMatrix:
    """G of a file by :func:`write_thesis_mat`: its positive, excited bins; DataError if missing or damaged."""
    file = Path(path)
    with reading(file, "damaged, or not a G written by forearm_fem ({why})"):
        check_elements(file.read_bytes())
        content = loadmat(file, appendmat=False, chars_as_strings=True)
        if "excited" not in content:
            return _of_own_frequencies(content)
        n = content["G"].shape[2]
        half = np.flatnonzero(content["excited"].ravel()[: (n + 1) // 2])  # of odd n the last positive bin: (n - 1) / 2
        valid = np.moveaxis(content["valid"].astype(bool), 2, 0)
        return TransferMatrix(
            frequency=content["frequency_Hz"].ravel()[half],
            values=np.ascontiguousarray(np.moveaxis(content["G"][:, :, half], 2, 0)),
            outputs=_ports(content, "grid", "point"),
            inputs=_ports(content, "actuator", "contact"),
            unit=str(content["units"][0]),
            valid=None if valid.all() else valid,
            errors=errors_from(json.loads(str(content["errors"][0]))),
            provenance=json.loads(str(content["provenance"][0])),
        )


def _of_own_frequencies(content: dict[str, Any]) -> TransferMatrix:
    def turned(name: str) -> Any:
        """The array of a name in the order (frequency, output, input); a last axis of length 1 is not stored."""
        array = content[name]
        return np.ascontiguousarray(np.moveaxis(array if array.ndim == 3 else array[:, :, None], 2, 0))

    return TransferMatrix(
        frequency=content["frequency_Hz"].ravel(),
        values=turned("G").astype(complex),
        outputs=_ports(content, "grid", "point"),
        inputs=_ports(content, "actuator", "contact"),
        unit=str(content["units"][0]),
        valid=turned("valid").astype(bool) if content["masked"].item() else None,
        deviation=turned("deviation").astype(float) if "deviation" in content else None,
        errors=errors_from(json.loads(str(content["errors"][0]))),
        provenance=json.loads(str(content["provenance"][0])),
    )


def two_sided(values: ComplexArray, bins: IntArray, n: int) -> ComplexArray:
    """(n_out, n_in, n) from ``values`` (n_bins, n_out, n_in) at positive ``bins``: G(-f) = conj G(f)."""
    spectrum = np.zeros((*values.shape[1:], n), dtype=complex)
    spectrum[:, :, bins] = np.moveaxis(values, 0, 2)
    spectrum[:, :, n - bins] = np.moveaxis(values, 0, 2).conj()
    return spectrum


def _axes(prefix: str, ports: tuple[Port, ...]) -> dict[str, Any]:
    return {
        f"{prefix}_names": labels(tuple(p.name for p in ports)),
        f"{prefix}_positions_m": positions(ports),
        f"{prefix}_axes": np.array([p.axis for p in ports], dtype=float),
        f"{prefix}_radii_m": np.array([p.radius for p in ports], dtype=float),
        f"{prefix}_contacts": labels(tuple(p.contact for p in ports)),
    }


def _ports(content: dict[str, Any], prefix: str, kind: Any) -> tuple[Port, ...]:
    names, contacts = ([str(c[0]) for c in content[f"{prefix}_{key}"].ravel()] for key in ("names", "contacts"))
    place, axes = (content[f"{prefix}_{key}"].tolist() for key in ("positions_m", "axes"))
    radii = content[f"{prefix}_radii_m"].ravel().tolist()
    rows: Iterable[Any] = zip(names, place, axes, radii, contacts, strict=True)
    return tuple(Port(name, kind, tuple(p), tuple(a), r, c) for name, p, a, r, c in rows)
