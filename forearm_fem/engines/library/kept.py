"""What the making of a library has done so far, on disk, so that a run that was ended goes on."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, BinaryIO
from zipfile import BadZipFile

import numpy as np

from ...errors import DataError
from ...fem.reduction.basis import Basis
from ...fem.reduction.reduced_model import ReducedModel
from ...store.folder import atomic_path
from ...typing import FloatArray
from .limb import Limb

_UNREADABLE = (OSError, ValueError, KeyError, EOFError, BadZipFile)
_SPACE, _SIDE = "space.npz", "side.npz"
_LIMBS = ("limb", "freed")
_log = logging.getLogger("forearm_fem.engines.library")


@dataclass(frozen=True, eq=False)
class Side:
    """One mesh's part: the limb through the bells, with free ends where it has absorbing ones, ``reduction`` (3, n),
    frequencies [Hz] and the reduced model's errors there along the normal and along the skin, ``missed`` (n, 3, n_bin)
    [m/N], what they are by distance, and facts."""

    limb: Limb
    freed: Limb | None
    reduction: FloatArray
    missed: FloatArray
    facts: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Progressed:
    """The space of the first ``done`` loads: ``reduced`` with its ``functionals`` (r, n_bell), made by ``solves``."""

    reduced: ReducedModel
    functionals: FloatArray
    done: int
    solves: int
    seconds: float


class Kept:
    """Files of one mesh's part in ``folder``: the columns of each batch, the space they span, and the part itself.

    What cannot be written is told in the log and made again next time; what cannot be read was never there.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def side(self) -> Side | None:
        """The part, if it was finished."""
        try:
            with np.load(self._folder / _SIDE, allow_pickle=False) as data:
                limb, freed = (Limb.read(data, name) for name in _LIMBS)
                facts = json.loads(str(data["facts"]))
                return None if limb is None else Side(limb, freed, data["reduction"], data["missed"], facts)
        except _UNREADABLE:
            return None

    def finish(self, side: Side) -> None:
        """Keep the part, and let its columns go."""
        facts = np.array(json.dumps(dict(side.facts)))
        arrays: dict[str, Any] = {"facts": facts, "reduction": side.reduction, "missed": side.missed}
        for name in _LIMBS:
            limb: Limb | None = getattr(side, name)
            if limb is not None:
                arrays |= {f"{name}_{field.name}": getattr(limb, field.name) for field in fields(Limb)}
        if self._written(self._folder / _SIDE, lambda stream: np.savez(stream, **arrays)):
            for file in (*self._folder.glob("columns-*.npy"), self._folder / _SPACE):
                file.unlink(missing_ok=True)

    def progressed(self, start: Progressed) -> Progressed:
        """As far as it got: ``start``, the empty space, where nothing was kept."""
        try:
            with np.load(self._folder / _SPACE, allow_pickle=False) as data:
                blocks = tuple(np.load(self._columns(k), allow_pickle=False) for k in range(int(data["blocks"])))
                matrices, functionals = data["matrices"], data["functionals"]
                if sum(block.shape[1] for block in blocks) != len(functionals):
                    return start
                reduced = replace(
                    start.reduced, matrices=matrices, functionals=np.zeros((len(functionals), 0)),
                    basis=Basis(blocks), low=np.zeros((len(functionals), 0)), coupling=data["coupling"],
                )  # fmt: skip
                done, solves = int(data["done"]), int(data["solves"])
                return Progressed(reduced, functionals, done, solves, float(data["seconds"]))
        except _UNREADABLE:
            return start

    def keep(self, state: Progressed) -> None:
        """Keep how far it got; the space's last block is new."""
        blocks, reduced = state.reduced.basis.blocks, state.reduced
        if self._written(self._columns(len(blocks) - 1), lambda stream: np.save(stream, blocks[-1])):
            arrays: dict[str, Any] = {
                "matrices": reduced.matrices, "coupling": reduced.coupling, "functionals": state.functionals,
                "blocks": np.array(len(blocks)), "done": np.array(state.done), "solves": np.array(state.solves),
                "seconds": np.array(state.seconds),
            }  # fmt: skip
            self._written(self._folder / _SPACE, lambda stream: np.savez(stream, **arrays))

    def _columns(self, number: int) -> Path:
        return self._folder / f"columns-{number:03d}.npy"

    def _written(self, file: Path, write: Callable[[BinaryIO], None]) -> bool:
        try:
            with atomic_path(file) as beside, beside.open("wb") as stream:
                write(stream)
        except (DataError, OSError) as problem:
            _log.warning(
                "what was solved for the library could not be kept in %s (%s); ended, it starts anew",
                self._folder, problem,
            )  # fmt: skip
            return False
        return True
