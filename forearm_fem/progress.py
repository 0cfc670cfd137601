"""How long work tells its caller how far it is: one signature for the whole package."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""``progress(stage, done, total)``: the ``stage`` under way in words, and how many of its ``total`` parts are done.

A stage of unknown length has ``total`` 0. A stage keeps its words from the first call to the last, so that a display
can draw one bar each. Called in the thread that does the work, which waits for it. What it raises ends the work.
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
