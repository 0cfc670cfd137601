"""Records: frozen dataclasses that are kept as netCDF files, or as parts on a shelf.

A class says its ``kind`` and ``version``; a field that is an array, or a row of names, says over what by
``field(metadata=dims("frequency output input", units="m/V"))``. Other fields are ports, records, rows of records,
pydantic models or plain values. None is left out. An array goes by the field's name, or the ``name`` that is given,
behind the name of the record that it stands in; plain values are one JSON text.
"""

from __future__ import annotations

import dataclasses
import io
import json
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from .. import __version__
from ..errors import DataError, first_problem
from ..ports import Port, positions
from .folder import write_bytes

R = TypeVar("R")
TIME_CONVENTION = "e^{+i omega t}"
FORMAT = 2  # of all files; a kind has a version of its own
_Variable = tuple[tuple[str, ...], Any, dict[str, str]]
_EACH = ("*",)  # dimensions of a mapping of arrays
UNKEPT = {"unkept": True}  # metadata of a field that is not kept: it comes back as its default
_AGAIN = "this version of forearm_fem makes and reads another; make it again"


def dims(
    names: str = "", *, name: str | None = None, upper: bool = False, single: bool = False, **attributes: str
) -> dict[str, Any]:
    """Metadata of a field that is an array over the dimensions ``names``, a row of names or ports over one, or a
    mapping of arrays ("*").

    ``name`` is its own in the file, "" of a record the absence of a prefix. An attribute "=field" is that field's
    value. Of symmetric matrices (n, r, r) over two names the ``upper`` triangles are kept, of ``single`` numbers half
    their digits.
    """
    return {"dims": tuple(names.split()), "name": name, "upper": upper, "single": single, "attributes": attributes}


def save(path: str | Path, record: Any) -> None:
    """Write ``record`` as netCDF, whole or not at all; DataError where that fails."""
    save_arrays(path, type(record).kind, *_flat(record), version=type(record).version)


def save_arrays(
    path: str | Path, kind: str, arrays: Mapping[str, _Variable], plain: Mapping[str, Any], *, version: int = 1
) -> None:
    """Variables (dims, values, attributes) and ``plain`` values as netCDF with a checksum of every array.

    Complex values are the compound type (r, i) of h5py and nc-complex. A dimension whose name is taken by another of
    other length gets the name of its variable before its own.
    """
    import h5netcdf
    import xarray as xr
    from xarray.backends import H5NetCDFStore

    dataset = xr.Dataset({name: xr.Variable(*parts) for name, parts in _named(arrays).items()})
    attributes = {
        "content": np.bytes_(kind), "format_version": FORMAT, "record_version": version,
        "time_convention": TIME_CONVENTION, "written_by": f"forearm_fem {__version__}",
        "plain": np.bytes_(plain_json(plain)),
    }  # fmt: skip
    described = dataset.assign_attrs(attributes)
    coordinates = [name for name in described.variables if str(name) in described.dims]
    encoding = {name: _encoding(variable) for name, variable in described.variables.items()}
    # what is read back stands in bytes, which HDF5 protects by a checksum; its heap of texts has none
    memory = io.BytesIO()
    with h5netcdf.File(memory, "w", libver=("v110", "v110")) as file:
        described.set_coords(coordinates).dump_to_store(H5NetCDFStore(file), encoding=encoding)
    write_bytes(path, memory.getvalue())


def load(path: str | Path, cls: type[R]) -> R:
    """The record of class ``cls`` in a file; DataError where it is missing, damaged, or of another kind or version."""
    import h5py

    file, kind, version = Path(path), cls.kind, cls.version  # type: ignore[attr-defined]
    if not file.is_file():
        raise DataError(f"{file}: {'is a folder, expected a file' if file.is_dir() else 'no such file'}")
    try:
        with h5py.File(file, "r") as content:  # by names alone: damaged references between dimensions make HDF5 hang
            said = content.attrs
            if "content" not in said:
                raise DataError(
                    "is netCDF of another program, and only netCDF of forearm_fem is read; bring a G as .csv, .mat, "
                    ".uff or by a recipe"
                )
            if (found := _text(said["content"])) != kind:
                raise DataError(f"holds {found}, expected {kind}")
            made = _whole(said["format_version"]), _whole(said.get("record_version", 0))
            if made != (FORMAT, version):
                raise DataError(f"holds {kind} of format {made[0]}.{made[1]}; {_AGAIN}")
            parts = {name: content[name] for name in content}  # raises for one that cannot be opened
            arrays = {n: _values(part) for n, part in parts.items() if isinstance(part, h5py.Dataset)}
            return _built(cls, "", arrays, json.loads(_text(said["plain"])))
    except DataError as problem:
        raise DataError(f"{file}: {problem}") from None
    except Exception as problem:  # damaged HDF5 fails in ways that h5py does not list
        first = str(problem).strip().splitlines()[0] if str(problem).strip() else type(problem).__name__
        if "filter returned failure" in first:
            raise DataError(f"{file}: damaged: its contents do not match its checksum") from None
        article = "an" if kind[0] in "aeiou" else "a"
        raise DataError(f"{file}: damaged or not {article} {kind} file of forearm_fem ({first})") from problem


def said_content(path: str | Path) -> str:
    """Content that a netCDF file of this program states; empty for any other file."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return _text(file.attrs.get("content", ""))
    except Exception:  # damaged HDF5 fails in ways that h5py does not list
        return ""


def to_parts(record: Any) -> dict[str, Any]:
    """``record`` as arrays and one plain value, for a :class:`.shelf.Shelf`."""
    arrays, plain = _flat(record)
    kept = {name: np.asarray(values) for name, (_, values, _) in arrays.items()}
    own = {"kind": type(record).kind, "version": type(record).version, "plain": json.loads(plain_json(plain))}
    return {**{n: v.astype(str) if v.dtype == object else v for n, v in kept.items()}, "record": own}


def from_parts(cls: type[R], parts: Mapping[str, Any]) -> R:
    """The record that :func:`to_parts` took apart; DataError where it is of another kind or version."""
    own, kind = parts.get("record", {}), (cls.kind, cls.version)  # type: ignore[attr-defined]
    if (own.get("kind"), own.get("version")) != kind:
        raise DataError(f"holds {own.get('kind', 'no record')}, expected {kind[0]}; {_AGAIN}")
    return _built(cls, "", parts, own["plain"])


def plain_json(content: Mapping[str, Any]) -> str:
    """JSON of ``content``; tuples and arrays become lists, models their fields, anything else its text."""
    return json.dumps(dict(content), default=_plain)


def labels(values: tuple[str, ...]) -> Any:
    """Names as an array of Python's strings."""
    return np.array(values, dtype=object)


def _plain(value: Any) -> Any:
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json")
    if isinstance(value, Mapping):
        return dict(value)
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def _flat(record: Any) -> tuple[dict[str, _Variable], dict[str, Any]]:
    """Variables (dims, values, attributes) and plain values of ``record``, by their names in a file."""
    arrays, plain = dict[str, _Variable](), dict[str, Any]()
    _collect(record, "", arrays, plain)
    return arrays, plain


def _collect(record: Any, prefix: str, arrays: dict[str, _Variable], plain: dict[str, Any]) -> None:
    for field in dataclasses.fields(record):
        value, of = getattr(record, field.name), field.metadata
        name = _name(prefix, field)
        if value is None or "unkept" in of:
            continue
        if isinstance(value, tuple) and value and isinstance(value[0], Port):
            (dim,) = of["dims"]
            if dim in arrays and _ports_of({n: v for n, (_, v, _) in arrays.items()}, dim) != value:
                raise ValueError(f"two rows of ports are called {dim}")
            arrays |= _port_variables(dim, value)
        elif dataclasses.is_dataclass(value):
            plain[f"{prefix}{field.name}#"] = 1
            _collect(value, f"{name}_" if name else "", arrays, plain)
        elif isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
            plain[f"{prefix}{field.name}#"] = len(value)
            for k, part in enumerate(value):
                _collect(part, f"{name}_{k}_", arrays, plain)
        elif of.get("dims") == _EACH:
            plain[f"{prefix}{field.name}"] = list(value)
            for each, array in value.items():
                arrays[f"{name}_{each}"] = (tuple(f"{name}_{each}_{k}" for k in range(np.ndim(array))), array, {})
        elif of.get("dims"):
            said = {k: str(getattr(record, v[1:])) if v[:1] == "=" else v for k, v in of["attributes"].items()}
            own, array = of["dims"], labels(value) if _is_text(value) else np.asarray(value)
            if of["upper"]:
                own, array = own[:2], array[(slice(None), *np.triu_indices(array.shape[-1]))]
            if of["single"]:
                array = array.astype(np.complex64 if array.dtype.kind == "c" else np.float32)
            arrays[name or field.name] = (own, array, said)
        else:
            plain[f"{prefix}{field.name}"] = value


def _name(prefix: str, field: dataclasses.Field[Any]) -> str:
    own = field.metadata.get("name")
    return f"{prefix}{field.name if own is None else own}".rstrip("_")


def _named(arrays: Mapping[str, _Variable]) -> dict[str, _Variable]:
    """Variables whose dimensions of one name are of one length."""
    sizes, found = dict[str, int](), dict[str, _Variable]()
    for name, (own, values, said) in arrays.items():
        taken = list[str]()
        for dim, size in zip(own, np.shape(values), strict=True):
            called = dim if sizes.setdefault(dim, size) == size and dim not in taken else f"{name}_{dim}"
            sizes[called] = size
            taken.append(called)
        found[name] = (tuple(taken), values, said)
    return found


def _encoding(variable: Any) -> dict[str, Any]:
    """Checksums; no fill value, so that NaN and everything else come back as they were; names as bytes of UTF-8."""
    if variable.dtype.kind in "OU":
        longest = max([1, *(len(str(v).encode()) for v in variable.values.ravel())])
        chunks = {"fletcher32": True, "chunksizes": (*variable.shape, longest)} if variable.size else {}
        return {"dtype": "S1", **chunks}
    checksum = {"fletcher32": True, "chunksizes": variable.shape} if variable.size > 0 and variable.ndim > 0 else {}
    return {"_FillValue": None, **checksum} if variable.dtype.kind in "fciu" else checksum


def _values(part: Any) -> Any:
    """An array as it was written: names as text, truth as truth."""
    array = np.asarray(part[()])
    if array.dtype == "S1":
        return np.char.decode(np.ascontiguousarray(array).view(f"S{array.shape[-1]}")[..., 0], "utf-8")
    return array.astype(bool) if array.dtype == np.int8 else array  # netCDF has no truth


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


def _whole(value: Any) -> int:
    return int(np.ravel(value)[0])


def _built(cls: type[R], prefix: str, arrays: Mapping[str, Any], plain: Mapping[str, Any]) -> R:
    hints, found = typing.get_type_hints(cls), dict[str, Any]()
    for field in dataclasses.fields(cls):  # type: ignore[arg-type]
        of, name, key = field.metadata, _name(prefix, field), f"{prefix}{field.name}"
        if "unkept" in of:
            continue
        inner = _record_of(hints[field.name])
        if inner is Port:
            found[field.name] = _ports_of(arrays, of["dims"][0]) if f"{of['dims'][0]}_kind" in arrays else ()
        elif inner is not None:
            count = plain.get(f"{key}#", 0)
            if _is_row(hints[field.name]):
                found[field.name] = tuple(_built(inner, f"{name}_{k}_", arrays, plain) for k in range(count))
            else:
                found[field.name] = _built(inner, f"{name}_" if name else "", arrays, plain) if count else None
        elif of.get("dims") == _EACH:
            found[field.name] = {each: arrays[f"{name}_{each}"] for each in plain[key]}
        elif of.get("dims"):
            called = name or field.name
            if called in arrays or type(None) not in _choices(hints[field.name]):
                found[field.name] = _array(arrays[called], of, hints[field.name])
            else:
                found[field.name] = None
        elif key in plain:
            found[field.name] = _value(plain[key], hints[field.name])
        elif type(None) in _choices(hints[field.name]):
            found[field.name] = None
    return cls(**found)


def _array(values: Any, of: Mapping[str, Any], hint: Any) -> Any:
    if _is_row(hint):
        return tuple(v.item() if isinstance(v, np.generic) else str(v) for v in np.asarray(values))
    if of["single"]:
        values = values.astype(complex if values.dtype.kind == "c" else float)
    if not of["upper"]:
        return values
    size = round((np.sqrt(8 * values.shape[1] + 1) - 1) / 2)
    rows, columns = np.triu_indices(size)
    whole = np.empty((len(values), size, size), dtype=values.dtype)
    whole[:, rows, columns] = whole[:, columns, rows] = values
    return whole


def _value(value: Any, hint: Any) -> Any:
    model = next((a for a in _choices(hint) if isinstance(a, type) and issubclass(a, BaseModel)), None)
    if model is not None:
        try:
            return model.model_validate(value)
        except ValidationError as problem:
            raise DataError(f"holds a {model.__name__} that is not known: {first_problem(problem, 'it')}") from None
    return _tuples(value) if _is_row(hint) else value


def _is_text(value: Any) -> bool:
    return isinstance(value, tuple) and any(isinstance(v, str) for v in value)


def _tuples(value: Any) -> Any:
    return tuple(_tuples(v) for v in value) if isinstance(value, list) else value


def _is_row(hint: Any) -> bool:
    """True if a field holds a tuple, or may."""
    return any(typing.get_origin(a) is tuple for a in _choices(hint))


def _choices(hint: Any) -> tuple[Any, ...]:
    """Types that a field may hold."""
    union = isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union
    return typing.get_args(hint) if union else (hint,)


def _record_of(hint: Any) -> Any:
    """The dataclass that a field holds, or holds a row of."""
    choices = _choices(hint)
    inside = (*choices, *(b for a in choices if typing.get_origin(a) is tuple for b in typing.get_args(a)))
    return next((a for a in inside if isinstance(a, type) and dataclasses.is_dataclass(a)), None)


def _port_variables(dim: str, ports: tuple[Port, ...]) -> dict[str, _Variable]:
    """Names of ports, and per port its position, axis, kind, radius and contact."""
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


def _ports_of(arrays: Mapping[str, Any], dim: str) -> tuple[Port, ...]:
    """The ports of :func:`_port_variables`; ValueError for kinds and contacts that there are none of."""
    columns = [np.asarray(arrays[dim if k == "name" else f"{dim}_{k}"]).tolist()
               for k in ("name", "kind", "position", "axis", "radius", "contact")]  # fmt: skip
    found = list[Port]()
    for name, kind, place, axis, radius, contact in zip(*columns, strict=True):
        if kind not in ("contact", "point") or contact not in ("pressure", "bonded", "frictionless"):
            raise ValueError(f"port {name} has kind '{kind}' and contact '{contact}'")
        found.append(Port(name, kind, tuple(place), tuple(axis), radius, contact))
    return tuple(found)
