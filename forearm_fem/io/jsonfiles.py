"""JSON objects as files, with a checksum under the key ``sha256``, and plain contents as text."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from .atomic import write_bytes
from .seal import BLANK, check_seals, sealed

_KEY = "sha256"
_EDITED = f"if you edited it on purpose, delete its line '{_KEY}'"


def write_json(path: str | Path, content: Mapping[str, Any], *, indent: int | None = 2) -> None:
    """``content`` after its checksum, whole or not at all."""
    text = json.dumps({_KEY: BLANK.decode(), **content}, indent=indent)
    write_bytes(path, sealed(text.encode()))


def read_json(path: str | Path) -> dict[str, Any]:
    """The object as written, without its checksum; one written by hand needs none.

    Raises DataError for a missing file, anything but a JSON object, and contents that do not match the checksum.
    """
    try:
        whole = Path(path).read_bytes()
        content = json.loads(whole.decode())
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, ValueError, RecursionError) as problem:
        raise DataError(f"{path}: damaged or not JSON ({problem})") from None
    if not isinstance(content, dict):
        raise DataError(f"{path}: damaged, expected a JSON object")
    try:
        if not check_seals(whole.replace(b"\r\n", b"\n"), _EDITED) and _KEY in content:
            raise DataError(f"damaged: its {_KEY} is none; {_EDITED}")
    except DataError as problem:
        raise DataError(f"{path}: {problem}") from None
    return {key: value for key, value in content.items() if key != _KEY}


def digest_of(content: Any) -> str:
    """SHA-256 of plain data, whatever the order of keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def plain(value: Any) -> float | None:
    """A float, or None for what is not finite: JSON knows no NaN."""
    return float(value) if np.isfinite(value) else None
