"""Shell blocks of the README and the manual, run line by line in one temporary folder: ``python docs/run_blocks.py``.

A block that needs hardware, finite elements, minutes or a reader's own files says so on the line before it:
``<!-- not run: REASON -->``. A block without a language is for a shell; ``text`` is not.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
SHELL = re.compile(r"^(?:<!-- not run: (?P<why>.+?) -->\n)?```\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """One block for a shell: the page's name, the reason why it is not run (or ""), its lines."""

    page: str
    reason: str
    lines: list[str]


def blocks() -> list[Block]:
    """The blocks of all pages, the README's first."""
    pages = [HERE.parent / "README.md", *sorted(HERE.rglob("*.md"))]
    shown = [p for p in pages if not {"_build", "made"} & set(p.relative_to(HERE.parent).parts)]
    return [
        Block(str(page.relative_to(HERE.parent)), found["why"] or "", found["code"].splitlines())
        for page in shown
        for found in SHELL.finditer(page.read_text(encoding="utf-8"))
    ]


def exit_code(words: list[str]) -> int:
    """Exit code of ``forearm-fem WORDS`` in this process: Python starts once for all lines."""
    from forearm_fem.cli.app import main

    sys.argv = ["forearm-fem", *words]
    try:
        main()
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    return 0


def failure(line: str) -> str:
    """What went wrong with a ``line``; empty where all went well."""
    for command in re.split(r"\s+&&\s+", line):
        words = shlex.split(command, comments=True)
        if words and words[0] != "forearm-fem":
            return f"{words[0]}: not a command that is run here; mark the block"
        said = io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            code = exit_code(words[1:]) if words else 0
        if code:
            return f"exit code {code}\n{said.getvalue()}"
    return ""


def run() -> int:
    """Run all blocks that are not marked; 1 where a line failed."""
    failed, ran, left = 0, 0, 0
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for block in blocks():
            left += bool(block.reason)
            for line in [] if block.reason else block.lines:
                began = time.process_time()
                wrong = failure(line)
                ran += bool(line.strip())
                print(f"{block.page}: {line} ({time.process_time() - began:.1f} s)" if line else "", flush=True)
                if wrong:
                    failed += 1
                    print(f"{block.page}: {line}\n{wrong}", file=sys.stderr)
    print(f"{ran} lines run, {failed} failed; {left} blocks are marked as not run")
    return int(failed > 0)


if __name__ == "__main__":
    os.environ.setdefault("MPLBACKEND", "Agg")
    sys.exit(run())
