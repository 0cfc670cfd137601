"""Progress on a terminal: one bar and one time left for the whole job, learnt from its last run."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from ..errors import ForearmError
from ..progress import Journey
from ..store.folder import default_cache_dir, write_text

console = Console(stderr=True)
_FILE, _MOST = "timings.json", 200  # jobs that are remembered
NO_ESTIMATE = "first run: no estimate yet"
# Seconds of first runs on two cores (benchmarks/results/account.csv): a guess until this machine knows better.
_SHIPPED: dict[str, dict[str, float]] = {
    "run thesis": {"mesh": 0.7, "solve": 0.4, "assembly": 11.0, "ordering of unknowns": 8.0, "reduced model": 70.0,
                   "check of the reduced model": 6.4, "coarser mesh: assembly": 2.8,
                   "coarser mesh: ordering of unknowns": 3.2, "coarser mesh: reduced model": 15.0,
                   "write": 1.8, "render": 0.9, "report": 5.4},
}  # fmt: skip


def job_words(arguments: list[str]) -> str:
    """The job as its command line says, but for where results go."""
    kept, skip = [], False
    for word in arguments:
        if not skip and word != "--out" and not word.startswith("--out="):
            kept.append(word)
        skip = word == "--out"
    return " ".join(kept)


def learnt_of(job: str) -> dict[str, float]:
    """Seconds of each stage of the last run of ``job``, or of the last one of its kin; empty where there was none."""
    known = {**_SHIPPED, **_timings()}
    kin = [stages for other, stages in known.items() if _kin(other) == _kin(job)] if job.startswith("run ") else []
    return known.get(job) or next(reversed(kin), {})


def _kin(job: str) -> list[str]:
    """Command, scenario and engine: runs that have these in common take about as long."""
    head = job.partition(" --")[0].split()
    return [*head, *(word for word in job.split() if word.startswith("engine="))] if len(head) > 1 else [job]


def learn(job: str, seconds: dict[str, float]) -> None:
    """Keep the ``seconds`` of each stage of ``job`` for its next run; a cache that cannot be written is no failure."""
    others = {name: stages for name, stages in _timings().items() if name != job}
    kept = dict(list(others.items())[-_MOST:])
    with suppress(OSError, ForearmError):
        write_text(default_cache_dir() / _FILE, json.dumps({**kept, job: seconds}, indent=0))


def _timings() -> dict[str, dict[str, float]]:
    try:
        found = json.loads((default_cache_dir() / _FILE).read_text(encoding="utf-8"))
        return {str(job): {str(s): float(t) for s, t in stages.items()} for job, stages in found.items()}
    except (OSError, ValueError, AttributeError, TypeError):
        return {}


class Display:
    """One bar on stderr with the stage under way and the time left of the whole job.

    A stage is shown before its work begins, so that none is silent even where compiled code holds the interpreter.
    Where stderr is no terminal, lines say the same: one a second after the job began, then one every ten seconds.
    """

    def __init__(self, job: str | None = None) -> None:
        self._job = job_words(sys.argv[1:]) if job is None else job
        self._journey = Journey(learnt_of(self._job), time.monotonic())
        self._unknown = NO_ESTIMATE  # said once
        self._lock = threading.Lock()
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(24), TimeElapsedColumn(), TextColumn("{task.fields[left]}"),
            console=console,
        ) if console.is_terminal else None  # fmt: skip
        self._task = self._bar.add_task("", total=None, left="") if self._bar else None
        self._beat = Heartbeat(self._refresh if self._bar else self._line, 0.5 if self._bar else Heartbeat.AGAIN)

    def __enter__(self) -> Display:
        if self._bar:
            self._bar.start()
        self._beat.start()
        return self

    def __exit__(self, failed: object, *_: object) -> None:
        self._beat.stop()
        if self._bar:
            self._bar.stop()
        if failed is None and self._journey.spent:
            learn(self._job, self._journey.ended(time.monotonic()))

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Progress callback of the library; a stage of unknown length has ``total`` 0."""
        with self._lock:
            begins = stage != self._journey.stage
            self._journey.tell(stage, done, total, time.monotonic())
        if begins and self._bar:
            self._refresh()

    def _refresh(self) -> None:
        assert self._bar is not None
        assert self._task is not None
        with self._lock:
            now, j = time.monotonic(), self._journey
            count = f" {j.done}/{j.total}" if j.total > 1 else ""
            share = j.share(now)
            left = left_words(j.left(now), NO_ESTIMATE if len(j.spent) < 2 else "")
            words = f"{j.stage}{count}"
        self._bar.update(self._task, description=f"{words:36}", completed=share or 0.0,
                         total=None if share is None else 1.0, left=left)  # fmt: skip
        self._bar.refresh()

    def _line(self) -> None:
        with self._lock:
            line = progress_line(self._journey, time.monotonic(), self._unknown)
        if line:
            self._unknown = ""
            console.print(line, highlight=False, markup=False, soft_wrap=True)


class Heartbeat(threading.Thread):
    """Calls ``beat`` one second after it starts, and then every ``again`` seconds until it is stopped."""

    FIRST, AGAIN = 1.0, 10.0

    def __init__(self, beat: Callable[[], None], again: float = AGAIN) -> None:
        super().__init__(daemon=True)
        self._beat, self._again = beat, again
        self._ended = threading.Event()

    def run(self) -> None:
        """See :class:`threading.Thread`."""
        wait = min(self.FIRST, self._again)
        while not self._ended.wait(wait):
            self._beat()
            wait = self._again

    def stop(self) -> None:
        """No more beats."""
        self._ended.set()
        self.join()


def progress_line(journey: Journey, now: float, unknown: str = "") -> str:
    """E.g. ``zero search 3 of 9; 12 s gone, about 24 s left``; empty while no stage is told."""
    if not journey.stage:
        return ""
    count = f" {journey.done} of {journey.total}" if journey.total > 1 else ""
    left = left_words(journey.left(now), unknown)
    return f"{journey.stage}{count}; {now - journey.began:.0f} s gone" + (f", {left}" if left else "")


def left_words(seconds: float | None, unknown: str = "") -> str:
    """E.g. ``about 24 s left``, or ``unknown`` where nothing is known."""
    if seconds is None:
        return unknown
    return f"about {seconds:.0f} s left" if seconds < 100 else f"about {seconds / 60:.0f} min left"
