"""All cases of the verification, run in order and timed, and their page."""

from __future__ import annotations

import math
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from .. import __version__
from ..progress import Progress, tell
from ..show.page import Block, Page, Section
from . import closed, layered
from .scenes import Row

Case = Callable[[], Iterator[Row]]
CASES: Mapping[str, Case] = {
    "layered model, published tables": layered.table_rows,
    "layered model, Miller-Pursey": layered.miller_pursey_rows,
    "layered model, limits": layered.limit_rows,
    "layered model, rigid discs": layered.rigid_rows,
    "shear bar": closed.shear_bar_rows,
    "rigid punch": closed.punch_rows,
    "oscillating sphere": closed.sphere_rows,
    "structure": closed.structure_rows,
    "slab against the layered model": closed.slab_rows,
}


def run_verification(progress: Progress | None = None, *, cases: Mapping[str, Case] = CASES) -> list[Row]:
    """Rows of all cases; progress(name, done, total) after each."""
    rows: list[Row] = []
    for i, (name, case) in enumerate(cases.items()):
        start = time.perf_counter()
        found = list(case())
        share = (time.perf_counter() - start) / max(len(found), 1)
        rows += [replace(row, seconds=share) for row in found]
        tell(progress, name, i + 1, len(cases))
    return rows


def weakest(rows: Sequence[Row]) -> Row:
    """The row whose error comes nearest to, or goes furthest beyond, its tolerance."""
    return max(rows, key=lambda r: r.error / r.tolerance if math.isfinite(r.error) else math.inf)


# The page of ``forearm-fem verify``.

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
