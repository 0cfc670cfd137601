"""The thesis' G [9, 4, 20000] as a MATLAB file: two-sided, Hermitian-mirrored, zero outside the band."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, savemat

from ..arguments import checked
from ..errors import DataError
from ..ports import Port, positions
from ..store.folder import write_bytes
from ..store.record import TIME_CONVENTION, labels, plain_json
from ..transfer import TransferMatrix
from ..typing import ComplexArray, IntArray
from .reading import reading
from .seal import BLANK, sealed

_TEXT, _HEADER = 116, 128  # bytes of a MATLAB file: of its header the text, and all
_NOTE = (
    "G(output, input, bin): bin k has frequency_Hz(k). Bins above sample_rate_Hz/2 are the negative "
    "frequencies frequency_Hz - sample_rate_Hz and hold the conjugates, so ifft(G, [], 3) is real: the "
    "impulse response times the sample interval. Bins where excited is 0 carry no information and are 0."
)


@checked
def write_thesis_mat(
    path: str | Path, transfer: TransferMatrix, sample_rate: float = 1e4, duration: float = 2.0
) -> None:
    """Write G (n_out, n_in, sample_rate * duration) with its axes and units; [9, 4, 20000] by default.

    ``sample_rate`` [Hz], ``duration`` [s]. Entries of ``transfer`` marked invalid are written as 0 and named in
    ``valid`` (n_out, n_in, excited positive bin). Error estimates and deviations are left out; transfer.nc has them.
    Raises DataError where a frequency lies on no bin of 1 / duration, or is not within 0 to sample_rate / 2.
    """
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
    valid = np.ones(transfer.values.shape, dtype=bool) if transfer.valid is None else transfer.valid
    content = {
        "G": two_sided(np.where(valid, transfer.values, 0), bins, n),
        "frequency_Hz": np.arange(n) / duration,
        "excited": np.isin(np.arange(n), np.concatenate([bins, n - bins])),
        "valid": np.moveaxis(valid, 0, 2),
        "units": transfer.unit,
        "time_convention": TIME_CONVENTION,
        "sample_rate_Hz": sample_rate,
        "duration_s": duration,
        "note": _NOTE,
        "provenance": plain_json(transfer.provenance),
        **_axes("grid", transfer.outputs),
        **_axes("actuator", transfer.inputs),
    }
    write_bytes(path, mat5(content, compressed=True))


@checked
def read_thesis_mat(path: str | Path) -> TransferMatrix:
    """The positive, excited bins of a file by :func:`write_thesis_mat`; DataError if missing or damaged."""
    file = Path(path)
    with reading(file, "damaged, or not a G written by forearm_fem ({why})"):
        content = loadmat(file, appendmat=False, chars_as_strings=True)
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
            provenance=json.loads(str(content["provenance"][0])),
        )


def mat5(variables: dict[str, Any], *, compressed: bool = False) -> bytes:
    """A MATLAB 5 file, sealed in its header's text and in the variable ``sha256`` at its end."""
    body, end = io.BytesIO(), io.BytesIO()
    savemat(body, variables, do_compression=compressed)
    savemat(end, {"sha256": BLANK.decode()})
    return sealed(stamped(body.getvalue(), b"MATLAB 5.0 MAT-file, ") + end.getvalue()[_HEADER:])


def stamped(content: bytes, kind: bytes) -> bytes:
    """A MATLAB file with ``kind`` and a blank seal as the 116 bytes of text that its header has room for."""
    return (kind + BLANK).ljust(_TEXT) + content[_TEXT:]


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
