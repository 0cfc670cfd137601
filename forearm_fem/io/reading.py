"""What goes wrong while a file is read, or is told from its shape or names and not declared, in one sentence."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import DataError, MissingExtra
from .seal import check_seals


def refuse_no_file(file: Path) -> None:
    """DataError where ``file`` is a folder, or is not there."""
    if not file.is_file():
        raise DataError(f"{file}: {'is a folder, expected a file' if file.is_dir() else 'no such file'}")


@contextmanager
def reading(file: Path, unreadable: str, *, seals: bool = True) -> Iterator[None]:
    """Every failure of the block as a DataError about ``file``: what it says itself, else that it is ``unreadable``.

    Libraries fail in ways they do not list where a file is damaged. A missing file is told before, and so is one whose
    checksum does not fit where the format keeps it in ``seals`` (:mod:`.seal`). MissingExtra passes.
    """
    refuse_no_file(file)
    try:
        if seals:
            check_seals(file.read_bytes())
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


def numbered_rows(lines: Iterable[str], delimiter: str, first: int = 1) -> list[tuple[int, list[str]]]:
    """Rows of a table that say something, each with the number of the file's line that it begins on; ``first`` is that
    of the first of the ``lines``. Blank lines and rows of separators alone are left out, and counted: a sentence about
    a row is looked up in the file. Raises csv.Error as the reader does."""
    reader = csv.reader(lines, delimiter=delimiter)
    found, begins = list[tuple[int, list[str]]](), first
    for row in reader:
        if any(cell.strip() for cell in row):
            found.append((begins, row))
        begins = first + reader.line_num
    return found
