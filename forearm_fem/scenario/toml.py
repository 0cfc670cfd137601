"""Reading TOML files: whatever is wrong with one is a sentence."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from ..errors import ForearmError, ScenarioError
from ..usercode import with_code_beside

_BACKSLASH = "within double quotes \\ begins an escape: write paths with /, or in single quotes"


def _line(file: Path, problem: Exception) -> str:
    """The line of ``file`` that a ``problem`` names; all of it where it names none."""
    lines = file.read_text(encoding="utf-8-sig").splitlines()
    named = re.search(r"at line (\d+)", str(problem))
    return "\n".join(lines) if named is None else "".join(lines[int(named[1]) - 1 : int(named[1])])


def read_toml(file: Path, missing: str, error: type[ForearmError] = ScenarioError) -> dict[str, Any]:
    """The table in ``file``, user code beside it named in full (:mod:`forearm_fem.usercode`).

    ``error`` with the sentence ``missing`` where there is no file, or with why it cannot be read.
    """
    if file.is_dir():
        raise error(f"{file}: is a folder, expected a TOML file")
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise error(f"{file}: {missing}") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise error(f"{file}: cannot be read as a text file ({problem})") from None
    except RecursionError:
        raise error(f"{file}: not valid TOML: nested too deeply") from None
    except tomllib.TOMLDecodeError as problem:
        more = f"; {_BACKSLASH}" if "\\" in _line(file, problem) else ""
        raise error(f"{file}: not valid TOML: {problem}{more}") from None
    except ValueError:  # Python reads no more
        raise error(f"{file}: a number has more than 4300 digits") from None
    beside: dict[str, Any] = with_code_beside(table, file.parent)
    return beside
