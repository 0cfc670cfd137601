"""Entries of a file of somebody else, put where their names belong among the points and actuators of a scenario."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import DataError
from ..ports import Port
from ..typing import BoolArray, ComplexArray
from .declaration import Declaration, RawMatrix
from .reading import RecognitionWarning

_SHOWN = 6  # names of a list in a sentence
_NUMBER = re.compile(r"^(.*?)0*(\d+)(?:\.0*)?$")


def as_named(word: str, names: Sequence[str], numbered: bool = False) -> str:
    """``word`` as one of ``names``: a number as other programs write it ("1.0", "01"; "A01") is the name that is that
    number, where just one is; any other word stays as it is. The number of a node (``numbered``) is that of a name
    which ends in it, as A3 does."""
    if word in names:
        return word
    alike = [n for n in names if n.lower() == word.lower()]
    if not alike and (mine := _NUMBER.match(word)):
        parts = {n: m for n in names if (m := _NUMBER.match(n))}
        alike = [n for n, m in parts.items() if (m[1].lower(), m[2]) == (mine[1].lower(), mine[2])]
        if not alike and numbered and not mine[1] and len({m[1] for m in parts.values()}) == 1:
            alike = [n for n, m in parts.items() if m[2] == mine[2]]
    return alike[0] if len(alike) == 1 else word


def renamed(raw: RawMatrix, declaration: Declaration, outputs: Sequence[Port], inputs: Sequence[Port]) -> RawMatrix:
    """``raw`` with the names of its columns as declared, else :func:`as_named`; columns that ``points`` or
    ``actuators`` leave out are left out."""
    if raw.names is None:
        if declaration.points or declaration.actuators:
            raise DataError(
                f"{raw.name}: names no points and actuators, so that a map of names has no effect; leave it out"
            )
        return raw
    found, kept = list[tuple[str, ...]](), list[list[int]]()
    maps = (declaration.points, declaration.actuators)
    for own, given, ports in zip(raw.names, maps, (outputs, inputs), strict=True):
        known = [p.name for p in ports]
        told = [_told(n, given, known, raw.numbered) for n in own]
        keep = [k for k, n in enumerate(told) if n is not None]
        names = tuple(n for n in told if n is not None)
        found.append(names if len(set(names)) == len(names) else tuple(own[k] for k in keep))
        kept.append(keep)
    at = np.ix_(*kept)
    arrays = {k: None if (a := getattr(raw, k)) is None else a[:, *at] for k in ("values", "valid", "deviation")}
    changed: dict[str, Any] = {**arrays, "names": (found[0], found[1])}
    return replace(raw, **changed)


def _told(name: str, given: Mapping[str, str] | None, known: Sequence[str], numbered: bool) -> str | None:
    """The port's name of a column; None for a column that is left out."""
    if given is None:
        return as_named(name, known, numbered)
    return next((port for own, port in given.items() if as_named(name, [own]) == own), None)


def unknown_names(named: Sequence[RawMatrix], declaration: Declaration, raws: Sequence[RawMatrix]) -> None:
    """DataError where ``points`` or ``actuators`` map a name that no file has: a slip would leave a port unmeasured."""
    side = [1, 0] if declaration.roving == "hammer" else [0, 1]
    for k, key in zip(side, ("points", "actuators"), strict=True):
        there = {n for raw in raws if raw.names is not None for n in raw.names[k]}
        if lost := [own for own in getattr(declaration, key) or {} if all(as_named(n, [own]) != own for n in there)]:
            raise DataError(
                f"{raws[0].name}: {key} maps '{lost[0]}', which the file does not have; it has {_list(sorted(there))}"
            )


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
    """Complaint of names in the file that no port has; "" for none.

    Numbers of nodes (``raw.numbered``) none of which is a port's name are none, where there are as many as ports.
    """
    keys = ("points", "actuators")
    for kind, key, named, ports in zip(
        ("output", "input"), keys, raw.names or ((), ()), (outputs, inputs), strict=True
    ):
        known = [p.name for p in ports]
        strange = [n for n in named if n not in known]
        if strange and not (raw.numbered and len(strange) == len(named) == len(known)):
            return (
                f"names the {kind}s {_list(strange)}, which are none of {_list(known)}; rename them, name the scenario "
                f"measured, or add --declare \"{key}.{strange[0]}='{known[0]}'\" for each"
            )
    return ""


def _columns(raw: RawMatrix, kind: str, named: Sequence[str], known: Sequence[str]) -> list[int]:
    """Positions of the file's names among the ports' names ``known``."""
    if all(n in known for n in named):
        return [known.index(n) for n in named]
    order = ", ".join(f"{a} as {b}" for a, b in zip(named, known, strict=True))
    warnings.warn(RecognitionWarning(raw.name, f"{kind} nodes, in the order of their numbers,", order), stacklevel=6)
    return list(range(len(known)))


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def _spread(array: ComplexArray | BoolArray | Any, columns: Sequence[list[int]], into: Any) -> Any:
    """``array`` written into the columns of ``into`` that are its own."""
    into[:, np.array(columns[0])[:, None], np.array(columns[1])] = array
    return into
