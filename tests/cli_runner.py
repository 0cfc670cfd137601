"""Runs the command line in this process, as the installed program would run."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

from typer.main import get_command

from forearm_fem.cli.app import app, main

SMALL = """name = "small"
engine = "layered"
accuracy = 0.05

[sweep]
f_max = 300.0
duration = 0.25
sample_rate = 2000.0

[rendering]
targets = ["5", "6"]
"""


_PARSER = cache(get_command)


@dataclass(frozen=True)
class Answer:
    """What the program said."""

    code: int
    out: str
    err: str

    @property
    def sentence(self) -> str:
        """The error message without its prefix; asserts that there is exactly one, on one line."""
        lines = [line for line in self.err.splitlines() if line.startswith("error: ")]
        assert len(lines) == 1, self.err
        return lines[0].removeprefix("error: ")


def cli(*arguments: object, cwd: Path | None = None) -> Answer:
    """``forearm-fem ARGUMENTS`` in the folder ``cwd``."""
    out, err = io.StringIO(), io.StringIO()
    argv = ["forearm-fem", *map(str, arguments)]
    with (
        mock.patch.object(sys, "argv", argv),
        mock.patch("typer.main.get_command", _PARSER),  # else built anew for each line
        contextlib.chdir(cwd or Path.cwd()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        code = _exit_code()
    return Answer(code, out.getvalue(), err.getvalue())


def _exit_code() -> int:
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def every_command(group: Any = None, before: str = "") -> list[tuple[str, Any]]:
    """(name, command) of all that can be called, in the order of ``--help``; a group's as "study run"."""
    found = []
    for name, command in (group or _PARSER(app)).commands.items():
        inside = getattr(command, "commands", None)
        found += every_command(command, f"{before}{name} ") if inside else [(f"{before}{name}", command)]
    return found


def leftovers(folder: Path) -> list[str]:
    """Every file below ``folder``."""
    return sorted(str(p.relative_to(folder)) for p in _walk(folder))


def _walk(folder: Path) -> Iterator[Path]:
    return (p for p in folder.rglob("*") if p.is_file())
