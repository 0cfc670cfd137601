"""Ctrl-C where Python's own way of it, an exception between any two lines, is not enough."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


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
