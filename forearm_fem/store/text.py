"""Text files of ours: JSON objects, tables in Markdown, and digests of plain data."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from .folder import write_text


def write_json(path: str | Path, content: Mapping[str, Any], *, indent: int | None = 2) -> None:
    """``content`` as JSON, whole or not at all."""
    write_text(path, json.dumps(dict(content), indent=indent))


def read_json(path: str | Path) -> dict[str, Any]:
    """The object as written; DataError for a missing file and anything but a JSON object."""
    try:
        content = json.loads(Path(path).read_bytes().decode())
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, ValueError, RecursionError) as problem:
        raise DataError(f"{path}: damaged or not JSON ({problem})") from None
    if not isinstance(content, dict):
        raise DataError(f"{path}: damaged, expected a JSON object")
    return content


def digest_of(content: Any) -> str:
    """SHA-256 of plain data, whatever the order of keys."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()


def plain(value: Any) -> float | None:
    """A float, or None for what is not finite: JSON knows no NaN."""
    return float(value) if np.isfinite(value) else None


def markdown_table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """``rows`` of cells below ``header``, a line each; bars and line breaks within a cell do not break the table."""
    head = list(header)
    lines = [head, ["---"] * len(head), *([c.replace("|", "\\|").replace("\n", " ") for c in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
