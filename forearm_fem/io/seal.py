"""A SHA-256 of a whole file, appended to it: damage is known before a library trips over it.

HDF5 ignores what follows its end of file. Without the seal, bytes changed in a heap could send the HDF5 library into an
endless loop while it read an attribute (seen in the damage tests).
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from ..errors import DataError

_MARK = b"forearm_fem sha256:"
_LENGTH = len(_MARK) + hashlib.sha256().digest_size


def seal(path: Path) -> None:
    """Append the mark and the digest of everything before it."""
    digest = hashlib.sha256(path.read_bytes()).digest()
    with open(path, "ab") as stream:
        stream.write(_MARK + digest)


def check_seal(path: Path) -> bool:
    """Whether the file is sealed; raises DataError where its contents do not match the seal."""
    content = path.read_bytes()
    body, end = content[:-_LENGTH], content[-_LENGTH:]
    if not end.startswith(_MARK):
        return False
    if hashlib.sha256(body).digest() != end[len(_MARK) :]:
        raise DataError("damaged: its contents do not match its checksum")
    return True
