"""All cases of the verification, run in order and timed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from ..progress import Progress, tell
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
