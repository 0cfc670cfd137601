"""Decorator of compiled kernels, and the folder in which their machine code is kept.

numba's own cache lies beside the source, survives ``pip uninstall`` there, and misses a change in another file that a
kernel calls. Here the folder bears the digest of all sources of kernels: what changed is compiled again, and
installations of different versions share no file.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import _Cache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.serialize import dumps

from ...store.folder import default_cache_dir, is_writable, private_temporary

F = TypeVar("F", bound=Callable[..., Any])
_FEM = Path(__file__).parents[1]
_SOURCES = (_FEM / "kernels", _FEM / "linear" / "multifrontal")


def kernel(function: F) -> F:
    """``function`` compiled without the interpreter's lock; its machine code is kept between runs."""
    options: dict[str, Any] = {"nogil": True, "no_cfunc_wrapper": True}
    compiled: Any = numba.njit(**options)(function)
    if (folder := kernels_folder()) is not None:
        compiled._cache = KeptCode(f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}", folder)
    return cast(F, compiled)


def inner_kernel(function: F) -> F:
    """``function`` for kernels only, part of the machine code of each that calls it; called from Python it ends the
    process.

    Alone it is neither optimised nor made machine code, which would take as long again as in its callers.
    """
    options: dict[str, Any] = {"no_cfunc_wrapper": True, "no_cpython_wrapper": True, "pipeline_class": _LinkedOnly}
    return cast(F, numba.njit(**options)(function))


class _LinkedOnly(Compiler):
    """numba's compiler, its result only for linking."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        base: Any = super()
        part: Any = _Part
        base.__init__(typing, target, part(target.codegen(), "part"), *rest)


class _Part(JITCodeLibrary):
    """Code as it comes from lowering, which has no address."""

    def _optimize_functions(self, ll_module: Any) -> None: ...

    def _optimize_final_module(self) -> None: ...

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """None."""
        return 0

    @property
    def codegen(self) -> Any:
        """What :meth:`set_env` is asked of."""
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Nothing: without an entry for Python there is nothing to set."""


class KeptCode(_Cache):
    """Machine code of one kernel: a file for each signature and processor."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self.folder = name, folder

    @property
    def cache_path(self) -> str:
        """Folder of the files."""
        return str(self.folder)

    def is_kept(self) -> bool:
        """True if the kernel was compiled before, for any signature."""
        return any(self.folder.glob(f"{self.name}-*.nbc"))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Code compiled for ``sig``, or None."""
        target_context.refresh()
        try:
            kept = pickle.loads(self._file(sig, target_context.codegen()).read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            return None
        return CompileResult._rebuild(target_context, *kept)  # type: ignore[no-untyped-call]

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep ``data``, whole or not at all; a full disk costs the next run some seconds and this one nothing."""
        if any(not loop.can_cache for loop in data.lifted) or data.library.has_dynamic_globals:
            return
        file = self._file(sig, data.codegen)
        part = file.with_suffix(f".{os.getpid()}")
        with suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            part.write_bytes(dumps(data._reduce()))  # type: ignore[no-untyped-call]
            part.replace(file)

    def _file(self, sig: Any, codegen: Any) -> Path:
        asked = hashlib.sha256(f"{sig} {codegen.magic_tuple()}".encode()).hexdigest()
        return self.folder / f"{self.name}-{asked[:24]}.nbc"

    def enable(self) -> None:
        """Nothing: it is always on."""

    def disable(self) -> None:
        """Nothing: it is always on."""

    def flush(self) -> None:
        """Forget what was compiled."""
        for file in self.folder.glob(f"{self.name}-*.nbc"):
            file.unlink(missing_ok=True)


@lru_cache
def kernels_folder() -> Path | None:
    """Folder of this version's kernels: in $NUMBA_CACHE_DIR, the user's cache, or a private temporary folder.

    None where none of them can be written: then each process compiles for itself.
    """
    digest, own = _digest(), os.environ.get("NUMBA_CACHE_DIR")
    home = (Path(own) if own else default_cache_dir() / "kernels") / digest
    temporary = private_temporary(f"-{digest}")
    return next((folder for folder in (home, temporary) if is_writable(folder)), None)


def _digest() -> str:
    """Of all that decides about machine code beside signature and processor: sources, numba, Python."""
    told = hashlib.sha256(f"{numba.__version__} {sys.implementation.cache_tag}".encode())
    for folder in _SOURCES:
        for file in sorted(folder.glob("*.py")):
            told.update(file.read_bytes())
    return told.hexdigest()[:16]
