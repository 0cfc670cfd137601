"""What all netCDF files of the project share: labels, provenance, checksums, named failures."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import h5netcdf
import h5py
import numpy as np
import xarray as xr
from xarray.backends import H5NetCDFStore

from .. import __version__
from ..errors import DataError
from ..ports import Port, positions
from ..store.folder import write_bytes
from .reading import refuse_no_file
from .seal import check_tail, sealed_tail

T = TypeVar("T")
TIME_CONVENTION = "e^{+i omega t}"
FORMAT_VERSION = 1
Variables = Mapping[str, tuple[tuple[str, ...], Any, dict[str, str]]]


def save(path: str | Path, variables: Variables, attributes: Mapping[str, str]) -> None:
    """Write ``variables`` (name -> dims, values, attributes) with a checksum per chunk and one of the file.

    Complex values become the compound type (r, i) of h5py and nc-complex; h5netcdf 1.4 or later.
    """
    dataset = xr.Dataset({name: xr.Variable(*parts) for name, parts in variables.items()})
    made = {"format_version": FORMAT_VERSION, "time_convention": TIME_CONVENTION}
    described = dataset.assign_attrs({**made, "written_by": f"forearm_fem {__version__}", **attributes})
    coordinates = [name for name in described.variables if str(name) in described.dims]
    encoding = {name: _encoding(variable) for name, variable in described.variables.items()}
    memory = io.BytesIO()
    with h5netcdf.File(memory, "w") as file:
        described.set_coords(coordinates).dump_to_store(H5NetCDFStore(file), encoding=encoding)
    write_bytes(path, sealed_tail(memory.getvalue()))


def said_content(path: str | Path) -> str:
    """What a netCDF file of this program says that it holds; empty for any other file."""
    try:
        with h5py.File(path, "r") as file:
            return str(file.attrs.get("content", ""))
    except Exception:  # damaged HDF5 fails in ways that h5py does not list
        return ""


def load(path: str | Path, content: str, unpack: Callable[[xr.Dataset], T]) -> T:
    """``unpack`` applied to the file's dataset; DataError if missing, damaged or not ``content``."""
    file = Path(path)
    refuse_no_file(file)
    try:
        whole = check_tail(file.read_bytes())
        with h5py.File(file, "r") as probe:
            dict(probe.attrs)  # damaged, these leave h5netcdf's file half-open
        dataset = xr.load_dataset(file, engine="h5netcdf")
        if "content" not in dataset.attrs:
            raise DataError(
                "is netCDF of another program, and only netCDF of forearm_fem is read; bring a G as .csv, .mat, .uff "
                "or by a recipe"
            )
        found, version = dataset.attrs["content"], dataset.attrs["format_version"]
        if found != content:
            raise DataError(f"holds {found}, expected {content}")
        if version != FORMAT_VERSION:
            raise DataError(f"written in format {version}, this version reads {FORMAT_VERSION}")
        result = unpack(dataset)
        if not whole:
            raise DataError("truncated: the checksum at its end is missing; copy or make it again")
        return result
    except DataError as problem:
        raise DataError(f"{file}: {problem}") from None
    except Exception as problem:  # damaged HDF5 fails in ways that h5py does not list
        first = str(problem).strip().splitlines()[0] if str(problem).strip() else type(problem).__name__
        article = "an" if content[0] in "aeiou" else "a"
        raise DataError(f"{file}: damaged or not {article} {content} file of forearm_fem ({first})") from problem


def _encoding(variable: xr.Variable) -> dict[str, Any]:
    """Checksums for numbers; no fill value, so that NaN and everything else come back as they were."""
    numeric = variable.dtype.kind in "fciub" and variable.size > 0 and variable.ndim > 0
    checksum = {"fletcher32": True, "chunksizes": variable.shape} if numeric else {}
    return {"_FillValue": None, **checksum} if variable.dtype.kind in "fciu" else checksum


def provenance_json(provenance: Mapping[str, Any]) -> str:
    """JSON of ``provenance``; tuples and arrays become lists, anything else its text."""
    return json.dumps(dict(provenance), default=_plain, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value)


def text(values: Any) -> list[str]:
    """A 1-D string variable as Python strings."""
    return [str(v) for v in np.atleast_1d(values)]


def labels(values: tuple[str, ...]) -> Any:
    """Strings as an array that h5netcdf writes as variable-length UTF-8."""
    return np.array(values, dtype=object)


def port_variables(dim: str, ports: tuple[Port, ...]) -> Variables:
    """Coordinate ``dim`` of port names, and per port its position, axis, kind, radius and contact."""
    metres = {"units": "m"}
    axes = np.array([p.axis for p in ports], dtype=float).reshape(-1, 3)
    return {
        dim: ((dim,), labels(tuple(p.name for p in ports)), {"long_name": f"{dim} port"}),
        "xyz": (("xyz",), labels(("x", "y", "z")), {"long_name": "x along the limb to the elbow, z outward"}),
        f"{dim}_position": ((dim, "xyz"), positions(ports), metres),
        f"{dim}_axis": ((dim, "xyz"), axes, {"units": "1", "long_name": "outward unit normal"}),
        f"{dim}_kind": ((dim,), labels(tuple(p.kind for p in ports)), {}),
        f"{dim}_radius": ((dim,), np.array([p.radius for p in ports], dtype=float), metres),
        f"{dim}_contact": ((dim,), labels(tuple(p.contact for p in ports)), {}),
    }


def ports_of(dataset: xr.Dataset, dim: str) -> tuple[Port, ...]:
    """The ports written by :func:`port_variables`."""
    names, kinds, contacts = (text(dataset[key].values) for key in (dim, f"{dim}_kind", f"{dim}_contact"))
    place, axes = dataset[f"{dim}_position"].values.tolist(), dataset[f"{dim}_axis"].values.tolist()
    radii = dataset[f"{dim}_radius"].values.tolist()
    ports = list[Port]()
    rows: Iterable[Any] = zip(names, kinds, place, axes, radii, contacts, strict=True)
    for name, kind, (x, y, z), (a, b, c), radius, contact in rows:
        if kind not in ("contact", "point") or contact not in ("pressure", "bonded", "frictionless"):
            raise ValueError(f"port {name} has kind '{kind}' and contact '{contact}'")
        ports.append(Port(name, kind, (x, y, z), (a, b, c), radius, contact))
    return tuple(ports)
