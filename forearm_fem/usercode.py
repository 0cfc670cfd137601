"""User code: classes of the user's own file, named ``module:Name`` in a scenario or in Python.

A scenario's file names modules beside it; elsewhere a module is looked for as Python does, and in the current folder.
The class is run as it is: a scenario that names code is trusted like a program.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .errors import ScenarioError

PATTERN = r"^[^:\s]+:[A-Za-z_]\w*$|^[A-Za-z]:[^:\n]+\.py:[A-Za-z_]\w*$|^/[^:\n]+\.py:[A-Za-z_]\w*$"
_SHORT = re.compile(r"^([A-Za-z_][\w.]*):([A-Za-z_]\w*)$")


def is_code(text: object) -> bool:
    """True if ``text`` names user code."""
    return isinstance(text, str) and re.match(PATTERN, text) is not None


def named(text: str, what: str) -> Any:
    """The object that ``text`` names, ``module:Name`` or ``/path/to/module.py:Name``; ``what`` it is said to be.

    ScenarioError for a module that is not found or fails, and for a name that it has not.
    """
    place, _, name = text.rpartition(":")
    try:
        module = _from_file(Path(place)) if place.endswith(".py") else _by_name(place)
    except ImportError as problem:
        raise ScenarioError(
            f"{what} {text!r}: no module of that name beside the scenario, in the current folder or installed "
            f"({problem}); write module:Name of a file module.py there"
        ) from None
    except Exception as problem:
        raise ScenarioError(f"{what} {text!r}: its module fails ({type(problem).__name__}: {problem})") from problem
    if not hasattr(module, name):
        raise ScenarioError(f"{what} {text!r}: {place} has no {name}; correct the name")
    return getattr(module, name)


def with_code_beside(data: Any, folder: Path) -> Any:
    """Plain ``data`` in which ``module:Name`` names ``module.py`` of ``folder`` in full, where there is that file."""
    if isinstance(data, Mapping):
        return {key: with_code_beside(value, folder) for key, value in data.items()}
    if isinstance(data, list):
        return [with_code_beside(value, folder) for value in data]
    found = _SHORT.match(data) if isinstance(data, str) else None
    if found is None:
        return data
    file = folder / (found[1].replace(".", "/") + ".py")
    return f"{file.resolve()}:{found[2]}" if file.is_file() else data


def _by_name(module: str) -> Any:
    here = Path(module.replace(".", "/") + ".py")
    return _from_file(here) if here.is_file() else importlib.import_module(module)


def _from_file(file: Path) -> Any:
    """The module in ``file``, read once a process and found again under its path by pickle."""
    path = file.resolve()
    name = f"forearm_fem_user_{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:12]}"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, path)
        if spec is None or spec.loader is None or not path.is_file():
            raise ImportError(f"{path}: no such file")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            spec.loader.exec_module(module)
        except BaseException:
            del sys.modules[name]
            raise
    return sys.modules[name]
