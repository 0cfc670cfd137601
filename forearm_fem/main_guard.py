"""A script whose processes would each run it again: told in one sentence before any of them starts."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from types import FrameType

from .errors import ForearmError

_SENTENCE = (
    "{file}, line {line}: starts processes, each of which runs the script again; put what it does below "
    'if __name__ == "__main__":, or ask for one worker (workers=1)'
)


def refuse_unguarded_script() -> None:
    """ForearmError where the script that is running calls this outside of ``if __name__ == "__main__":``.

    Processes that are spawned import the script first, and would come here again. Lines typed in, `python -c` and
    notebooks are imported by nobody.
    """
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        if frame.f_code.co_name == "<module>" and frame.f_globals.get("__name__") == "__main__":
            file, line = Path(frame.f_code.co_filename), frame.f_lineno
            if file.is_file() and frame.f_globals.get("__spec__") is None and not _guarded(file, line):
                raise ForearmError(_SENTENCE.format(file=file, line=line))
            return
        if frame.f_code.co_name == "<module>" and frame.f_globals.get("__name__") == "__mp_main__":
            raise ForearmError(_SENTENCE.format(file=Path(frame.f_code.co_filename), line=frame.f_lineno))
        frame = frame.f_back


def _guarded(file: Path, line: int) -> bool:
    """True if ``line`` of ``file`` lies below a test of ``__name__``, or the file is none that can be told."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError, OSError):
        return True
    return any(
        isinstance(node, ast.If)
        and any(isinstance(n, ast.Name) and n.id == "__name__" for n in ast.walk(node.test))
        and node.lineno <= line <= (node.end_lineno or line)
        for node in tree.body
    )
