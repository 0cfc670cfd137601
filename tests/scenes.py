"""Scenes that several files of tests look at: each is solved once a session, by whichever worker asks first."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """The folder ``name`` that all workers of this session share, filled by ``make``; do not write into it."""
    base = factory.getbasetemp()
    if base.name.startswith("popen-"):  # a worker's own, below the session's
        base = base.parent
    folder, made = base / name, base / f"{name}.made"
    with FileLock(base / f"{name}.lock"):
        if not made.exists():
            folder.mkdir(exist_ok=True)
            make(folder)
            made.touch()
    return folder


def shows_itself(answer: Any) -> None:
    """What a notebook asks of every answer: a line, a table, labelled arrays, a picture."""
    assert "\n" not in repr(answer)
    assert 20 < len(repr(answer)) < 600
    assert "<table>" in answer._repr_html_()
    assert answer.to_xarray().sizes
    assert answer.plot().axes


def sampled(cases: Iterable[Any], every: int) -> list[Any]:
    """Each ``every``-th case of one rule for the default suite, the others by night."""
    return [pytest.param(c, marks=[pytest.mark.slow] if n % every else []) for n, c in enumerate(cases)]
