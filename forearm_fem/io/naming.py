"""Entries of a file of somebody else, put where their names belong among the points and actuators of a scenario."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..ports import Port
from ..typing import BoolArray, ComplexArray
from .reading import RecognitionWarning

if TYPE_CHECKING:
    from .declaration import RawMatrix

_SHOWN = 6  # names of a list in a sentence


def as_named(word: str, names: Sequence[str]) -> str:
    """``word`` as one of ``names``: a number as other programs write it ("1.0", "01") is the name that is that number,
    where just one is; any other word stays as it is."""
    if word in names:
        return word
    try:
        alike = [n for n in names if n.isdigit() and int(n) == float(word)]
    except ValueError:
        return word
    return alike[0] if len(alike) == 1 else word


def renamed(raw: RawMatrix, outputs: Sequence[Port], inputs: Sequence[Port]) -> RawMatrix:
    """``raw`` with the names of its columns :func:`as_named`; as it is where two would then be one."""
    if raw.names is None:
        return raw
    known = [[p.name for p in ports] for ports in (outputs, inputs)]
    found = [tuple(as_named(n, names) for n in own) for own, names in zip(raw.names, known, strict=True)]
    return raw if any(len(set(n)) < len(n) for n in found) else replace(raw, names=(found[0], found[1]))


def placed_by_name(raw: RawMatrix, outputs: Sequence[Port], inputs: Sequence[Port]) -> RawMatrix:
    """``raw`` (frequency, output, input) in the order of ``outputs`` and ``inputs``, by the names that the file uses.

    A port that the file lacks is not measured: NaN, marked. Every name is a port's (:func:`strange_names`), or numbers
    of nodes are taken in their order, with a RecognitionWarning. A file that names no ports is returned as it is.
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


def strange_names(raw: RawMatrix, outputs: Sequence[Port], inputs: Sequence[Port]) -> str:
    """What is wrong with the file's names: those that no port has; "" for nothing.

    Numbers of nodes (``raw.numbered``) none of which is a port's name are none, where there are as many as ports.
    """
    for kind, named, ports in zip(("output", "input"), raw.names or ((), ()), (outputs, inputs), strict=True):
        known = [p.name for p in ports]
        strange = [n for n in named if n not in known]
        if strange and not (raw.numbered and len(strange) == len(named) == len(known)):
            return (
                f"names the {kind}s {_list(strange)}, which are none of {_list(known)}; rename them, "
                "or name the scenario measured"
            )
    return ""


def _columns(raw: RawMatrix, kind: str, named: Sequence[str], known: Sequence[str]) -> list[int]:
    """Where each of the file's names stands among the ports' names ``known``."""
    if all(n in known for n in named):
        return [known.index(n) for n in named]
    order = ", ".join(f"{a} as {b}" for a, b in zip(named, known, strict=True))
    warnings.warn(RecognitionWarning(raw.name, f"{kind} nodes, in the order of their numbers,", order), stacklevel=5)
    return list(range(len(known)))


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def _spread(array: ComplexArray | BoolArray | Any, columns: Sequence[list[int]], into: Any) -> Any:
    """``array`` written into the columns of ``into`` that are its own."""
    into[:, np.array(columns[0])[:, None], np.array(columns[1])] = array
    return into
