"""G as one array of a file: MATLAB 5 and 7.3, numpy's .npz and .npy, HDF5; any names, any order of axes."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import h5py
import numpy as np
from scipy.fft import rfft, rfftfreq
from scipy.io import loadmat
from scipy.io.matlab import MatReadWarning

from ..errors import DataError, optional
from ..transfer import TransferMatrix
from .declaration import Declaration, Ports, RecognitionWarning, declare, reading, text_in
from .reader import NEEDS, RawMatrix, Reader, asked, understand

_FREQUENCY = frozenset({
    "frequency_hz", "frequency", "frequencies", "freq", "freqs", "f", "f_hz", "freq_hz", "fr", "faxis", "freqvec",
    "frq", "freq_vec", "fvec", "f_axis", "freq_domain", "frequency_vector",
})  # fmt: skip
_COMPLEX = ({"real", "imag"}, {"r", "i"}, {"re", "im"})
_SHOWN = 90  # characters of a list of arrays
_NUMERIC = "fciub"


class ArrayReader(Reader):
    """G from one of a file's arrays; array and frequency vector are recognised, with a warning, if only one fits."""

    takes = frozenset({
        "axes", "variable", "imaginary_variable", "frequency_variable", "frequency_file", "valid_variable",
        "sample_rate",
    })  # fmt: skip

    def variables(self, file: Path) -> dict[str, Any]:
        """All numeric arrays of ``file``, those in structures and groups by their whole names."""
        raise NotImplementedError

    def read(self, file: Path, said: Declaration, ports: Ports | None) -> TransferMatrix:
        """See :meth:`.Reader.read`; a matrix of two axes serves where there is one point or one actuator."""
        raw = self.checked(file, said)
        if raw.provenance["flat"] and ports is not None and 1 not in map(len, ports):
            raise DataError(
                f"{raw.name}: has two axes {raw.values.shape[:2]}, and G three: output, input and frequency; save it "
                "as one array of three axes, or by a recipe"
            )
        return understand(raw, said, ports)

    def raw(self, file: Path, said: Declaration) -> RawMatrix:
        """See :meth:`.Reader.raw`."""
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", MatReadWarning)  # of objects of MATLAB's classes, which hold no G
            variables = self.variables(file)
        if not variables:
            raise DataError(f"{file}: holds no numeric arrays; save G as a plain array")
        name = self._chosen(file, said, variables)
        values = np.asarray(variables[name])
        if (other := said.imaginary_variable) is not None:
            imaginary = np.asarray(self._one(file, variables, other, "array of imaginary parts"))
            if imaginary.shape != values.shape:
                raise DataError(f"{file}: '{name}' has the shape {values.shape}, '{other}' {imaginary.shape}")
            values = values + 1j * imaginary
        frequency = self._frequency(file, said, variables, name, values)
        valid = None
        if (mask := said.valid_variable) is not None:
            if mask not in variables or variables[mask].shape != values.shape:
                raise DataError(
                    f"{file}: has no mask '{mask}' of G's shape {values.shape}; leave valid_variable out, or correct it"
                )
            valid = np.asarray(variables[mask] != 0)
        flat = values.ndim == 2
        if flat:
            values, valid = values[:, :, None], None if valid is None else valid[:, :, None]
        provenance = {"format": self.kind, "variable": name, "flat": flat}
        whole = np.asarray(values, dtype=complex)
        return RawMatrix(f"{file}:{name}", whole, frequency, valid=valid, provenance=provenance)

    def _chosen(self, file: Path, said: Declaration, variables: dict[str, Any]) -> str:
        """Name of the array that is G."""
        if (wanted := said.variable) is not None:
            self._one(file, variables, wanted, "array")
            if variables[wanted].ndim not in (2, 3):
                raise DataError(
                    f"{file}: '{wanted}' has the shape {variables[wanted].shape}, expected three axes: output, input "
                    "and frequency in any order"
                )
            return wanted
        cubes = [k for k, v in variables.items() if v.ndim == 3]
        if not cubes:
            lengths = {v.size for k, v in variables.items() if _is_frequency(k, v)}
            cubes = [k for k, v in variables.items()
                     if v.ndim == 2 and min(v.shape) > 0 and np.iscomplexobj(v) and lengths & set(v.shape)]  # fmt: skip
        if len(cubes) == 1:
            warnings.warn(RecognitionWarning(str(file), "G", f"variable '{cubes[0]}'"), stacklevel=4)
            return cubes[0]
        described, option = _described(variables), declare("variable", "'G'")
        if not cubes:
            raise DataError(
                f"{file}: no plain array has three axes ({described}); save G as one, in the order output, input, "
                f"frequency, or name it with {option}"
            )
        open_ends = [n for n in NEEDS[:3] if getattr(said, n.key) is None]
        first = declare("variable", f"'{cubes[0]}'")
        raise DataError(f"{file}: {len(cubes)} arrays may be G ({described}); it {asked(open_ends, first)}")

    def _one(self, file: Path, variables: dict[str, Any], name: str, what: str) -> Any:
        if name not in variables:
            raise DataError(f"{file}: has no {what} '{name}'; it has {', '.join(sorted(variables))[:120]}")
        return variables[name]

    def _frequency(
        self, file: Path, said: Declaration, variables: dict[str, Any], name: str, values: Any
    ) -> Any:
        """Frequencies (n,) as declared or recognised; None for none."""
        if (beside := said.frequency_file) is not None:
            return numbers_in(file.parent / beside)
        if (axis := said.frequency_variable) is not None:
            vector = self._one(file, variables, axis, "frequency vector")
        elif said.sample_rate is None:
            named = [k for k, v in variables.items() if k != name and _is_frequency(k, v) and v.size in values.shape]
            if len(named) != 1:
                return None
            vector = variables[named[0]]
            chosen = f"variable '{named[0]}', {np.min(vector.real):g} to {np.max(vector.real):g} Hz"
            warnings.warn(RecognitionWarning(str(file), "frequency", chosen), stacklevel=4)
        else:
            return None
        return np.asarray(np.real(vector), dtype=float).ravel()


def _is_frequency(name: str, vector: Any) -> bool:
    last = name.replace("/", ".").rpartition(".")[2].lower()
    return bool(vector.size == max(vector.shape, default=0) > 0 and last in _FREQUENCY and not np.iscomplexobj(vector))


def _described(variables: dict[str, Any]) -> str:
    first = sorted(variables.items(), key=lambda item: not np.iscomplexobj(item[1]))
    text = ", ".join(f"{k} {v.shape}{' complex' * bool(np.iscomplexobj(v))}" for k, v in first)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def numbers_in(file: Path) -> Any:
    """Real numbers (n,) of an .npy file, or of a text file with one number a line or more."""
    if file.suffix.lower() == ".npy":
        return np.asarray(np.real(_plain_npy(file)), dtype=float).ravel()
    words = text_in(file).replace(";", " ").split()
    try:
        return np.array([float(w.rstrip(",")) for w in words])
    except ValueError as problem:
        raise DataError(f"{file}: expected numbers alone ({problem})") from None


def _plain_npy(file: Path) -> Any:
    with reading(file, "damaged, or no file of numpy ({why})"):
        try:
            array = np.load(file, allow_pickle=False)
        except ValueError as problem:
            if "allow_pickle" in str(problem):
                raise DataError(
                    f"{file}: holds Python objects (a pickle), which are not loaded, as they may run programs; save "
                    "plain arrays"
                ) from None
            raise
        if not isinstance(array, np.ndarray):
            raise DataError(f"{file}: holds several arrays; call it .npz")
        return array


class NpyReader(ArrayReader):
    """One array of numpy; its frequencies come from another file, or from a sample rate."""

    kind: ClassVar[str] = "an array of numpy"
    endings: ClassVar[tuple[str, ...]] = (".npy",)

    def variables(self, file: Path) -> dict[str, Any]:
        """See :meth:`.ArrayReader.variables`."""
        array = _plain_npy(file)
        if array.dtype.kind not in _NUMERIC:
            raise DataError(f"{file}: holds {array.dtype}, expected numbers")
        return {file.stem: array}


class NpzReader(ArrayReader):
    """Arrays that numpy.savez put together."""

    kind: ClassVar[str] = "numpy's .npz"
    endings: ClassVar[tuple[str, ...]] = (".npz",)

    def variables(self, file: Path) -> dict[str, Any]:
        """See :meth:`.ArrayReader.variables`."""
        with reading(file, "damaged, cut short or no .npz file of numpy ({why})"):
            with np.load(file, allow_pickle=False) as content:
                found = dict[str, Any]()
                for name in content.files:
                    try:
                        array = content[name]
                    except ValueError:  # a pickle: of somebody's own, and never loaded
                        continue
                    if array.dtype.kind in _NUMERIC:
                        found[name] = array
            return found


class MatReader(ArrayReader):
    """Arrays of MATLAB in its order of axes, of version 5 or 7.3; those in structures as FRF.H."""

    kind: ClassVar[str] = "MATLAB"
    endings: ClassVar[tuple[str, ...]] = (".mat",)

    def variables(self, file: Path) -> dict[str, Any]:
        """See :meth:`.ArrayReader.variables`."""
        with reading(file, "damaged, cut short or not a MATLAB file; save or copy it again"):
            if h5py.is_hdf5(file):
                with h5py.File(file, "r") as content:
                    return dict(_of_hdf5(content, "", ".", turned=True))
            check_elements(file.read_bytes())
            found = dict[str, Any]()
            for name, value in loadmat(file, appendmat=False).items():
                if not name.startswith("__"):
                    found |= dict(_of_matlab(name, value))
            return found


_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13})  # types of a version 5 file's data elements
_ANY = _NUMBERS | {_MATRIX, _COMPRESSED, 16, 17, 18}  # the last three are text
_NAME = (16, 2)  # in UTF-8, behind flags and dimensions


def check_elements(content: bytes) -> None:
    """ValueError for an element of a version 5 file that has no possible type, ends beyond its parent or is missing.

    scipy follows such types into nothing and ends the program. Compressed elements have zlib's own checksum.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    spans = [] if order is None else [(128, len(content), _ANY, 0)]
    while spans:
        at, end, known, least = spans.pop()
        place = 0
        while at < end:
            if end - at < 8:
                raise ValueError(f"an element at byte {at} is cut short")
            kind, size = struct.unpack_from(f"{order}II", content, at)
            short = kind >> 16  # four bytes at most, in the tag itself
            kind, body, size = (kind & 0xFFFF, at + 4, short) if short else (kind, at + 8, size)
            if body + size > end or short > 4 or (kind not in known and (kind, place) != _NAME):
                raise ValueError(f"the element at byte {at} has a type or length that cannot be")
            if kind == _MATRIX and size >= 16:
                flags = struct.unpack_from(f"{order}I", content, body + 8)[0]
                numeric = 5 <= flags & 0xFF <= 15  # from 5, sparse, on a matrix holds numbers alone
                parts = (6 if flags & 0xFF == 5 else 4) + (flags >> 11 & 1)  # an imaginary part where a bit says so
                spans.append((body, body + size, *((_NUMBERS, parts) if numeric else (_ANY, 0))))
            place += 1
            at = at + 8 if short else body + size + (-size % 8 if kind != _COMPRESSED else 0)
        if place < least:
            raise ValueError(f"the matrix that ends at byte {end} has {place} elements of {least}")


def _of_matlab(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numeric arrays in ``value`` of scipy, with structures and cells opened."""
    if not isinstance(value, np.ndarray):
        return
    if value.dtype.names is not None:
        for k, element in enumerate(value.ravel()):
            label = name if value.size == 1 else f"{name}({k + 1})"
            for key in value.dtype.names:
                yield from _of_matlab(f"{label}.{key}", element[key])
    elif value.dtype.kind == "O":
        for k, element in enumerate(value.ravel()):
            yield from _of_matlab(name if value.size == 1 else f"{name}{{{k + 1}}}", element)
    elif value.dtype.kind in _NUMERIC:
        yield name, value


def _of_hdf5(group: Any, above: str, mark: str, *, turned: bool) -> Iterator[tuple[str, Any]]:
    """Numeric arrays of a ``group`` and those in it; ``turned``: as MATLAB stores them, axes reversed."""
    for key, stored in group.items():
        name = f"{above}{mark}{key}" if above else key
        if key.startswith("#"):  # MATLAB's own
            continue
        if isinstance(stored, h5py.Group):
            yield from _of_hdf5(stored, name, mark, turned=turned)
        elif isinstance(stored, h5py.Dataset):
            if stored.dtype.kind == "O" and h5py.check_ref_dtype(stored.dtype):
                for k, reference in enumerate(np.ravel(stored[()])):
                    if reference and isinstance(target := group.file[reference], h5py.Dataset):
                        yield from _numeric(f"{name}{{{k + 1}}}", target, turned)
            else:
                yield from _numeric(name, stored, turned)


def _numeric(name: str, stored: Any, turned: bool) -> Iterator[tuple[str, Any]]:
    names = stored.dtype.names
    if "MATLAB_empty" in stored.attrs or not (stored.dtype.kind in _NUMERIC or set(names or ()) in _COMPLEX):
        return
    raw = stored[()]
    values = np.asarray(raw if names is None else raw[names[0]] + 1j * raw[names[1]])
    yield name, values.T if turned else values


class Hdf5Reader(ArrayReader):
    """Arrays of an HDF5 file by their whole names, group/H; also of netCDF files of other programs."""

    kind: ClassVar[str] = "HDF5"
    endings: ClassVar[tuple[str, ...]] = (".h5", ".hdf5", ".hdf", ".he5")

    def variables(self, file: Path) -> dict[str, Any]:
        """See :meth:`.ArrayReader.variables`."""
        with reading(file, "damaged, cut short or no HDF5 file ({why})"):
            if not h5py.is_hdf5(file):
                raise DataError(f"{file}: is no HDF5 file; its first bytes are another format's")
            with h5py.File(file, "r") as content:
                return dict(_of_hdf5(content, "", "/", turned=False))


# SOFA (AES69), the format of acoustic transfer functions, read through sofar.

class SofaReader(Reader):
    """G of impulse responses (Data.IR) or transfer functions (Data.Real, Data.Imag): measurements are drives,
    receivers are points."""

    kind: ClassVar[str] = "SOFA"
    endings: ClassVar[tuple[str, ...]] = (".sofa",)
    takes = frozenset({"axes"})

    def raw(self, file: Path, said: Declaration) -> RawMatrix:
        """See :meth:`.Reader.raw`."""
        sofar = optional("sofar", "sofa", "reading SOFA files")
        with reading(file, "damaged, cut short or no SOFA file ({why})"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            content: Any = sofar.read_sofa(str(file), verify=False, verbose=False)
            values, frequency = _spectra(file, content)
        return RawMatrix(
            str(file),
            values,
            frequency,
            ("input", "output", "frequency"),
            spectrum="one-sided",
            sign="+iwt" if hasattr(content, "Data_IR") else None,
            provenance={"format": "SOFA", "title": str(getattr(content, "GLOBAL_Title", ""))},
        )


def _spectra(file: Path, content: Any) -> tuple[Any, Any]:
    """(measurement, receiver, frequency) and the frequencies [Hz]."""
    if hasattr(content, "Data_IR"):
        impulses = np.asarray(content.Data_IR, dtype=float)
        rates = np.unique(np.asarray(content.Data_SamplingRate, dtype=float))
        if impulses.ndim != 3 or len(rates) != 1:
            raise DataError(
                f"{file}: its Data.IR has the shape {impulses.shape} at {len(rates)} rates, expected (M, R, N)"
            )
        delay = np.asarray(getattr(content, "Data_Delay", 0.0), dtype=float)
        frequency = rfftfreq(impulses.shape[2], 1 / rates[0])
        late = np.broadcast_to(delay, impulses.shape[:2])[:, :, None] / rates[0]
        return rfft(impulses, axis=2) * np.exp(-2j * np.pi * frequency * late), frequency
    if hasattr(content, "Data_Real") and hasattr(content, "Data_Imag"):
        values = np.asarray(content.Data_Real, dtype=float) + 1j * np.asarray(content.Data_Imag, dtype=float)
        if values.ndim != 3:
            raise DataError(f"{file}: its Data.Real has the shape {values.shape}, expected (M, R, N)")
        return values, np.asarray(content.N, dtype=float).ravel()
    raise DataError(f"{file}: holds neither Data.IR nor Data.Real and Data.Imag, which alone are read")
