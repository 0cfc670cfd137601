"""SHA-256 of a whole file, kept inside it: damage is known before a library trips over it, or passes it on as a number.

Without the seal, bytes changed in a heap could send the HDF5 library into an endless loop while it read an attribute
(seen in the damage tests), and a flipped bit in most other formats is simply another number. netCDF files end in a
binary seal, which HDF5 ignores. All other formats hold text seals wherever they allow a text: :data:`BLANK` is written
there, at least twice and far apart where possible, so that damage to one seal is convicted by the other;
:func:`sealed` puts the digest of the file with blank seals into all of them.
"""

from __future__ import annotations

import hashlib
import re

from ..errors import DataError

_TAIL = b"forearm_fem sha256:"
_LENGTH = len(_TAIL) + hashlib.sha256().digest_size
MARK = b"forearm_sha256:"
BLANK = MARK + b"0" * 64  # 79 characters: a line of 80 columns takes it
_FILLED = re.compile(re.escape(MARK) + b".{64}", re.DOTALL)


def sealed_tail(content: bytes) -> bytes:
    """``content`` with a mark and its digest behind it."""
    return content + _TAIL + hashlib.sha256(content).digest()


def check_tail(content: bytes) -> bool:
    """Whether ``content`` ends in a seal; raises DataError where it does not match the seal."""
    body, end = content[:-_LENGTH], content[-_LENGTH:]
    if not end.startswith(_TAIL):
        return False
    if hashlib.sha256(body).digest() != end[len(_TAIL) :]:
        raise DataError("damaged: its contents do not match its checksum")
    return True


def sealed(content: bytes) -> bytes:
    """``content`` with the digest of itself in place of the zeros of every :data:`BLANK`."""
    return content.replace(BLANK, MARK + hashlib.sha256(content).hexdigest().encode())


def check_seals(content: bytes, hint: str = "copy it again, or make it again") -> bool:
    """Whether ``content`` holds seals of :func:`sealed`; raises DataError, with ``hint``, where one does not match.

    Files of others, and of this program before 0.14, hold none. Not covered: damage that hits every seal's mark.
    """
    if MARK not in content:
        return False
    right = MARK + hashlib.sha256(_FILLED.sub(BLANK, content)).hexdigest().encode()
    if content.count(MARK) != content.count(right):
        raise DataError(f"its contents do not match its checksum: cut short, damaged or edited; {hint}")
    return True
