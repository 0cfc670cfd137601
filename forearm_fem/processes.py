"""Processes: Ctrl-C while they start and end, and a script that each of them would run again."""

from __future__ import annotations

import ast
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from .errors import ForearmError

# Ctrl-C where Python's own way of it, an exception between any two lines, is not enough.

@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Ctrl-C waits for the end of what stands within, also in processes that are started there.

    A cluster that is cut off while it starts or closes can no longer be closed, and says so in pages of tracebacks; its
    young processes add theirs. Outside of the main thread, where no interrupt arrives, nothing is done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    masks = hasattr(signal, "pthread_sigmask")  # processes and threads inherit the mask; Windows has none
    if masks:
        from multiprocessing import resource_tracker

        resource_tracker.ensure_running()  # which takes the mask off again where it starts itself
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masks else set()
    try:
        yield
    finally:
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGINT, before)
        if pressed:
            signal.raise_signal(signal.SIGINT)


@contextmanager
def interrupts_heard() -> Iterator[list[int]]:
    """The interrupts that came, each still a KeyboardInterrupt: what it breaks may end in another error's name."""
    pressed: list[int] = []
    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:  # ignored, or somebody else's
        yield pressed
        return

    def press(number: int, frame: object) -> None:
        """Note the signal, and interrupt."""
        pressed.append(number)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, press)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


# A script whose processes would each run it again: told in one sentence before any of them starts.

_SENTENCE = (
    "{file}, line {line}: starts processes, each of which runs the script again; put what it does below "
    'if __name__ == "__main__":, or ask for one worker (workers=1)'
)


def refuse_unguarded_script() -> None:
    """ForearmError where the script that is running calls this outside of ``if __name__ == "__main__":``.

    Processes that are spawned import the script first, and would come here again. Lines typed in, `python -c` and
    notebooks are imported by nobody.
    """
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_name == "<module>" and frame.f_globals.get("__name__") == "__main__":
            file, line = Path(frame.f_code.co_filename), frame.f_lineno
            if file.is_file() and frame.f_globals.get("__spec__") is None and not _guarded(file, line):
                raise ForearmError(_SENTENCE.format(file=file, line=line))
            return
        if frame.f_code.co_name == "<module>" and frame.f_globals.get("__name__") == "__mp_main__":
            raise ForearmError(_SENTENCE.format(file=Path(frame.f_code.co_filename), line=frame.f_lineno))
        frame = frame.f_back


def _guarded(file: Path, line: int) -> bool:
    """True if ``line`` of ``file`` lies below a test of ``__name__``, or the file is none that can be told."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError, OSError):
        return True
    return any(
        isinstance(node, ast.If)
        and any(isinstance(n, ast.Name) and n.id == "__name__" for n in ast.walk(node.test))
        and node.lineno <= line <= (node.end_lineno or line)
        for node in tree.body
    )
