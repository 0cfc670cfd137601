"""Entries of a file of somebody else, put where their names belong among the points and actuators of a scenario."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DataError
from ..ports import Port
from ..typing import BoolArray, ComplexArray
from .recognition import RecognitionWarning

if TYPE_CHECKING:
    from .declaration import RawMatrix

_SHOWN = 8  # names of a list in a sentence


def placed_by_name(raw: RawMatrix, outputs: Sequence[Port], inputs: Sequence[Port]) -> RawMatrix:
    """``raw`` (frequency, output, input) in the order of ``outputs`` and ``inputs``, by the names that the file uses.

    A port that the file lacks is not measured: NaN, marked. Raises DataError for a name that no port has. Numbers of
    nodes (``raw.numbered``) none of which is a port's name are taken in their order, with a RecognitionWarning, where
    there are as many as ports. A file that names no ports is returned as it is.
    """
    if raw.names is None:
        return raw
    columns = [
        _columns(raw, kind, named, [p.name for p in ports])
        for kind, named, ports in zip(("output", "input"), raw.names, (outputs, inputs), strict=True)
    ]
    shape = (len(raw.values), len(outputs), len(inputs))
    measured = np.isfinite(raw.values) if raw.valid is None else raw.valid
    return replace(
        raw,
        values=_spread(raw.values, columns, np.full(shape, np.nan + 0j)),
        valid=_spread(measured, columns, np.zeros(shape, dtype=bool)),
        deviation=None if raw.deviation is None else _spread(raw.deviation, columns, np.full(shape, np.nan)),
    )


def _columns(raw: RawMatrix, kind: str, named: Sequence[str], known: Sequence[str]) -> list[int]:
    """Where each of the file's names stands among the ports' names ``known``."""
    strange = [n for n in named if n not in known]
    if not strange:
        return [known.index(n) for n in named]
    if raw.numbered and len(strange) == len(named) == len(known):
        order = ", ".join(f"{a} as {b}" for a, b in zip(named, known, strict=True))
        warnings.warn(
            RecognitionWarning(raw.name, f"{kind} nodes, in the order of their numbers,", order), stacklevel=5
        )
        return list(range(len(known)))
    raise DataError(
        f"{raw.name}: names the {kind}s {_list(strange)}, which are none of {_list(known)}; rename them in the file, "
        "or name the scenario that was measured"
    )


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def _spread(array: ComplexArray | BoolArray | Any, columns: Sequence[list[int]], into: Any) -> Any:
    """``array`` written into the columns of ``into`` that are its own."""
    into[:, np.array(columns[0])[:, None], np.array(columns[1])] = array
    return into
