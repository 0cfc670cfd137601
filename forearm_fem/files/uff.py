"""Universal file format, dataset 58 (functions at nodal degrees of freedom), read through pyuff.

Of its reading two habits matter: a dataset cut short is returned without complaint, so values are counted; and marks
with blanks behind them are not seen, so these are taken off.
"""

from __future__ import annotations

import re
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ..errors import DataError, optional
from ..scenario.measurement import Quantity, parse_unit
from ..typing import BoolArray, ComplexArray, FloatArray
from .declaration import FOI, Declaration, RecognitionWarning, declare, reading
from .reader import RawMatrix, Reader

_MARKS = re.compile(rb"    -1(?=[\r\n]|\Z| {74})")  # of datasets, as pyuff finds them
_BLANKS = re.compile(rb"^( {4}-1) +(?=\r?$)", re.MULTILINE)
_KINDS = re.compile(rb"^ {4}-1[^\n]*\n\s*(\d+)", re.MULTILINE)
_TURNS = 3  # directions beyond are rotations
_FREQUENCY = (0, 18)  # kinds of an abscissa: not said, and frequency
_NUMERATOR: Mapping[int, Quantity] = MappingProxyType({8: "displacement", 11: "velocity", 12: "acceleration"})
_ESTIMATOR = re.compile(r"\bH(1|2|v)\b", re.IGNORECASE)
_FRF = 4  # the type of a frequency response function
_OTHERS: Mapping[int, str] = MappingProxyType(
    {0: "general", 1: "time response", 2: "auto spectrum", 3: "cross spectrum", 6: "coherence", 9: "spectrum"}
)


class UffReader(Reader):
    """G from the frequency response functions (type 4) of a universal file, ASCII or binary.

    Entries may have different abscissae: the union is taken and what an entry lacks is marked. Of a function in a
    negative direction (-X, -Y, -Z) the sign is turned: all are motion in the positive direction per drive in the
    positive one. Which axis it is must be declared where a node has several.
    """

    kind: ClassVar[str] = "a universal file"
    endings: ClassVar[tuple[str, ...]] = (".uff", ".unv", ".uf", ".ufb", ".bunv", ".58")
    takes = frozenset({"direction", "estimator"})

    def raw(self, file: Path, said: Declaration) -> RawMatrix:
        """See :meth:`.Reader.raw`; damage, cut-off data and functions in different units are refused."""
        with reading(file, "damaged or not a universal file ({why})"):
            functions = _meant(file, _functions(file), said)
            for s in functions:
                _check(file, s)
            x = np.unique(np.concatenate([s["x"] for s in functions]))
            nodes = [sorted({int(s[k]) for s in functions}) for k in ("rsp_node", "ref_node")]
            values, valid = _cube(file, functions, x, nodes)
            unit, quantity = _units(file, functions)
            return RawMatrix(
                name=str(file),
                values=values,
                frequency=x,
                axes=FOI,
                unit=unit,
                quantity=quantity,
                spectrum="one-sided",
                valid=valid,
                provenance={"format": "UFF 58"},
                names=(tuple(map(str, nodes[0])), tuple(map(str, nodes[1]))),
                numbered=True,
            )


def _functions(file: Path) -> list[dict[str, Any]]:
    """The frequency response functions in ``file``, as many as it says."""
    content = file.read_bytes()
    pyuff = optional("pyuff", "uff", "reading universal files")
    plain = _BLANKS.sub(rb"\1", content) if b"58b" not in content else content
    if len(_MARKS.findall(plain)) % 2:
        raise DataError(f"{file}: a dataset has no end mark; the file is cut short")
    if not _MARKS.search(plain):
        raise DataError(f"{file}: has no line of a lone -1, which begins a dataset; it is no universal file")
    with tempfile.TemporaryDirectory(prefix="forearm_fem_") as folder:
        clean = file
        if plain != content:
            clean = Path(folder, "plain.uff")
            clean.write_bytes(plain)
        universal = pyuff.UFF(str(clean))
        places = [k for k, kind in enumerate(universal.get_set_types()) if kind == 58]
        read = universal.read_sets(places) if places else []
    sets: list[dict[str, Any]] = read if isinstance(read, list) else [read]
    told = sum(int(kind) == 58 for kind in _KINDS.findall(plain))
    found = [s for s in sets if s.get("type") == 58]
    if b"58b" not in plain and told > len(found):
        raise DataError(f"{file}: {told} functions begin in it, {len(found)} could be read; the file is damaged")
    responses = [s for s in found if s.get("func_type") == _FRF]
    if not responses:
        kinds = sorted({_OTHERS.get(int(s["func_type"]), f"type {s['func_type']}") for s in found})
        other = f"; its functions are of the kind {', '.join(kinds)}" if kinds else ""
        raise DataError(
            f"{file}: holds no frequency response functions (dataset 58, type 4){other}; export those from the analyser"
        )
    return responses


def _meant(file: Path, functions: list[dict[str, Any]], said: Declaration) -> list[dict[str, Any]]:
    """Functions of the direction and the estimator that are declared, where a pair of nodes has several."""
    turns = [s for s in functions if abs(int(s["rsp_dir"])) > _TURNS]
    if said.direction is not None:
        found = [s for s in functions if abs(int(s["rsp_dir"])) in (0, said.direction)]
        if not found:
            there = ", ".join(map(str, sorted({abs(int(s["rsp_dir"])) for s in functions})))
            raise DataError(f"{file}: no response is in the direction {said.direction}; there are {there}")
        functions = found
    elif turns and len(turns) < len(functions):  # a rotation is named, and refused, where it is all there is
        functions = functions if _one_each(functions) else [s for s in functions if s not in turns]
    several: dict[tuple[int, int], set[int]] = {}
    for s in functions:
        several.setdefault((int(s["rsp_node"]), int(s["ref_node"])), set()).add(abs(int(s["rsp_dir"])))
    if many := next(((pair, found) for pair, found in several.items() if len(found) > 1), None):
        (node, _), directions = many
        raise DataError(
            f"{file}: node {node} has responses in the directions {', '.join(map(str, sorted(directions)))}; add "
            f"{declare('direction', '3')} where z is out of the skin (1 is x, 2 is y)"
        )
    if said.estimator is None and _one_each(functions):
        return functions
    kinds = {id(s): _estimator(s) for s in functions}
    wanted = said.estimator
    named = sorted({k for k in kinds.values() if k})
    if wanted is None and len(named) > 1:
        wanted = "H1" if "H1" in named else named[0]  # type: ignore[assignment]
        others = " and ".join(k for k in named if k != wanted)
        warnings.warn(RecognitionWarning(str(file), f"estimator, beside {others},", str(wanted)), stacklevel=4)
    if wanted is None:
        return functions
    found = [s for s in functions if kinds[id(s)] == wanted]
    if not found:
        raise DataError(
            f"{file}: no function is called {wanted} in its text; they are {', '.join(named) or 'not named'}"
        )
    return found


def _one_each(functions: Sequence[dict[str, Any]]) -> bool:
    return len({(int(s["rsp_node"]), int(s["ref_node"])) for s in functions}) == len(functions)


def _estimator(s: Mapping[str, Any]) -> str:
    """H1, H2 or Hv where one of the lines of text of a function says so; "" otherwise."""
    for key in ("id1", "id2", "id3", "id4", "id5"):
        if named := _ESTIMATOR.search(str(s.get(key, ""))):
            return f"H{named[1].lower()}"
    return ""


def _check(file: Path, s: dict[str, Any]) -> None:
    """DataError for values that are cut short, and for what is no frequency in Hz."""
    name = f"{s['rsp_node']} <- {s['ref_node']}"
    found, told = len(s["data"]), int(s["num_pts"])
    if found != told or len(s["x"]) != told:
        raise DataError(
            f"{file}: the function {name} has {found} values, its header says {told}; the "
            "file is cut short, or its binary abscissa is in single precision"
        )
    axis, unit = int(s["abscissa_spec_data_type"]), str(s["abscissa_axis_units_lab"]).strip()
    if axis not in _FREQUENCY or unit.lower() not in ("", "none", "hz"):
        raise DataError(
            f"{file}: the abscissa of {name} is of kind {axis} in '{unit}', expected "
            "frequencies (18) in Hz; export them so"
        )
    if max(abs(int(s["rsp_dir"])), abs(int(s["ref_dir"]))) > _TURNS:
        raise DataError(
            f"{file}: the function {name} is a rotation (direction {s['rsp_dir']} or "
            f"{s['ref_dir']}), and G is of translations; export those (directions 1 to 3)"
        )
    if not np.all(np.isfinite(s["x"])) or np.any(np.diff(s["x"]) <= 0):
        raise DataError(f"{file}: the frequencies of {name} do not increase; the file is damaged")


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
                f"{file}: the function {s['rsp_node']} <- {s['ref_node']} occurs twice; keep one of them, or one "
                "direction of the drive"
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
