"""One command at a time in a results folder."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import DataError

LOCK = ".lock"


@contextmanager
def locked(folder: str | Path) -> Iterator[None]:
    """Hold ``folder`` (made as needed) for this process until the block ends.

    The lock is the operating system's own, on the file ``.lock``: it ends with its process, however that ends. The file
    is removed afterwards, and folders that were made for it and stayed empty. Raises DataError where another process
    holds the folder or where it cannot be written. Not covered: two machines on a file system that shares no locks.
    """
    place = Path(folder)
    made = [p for p in (place, *place.parents) if not p.exists()]
    file = place / LOCK
    try:
        place.mkdir(parents=True, exist_ok=True)
        descriptor = _taken(file)
    except OSError as problem:
        why = "it is a file and no folder" if place.is_file() else problem.strerror or problem
        raise DataError(f"{place}: cannot be written ({why}); name another folder") from None
    try:
        yield
    finally:
        if sys.platform == "win32":  # removes no open file
            os.close(descriptor)
        with suppress(OSError):  # while its lock is held, so that nobody locks a file that is about to vanish unseen
            file.unlink()
        if sys.platform != "win32":
            os.close(descriptor)
        for empty in made:
            with suppress(OSError):
                empty.rmdir()


def _taken(file: Path) -> int:
    """A descriptor that holds the lock on ``file``; who held it before may have removed the file meanwhile."""
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o644)
        if not _try_lock(descriptor):
            owner = os.pread(descriptor, 20, 0).decode("ascii", "replace").strip() if sys.platform != "win32" else ""
            os.close(descriptor)
            raise DataError(
                f"{file.parent}: another forearm-fem command{f' (process {owner})' if owner else ''} works in this "
                "folder; wait until it is done, or name another folder with --out"
            )
        try:
            same = os.path.samestat(os.stat(file), os.fstat(descriptor))
        except FileNotFoundError:
            same = False
        if same:
            os.ftruncate(descriptor, 0)
            os.write(descriptor, str(os.getpid()).encode())
            return descriptor
        os.close(descriptor)


def _try_lock(descriptor: int) -> bool:
    """Whether the lock was free; where the file system knows no locks, all are."""
    if sys.platform == "win32":
        import msvcrt

        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
