"""No sentence of the manual or of the README carries more than two numbers: figures stand in tables."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

HOME = Path(__file__).parents[1]
PAGES = [
    HOME / "README.md",
    HOME / "CONTRIBUTING.md",
    *(p for p in sorted((HOME / "docs").rglob("*.md")) if not {"_build", "made"} & set(p.parts)),
    *sorted((HOME / "benchmarks" / "results").glob("*.md")),  # included in the manual
    *sorted(p for room in ("tutorials", "gallery") for p in (HOME / "docs" / room).glob("[0-9]*.py")),
]
MOST = 2
OVERFULL: dict[str, int] = {}  # page: how many sentences may still be too full
_NUMBER = r"(?:\d[\d,]*(?:\.\d+)*(?:e[-+]?\d+)?|\.\d+)"
# A range and a size count once; digits of names (AVX-512) do not.
_QUANTITY = re.compile(rf"(?<![\w.])(?<!\w-)[-+±]?{_NUMBER}(?:(?:-|±|\+-| ?x ?){_NUMBER})?")
_NOT_PROSE = (
    r"(?s)```.*?```|<!--.*?-->|\$\$.*?\$\$",  # code, comments, equations
    r"(?m)^(?:\s*[|#:]| {4}\S).*$",  # tables, headings, directives, indented code
    r"\]\([^)]*\)|\([^()]*\b(?:1[89]|20)\d\d\b[^()]*\)|\b(?:1[89]|20)\d\d\b",  # addresses, citations, years
)
_LITERAL = r"`[^`]*`|\$[^$]*\$"  # code and mathematics within a sentence: they may begin one


def sentences(text: str) -> Iterator[str]:
    """Sentences of a Markdown page as they are read, without what is not prose; items of a list are their own."""
    for pattern in _NOT_PROSE:
        text = re.sub(pattern, " ", text)
    text = re.sub(_LITERAL, "Literal", text)
    text = re.sub(r"^\s*(?:[-*]|\d+\.)\s+", "\n\n", text, flags=re.MULTILINE)
    for paragraph in re.split(r"\n\s*\n", text):
        yield from re.split(r"(?<=[.!?])\)?\*{0,2}\s+(?=[\W_]*[A-Z0-9])", " ".join(paragraph.split()))


def too_full(text: str) -> list[str]:
    """Sentences with more than two numbers."""
    return [s for s in sentences(text) if len(_QUANTITY.findall(s)) > MOST]


def words_of_a_script(text: str) -> str:
    """What a page of the gallery says: its docstring, and the comments between its code."""
    doc, _, code = text.removeprefix('"""').partition('"""')
    comments = (line[2:] if line.startswith("# ") and "%%" not in line else "" for line in code.splitlines())
    return "\n".join([doc, *comments]).replace("``", "`")


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(HOME)))
def test_figures_stand_in_tables(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    found = too_full(words_of_a_script(text) if page.suffix == ".py" else text)
    assert len(found) <= OVERFULL.get(str(page.relative_to(HOME)), 0), "\n".join(found)


@pytest.mark.parametrize(
    ("text", "full"),
    [
        ("It takes 3 s, 4 GB and 5 cores.", True),
        ("It takes 3 s and 4 GB. Another takes 5 s and 6 GB.", False),
        ("Errors are .1, .2 and .3 %.", True),
        ("It is 0.5 at 10-500 Hz.", False),  # a range is one number
        ("It is 1e-3 of 2,000 at 10 to 20 Hz.", True),  # a range in words is two
        ("Version 0.13.1 of 9x4 entries.", False),
        ("Seen in 2011 (Zhang et al. 2011, 33:31), 2 of 3.", False),
        ("| 1 | 2 | 3 |\n| --- | --- | --- |", False),
        ("Give `--set a=1 b=2 c=3`, [here](page-1-2-3.md), $1+2+3$.", False),
        ("```\n1 2 3 4\n```\n\n$$ 1 + 2 + 3 $$", False),
        ("- one 1, two 2\n- three 3, four 4", False),
        ("one 1, two 2\nthree 3.", True),  # a line's end is no sentence's
    ],
)
def test_what_counts(text: str, full: bool) -> None:
    assert bool(too_full(text)) is full
