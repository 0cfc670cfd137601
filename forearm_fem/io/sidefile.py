"""Checksums beside tables that other programs must read as they are: ``NAME.sha256``, as sha256sum writes it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ..errors import DataError
from .atomic import atomic_path, write_bytes


def write_with_side(path: str | Path, content: bytes) -> None:
    """``content``, and its checksum beside it: both or neither."""
    digest = hashlib.sha256(content).hexdigest()
    with atomic_path(_side(Path(path))) as side:
        side.write_bytes(f"{digest}  {Path(path).name}\n".encode())
        write_bytes(path, content)


def read_with_side(path: str | Path) -> bytes:
    """The file's bytes; DataError where they do not match the checksum beside them, if there is one.

    Raises OSError for a file that cannot be read. A copy without its checksum is taken as it is.
    """
    content, side = Path(path).read_bytes(), _side(Path(path))
    if side.is_file() and side.read_bytes().split()[:1] != [hashlib.sha256(content).hexdigest().encode()]:
        raise DataError(
            f"{path}: its contents do not match its checksum: cut short, damaged or edited; make it again, or delete "
            f"{side.name} if you edited it on purpose"
        )
    return content


def _side(file: Path) -> Path:
    return file.with_name(f"{file.name}.sha256")
