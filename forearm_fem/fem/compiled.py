"""Modules of compiled kernels, for those who can do without them."""

from __future__ import annotations

import importlib
import logging
from functools import lru_cache
from types import ModuleType

_log = logging.getLogger("forearm_fem.fem")


@lru_cache
def compiled(module: str) -> ModuleType | None:
    """A module of this package by name, or None where numba or a place for what it compiles is missing."""
    try:
        return importlib.import_module(f"{__package__}.{module}")
    except (ImportError, RuntimeError) as problem:
        _log.info("%s is not compiled: %s", module, problem)
        return None
