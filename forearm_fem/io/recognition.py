"""The warning that something about a file was told from its shape or its names, and not declared."""

from __future__ import annotations


class RecognitionWarning(UserWarning):
    """Something about a file was recognised, not declared; ``what`` names it and ``chosen`` is what was taken."""

    def __init__(self, file: str, what: str, chosen: str) -> None:
        super().__init__(f"{file}: {what} recognised as {chosen}; declare it to be sure")
        self.file, self.what, self.chosen = file, what, chosen
