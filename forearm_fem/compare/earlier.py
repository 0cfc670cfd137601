"""What a folder holds of an earlier comparison or fit: it is replaced as a whole; files of others are not touched."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import DataError
from ..io.jsonfiles import read_json

_OURS = ("asked", "e_band", "overall")  # of an account; before 0.21 none said what was asked


def check_earlier(folder: Path, names: Sequence[str], asked: Mapping[str, Any]) -> None:
    """Look at ``folder`` before work for it begins; a warning where it holds the answer to another question.

    ``names`` are the files written there, first the account in JSON, which says what was asked. DataError where one of
    them is there that no such command wrote.
    """
    there = [n for n in names if (folder / n).exists()]
    if not there:
        return
    try:
        before = read_json(folder / names[0])
    except DataError:
        before = {}
    if not before.keys() & set(_OURS):
        raise DataError(f"{folder / there[0]}: is no earlier result of this command; name another folder with --out")
    if before.get("asked", {}) != json.loads(json.dumps(asked)):
        warnings.warn(f"{folder}: its {', '.join(there)} answered another question and are replaced", stacklevel=3)


def clear_earlier(folder: Path, names: Sequence[str]) -> None:
    """Take an earlier result away, its account last, so that what an interruption leaves is known by it."""
    for name in reversed(names):
        (folder / name).unlink(missing_ok=True)
