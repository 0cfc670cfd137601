"""Text: JSON objects, Markdown tables and digests of ours; other people's files in any encoding."""

from __future__ import annotations

import codecs
import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError
from .folder import write_text


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """``content`` as JSON, whole or not at all."""
    write_text(path, json.dumps(dict(content), indent=2))


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


# Content of a file of somebody else: text in any usual encoding, and what stands in the place of the file itself.

_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_PACKED = ((b"\x1f\x8b", "gzip"), (b"BZh", "bzip2"), (b"\xfd7zXZ\x00", "xz"), (b"7z\xbc\xaf", "7-Zip"))
_POINTER = re.compile(rb"version https?://[^\n]*(git-lfs|hawser)[^\n]*\n(?:.*\n)*?size (\d+)")
_LINK = re.compile(rb"(\.\.?/)+[^\0\n]+\.\w+\n?")
_LONGEST_POINTER = 1024  # bytes


def stand_in(content: bytes) -> str:
    """Name of what ``content`` is instead of the file meant, and the cure; "" for unknown content."""
    head = content[:_LONGEST_POINTER].lstrip()
    if pointer := _POINTER.match(head):
        return f"is a Git LFS pointer to {int(pointer[2])} bytes, not the file itself; fetch it with `git lfs pull`"
    if len(content) < _LONGEST_POINTER and b"annex/objects/" in head:
        return "is a git-annex pointer, not the file itself; fetch it with `git annex get`"
    if len(content) < _LONGEST_POINTER and _LINK.fullmatch(head):
        path = head.decode(errors="replace").strip()[-60:]
        return f"holds only the path '{path}': a symbolic link that git wrote as text; copy that file here"
    if not content.strip(b"\0 \r\n\t"):
        return "is empty" if not content else f"holds {len(content)} bytes of nothing (zeros or blanks); copy it again"
    lower = head[:200].lower()
    if lower.startswith((b"<!doctype html", b"<html")):
        return "is a web page saved under this name; download the file itself"
    for mark, name in _PACKED:
        if content.startswith(mark):
            return f"is compressed ({name}); unpack it first"
    return ""


def text_of(content: bytes) -> str:
    """``content`` as text: UTF-8 or UTF-16 by its mark or its zeros, else UTF-8, else Windows-1252.

    ValueError for what is no text. Every line end becomes a line feed.
    """
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            text = content[len(mark) :].decode(encoding)
            break
    else:
        text = _unmarked(content)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _unmarked(content: bytes) -> str:
    head = content[:4096]
    if len(head) > 3 and head[1::2].count(0) > 0.8 * (len(head) // 2):
        return content.decode("utf-16-le")
    if len(head) > 3 and head[0::2].count(0) > 0.8 * (len(head) // 2):
        return content.decode("utf-16-be")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    odd = sum(not c.isprintable() and c not in "\t\n\r\f\v\x1a" for c in text[:4096])
    if odd > len(text[:4096]) / 50:
        raise ValueError(f"{odd} of its first {len(text[:4096])} characters are none of a text")
    return text.rstrip("\x1a")


def whole(file: Path) -> bytes:
    """The bytes of ``file``; ValueError, in words that follow its name, where something stands in its place."""
    content = file.read_bytes()
    if said := stand_in(content):
        raise ValueError(said)
    return content
