"""The table that ``forearm-fem verify`` prints, and the page that it writes."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence

from ..store.text import markdown_table
from .run import weakest
from .scenes import Row


def verification_table(rows: Sequence[Row]) -> str:
    """Case, reference, quantity, error, tolerance and its reason, seconds, met; one Markdown line per row."""
    header = ("case", "reference", "quantity", "error", "tolerance", "why this tolerance", "s", "met")
    cells = (
        (r.case, r.reference, r.quantity, f"{r.error:.2g}", f"{r.tolerance:.2g}", r.reason, f"{r.seconds:.1f}",
         "yes" if r.met else "NO")
        for r in rows
    )  # fmt: skip
    return markdown_table(header, cells)


def count_met(rows: Sequence[Row]) -> str:
    """Number of rows met, and the one nearest to its tolerance."""
    met, weak = sum(r.met for r in rows), weakest(rows)
    return (
        f"{met} of {len(rows)} rows met. Weakest: *{weak.case}*, {weak.quantity}: "
        f"{weak.error:.2g} of {weak.tolerance:.2g} allowed ({weak.reason})."
    )


def verification_page(rows: Sequence[Row]) -> str:
    """The page verification.md."""
    system = f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"
    return (
        "# Verification\n\nWritten by `forearm-fem verify`: finite elements and the layered model against exact "
        f"solutions and published tables.\n\n{count_met(rows)}\nMachine: {os.cpu_count()} cores, {system}.\n\n"
        f"{verification_table(rows)}"
    )
