"""Other people's G in MATLAB files: version 5 (scipy) and 7.3, which is HDF5 (h5py); any names, any order of axes."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat

from ..errors import DataError
from ..store.folder import atomic_path, write_bytes
from ..transfer import TransferMatrix
from .declaration import Axis, Declaration, RawMatrix, asked, declare, left_open
from .matlab import mat5, stamped
from .reading import RecognitionWarning, reading
from .seal import BLANK, sealed

_VERSION_AT = 116  # where the header's text ends and what MATLAB knows the version by begins
_NAMES = ("frequency_Hz", "frequency", "freq", "f", "F", "freqs", "f_Hz")


def read_mat(path: str | Path, declaration: Declaration) -> RawMatrix:
    """The array ``declaration.variable`` and its frequency vector; both are recognised, with a warning, if
    only one fits.

    Axes keep MATLAB's order (files of version 7.3 store them reversed; that is undone). Raises DataError
    for damage, and where several variables could be meant.
    """
    file = Path(path)
    variables = read_variables(file)
    if (wanted := declaration.variable) is not None and wanted not in variables:
        raise DataError(f"{file}: has no array '{wanted}'; it has {', '.join(sorted(variables))[:120]}")
    cubes = [wanted] if wanted is not None else [k for k, v in variables.items() if v.ndim == 3]
    if len(cubes) != 1:
        described = ", ".join(f"{k} {v.shape}" for k, v in variables.items())
        if not cubes:
            raise DataError(
                f"{file}: no plain array has three axes ({described[:80]}); save G as one, not in a structure, cell or "
                "sparse matrix, in the order output, input, frequency (MATLAB drops a last axis of length 1)"
            )
        open_ends = {"variable": declare("variable", f"'{(cubes or ['G'])[0]}'"), **left_open(None, declaration)}
        raise DataError(f"{file}: {len(cubes)} arrays have three axes ({described[:80]}); it {asked(open_ends)}")
    name = cubes[0]
    if wanted is None:
        warnings.warn(RecognitionWarning(str(file), "G", f"variable '{name}'"), stacklevel=3)
    values = np.asarray(variables[name], dtype=complex)
    if (axis := declaration.frequency_variable) is not None:
        if axis not in variables:
            raise DataError(f"{file}: has no frequency vector '{axis}'; it has {', '.join(sorted(variables))[:120]}")
    elif declaration.sample_rate is None:
        lines = [k for k, v in variables.items() if k != name and v.size == max(v.shape, default=0)]
        named = [k for k in lines if variables[k].size in values.shape and k in _NAMES]
        if len(named) == 1:
            axis = named[0]
            chosen = f"variable '{axis}', {_span(variables[axis])} Hz"
            warnings.warn(RecognitionWarning(str(file), "frequency", chosen), stacklevel=3)
    frequency = None if axis is None else np.asarray(variables[axis], dtype=float).ravel()
    provenance = {"format": "MATLAB", "variable": name}
    valid = None
    if (mask := declaration.valid_variable) is not None:
        if mask not in variables or variables[mask].shape != values.shape:
            raise DataError(
                f"{file}: has no mask '{mask}' of G's shape {values.shape}; leave valid_variable out, or correct it"
            )
        valid = np.asarray(variables[mask] != 0)
    return RawMatrix(f"{file}:{name}", values, frequency, valid=valid, provenance=provenance)


def _span(axis: Any) -> str:
    return f"{np.min(axis.real):g} to {np.max(axis.real):g}"


def read_variables(file: Path) -> dict[str, Any]:
    """All numeric arrays of a MATLAB file in MATLAB's order of axes."""
    told = "damaged, cut short or not a MATLAB file; save or copy it again"
    with reading(file, told), warnings.catch_warnings():
        warnings.simplefilter("error")
        found = dict[str, Any]()
        if h5py.is_hdf5(file):
            with h5py.File(file, "r") as content:
                for name, stored in content.items():
                    if isinstance(stored, h5py.Dataset) and (
                        stored.dtype.kind in "fciu" or stored.dtype.names == ("real", "imag")
                    ):
                        raw = stored[()]
                        values = raw if raw.dtype.names is None else raw["real"] + 1j * raw["imag"]
                        found[name] = np.asarray(values).T
        else:
            arrays = loadmat(file, appendmat=False).items()
            found = {k: v for k, v in arrays if isinstance(v, np.ndarray) and v.dtype.kind in "fciub"}
    if not found:
        raise DataError(f"{file}: holds no numeric arrays; save G as a plain array, not inside a structure or object")
    return found


def write_mat73(
    path: str | Path, transfer: TransferMatrix, axes: tuple[Axis, ...] = ("output", "input", "frequency")
) -> None:
    """G [m/V] in the MATLAB 7.3 layout (HDF5): ``G`` with ``axes`` in MATLAB's order, ``frequency_Hz``,
    ``valid``; exact.

    MATLAB's own `load` wants a 512-byte header that h5py writes as a user block; `matfile` and `h5read` need neither.
    """
    memory = io.BytesIO()
    with h5py.File(memory, "w", userblock_size=512) as content:
        for name, array in _named(transfer, axes).items():
            stored = array.T
            if np.iscomplexobj(stored):
                pairs = np.empty(stored.shape, dtype=[("real", "<f8"), ("imag", "<f8")])
                pairs["real"], pairs["imag"] = stored.real, stored.imag
                stored = pairs
            dataset = content.create_dataset(name, data=stored)
            dataset.attrs["MATLAB_class"] = np.bytes_("uint8" if array.dtype == np.uint8 else "double")
    whole = stamped(memory.getvalue(), b"MATLAB 7.3 MAT-file, ")
    whole = whole[:_VERSION_AT] + b"\0" * 8 + b"\x00\x02IM" + whole[_VERSION_AT + 12 :]
    with atomic_path(path) as beside:
        beside.write_bytes(sealed(whole + BLANK))
        if not np.array_equal(read_variables(beside)["G"], _named(transfer, axes)["G"], equal_nan=True):
            raise DataError(f"{path}: reading back gave something else than was written; nothing was saved")


def write_mat5(
    path: str | Path, transfer: TransferMatrix, axes: tuple[Axis, ...] = ("output", "input", "frequency")
) -> None:
    """As :func:`write_mat73` in version 5, up to 2 GB: one-sided G on its own frequencies; exact."""
    write_bytes(path, mat5(_named(transfer, axes)))


def _named(transfer: TransferMatrix, axes: tuple[Axis, ...]) -> dict[str, Any]:
    order = [("frequency", "output", "input").index(a) for a in axes]
    valid = np.isfinite(transfer.values) if transfer.valid is None else transfer.valid
    return {
        "G": np.transpose(transfer.values, order),
        "valid": np.transpose(valid, order).astype(np.uint8),
        "frequency_Hz": transfer.frequency[:, None],
    }
