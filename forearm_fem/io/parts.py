"""Finished parts of a long computation, one file each in a folder of the cache, until the whole is there."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ..errors import DataError
from ..store.folder import atomic_path

_log = logging.getLogger("forearm_fem.io")
DAMAGED = OSError, ValueError, KeyError, EOFError, BadZipFile


@dataclass(frozen=True)
class PartFolder:
    """Arrays by the name of their part in ``folder``; ``what`` each is called where it cannot be kept.

    A damaged part counts as missing, a folder that cannot be written to only costs the reuse.
    """

    folder: Path
    what: str = "a finished part"

    def get(self, name: str) -> Mapping[str, Any] | None:
        """The arrays of a part, or None."""
        try:
            with (self.folder / f"{name}.npz").open("rb") as stream, np.load(stream, allow_pickle=False) as data:
                return {key: data[key] for key in data.files}
        except DAMAGED:
            return None

    def put(self, name: str, parts: Mapping[str, Any]) -> None:
        """Keep a part, whole or not at all."""
        try:
            with atomic_path(self.folder / f"{name}.npz", durable=False) as target, open(target, "wb") as stream:
                np.savez(stream, **parts)
        except (DataError, OSError) as problem:
            _log.warning("%s could not be kept for a later run: %s", self.what, problem)

    def drop(self) -> None:
        """Remove all parts."""
        shutil.rmtree(self.folder, ignore_errors=True)
