"""Freed memory kept by the process while it solves: large arrays come and go, and fresh pages cost their time each."""

from __future__ import annotations

import ctypes
import platform
from collections.abc import Iterator
from contextlib import contextmanager

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4  # of <malloc.h>
_NEVER, _USUAL_TRIM, _USUAL_MMAP = -1, 128 * 1024, 65536


@contextmanager
def freed_memory_kept() -> Iterator[None]:
    """glibc maps large arrays one by one and unmaps them at once; inside, it takes them from its heap instead.

    A tenth of the forearm's solve was spent on fresh pages (docs/decisions/0012). At the end what is free goes back to
    the system. Does nothing where the C library is another one.
    """
    library = ctypes.CDLL(None) if platform.libc_ver()[0] == "glibc" else None
    if library is None:
        yield
        return
    library.mallopt(_MMAP_MAX, 0)
    library.mallopt(_TRIM_THRESHOLD, _NEVER)
    try:
        yield
    finally:
        library.mallopt(_MMAP_MAX, _USUAL_MMAP)
        library.mallopt(_TRIM_THRESHOLD, _USUAL_TRIM)
        library.malloc_trim(0)
