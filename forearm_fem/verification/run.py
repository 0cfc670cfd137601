"""All cases in one tuple, run in order, timed."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from ..progress import Progress, tell
from . import cases, hard, slabs, twin
from .rows import HardRow, Row


@dataclass(frozen=True)
class Case:
    """A named generator of rows; ``quick`` ones make up the short version."""

    name: str
    rows: Callable[[], Iterator[Row]]
    quick: bool = True


CASES = (
    Case("twin, published tables", twin.table_rows),
    Case("twin, Miller-Pursey", twin.miller_pursey_rows),
    Case("twin, limits", twin.limit_rows),
    Case("twin, rigid discs", twin.rigid_rows),
    Case("orders, P2/P1", partial(cases.order_rows, "P2")),
    Case("orders, P3/P2", partial(cases.order_rows, "P3")),
    Case("orders, MINI", partial(cases.order_rows, "P1")),
    Case("orders, modulus jump, P2/P1", partial(cases.order_rows, "P2", jump=20.0, bulks=(2.2e9,))),
    Case("orders, modulus jump, P3/P2", partial(cases.order_rows, "P3", jump=20.0, bulks=(2.2e9,)), quick=False),
    Case("no locking", cases.locking_rows),
    Case("shear bar", cases.shear_bar_rows),
    Case("rigid punch", cases.punch_rows),
    Case("oscillating sphere", cases.sphere_rows),
    Case("structure", cases.structure_rows),
    Case("turned, shifted, scaled", cases.moved_rows),
    Case("solvers and reduction", cases.solver_rows),
    Case("FE against the twin, three levels", slabs.convergence_rows),
    Case("FE, half-space Z, 100 Hz", partial(slabs.reference_rows, slabs.REFERENCE[2:3])),
    Case("FE, further scenes", partial(slabs.reference_rows, slabs.REFERENCE[:2] + slabs.REFERENCE[3:]), quick=False),
)


def run_verification(
    full: bool = False, progress: Progress | None = None, *, chosen: Sequence[Case] = CASES
) -> list[Row]:
    """Run the quick cases, or with ``full`` all of them; progress(name, done, total) after each."""
    wanted = [c for c in chosen if full or c.quick]
    rows: list[Row] = []
    for i, case in enumerate(wanted):
        start = time.perf_counter()
        found = list(case.rows())
        share = (time.perf_counter() - start) / max(len(found), 1)
        rows += [replace(row, seconds=row.seconds or share) for row in found]
        tell(progress, case.name, i + 1, len(wanted))
    return rows


def run_hard_cases(progress: Progress | None = None) -> list[HardRow]:
    """Extreme scenes, each right within its stated error or refused by name."""
    rows: list[HardRow] = []
    for i, case in enumerate(hard.HARD):
        rows += hard.hard_rows(case)
        tell(progress, case.name, i + 1, len(hard.HARD))
    return rows
