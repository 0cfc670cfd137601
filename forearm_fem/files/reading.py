"""Errors of reading a file, and shapes or names that leave its meaning open, in one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import DataError, MissingExtra
from ..store.folder import refuse_no_file
from ..store.text import stand_in, text_of

_SNIFFED = 1 << 16  # bytes


def refuse_stand_in(file: Path) -> None:
    """DataError where ``file`` is missing, or something stands in its place: a pointer, a web page, an archive."""
    refuse_no_file(file)
    with file.open("rb") as stream:
        head = stream.read(_SNIFFED)
    if said := stand_in(head):
        raise DataError(f"{file}: {said}")


def text_in(file: Path) -> str:
    """The text in ``file``, whatever its encoding; DataError where it is none."""
    refuse_stand_in(file)
    content = file.read_bytes()
    if content[:4] == b"PK\x03\x04":
        raise DataError(f"{file}: is an archive or a spreadsheet (.xlsx) under this name; save the sheet as CSV")
    try:
        return text_of(content)
    except ValueError as problem:
        raise DataError(f"{file}: is no text ({problem}); is it really of this kind?") from None


@contextmanager
def reading(file: Path, unreadable: str) -> Iterator[None]:
    """Every failure of the block as a DataError about ``file``: what it says itself, else that it is ``unreadable``.

    Libraries fail in ways they do not list where a file is damaged. A missing file, and what stands in a file's place,
    is told before. MissingExtra passes.
    """
    refuse_stand_in(file)
    try:
        yield
    except MissingExtra:
        raise
    except DataError as problem:
        said = str(problem)
        raise DataError(said if said.startswith(str(file)) else f"{file}: {said}") from None
    except Exception as problem:
        why = " ".join(str(problem).split())[:120] or type(problem).__name__
        raise DataError(f"{file}: {unreadable.format(why=why)}") from problem


class RecognitionWarning(UserWarning):
    """Something about a file was recognised, not declared; ``what`` names it and ``chosen`` is what was taken."""

    def __init__(self, file: str, what: str, chosen: str) -> None:
        super().__init__(f"{file}: {what} recognised as {chosen}; declare it to be sure")
        self.file, self.what, self.chosen = file, what, chosen
