"""Universal file format, dataset 58 (functions at nodal degrees of freedom), through pyuff.

Four habits of pyuff 2.5 are worked around, each seen in its source: overwriting in binary mode truncates
the header it has just written (we only append to a new file); NaN becomes 0 (we refuse it, and leave masked
bins out of the entry); the byte count in the binary header is that of real data (we write the right one);
and a data set cut short is returned without complaint (we count the values). What is written is read back
and compared before it counts.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..errors import DataError, MissingExtra
from ..measurement.declaration import RawMatrix, port_from
from ..ports import Port
from ..scenario.measurement import Quantity
from ..transfer import TransferMatrix
from ..typing import BoolArray, ComplexArray, FloatArray
from .atomic import atomic_path

_MARK = "forearm_fem e^{+i omega t}"
_DEVIATION = "standard deviation"
_NUMERATOR: Mapping[int, Quantity] = MappingProxyType({8: "displacement", 11: "velocity", 12: "acceleration"})


def write_uff(path: str | Path, transfer: TransferMatrix) -> None:
    """G as one binary dataset 58 per entry [m/V, m/N or m/m], its deviation as another, the ports in
    dataset 151.

    Masked bins are left out of their entry (its abscissa then has a gap), never written as zeros. Error
    estimates, ``contacts`` and provenance are not carried: transfer.nc has them. Raises DataError for NaN
    among valid entries, and if what stands in the file is not what was to be written.
    """
    pyuff = _pyuff()
    valid = np.ones(transfer.values.shape, dtype=bool) if transfer.valid is None else transfer.valid
    if bad := int(np.count_nonzero(~np.isfinite(transfer.values) & valid)):
        raise DataError(f"{path}: {bad} entries of G are not finite; mark them in `valid` before writing UFF")
    with atomic_path(path) as beside:
        beside.write_text(_header(transfer), encoding="ascii")
        file = pyuff.UFF(str(beside))
        for o, i in np.ndindex(*transfer.values.shape[1:]):
            for dataset in _datasets(transfer, valid[:, o, i], o, i):
                file.write_sets([dataset], mode="add")
        beside.write_bytes(_with_byte_counts(beside.read_bytes()))
        _compare(path, transfer, valid, _read(beside))


def read_uff(path: str | Path) -> RawMatrix:
    """G from the frequency response functions (type 4) of a universal file, ASCII or binary.

    Entries may have different abscissae: the union is taken and what an entry lacks is marked. Nodes become
    outputs and inputs in the order of their numbers. Raises DataError for damage, cut-off data, and files
    without FRFs.
    """
    file = Path(path)
    if not file.is_file():
        raise DataError(f"{file}: no such file")
    try:
        return _read(file)
    except DataError:
        raise
    except Exception as problem:  # pyuff raises plain Exception for whatever goes wrong
        raise DataError(f"{file}: damaged or not a universal file ({_short(problem)})") from problem


def _short(problem: Exception) -> str:
    return " ".join(str(problem).split())[:120] or type(problem).__name__


def _pyuff() -> Any:
    try:
        return importlib.import_module("pyuff")
    except ImportError:
        raise MissingExtra("pyuff", "uff", "reading and writing universal files") from None


def _header(transfer: TransferMatrix) -> str:
    """Dataset 151 with the ports as JSON in 80-column lines: readers that do not know it skip it."""
    ports = {"outputs": [_plain(p) for p in transfer.outputs], "inputs": [_plain(p) for p in transfer.inputs]}
    text = json.dumps({"unit": transfer.unit, "n": len(transfer.frequency), **ports}, ensure_ascii=True)
    if "    -1" in text:
        raise DataError("a port's name holds '    -1', which ends a universal dataset; rename it")
    lines = [text[k : k + 72] for k in range(0, len(text), 72)]
    return "\n".join([f"{-1:6d}", f"{151:6d}", _MARK, *(f"|{line}|" for line in lines), f"{-1:6d}"]) + "\n"


def _plain(port: Port) -> dict[str, Any]:
    return dict(vars(port))


def _datasets(transfer: TransferMatrix, valid: BoolArray, o: int, i: int) -> list[dict[str, Any]]:
    values = transfer.values[valid, o, i]
    if not valid.any():
        return []
    sets = [_dataset(transfer, o, i, transfer.frequency[valid], values, 4, "frequency response")]
    if transfer.deviation is not None:
        size = transfer.deviation[valid, o, i]
        known = np.isfinite(size)
        if known.any():
            sets.append(
                _dataset(transfer, o, i, transfer.frequency[valid][known], size[known], 0, _DEVIATION)
            )
    return sets


def _dataset(
    transfer: TransferMatrix, o: int, i: int, x: FloatArray, data: Any, kind: int, title: str
) -> dict[str, Any]:
    drive = {"V": 0, "N": 13, "m": 8}[transfer.unit.rpartition("/")[2]]
    return {
        "type": 58, "binary": 1, "func_type": kind, "rsp_node": o + 1, "rsp_dir": 3, "ref_node": i + 1, "ref_dir": 3,
        "id1": title, "id2": _MARK, "id3": "NONE", "id4": f"{o + 1} {i + 1}", "id5": "NONE",
        "data": np.array(data), "x": _at_least_two(x), "abscissa_spacing": 0, "abscissa_spec_data_type": 18,
        "abscissa_axis_lab": "frequency", "abscissa_axis_units_lab": "Hz",
        "ordinate_spec_data_type": 8, "ordinate_axis_lab": "displacement", "ordinate_axis_units_lab": "m",
        "orddenom_spec_data_type": drive, "orddenom_axis_lab": "drive",
        "orddenom_axis_units_lab": transfer.unit.rpartition("/")[2],
    }


def _at_least_two(x: FloatArray) -> FloatArray:
    """pyuff looks at x[1] whatever the spacing."""
    if len(x) < 2:
        raise DataError("a universal file needs at least two valid bins per entry; write transfer.nc instead")
    return np.array(x)


def _with_byte_counts(content: bytes) -> bytes:
    """The header of each binary dataset 58 with the number of bytes that do follow it."""
    parts, at = [], 0
    while (start := content.find(b"\n    58b", at)) >= 0:
        end_of_line = content.index(b"\n", start + 1)
        data = end_of_line + 1
        for _ in range(11):
            data = content.index(b"\n", data) + 1
        form = content[:data].rsplit(b"\n", 7)[1].split()  # record 7: type, number of pairs
        size = int(form[1]) * 8 * (2 if int(form[0]) == 4 else 3)
        fields = content[start + 1 : end_of_line]
        parts += [content[at : start + 1], fields[:31] + b"%12d" % size + fields[43:] + b"\n"]
        parts.append(content[end_of_line + 1 : data + size])
        at = data + size
    return b"".join([*parts, content[at:]])


def _read(file: Path) -> RawMatrix:
    sets = _sets(file)
    responses = [s for s in sets if s.get("type") == 58 and s.get("func_type") == 4]
    if not responses:
        raise DataError(
            f"{file}: holds no frequency response functions (dataset 58, type "
            f"4); export those from the analyser"
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


def _sets(file: Path) -> list[dict[str, Any]]:
    if file.read_bytes().count(b"    -1") % 2:
        raise DataError(f"{file}: a dataset has no end mark; the file is cut short")
    read = _pyuff().UFF(str(file)).read_sets()
    return read if isinstance(read, list) else [read]


def _check_count(file: Path, s: dict[str, Any]) -> None:
    found, told = len(s["data"]), int(s["num_pts"])
    if found != told or len(s["x"]) != told:
        raise DataError(
            f"{file}: the function {s['rsp_node']} <- {s['ref_node']} has "
            f"{found} values, its header says {told}; "
            "the file is cut short, or its binary abscissa is in single precision"
        )
    if not np.all(np.isfinite(s["x"])) or np.any(np.diff(s["x"]) <= 0):
        raise DataError(
            f"{file}: the frequencies of {s['rsp_node']} <- {s['ref_node']} do "
            f"not increase; the file is damaged"
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
                f"{file}: the function {s['rsp_node']} <- {s['ref_node']} occurs "
                f"twice; keep one direction per node"
            )
        values[rows, o, i], valid[rows, o, i] = s["data"], np.isfinite(s["data"])
    return values, valid


def _raw(
    file: Path, sets: Sequence[dict[str, Any]], x: FloatArray, values: ComplexArray, valid: BoolArray,
    nodes: list[list[int]], own: dict[str, Any] | None,
) -> RawMatrix:
    first = next(s for s in sets if s.get("func_type") == 4)
    above, below = str(first["ordinate_axis_units_lab"]), str(first["orddenom_axis_units_lab"])
    known = "NONE" not in (above, below) and above and below
    return RawMatrix(
        name=str(file),
        values=values,
        frequency=x,
        axes=("frequency", "output", "input"),
        unit=f"({above})/{below}" if known else None,
        quantity=_NUMERATOR.get(int(first["ordinate_spec_data_type"])),
        spectrum="one-sided",
        sign="+iwt" if str(first["id2"]).strip() == _MARK else None,
        outputs=None if own is None else tuple(port_from(p) for p in own["outputs"]),
        inputs=None if own is None else tuple(port_from(p) for p in own["inputs"]),
        valid=valid,
        deviation=_deviation(sets, x, nodes),
        provenance={"format": "UFF 58"},
    )


def _deviation(sets: Sequence[dict[str, Any]], x: FloatArray, nodes: list[list[int]]) -> FloatArray | None:
    ours = [s for s in sets if s.get("type") == 58 and str(s.get("id1", "")).strip() == _DEVIATION]
    if not ours:
        return None
    out = np.full((len(x), len(nodes[0]), len(nodes[1])), np.nan)
    for s in ours:
        place = nodes[0].index(int(s["rsp_node"])), nodes[1].index(int(s["ref_node"]))
        out[np.searchsorted(x, s["x"]), place[0], place[1]] = s["data"]
    return out


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
    seen = np.isin(transfer.frequency, back.frequency)
    same = (
        back.frequency is not None
        and back.valid is not None
        and np.array_equal(transfer.frequency[seen], back.frequency)
        and np.array_equal(valid[seen], back.valid)
        and not valid[~seen].any()
        and np.array_equal(transfer.values[seen][back.valid], back.values[back.valid])
    )
    if not same:
        raise DataError(f"{path}: reading back gave something else than was written; nothing was saved")
