"""The page of ``forearm-fem verify``."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence

from .. import __version__
from ..show.page import Block, Page, Section
from .run import weakest
from .scenes import Row

_HEADER = ["case", "reference", "quantity", "error", "tolerance", "why this tolerance", "s"]


def verification_page(rows: Sequence[Row]) -> Page:
    """Page: number of rows met, the one nearest to its tolerance, rows that miss it, and every row folded."""
    met, weak = sum(r.met for r in rows), weakest(rows)
    answer = [
        f"Weakest: {weak.case}, {weak.quantity}: {weak.error:.2g} of {weak.tolerance:.2g} allowed ({weak.reason}).",
        *(f"MISSED: {r.case}, {r.quantity}: {r.error:.2g} of {r.tolerance:.2g} allowed." for r in rows if not r.met),
    ]
    missed, every = ([_cells(r) for r in chosen] for chosen in ([r for r in rows if not r.met], rows))
    sections = [
        Section("missed", "What misses its tolerance", Block(_HEADER, missed) if missed else None),
        Section("rows", "Every row", Block(_HEADER, every), folded=bool(missed) or len(every) > 40),
    ]
    machine = f"{os.cpu_count()} cores, {platform.system()} {platform.machine()}, Python {platform.python_version()}"
    subject = "Finite elements and the layered model against exact solutions and published tables, on this machine."
    return Page(f"Verification: {met} of {len(rows)} rows met", answer, sections,
                f"forearm_fem {__version__} · {machine}", subject)  # fmt: skip


def _cells(r: Row) -> list[str]:
    return [r.case, r.reference, r.quantity, f"{r.error:.2g}", f"{r.tolerance:.2g}", r.reason, f"{r.seconds:.1f}"]
