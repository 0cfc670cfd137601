"""Progress of long work: one signature for the whole package, and the time left of a job."""

from __future__ import annotations

from collections.abc import Callable, Mapping

_EARLY = 0.1  # share of a stage before which its own pace tells nothing
_OVERDUE = 0.1  # of the time since a stage last told of itself is left at least: what is late does not end at once

Progress = Callable[[str, int, int], None]
"""``progress(stage, done, total)``: the ``stage`` under way in words, and how many of its ``total`` parts are done.

A stage of unknown length has ``total`` 0. A stage keeps its words from the first call to the last. Called in the thread
that does the work, which waits for it. What it raises ends the work.
"""


def tell(progress: Progress | None, stage: str, done: int, total: int) -> None:
    """Call ``progress`` unless it is None, for nobody need listen."""
    if progress is not None:
        progress(stage, done, total)


def within(progress: Progress | None, whole: str) -> Progress | None:
    """``progress`` of a part, whose stages are told as ``whole``: stage."""
    if progress is None:
        return None
    return lambda stage, done, total: progress(f"{whole}: {stage}", done, total)


class Journey:
    """The way of one job through its stages, with one estimate of the time left.

    ``learnt`` are the seconds of each stage in the last run of the same job, in their order; times are in seconds of
    one clock. Time counts for the stage that was told last.
    """

    def __init__(self, learnt: Mapping[str, float], now: float) -> None:
        self.learnt = dict(learnt)
        self.spent: dict[str, float] = {}
        self.stage, self.done, self.total = "", 0, 0
        self.began = self._since = now

    def tell(self, stage: str, done: int, total: int, now: float) -> None:
        """Note how far ``stage`` is."""
        self._charge(now)
        self.stage, self.done, self.total = stage, done, total
        self.spent.setdefault(stage, 0.0)

    def _charge(self, now: float) -> None:
        if self.stage:
            self.spent[self.stage] += now - self._since
        self._since = now

    def left(self, now: float) -> float | None:
        """Seconds left of the whole job; None where nothing was learnt, as no other stage can be foreseen."""
        if not self.learnt:
            return None
        order = list(self.learnt)
        reached = max((order.index(s) for s in self.spent if s in self.learnt), default=-1)
        known = [s for s in self.spent if s in self.learnt and s != self.stage]
        here = self.spent.get(self.stage, 0.0) + (now - self._since if self.stage else 0.0)
        before, promised = sum(self.spent[s] for s in known), sum(self.learnt[s] for s in known)
        pace = min(max(before / promised, 0.5), 2.0) if promised > 1 else 1.0  # of this run beside the last one
        after = sum(self.learnt[s] for k, s in enumerate(order) if k > reached and s != self.stage)
        silent = _OVERDUE * (now - self._since) if self.stage else 0.0
        return pace * after + max(self._left_here(here, pace), silent)

    def _left_here(self, here: float, pace: float) -> float:
        """Seconds left of the stage under way, after ``here`` seconds of it."""
        whole = pace * self.learnt.get(self.stage, 0.0)
        if 0 < self.done <= self.total and self.total > 1:  # its own count knows better, the further it is
            share = self.done / self.total
            if not whole and share < _EARLY:
                return 0.0  # nothing to go by: the first part often takes longest
            whole = here + (1 - share) * whole if whole else here / share
            return max(0.0, (1 - share) * max(whole, here))
        return max(0.0, whole - here)

    def share(self, now: float) -> float | None:
        """Share of the job that is done, 0 to 1; None where that is unknown."""
        left = self.left(now)
        gone = now - self.began
        return None if left is None else gone / max(gone + left, 1e-9)

    def ended(self, now: float) -> dict[str, float]:
        """Account for the next run of the job: a stage that reused results keeps its older, larger account."""
        self._charge(now)
        fresh = {s: t if t >= self.learnt.get(s, 0.0) / 2 else self.learnt[s] for s, t in self.spent.items()}
        return {**fresh, **{s: t for s, t in self.learnt.items() if s not in fresh and len(fresh) < len(self.learnt)}}
