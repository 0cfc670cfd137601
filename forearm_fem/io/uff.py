"""Universal file format, dataset 58 (functions at nodal degrees of freedom); read through pyuff, written here.

pyuff 2.5 does not serve for writing: in binary mode "overwrite" truncates the header it has just written,
NaN becomes 0, complex data get the byte count of real ones, and files are left open. So the datasets are laid
out here after the format's description (SDRC 58 and 58b) and read back with pyuff before they count. Of
its reading one habit matters: a dataset cut short is returned without complaint, so values are counted.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..errors import DataError, optional
from ..scenario.measurement import Quantity
from ..store.folder import atomic_path
from ..transfer import TransferMatrix
from ..typing import BoolArray, ComplexArray, FloatArray
from .declaration import RawMatrix, arbitrary_gain, port_from
from .reading import reading
from .seal import BLANK, sealed
from .units import parse_unit

_MARK = "forearm_fem e^{+i omega t}"
_DEVIATION = "standard deviation"
_PRIVATE = 9158  # dataset number of our ports
_END = f"{-1:6d}"
_MARKS = re.compile(rb"    -1(?=[\r\n]|\Z| {74})")  # of datasets, as pyuff finds them: a -1 among others is a field
_END_SEAL = "\n".join([_END, f"{_PRIVATE:6d}", BLANK.decode(), _END, ""]).encode("ascii")
_DENOMINATOR: Mapping[str, int] = MappingProxyType({"V": 0, "N": 13, "m": 8})
_TURNS = 3  # directions beyond are rotations
_FREQUENCY = (0, 18)  # kinds of an abscissa: not said, and frequency
_NUMERATOR: Mapping[int, Quantity] = MappingProxyType({8: "displacement", 11: "velocity", 12: "acceleration"})


def write_uff(path: str | Path, transfer: TransferMatrix) -> None:
    """G as one binary dataset 58 per entry [m/V, m/N or m/m], its deviation as another, the ports in a private one.

    Masked bins are left out of their entry (its abscissa then has a gap), never written as zeros; a bin that is masked
    in every entry is lost. Error estimates, ``contacts`` and provenance are not carried: transfer.nc has them. Raises
    DataError for NaN among valid entries, and if what stands in the file is not what was to be written.
    """
    _pyuff()
    valid = np.ones(transfer.values.shape, dtype=bool) if transfer.valid is None else transfer.valid
    if bad := int(np.count_nonzero(~np.isfinite(transfer.values) & valid)):
        raise DataError(f"{path}: {bad} entries of G are not finite; mark them in `valid` before writing UFF")
    blocks = [_header(transfer)]
    for o, i in np.ndindex(*transfer.values.shape[1:]):
        some = valid[:, o, i]
        if not some.any():
            continue
        x, drive = transfer.frequency[some], transfer.unit.rpartition("/")[2]
        blocks.append(_dataset58("frequency response", 4, (o, i), x, transfer.values[some, o, i], drive))
        if transfer.deviation is not None:
            size = transfer.deviation[some, o, i]
            known = np.isfinite(size)
            blocks += [_dataset58(_DEVIATION, 0, (o, i), x[known], size[known], drive)] if known.any() else []
    with atomic_path(path) as beside:
        beside.write_bytes(sealed(b"".join([*blocks, _END_SEAL])))
        _compare(path, transfer, valid, read_uff(beside))


def read_uff(path: str | Path) -> RawMatrix:
    """G from the frequency response functions (type 4) of a universal file, ASCII or binary.

    Entries may have different abscissae: the union is taken and what an entry lacks is marked. Node n is called point n
    as an output and An as an input. Of a function in a negative direction (-X, -Y, -Z) the sign is turned, so that all
    are motion in the positive direction per drive in the positive one; which axis it is, is not looked at. Raises
    DataError for damage, cut-off data, functions in different units, and files without FRFs.
    """
    file = Path(path)
    with reading(file, "damaged or not a universal file ({why})"):
        if len(_MARKS.findall(file.read_bytes())) % 2:
            raise DataError(f"{file}: a dataset has no end mark; the file is cut short")
        content = _pyuff().UFF(str(file))
        functions = [k for k, kind in enumerate(content.get_set_types()) if kind == 58]
        read = content.read_sets(functions) if functions else []
        sets: list[dict[str, Any]] = read if isinstance(read, list) else [read]
        responses = [s for s in sets if s.get("type") == 58 and s.get("func_type") == 4]
        if not responses:
            raise DataError(
                f"{file}: holds no frequency response functions (dataset 58, type 4); export those from the analyser"
            )
        for s in responses:
            _check_count(file, s)
        own = _own_ports(file)
        x = np.unique(np.concatenate([s["x"] for s in responses]))
        nodes = [sorted({int(s[k]) for s in responses}) for k in ("rsp_node", "ref_node")]
        if own is not None:
            nodes = [list(range(1, len(p) + 1)) for p in (own["outputs"], own["inputs"])]
        values, valid = _cube(file, responses, x, nodes)
        return _raw(file, sets, x, values, valid, nodes, own)


def _pyuff() -> Any:
    return optional("pyuff", "uff", "reading and writing universal files")


def _header(transfer: TransferMatrix) -> bytes:
    """A private dataset with the ports as JSON in 80-column lines: readers skip numbers that they do not know."""
    ports = {"outputs": [vars(p) for p in transfer.outputs], "inputs": [vars(p) for p in transfer.inputs]}
    text = json.dumps({"unit": transfer.unit, **arbitrary_gain(transfer.provenance), **ports}, ensure_ascii=True)
    lines = [BLANK.decode(), *(f"|{text[k : k + 72]}|" for k in range(0, len(text), 72))]
    return "\n".join([_END, f"{_PRIVATE:6d}", _MARK, *lines, _END, ""]).encode("ascii")


def _dataset58(title: str, kind: int, place: tuple[int, int], x: FloatArray, data: Any, drive: str) -> bytes:
    """One binary dataset 58b: double precision, little endian, uneven abscissa (in double precision too)."""
    parts = [data.real, data.imag] if np.iscomplexobj(data) else [data]
    body = np.stack([x, *parts], axis=1).astype("<f8").tobytes()
    row = "{:10d}{:5d}{:5d}{:5d} {:<20s} {:<20s}"
    lines = [
        _END,
        f"{58:6d}b{1:6d}{2:6d}{11:12d}{len(body):12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *(f"{line:<80s}" for line in (title, _MARK, "NONE", "NONE", "NONE")),
        f"{kind:5d}{0:10d}{0:5d}{0:10d} {'NONE':>10s}{place[0] + 1:10d}{3:4d} {'NONE':>10s}{place[1] + 1:10d}{3:4d}",
        f"{6 if len(parts) == 2 else 4:10d}{len(x):10d}{0:10d}{0.0:13.5e}{0.0:13.5e}{0.0:13.5e}",
        row.format(18, 0, 0, 0, "frequency", "Hz"),
        row.format(8, 0, 0, 0, "displacement", "m"),
        row.format(_DENOMINATOR[drive], 0, 0, 0, "drive", drive),
        row.format(0, 0, 0, 0, "NONE", "NONE"),
    ]
    return "\n".join([*lines, ""]).encode("ascii") + body + f"{_END}\n".encode("ascii")


def _check_count(file: Path, s: dict[str, Any]) -> None:
    """DataError for values that are cut short, and for what is no frequency in Hz."""
    found, told = len(s["data"]), int(s["num_pts"])
    if found != told or len(s["x"]) != told:
        raise DataError(
            f"{file}: the function {s['rsp_node']} <- {s['ref_node']} has {found} values, its header says {told}; the "
            "file is cut short, or its binary abscissa is in single precision"
        )
    axis, unit = int(s["abscissa_spec_data_type"]), str(s["abscissa_axis_units_lab"]).strip()
    if axis not in _FREQUENCY or unit.lower() not in ("", "none", "hz"):
        raise DataError(
            f"{file}: the abscissa of {s['rsp_node']} <- {s['ref_node']} is of kind {axis} in '{unit}', expected "
            "frequencies (18) in Hz; export them so"
        )
    if max(abs(int(s["rsp_dir"])), abs(int(s["ref_dir"]))) > _TURNS:
        raise DataError(
            f"{file}: the function {s['rsp_node']} <- {s['ref_node']} is a rotation (direction {s['rsp_dir']} or "
            f"{s['ref_dir']}), and G is of translations; export those (directions 1 to 3)"
        )
    if not np.all(np.isfinite(s["x"])) or np.any(np.diff(s["x"]) <= 0):
        raise DataError(
            f"{file}: the frequencies of {s['rsp_node']} <- {s['ref_node']} do not increase; the file is damaged"
        )


def _cube(
    file: Path, sets: Sequence[dict[str, Any]], x: FloatArray, nodes: list[list[int]]
) -> tuple[ComplexArray, BoolArray]:
    shape = (len(x), len(nodes[0]), len(nodes[1]))
    values, valid = np.full(shape, np.nan + 0j), np.zeros(shape, dtype=bool)
    for s in sets:
        rows = np.searchsorted(x, s["x"])
        o, i = nodes[0].index(int(s["rsp_node"])), nodes[1].index(int(s["ref_node"]))
        if valid[rows, o, i].any():
            raise DataError(
                f"{file}: the function {s['rsp_node']} <- {s['ref_node']} occurs twice; keep one direction per node"
            )
        values[rows, o, i], valid[rows, o, i] = _sense(s) * s["data"], np.isfinite(s["data"])
    return values, valid


def _sense(s: Mapping[str, Any]) -> int:
    """-1 where one of response and reference points in a negative direction (-1 to -3 in the format), else 1."""
    return -1 if (int(s["rsp_dir"]) < 0) != (int(s["ref_dir"]) < 0) else 1


def _known_unit(above: str, below: str) -> str | None:
    """The unit that two labels say; None where they say none that is known, which is then to be declared."""
    text = f"({above})/{'V' if below.lower() in ('volt', 'volts', 'v') else below}"
    try:
        parse_unit(text)
    except DataError:
        return None
    return text


def _units(file: Path, sets: Sequence[dict[str, Any]]) -> tuple[str | None, Quantity | None]:
    """Unit and quantity, which all functions must share: one of them would else be off by their ratio."""
    said: dict[tuple[str | None, Quantity | None], dict[str, Any]] = {}
    for s in sets:
        above, below = str(s["ordinate_axis_units_lab"]), str(s["orddenom_axis_units_lab"])
        unit = _known_unit(above.strip(), below.strip())
        said.setdefault((unit, _NUMERATOR.get(int(s["ordinate_spec_data_type"]))), s)
    if len(said) > 1:
        each = [f"{s['rsp_node']} <- {s['ref_node']} is {q or 'motion'} in {u}" for (u, q), s in said.items()]
        raise DataError(f"{file}: its functions have different units ({'; '.join(each[:3])}); export all in one unit")
    return next(iter(said))


def _raw(
    file: Path,
    sets: Sequence[dict[str, Any]],
    x: FloatArray,
    values: ComplexArray,
    valid: BoolArray,
    nodes: list[list[int]],
    own: dict[str, Any] | None,
) -> RawMatrix:
    responses = [s for s in sets if s.get("func_type") == 4]
    unit, quantity = _units(file, responses)
    first, deviation = responses[0], None
    for s in (s for s in sets if s.get("type") == 58 and str(s.get("id1", "")).strip() == _DEVIATION):
        if deviation is None:
            deviation = np.full(values.shape, np.nan)
        place = nodes[0].index(int(s["rsp_node"])), nodes[1].index(int(s["ref_node"]))
        deviation[np.searchsorted(x, s["x"]), place[0], place[1]] = s["data"]
    return RawMatrix(
        name=str(file),
        values=values,
        frequency=x,
        axes=("frequency", "output", "input"),
        unit=unit,
        quantity=quantity,
        spectrum="one-sided",
        sign="+iwt" if str(first["id2"]).strip() == _MARK else None,
        outputs=None if own is None else tuple(port_from(p) for p in own["outputs"]),
        inputs=None if own is None else tuple(port_from(p) for p in own["inputs"]),
        valid=valid,
        deviation=deviation,
        provenance={"format": "UFF 58", **arbitrary_gain(own or {})},
        names=None if own is not None else (tuple(map(str, nodes[0])), tuple(f"A{n}" for n in nodes[1])),
        numbered=True,
    )


def _own_ports(file: Path) -> dict[str, Any] | None:
    """The ports of a file that we wrote."""
    head = file.read_bytes()[: 1 << 20].split(b"\n    -1")[0].decode("ascii", errors="replace").splitlines()
    if _MARK not in (line.strip() for line in head[:4]):
        return None
    text = "".join(line[1:-1] for line in head if line.startswith("|") and line.endswith("|"))
    content: dict[str, Any] = json.loads(text)
    return content


def _compare(path: str | Path, transfer: TransferMatrix, valid: BoolArray, back: RawMatrix) -> None:
    """What was read back holds exactly the valid entries."""
    found = np.zeros(0) if back.frequency is None else back.frequency
    seen = np.isin(transfer.frequency, found)
    same = (
        back.valid is not None
        and np.array_equal(transfer.frequency[seen], found)
        and np.array_equal(valid[seen], back.valid)
        and not valid[~seen].any()
        and np.array_equal(transfer.values[seen][back.valid], back.values[back.valid])
    )
    if not same:
        raise DataError(f"{path}: reading back gave something else than was written; nothing was saved")
