"""Work in threads of our own instead of BLAS's: many small pieces are done faster side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from threadpoolctl import ThreadpoolController

Thing = TypeVar("Thing")
Result = TypeVar("Result")


def thread_count() -> int:
    """Threads that BLAS may use, which is how many are used here."""
    pools = ThreadpoolController().select(user_api="blas").info()
    return max([int(pool["num_threads"]) for pool in pools], default=1)


def in_threads(work: Callable[[Thing], Result], things: Sequence[Thing]) -> list[Result]:
    """Results of ``work`` on each of the ``things``, which must leave Python's lock; BLAS has one thread meanwhile.

    Where there is one thing or one thread the work is done here, with what BLAS has.
    """
    blas = ThreadpoolController().select(user_api="blas")
    count = max([int(pool["num_threads"]) for pool in blas.info()], default=1)
    if min(count, len(things)) < 2:
        return [work(thing) for thing in things]
    with blas.limit(limits=1), ThreadPoolExecutor(count) as pool:
        return list(pool.map(work, things))
