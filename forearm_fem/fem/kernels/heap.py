"""Freed memory given back to the system at moments when much of it is free and little of it fits what comes next."""

from __future__ import annotations

import ctypes
import platform


def give_back() -> None:
    """glibc returns whole free pages; arrays that were freed while others above them live stay resident else.

    Fresh pages cost time (docs/decisions/0012), so this is for turns of the work, not for loops. Does nothing where the
    C library is another one.
    """
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).malloc_trim(0)
