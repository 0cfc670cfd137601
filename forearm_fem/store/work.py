"""Work that is done once: a map over jobs that goes on where it stopped, in this process, several, or on Dask."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from typing import Any

import psutil

from ..errors import SolverError, optional
from ..processes import interrupts_wait, refuse_unguarded_script
from .shelf import Shelf

LIGHT = 0.6e9  # bytes of a worker that solves no finite elements
SHARE = 0.8  # of the free memory that workers may take together
PATIENCE = 10  # s for a scheduler to answer
LOST = "lost"  # the key of a result that says why there is none: it is not kept
Work = Callable[[Any], Mapping[str, Any]]
Run = Callable[[Mapping[str, Any], Work], Iterator[tuple[str, Mapping[str, Any]]]]


def done_once(
    shelf: Shelf, jobs: Mapping[str, Any], work: Work, *, run: Run | None = None,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[tuple[str, dict[str, Any]]]:  # fmt: skip
    """(key, ``work(job)``) of all ``jobs``: first those on the ``shelf``, then others as they end, kept before told.

    Results are arrays, and values that JSON has, by name; one with the key :data:`LOST` is passed on and not kept.
    ``run`` (:func:`spread`) does the rest, without it this process. ``tell`` hears how many are done, of how many.
    """
    missing = dict(jobs)
    for key in jobs:
        if (found := shelf.get(key)) is not None:
            del missing[key]
            yield key, found
    done = len(jobs) - len(missing)
    tell(done, len(jobs))
    for key, made in (run or in_this_process)(missing, work):
        if LOST not in made:
            shelf.put(key, made)
        done += 1
        tell(done, len(jobs))
        yield key, dict(made)


def in_this_process(jobs: Mapping[str, Any], work: Work) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """(key, ``work(job)``), one after the other."""
    return ((key, work(job)) for key, job in jobs.items())


def spread(
    workers: int | Callable[[], int], scheduler: str | None, purpose: str, *, asked: bool = True, apart: bool = False
) -> Run | None:
    """Processes for the jobs of :func:`done_once`: so many, or those of a Dask ``scheduler`` at this address.

    ``workers`` that are worked out are so when there is a job. None where this process does all: for one worker, unless
    its jobs are to be ``apart`` from it, and where nobody ``asked`` for processes and Dask is not installed.
    """
    if scheduler is None and ((workers == 1 and not apart) or not (asked or _has_dask())):
        return None

    def on_dask(jobs: Mapping[str, Any], work: Work) -> Iterator[tuple[str, Mapping[str, Any]]]:
        """Results as they end, from processes that live as long as there are jobs."""
        if not jobs:
            return
        count = workers if isinstance(workers, int) else 1 if scheduler else min(len(jobs), workers())
        if scheduler is None and count == 1 and not apart:
            yield from in_this_process(jobs, work)
            return
        with cluster(scheduler, count, purpose) as client:
            yield from completed(client, work, jobs)

    return on_dask


def _has_dask() -> bool:
    try:
        return find_spec("distributed") is not None
    except ValueError:  # of a module that is None
        return False


def light_workers() -> int:
    """Processes of ``LIGHT`` bytes that cores and free memory allow."""
    return max(1, min(os.cpu_count() or 1, int(SHARE * psutil.virtual_memory().available // LIGHT)))


@contextmanager
def cluster(scheduler: str | None, count: int, purpose: str) -> Iterator[Any]:
    """A Dask client: of the scheduler at the address ``scheduler``, else of ``count`` processes started for it.

    Raises MissingExtra without Dask, SolverError where no scheduler answers, ForearmError in a script whose processes
    would each run it again.
    """
    distributed = optional("distributed", "campaign", purpose)
    if scheduler is not None:
        try:
            client: Any = distributed.Client(scheduler, timeout=PATIENCE)
        except (OSError, ValueError) as problem:
            raise SolverError(f"no Dask scheduler answers at {scheduler} ({problem}); check the address") from None
        with client:
            yield client
        return
    refuse_unguarded_script()
    settings = {"n_workers": count, "threads_per_worker": 1, "processes": True, "dashboard_address": None}
    with _quiet(), ExitStack() as stack:
        try:
            with interrupts_wait():
                own = stack.enter_context(distributed.LocalCluster(**settings, memory_limit=0, silence_logs=50))
                client = stack.enter_context(distributed.Client(own))
            yield client
        finally:
            with interrupts_wait():
                stack.close()


@contextmanager
def _quiet() -> Iterator[None]:
    """A cluster of our own comes and goes unheard; its errors stay."""
    log = logging.getLogger("distributed")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


def completed(
    client: Any, function: Work, jobs: Mapping[str, Any]
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """(key, ``function(job)``) as ``jobs`` end, in whatever order.

    A worker that dies three times with a job loses this job only: its result says so under :data:`LOST`.
    """
    distributed = optional("distributed", "campaign", "a campaign")
    futures = {client.submit(function, job, pure=False): key for key, job in jobs.items()}
    for future in distributed.as_completed(list(futures)):
        key = futures.pop(future)
        if future.status == "finished":
            yield key, future.result()
        else:
            yield key, {LOST: f"its worker was lost ({future.exception()}), most likely for memory"}
        future.release()
