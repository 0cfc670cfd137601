"""Tables in Markdown: one writer for every page of the package."""

from __future__ import annotations

from collections.abc import Iterable


def markdown_table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """``rows`` of cells below ``header``, a line each; bars and line breaks within a cell do not break the table."""
    head = list(header)
    lines = [head, ["---"] * len(head), *([c.replace("|", "\\|").replace("\n", " ") for c in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"
