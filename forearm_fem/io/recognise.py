"""One door for every measured G: `read_measured` looks at the file's kind and asks for what it does not say."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from scipy.io import whosmat

from ..arguments import checked
from ..errors import DataError
from ..store.results import read_transfer, write_transfer
from ..transfer import TransferMatrix
from .csvfiles import read_csv, write_csv
from .declaration import Declaration, Ports, RawMatrix, understand
from .matlab import read_thesis_mat, write_thesis_mat
from .matlab_import import read_mat, write_mat73
from .recipe import import_by_recipe, load_recipe
from .tdms import read_tdms, write_tdms
from .uff import read_uff, write_uff


@checked
def read_measured(
    path: str | Path, declaration: Declaration | None = None, *, ports: Ports | None = None
) -> TransferMatrix:
    """G in netCDF, MATLAB 5 or 7.3, UFF 58, TDMS, CSV, an import recipe (.toml, files beside it) or a results folder.

    ``declaration`` says what the file leaves open (quantity, unit, sides, sign, axes); ``ports`` (outputs, inputs) are
    those of the scenario measured, for files that name none. Files written by forearm_fem need neither. Axes and
    variable names may be recognised, each with a RecognitionWarning. DataError asks for anything else that is missing.
    """
    file = Path(path)
    if file.is_dir():
        file = file / "transfer.nc"
    kind = file.suffix.lower()
    if kind not in _READERS:
        raise DataError(
            f"{file}: '{kind}' is none of the known kinds {', '.join(_READERS)}; convert it, or write a recipe"
        )
    return _READERS[kind](file, declaration or Declaration(), ports)


@checked
def write_measured(path: str | Path, transfer: TransferMatrix) -> None:
    """G in the format of the path's suffix: .nc (everything), .mat (7.3), .uff, .tdms or .csv."""
    writers: Mapping[str, Callable[[str | Path, TransferMatrix], None]] = {
        ".nc": write_transfer,
        ".mat": write_mat73,
        ".uff": write_uff,
        ".unv": write_uff,
        ".tdms": write_tdms,
        ".csv": write_csv,
    }
    kind = Path(path).suffix.lower()
    if kind not in writers:
        raise DataError(f"{path}: cannot write '{kind}'; choose one of {', '.join(writers)}")
    writers[kind](path, transfer)


def _netcdf(file: Path, declaration: Declaration, ports: Ports | None) -> TransferMatrix:
    transfer = read_transfer(file)
    _refuse(file, declaration)
    return transfer


def _refuse(file: Path, declaration: Declaration) -> None:
    if declaration != Declaration():
        raise DataError(f"{file}: describes itself; leave the declaration out")


def _mat(file: Path, declaration: Declaration, ports: Ports | None) -> TransferMatrix:
    if declaration.variable is None:
        try:
            names = {name for name, _, _ in whosmat(file, appendmat=False)}
        except Exception:  # version 7.3 or damaged: the reader will say
            names = set()
        # a thesis-shaped file of forearm_fem carries its convention and ports
        if {"G", "time_convention", "units", "excited", "grid_positions_m"} <= names:
            _refuse(file, declaration)
            return read_thesis_mat(file)
    return understand(read_mat(file, declaration), declaration, ports)


def _recipe(file: Path, declaration: Declaration, ports: Ports | None) -> TransferMatrix:
    recipe = load_recipe(file)
    _refuse(file, declaration)
    return import_by_recipe(recipe, file.parent, ports)


def _by(read: Callable[[Path], RawMatrix]) -> Callable[[Path, Declaration, Ports | None], TransferMatrix]:
    return lambda file, declaration, ports: understand(read(file), declaration, ports)


_READERS: Mapping[str, Callable[[Path, Declaration, Ports | None], TransferMatrix]] = MappingProxyType(
    {
        ".nc": _netcdf,
        ".mat": _mat,
        ".uff": _by(read_uff),
        ".unv": _by(read_uff),
        ".uf": _by(read_uff),
        ".tdms": _by(read_tdms),
        ".csv": _by(read_csv),
        ".tsv": _by(read_csv),
        ".txt": _by(read_csv),
        ".toml": _recipe,
    }
)

__all__ = ["read_measured", "write_measured", "write_thesis_mat"]
