"""Modules of compiled kernels, for those who can do without them."""

from __future__ import annotations

import importlib
import logging
from functools import lru_cache
from types import ModuleType

import numpy as np

_log = logging.getLogger("forearm_fem.fem")
MODULES = (
    "kernels.triple_products", "kernels.sparse_times_few", "kernels.skinny_products", "linear.multifrontal.factor",
)  # fmt: skip
_ROOM = __package__.rpartition(".")[0]


@lru_cache
def compiled(module: str) -> ModuleType | None:
    """A module by its name below ``fem``, or None where numba is missing."""
    try:
        return importlib.import_module(f"{_ROOM}.{module}")
    except ImportError as problem:
        if (problem.name or "").startswith(_ROOM):
            raise  # a module of ours that is not there would only make everything slow
        _log.info("%s is not compiled: %s", module, problem)
        return None


def import_compiled() -> None:
    """Import all of them now, so that no clock that is started later sees it; numba, too, imports half of itself with
    the first call of a kernel."""
    for module in MODULES:
        compiled(module)
    if (patterns := compiled("kernels.triple_products")) is not None:
        none = np.empty(0)
        patterns.add_at(none.astype(complex), none.astype(np.int64), 0j, none)
