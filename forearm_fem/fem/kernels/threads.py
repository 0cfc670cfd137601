"""Work in threads of our own instead of BLAS's: many small pieces are done faster side by side."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from typing import TypeVar

from threadpoolctl import ThreadpoolController

Thing = TypeVar("Thing")
Result = TypeVar("Result")


def thread_count() -> int:
    """Threads that BLAS may use, which is how many are used here."""
    return max([library.num_threads for library in _blas(len(sys.modules)).lib_controllers], default=1)


def in_threads(work: Callable[[Thing], Result], things: Sequence[Thing]) -> list[Result]:
    """Results of ``work`` on each of the ``things``, which must leave Python's lock; BLAS has one thread meanwhile.

    Where there is one thing or one thread the work is done here, with what BLAS has.
    """
    count = thread_count()
    if min(count, len(things)) < 2:
        return [work(thing) for thing in things]
    with one_blas_thread(), ThreadPoolExecutor(count) as pool:
        return list(pool.map(work, things))


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS has one thread meanwhile."""
    with _blas(len(sys.modules)).limit(limits=1):
        yield


@lru_cache(maxsize=1)
def _blas(modules: int) -> ThreadpoolController:
    """NumPy's and SciPy's BLAS, found once for as many imported ``modules``, with which they are loaded: a search reads
    the process' table of memory, 4-7 ms, and there would be hundreds in a sweep. MKL, which comes without an import,
    may be missing: only PARDISO is called there, and not from these threads."""
    return ThreadpoolController().select(user_api="blas")
