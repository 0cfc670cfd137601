"""Seconds and peak memory of each stage."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import psutil

from ..results import StageCost


@dataclass
class Ledger:
    """Collects what each stage cost; the one mutable record of a run."""

    stages: dict[str, StageCost] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage and watch the process's memory while it runs."""
        watch = _MemoryWatch()
        start = time.perf_counter()
        watch.start()
        try:
            yield
        finally:
            watch.stop()
            seconds = time.perf_counter() - start
            self.stages[name] = StageCost(seconds=round(seconds, 3), peak_memory_bytes=float(watch.peak))


class _MemoryWatch(threading.Thread):
    """Samples the resident set every 50 ms."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self._process = psutil.Process()
        self._done = threading.Event()
        self.peak = self._process.memory_info().rss

    def run(self) -> None:
        """See :class:`threading.Thread`."""
        while not self._done.wait(0.05):
            self.peak = max(self.peak, self._process.memory_info().rss)

    def stop(self) -> None:
        """End the sampling."""
        self._done.set()
        self.join()
