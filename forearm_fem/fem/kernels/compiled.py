"""Compiled kernels on demand, threads, and the heap while a solve runs."""

from __future__ import annotations

import ctypes
import importlib
import logging
import platform
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from types import ModuleType
from typing import TypeVar

import numpy as np
import scipy.linalg.blas  # noqa: F401
from threadpoolctl import ThreadpoolController

# Modules of compiled kernels, for those who can do without them.

_log = logging.getLogger("forearm_fem.fem")
MODULES = "kernels.scatter", "kernels.products", "linear.multifrontal.factor"
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
    if (patterns := compiled("kernels.scatter")) is not None:
        patterns.sort_in_place(np.empty(0, np.int64))


# Work in threads of our own instead of BLAS's: many small pieces are done faster side by side.

Thing = TypeVar("Thing")
Result = TypeVar("Result")


def thread_count() -> int:
    """Threads that BLAS may use, which is how many are used here."""
    return max([library.num_threads for library in _blas().lib_controllers], default=1)


def in_threads(work: Callable[[Thing], Result], things: Sequence[Thing]) -> list[Result]:
    """Results of ``work`` on each of the ``things``, which must leave Python's lock; BLAS has one thread meanwhile."""
    count = thread_count()
    with one_blas_thread():
        if min(count, len(things)) < 2:
            return [work(thing) for thing in things]
        with ThreadPoolExecutor(count) as pool:
            return list(pool.map(work, things))


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS has one thread meanwhile.

    OpenBLAS's other threads wait for work by spinning. On matrices of some hundred rows that takes more of the cores
    than they give.
    """
    with _blas().limit(limits=1):
        yield


@lru_cache
def _blas() -> ThreadpoolController:
    """NumPy's and SciPy's BLAS, both loaded by now and found once: a search reads the process' table of memory, 4-7 ms,
    and there would be hundreds in a sweep. MKL, which comes without an import, may be missing: only PARDISO is called
    there, and not from these threads."""
    return ThreadpoolController().select(user_api="blas")


# Freed memory in glibc: kept while large arrays come and go, given back at turns of the work.

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _MMAP_MAX = -1, -3, -4  # of <malloc.h>
_NEVER, _USUAL_MAPS = -1, 65536
_LARGE = 32 * 1024 * 1024  # bytes: what glibc's own threshold grows to, which it no longer does once it is told any


@contextmanager
def freed_memory_kept() -> Iterator[None]:
    """glibc maps large arrays one by one and unmaps them at once; inside, it takes them from its heap instead.

    A tenth of the forearm's solve was spent on fresh pages. At the end what is free goes back to
    the system. Does nothing where the C library is another one.
    """
    library = _glibc()
    if library is None:
        yield
        return
    library.mallopt(_MMAP_MAX, 0)
    library.mallopt(_TRIM_THRESHOLD, _NEVER)
    try:
        yield
    finally:
        library.mallopt(_MMAP_MAX, _USUAL_MAPS)
        library.mallopt(_MMAP_THRESHOLD, _LARGE)
        library.mallopt(_TRIM_THRESHOLD, 2 * _LARGE)
        give_back()


def give_back() -> None:
    """Free pages back to the system now; arrays that were freed while others above them live stay resident else.

    Fresh pages cost time, so this is for moments when much is free and little of it fits what comes next, not for
    loops. Does nothing where the C library is another one.
    """
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


def _glibc() -> ctypes.CDLL | None:
    return ctypes.CDLL(None) if platform.libc_ver()[0] == "glibc" else None
