"""Files appear whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import DataError


@contextmanager
def atomic_path(path: str | Path, *, durable: bool = True) -> Iterator[Path]:
    """A path beside ``path`` to write to; it takes ``path``'s place when the block ends without failure.

    Folders are made as needed. The data are on the disk before the old file is replaced, unless it need not be
    ``durable`` (a cache that is checked when it is read, and of which a power cut may take a part); after a failure
    the old file stands untouched and nothing is left beside it. The suffix is kept, for writers that look
    at it. Raises DataError where the file cannot be written.
    """
    target = Path(path)
    beside = target.with_name(f".{target.stem}-{secrets.token_hex(4)}{target.suffix}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield beside
        if durable:
            with beside.open("rb+") as stream:
                os.fsync(stream.fileno())
        os.replace(beside, target)
        if durable:
            _flush_folder(target.parent)
    except OSError as problem:
        raise DataError(f"{target}: cannot be written ({problem.strerror or problem})") from problem
    finally:
        with suppress(OSError):
            beside.unlink()


def refuse_no_file(file: Path) -> None:
    """DataError where ``file`` is a folder, or is not there."""
    if not file.is_file():
        raise DataError(f"{file}: {'is a folder, expected a file' if file.is_dir() else 'no such file'}")


def write_bytes(path: str | Path, content: bytes, *, durable: bool = True) -> None:
    """``content``, whole or not at all.

    Libraries write into memory, and the memory goes here: on a full disk HDF5 leaves objects behind that crash the
    process when they are closed.
    """
    with atomic_path(path, durable=durable) as beside:
        beside.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """``text`` as UTF-8 with the line ends it has, whole or not at all."""
    write_bytes(path, text.encode("utf-8"))


def _flush_folder(folder: Path) -> None:
    """Make the renaming itself durable; Windows cannot open folders and needs no such step."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
