"""What glibc does with freed memory: kept while large arrays come and go, given back at turns of the work."""

from __future__ import annotations

import ctypes
import platform
from collections.abc import Iterator
from contextlib import contextmanager

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _MMAP_MAX = -1, -3, -4  # of <malloc.h>
_NEVER, _USUAL_MAPS = -1, 65536
_LARGE = 32 * 1024 * 1024  # bytes: what glibc's own threshold grows to, which it no longer does once it is told any


@contextmanager
def freed_memory_kept() -> Iterator[None]:
    """glibc maps large arrays one by one and unmaps them at once; inside, it takes them from its heap instead.

    A tenth of the forearm's solve was spent on fresh pages (docs/decisions/0012). At the end what is free goes back to
    the system. Does nothing where the C library is another one.
    """
    library = _glibc()
    if library is None:
        yield
        return
    library.mallopt(_MMAP_MAX, 0)
    library.mallopt(_TRIM_THRESHOLD, _NEVER)
    try:
        yield
    finally:
        library.mallopt(_MMAP_MAX, _USUAL_MAPS)
        library.mallopt(_MMAP_THRESHOLD, _LARGE)
        library.mallopt(_TRIM_THRESHOLD, 2 * _LARGE)
        give_back()


def give_back() -> None:
    """Free pages back to the system now; arrays that were freed while others above them live stay resident else.

    Fresh pages cost time, so this is for moments when much is free and little of it fits what comes next, not for
    loops. Does nothing where the C library is another one.
    """
    library = _glibc()
    if library is not None:
        library.malloc_trim(0)


def _glibc() -> ctypes.CDLL | None:
    return ctypes.CDLL(None) if platform.libc_ver()[0] == "glibc" else None
