"""Work on many processes: Dask's, of this machine or of a scheduler that is already running."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from typing import Any

from ..errors import SolverError, optional
from ..interrupts import interrupts_wait

LIGHT = 0.6e9  # bytes of a worker that solves no finite elements
SHARE = 0.8  # of the free memory that workers may take together
PATIENCE = 10  # s for a scheduler to answer


def in_turn(scheduler: str | None, workers: int | None) -> bool:
    """Whether nobody asked for processes and Dask, which would start them, is not installed: this one does the work."""
    return scheduler is None and workers is None and find_spec("distributed") is None


@contextmanager
def cluster(scheduler: str | None, count: Callable[[], int], purpose: str = "a campaign") -> Iterator[Any]:
    """A Dask client: of the scheduler at the address ``scheduler``, else of ``count()`` processes started for it.

    Raises MissingExtra without Dask, SolverError where no scheduler answers.
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
    settings = {"n_workers": count(), "threads_per_worker": 1, "processes": True, "dashboard_address": None}
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
    client: Any, function: Callable[[Any], dict[str, Any]], jobs: Mapping[str, Any]
) -> Iterator[tuple[str, dict[str, Any]]]:
    """(key, ``function(job)``) as ``jobs`` end, in whatever order.

    A worker that dies three times with a job loses this job only: its result is {"problem": sentence}.
    """
    distributed = optional("distributed", "campaign", "a campaign")
    futures = [client.submit(function, job, key=key, pure=False) for key, job in jobs.items()]
    for future in distributed.as_completed(futures):
        if future.status == "finished":
            yield future.key, future.result()
        else:
            yield (
                future.key,
                {"problem": f"its worker was lost ({future.exception()}), most likely for memory"},
            )
        future.release()
