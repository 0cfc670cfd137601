"""One door for every G of a file, a folder or a pattern of files, and one for writing it."""

from __future__ import annotations

import glob
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

import h5py
from scipy.io import whosmat

from ..errors import DataError
from ..results.files import read_transfer, write_transfer
from ..scenario import Scenario
from ..store.record import said_content
from ..transfer import TransferMatrix
from ..usercode import named
from .arrays import Hdf5Reader, MatReader, NpyReader, NpzReader, SofaReader
from .declaration import SWEEPS, Declaration, Ports, refuse_stand_in
from .joining import estimated, joined, named_files
from .mat import read_thesis_mat, write_thesis_mat
from .reader import Reader
from .recipe import RecipeReader
from .sweeps import SweepReader
from .tables import TableReader, write_csv
from .uff import UffReader


class NetCdfReader(Hdf5Reader):
    """G as this program wrote it; of another program's netCDF the array that ``variable`` names."""

    kind: ClassVar[str] = "netCDF"
    endings: ClassVar[tuple[str, ...]] = (".nc", ".nc4", ".cdf")

    def read(self, file: Path, said: Declaration, ports: Ports | None) -> TransferMatrix:
        """See :meth:`.Reader.read`."""
        if said.variable is not None and file.is_file() and not said_content(file):
            return super().read(file, said, ports)
        transfer = read_transfer(file)
        _refuse_declared(file, said)
        return transfer


class OwnOrMatReader(MatReader):
    """Arrays of MATLAB, or G as this program exports it, which says all of itself."""

    def read(self, file: Path, said: Declaration, ports: Ports | None) -> TransferMatrix:
        """See :meth:`.Reader.read`."""
        if said.variable is None and file.is_file():
            try:
                names = {name for name, _, _ in whosmat(file, appendmat=False)}
            except Exception:  # version 7.3 or damaged: the reader will say
                names = set()
            if {"G", "time_convention", "units", "grid_positions_m"} <= names:
                _refuse_declared(file, said)
                return read_thesis_mat(file)
        return super().read(file, said, ports)


def _refuse_declared(file: Path, said: Declaration) -> None:
    if said != Declaration():
        raise DataError(f"{file}: describes itself; leave the declaration out")


READERS: tuple[Reader, ...] = (
    NetCdfReader(), OwnOrMatReader(), UffReader(), TableReader(), NpzReader(), NpyReader(), Hdf5Reader(), SofaReader(),
    SweepReader(), RecipeReader(),
)  # fmt: skip
_BY_ENDING: Mapping[str, Reader] = MappingProxyType({e: r for r in READERS for e in r.endings})
_ELSEWHERE: Mapping[str, str] = MappingProxyType(
    {
        ".xlsx": "a spreadsheet: save the sheet as CSV", ".xls": "a spreadsheet: save the sheet as CSV",
        ".ods": "a spreadsheet: save the sheet as CSV", ".svd": "Polytec's own format: export UFF 58 there",
        ".pvd": "Polytec's own format: export UFF 58 there", ".op2": "Nastran's results: export UFF 58",
        ".pti": "B&K's own format: export UFF 58 there", ".mf4": "MDF: export TDMS, CSV or MATLAB",
        ".mdf": "MDF: export TDMS, CSV or MATLAB", ".dat": "of unknown layout: write a recipe for raw numbers, or "
        "rename a table to .csv", ".bin": "of unknown layout: write a recipe for raw numbers", ".f32": "raw numbers: "
        "write a recipe", ".raw": "raw numbers: write a recipe", ".json": "no G: export CSV", ".pkl": "a pickle, which "
        "may run programs and is never loaded: save .npz", ".pickle": "a pickle, which may run programs and is never "
        "loaded: save .npz", ".frf": "a format of one program: export UFF 58 there", ".ats": "a format of one program: "
        "export UFF 58 there", ".tdms_index": "the index of a .tdms file: name that file", ".zip": "an archive: unpack "
        "it",
        ".gz": "an archive: unpack it",
    }
)  # fmt: skip
_BEGINNINGS: tuple[tuple[bytes, str], ...] = ((b"TDSm", ".tdms"), (b"LabVIEW Measurement", ".lvm"), (b"RIFF", ".wav"),
                                              (b"    -1", ".uff"), (b"\x93NUMPY", ".npy"), (b"MATLAB 5.0", ".mat"),
                                              (b"MATLAB 7.3", ".mat"))  # fmt: skip
_TIMED = (".tdms", ".lvm", ".wav")


def read(
    path: str | Path,
    declaration: Declaration | None = None,
    *,
    ports: Ports | None = None,
    scenario: Scenario | None = None,
) -> TransferMatrix:
    """G in a file of any known kind, a results folder, a folder of files or a pattern (``sweeps/*.tdms``).

    ``declaration`` says what the file leaves open (quantity, unit, sides, sign, axes); ``ports`` (outputs, inputs) are
    those of the ``scenario`` measured, for files that name none. Of raw sweeps, whose ``drive`` and ``response`` are
    channels, G is estimated as the scenario's ``measurement`` says. Files written by forearm_fem need none of these.
    What is recognised comes with a RecognitionWarning each. DataError asks for anything else that is missing.
    """
    said, place = declaration or Declaration(), Path(path)
    if ports is None and scenario is not None:
        from ..geometry.device.layout import planform_ports

        ports = planform_ports(scenario)
    if place.is_dir() and (place / "transfer.nc").is_file():
        place = place / "transfer.nc"
    files = several(place)
    if files is None:
        if place.suffix.lower() == ".toml":
            return RecipeReader().read_with(place, said, ports, scenario, together)
        return _alone(place, said, ports, scenario)
    return together(files, said, ports, scenario)


def _alone(file: Path, said: Declaration, ports: Ports | None, scenario: Scenario | None) -> TransferMatrix:
    reader = reader_of(file) if said.reader is None else user_reader(said.reader, file)
    if said.drive is not None or said.response is not None or (scenario and file.suffix.lower() in _TIMED):
        return together([file], said, ports, scenario)
    return reader.read(file, said, ports)


def together(
    files: list[Path], said: Declaration, ports: Ports | None, scenario: Scenario | None,
    entries: Mapping[str, list[str]] | None = None,
) -> TransferMatrix:  # fmt: skip
    """G that ``files`` hold together, told apart by ``entries``, by ``said.pattern`` or by their names."""
    named = named_files(files, said, ports, entries)
    in_time = said.drive is not None or said.response is not None or all(f.suffix.lower() in _TIMED for f in files)
    if in_time:
        if scenario is None or ports is None:
            raise DataError(
                f"{files[0]}: holds raw sweeps, of which G is estimated as a scenario's sweep and measurement say; add "
                "--scenario FILE"
            )
        SweepReader().refuse_idle(files[0], said.model_copy(update={"points": None, "actuators": None}))
        return estimated(named, said, scenario, ports)
    if idle := [k for k in sorted(SWEEPS) if getattr(said, k) != getattr(Declaration(), k)]:
        raise DataError(f"{files[0]}: {idle[0]} has an effect on raw sweeps alone, with a drive and a response")
    return joined(lambda f: reader_of(f) if said.reader is None else user_reader(said.reader, f), named, said, ports)


def several(place: Path) -> list[Path] | None:
    """Files of a folder or a pattern, in the order of their numbers; None for the name of one file."""
    text = str(place)
    if place.is_dir():
        found = [f for f in place.iterdir() if f.is_file() and f.suffix.lower() in _BY_ENDING and f.name[:1] != "."]
        tables = [f for f in found if f.suffix.lower() == ".toml"]
        found = [f for f in found if f.suffix.lower() not in (".toml", ".nc")]
        if len(tables) == 1 and not found:
            return tables
        kinds = sorted({f.suffix.lower() for f in found})
        if not found:
            raise DataError(
                f"{place}: no transfer.nc in this folder, nor files of a known kind; `forearm-fem run` makes one, or "
                "name a file"
            )
        if len(kinds) > 1:
            raise DataError(
                f"{place}: holds files of several kinds ({', '.join(kinds)}); name one, as '{place}/*{kinds[0]}'"
            )
    elif not place.exists() and any(c in text for c in "*?["):
        found = [Path(f) for f in glob.glob(text)]
        if not found:
            raise DataError(f"{text}: no file has such a name")
    else:
        return None
    return sorted(found, key=lambda f: [int(w) if w.isdigit() else w for w in _words(f.name)])


def _words(name: str) -> list[str]:
    return re.split(r"(\d+)", name)


def user_reader(code: str, file: Path) -> Reader:
    """The user's own class ``code``, a :class:`.Reader`, for a ``file`` that is there; DataError for anything else."""
    made = named(code, "reader")
    if not (isinstance(made, type) and issubclass(made, Reader)):
        raise DataError(f"reader: {code} is no reader; write a class that inherits from forearm_fem.files.Reader")
    if not file.is_file():
        raise DataError(f"{file}: no such file")
    return made()


def reader_of(file: Path) -> Reader:
    """The reader of ``file`` by its ending, or else by how it begins."""
    ending = file.suffix.lower()
    if file.is_dir() or not file.exists():
        if ending in _BY_ENDING:
            raise DataError(f"{file}: {'is a folder, expected a file' if file.is_dir() else 'no such file'}")
    else:
        refuse_stand_in(file)
        with file.open("rb") as stream:
            head = stream.read(128)
        begun = next((e for mark, e in _BEGINNINGS if head.startswith(mark)), None)
        if begun is not None and (ending not in _BY_ENDING or ending in (".txt", ".asc", ".csv")):
            return _BY_ENDING[begun]
        if ending not in _BY_ENDING and h5py.is_hdf5(file):
            return _BY_ENDING[".h5"]
    if ending in _BY_ENDING:
        return _BY_ENDING[ending]
    if ending in _ELSEWHERE:
        raise DataError(f"{file}: is {_ELSEWHERE[ending]}")
    known = ", ".join(e for e in _BY_ENDING if e not in (".asc", ".uf", ".bunv", ".58", ".hdf", ".he5", ".cdf"))
    raise DataError(f"{file}: '{ending}' is none of the known kinds {known}; convert it, or write a recipe")


WRITERS: Mapping[str, Callable[[str | Path, TransferMatrix], None]] = MappingProxyType(
    {".nc": write_transfer, ".csv": write_csv, ".mat": lambda path, g: write_thesis_mat(path, g, None)}
)
"""Writers of G by the ending: netCDF holds everything; CSV and MATLAB all but estimates of errors."""


def save(path: str | Path, transfer: TransferMatrix) -> None:
    """G in the format of the path's ending: .nc (everything), .csv or .mat."""
    kind = Path(path).suffix.lower()
    if kind not in WRITERS:
        raise DataError(f"{path}: cannot write '{kind}'; choose one of {', '.join(WRITERS)}")
    WRITERS[kind](path, transfer)
