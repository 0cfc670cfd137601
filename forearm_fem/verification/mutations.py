"""Break it: deliberate bugs put into the running package, and the rows that catch them.

Nothing is written to disk; each bug lives inside a ``with`` block.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any
from unittest import mock

import numpy as np

from ..errors import ForearmError
from ..fem.assembly import loads
from ..fem.assembly import tissues as assembly
from ..fem.assembly.coefficients import Polynomial
from ..fem.assembly.operator import AffineOperator, WeightedSum
from ..fem.space.numbering import MixedSpace
from ..store.text import markdown_table
from . import cases, slabs
from .rows import Row


@dataclass(frozen=True)
class Caught:
    """A bug and the rows that it made fail (or the error that it raised)."""

    bug: str
    rows: tuple[Row, ...]
    raised: str = ""


def _wrong_inertia() -> AbstractContextManager[Any]:
    def at(self: Polynomial, omega: Any) -> Any:
        """With the sign of inertia turned."""
        w = np.asarray(omega, dtype=float)
        return self.constant + 1j * w * self.rate + w**2 * self.inertia

    return mock.patch.object(Polynomial, "at", at)


def _heavy_pressure_mass() -> AbstractContextManager[Any]:
    right = assembly.tissue_matrices

    def wrong(*arguments: Any, **options: Any) -> Any:
        """With a thousand times the pressure mass."""
        parts = right(*arguments, **options)
        return replace(parts, pressure_mass=1e3 * parts.pressure_mass)

    return mock.patch.object(assembly, "tissue_matrices", wrong)


def _transposed_jacobian() -> AbstractContextManager[Any]:
    def jacobians(self: MixedSpace) -> Any:
        """By rows instead of columns."""
        corner = self.mesh.points[self.vertices]
        return corner[:, 1:] - corner[:, :1]

    return mock.patch.object(MixedSpace, "jacobians", property(jacobians))


def _shifted_point() -> AbstractContextManager[Any]:
    right = loads._point_value
    return mock.patch.object(loads, "_point_value", lambda s, x, a: right(s, x + np.array([3e-4, 0.0, 0.0]), a))


def _real_part() -> AbstractContextManager[Any]:
    combine, at = AffineOperator.combine, AffineOperator.at

    def real_at(self: AffineOperator, omega: float) -> WeightedSum:
        """Without imaginary parts."""
        whole = at(self, omega)
        return replace(whole, weights=whole.weights.real.astype(complex))

    # what is factorised and what residuals are formed with: in one alone refinement would refuse it
    return mock.patch.multiple(
        AffineOperator, combine=lambda self, w: combine(self, w).real.astype(complex), at=real_at
    )


BUGS: dict[str, Callable[[], AbstractContextManager[Any]]] = {
    "wrong sign of the inertia term": _wrong_inertia,
    "pressure mass off by 1e3": _heavy_pressure_mass,
    "transposed Jacobian": _transposed_jacobian,
    "grid points shifted by 0.3 mm": _shifted_point,
    "imaginary part dropped": _real_part,
}


def probe_rows() -> Iterator[Row]:
    """Rows cheap enough to run once per bug (a quarter of a minute)."""
    yield from cases.order_rows("P2", bulks=(1e4, 2.2e9, math.inf))
    yield from chain(cases.shear_bar_rows(), cases.sphere_rows(), cases.structure_rows())
    slab = slabs.CONVERGENCE
    _, points = slabs.errors_of(slabs.solve_level(slab, 1.5).values, slabs.exact(slab))
    yield Row("FE, preset O, 300 Hz, coarse", "layered twin", "e(f), r = 10, 20 mm", points, 0.04, "2.1 % without bugs")


def run_mutations() -> list[Caught]:
    """Every bug in turn; an empty ``rows`` with nothing raised would be a hole in the verification."""
    found = []
    for name, bug in BUGS.items():
        rows: list[Row] = []
        raised = ""
        with bug():
            try:
                rows.extend(row for row in probe_rows() if not row.met)
            except (ForearmError, np.linalg.LinAlgError) as problem:
                raised = f"{type(problem).__name__}: {problem}"
        found.append(Caught(name, tuple(rows), raised))
    return found


def mutation_table(found: list[Caught]) -> str:
    """Markdown: the bug, the rows that caught it, the first one's error."""
    lines = []
    for each in found:
        names = "; ".join(dict.fromkeys(r.case for r in each.rows)) or ("**none**" if not each.raised else "-")
        first = each.raised
        if each.rows:
            first = f"{each.rows[0].quantity}: {each.rows[0].error:.1e} of {each.rows[0].tolerance:.0e}"
        lines.append((each.bug, names, first))
    return markdown_table(("deliberate bug", "rows that catch it", "e.g."), lines)
