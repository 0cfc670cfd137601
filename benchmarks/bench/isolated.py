"""A run in a process of its own, so that its memory is its own; medians of several."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import fields, replace
from multiprocessing import get_context
from typing import TypeVar

from forearm_fem.errors import SolverError
from forearm_fem.fem.kernels.compiled import import_compiled

A = TypeVar("A")
R = TypeVar("R")
PATIENCE = 30.0  # s
REPEATS = 3
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Processes started inside use ``count`` threads; more than there are free cores are punished."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, str(count)))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def clock() -> float:
    """Seconds: of the processor with one thread (what an idle machine would take), of the wall with more."""
    return time.process_time() if os.environ.get(_THREADS[0]) == "1" else time.perf_counter()


def isolated(work: Callable[[A], R], argument: A) -> R:
    """``work(argument)`` in a fresh process; SolverError where it was killed."""
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(_worked, work, argument).result()
    except BrokenProcessPool:
        raise SolverError(f"a benchmark of {argument} was killed, most likely for memory") from None


def _worked(work: Callable[[A], R], argument: A) -> R:
    import_compiled()
    return work(argument)


def repeated(work: Callable[[A], R], argument: A) -> tuple[R, ...]:
    """Up to three runs, fewer where all would take longer than :data:`PATIENCE`."""
    start = time.perf_counter()
    results = [isolated(work, argument)]
    while len(results) < REPEATS and (time.perf_counter() - start) * (1 + 1 / len(results)) < PATIENCE:
        results.append(isolated(work, argument))
    return tuple(results)


def median(runs: Sequence[R]) -> R:
    """The first run with the median of every ``seconds...`` and ``peak...`` field, and ``runs`` set."""
    first = runs[0]
    names = [f.name for f in fields(first) if f.name.startswith(("seconds", "peak"))]  # type: ignore[arg-type]
    middle = {n: statistics.median(getattr(r, n) for r in runs) for n in names}
    return replace(first, **middle, runs=len(runs))  # type: ignore[type-var]
