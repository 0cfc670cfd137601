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
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from ...store.folder import default_cache_dir, is_writable, private_temporary

F = TypeVar("F", bound=Callable[..., Any])
_FEM = Path(__file__).parents[1]
_SOURCES = (_FEM / "kernels", _FEM / "linear" / "multifrontal")


def kernel(function: F) -> F:
    """``function`` compiled without the interpreter's lock; its machine code is kept between runs.

    One whose name begins with an underscore is called by kernels only: it has no entry for Python, which would take as
    long to compile as a small kernel itself, and calling it from there ends the process.
    """
    options: dict[str, Any] = {"no_cfunc_wrapper": True, "no_cpython_wrapper": function.__name__.startswith("_")}
    compiled: Any = numba.njit(nogil=True, **options)(function)
    if (folder := kernels_folder()) is not None:
        compiled._cache = KeptCode(f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}", folder)
    return cast(F, compiled)


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
