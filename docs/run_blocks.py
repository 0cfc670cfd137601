"""Shell blocks of README and manual, run line by line in a folder a page: ``python docs/run_blocks.py [PAGE ...]``.

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
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parent
FENCED = re.compile(r"^(?:<!-- not run: (?P<why>.+?) -->\n)?```(?P<kind>.*?)\n(?P<code>.*?)^```$", re.M | re.S)


class Block(NamedTuple):
    """One block for a shell: the page's name, the reason why it is not run (or ""), its lines."""

    page: str
    reason: str
    lines: list[str]


def blocks() -> list[Block]:
    """The blocks of all pages, the README's first."""
    pages = [HERE.parent / "README.md", *sorted(HERE.rglob("*.md"))]
    elsewhere = {"_build", "made", "files"}  # howto/files: tests/test_docs_in_hand.py runs these on files of a lab
    shown = [p for p in pages if not elsewhere & set(p.relative_to(HERE.parent).parts)]
    return [
        Block(str(page.relative_to(HERE.parent)), found["why"] or "", found["code"].splitlines())
        for page in shown
        for found in FENCED.finditer(page.read_text(encoding="utf-8"))
        if not found["kind"]
    ]


def shorter_thesis() -> str:
    """The thesis' scenario with an eighth of its record, so that all lines take little more than a minute."""
    from forearm_fem.scenario import scenario_file

    whole = scenario_file("thesis").read_text(encoding="utf-8")
    assert "[sweep]\n" in whole
    return whole.replace("[sweep]\n", "[sweep]\nduration = 0.25\n")


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


def run(pages: Sequence[str]) -> int:
    """Run all blocks that are not marked, of some ``pages`` or of all; 1 where a line failed."""
    asked = [b for b in blocks() if not pages or b.page in pages]
    failed, ran = 0, 0
    with tempfile.TemporaryDirectory() as home:
        for page, told in groupby((b for b in asked if not b.reason), key=lambda b: b.page):
            folder = Path(home) / page.replace("/", "-")
            folder.mkdir()
            (folder / "thesis").write_text(shorter_thesis(), encoding="utf-8")  # a file goes before a shipped name
            for line in (line for block in told for line in block.lines if line.strip()):
                began = os.times()
                with contextlib.chdir(folder):
                    wrong = failure(line)
                ran += 1
                spent = sum(b - a for a, b in zip(began[:4], os.times()[:4], strict=True))
                print(f"{page}: {line} ({spent:.1f} s of CPU)", flush=True)
                if wrong:
                    failed += 1
                    print(f"{page}: {line}\n{wrong}", file=sys.stderr)
    print(f"{ran} lines run, {failed} failed; {sum(bool(b.reason) for b in asked)} blocks say why they are not run")
    return int(failed > 0)


if __name__ == "__main__":
    os.environ.setdefault("MPLBACKEND", "Agg")
    sys.exit(run(sys.argv[1:]))
