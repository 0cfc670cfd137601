"""Tables of the integrals between equal discs over their distance: how :class:`~.tabulated.Tabulated` is made."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from ..progress import Progress, tell
from ..typing import ComplexArray, FloatArray, IntArray
from .hankel import HankelTable
from .integrals import Integrals, Medium
from .kernel import Layer, Surface, check_layers
from .response import layered_compliance, terms_of
from .rigid import Disc
from .sampling import chebyshev_nodes
from .scattering import Galerkin, changed, galerkin
from .tabulated import CLEAR, DEGREE, MARGIN, Column, Tabulated, named, orders_of

_DEGREE = 48  # of the Chebyshev rule in the root of the frequency, as the twin's own first try
_STEP = 2e-3  # [m] at the far end of a table; they lie closer towards the rims (0.8 mm leaves 1e-9, by its 6th power)
_AT_ONCE = 6  # distances of one quadrature
_SEEN_AT = 6  # every so many nodes a table is held against the twin's own quadrature


def tabulate(
    layers: Sequence[Layer],
    band: tuple[float, float],
    radius: float,
    contact: str,
    *,
    surface: Surface | None = None,
    farthest: float = 0.1,
    tolerance: float = 1e-7,
    step: float = _STEP,
    progress: Progress | None = None,
) -> Tabulated:
    """Tables for discs of ``radius`` [m] on ``layers``, for angular frequencies in ``band`` [rad/s] and ports up to
    ``farthest`` [m] apart, ``step`` [m] fine at that end.

    ``progress`` counts distances. Media with next to no loss are not covered: their sharp
    resonances escape the Chebyshev rule, which ``checked`` then says.
    """
    check_layers(layers, "halfspace")
    medium = Medium(tuple(layers), "halfspace", surface or Surface())
    omega = chebyshev_nodes(*band, _DEGREE)
    build = _Builder(medium, radius, contact, omega, tolerance)
    edges = (2 * radius, radius)
    grids = []
    for edge in edges:  # even in the root of the distance, and a step apart at its end
        count = max(12, int(np.ceil(2 * (farthest - edge) / step)))
        grids.append(np.linspace(np.sqrt(0.9 * CLEAR), np.sqrt(farthest - edge), count))
    total, done = sum(len(g) for g in grids), [0]

    def counted(count: int) -> None:
        """Tell that ``count`` more distances are done."""
        done[0] += count
        tell(progress, "tables of the flat twin", done[0], total)

    discs, points = (build.over(root, edge, counted) for root, edge in zip(grids, edges, strict=True))
    made = Tabulated(
        medium.layers, medium.surface, radius, contact, farthest, *band, omega, build.own(), discs, points,
        np.zeros(omega.size),
    )  # fmt: skip
    return replace(made, checked=MARGIN * _seen(made, tolerance))


def _seen(made: Tabulated, tolerance: float) -> FloatArray:
    """e(f) (n_node,), the worse of both kinds of entries, of an arrangement without symmetry against the twin's own
    quadrature, as many orders taken: what they leave out, each arrangement says itself."""
    r, reach = made.radius, 0.4 * made.farthest
    places = [(0.0, 0.0), (4.3 * r, 1.1 * r), (-2.1 * r, 0.6 * reach)]
    spots = [(2.2 * r, 2.4 * r), (0.5 * reach, -0.3 * reach), (-1.6 * r, -0.9 * r), (0.1 * reach, 0.8 * reach)]
    contact = made.contact
    discs = [*(Disc(x, y, r, contact) for x, y in places), *(Disc(x, y) for x, y in spots)]  # type: ignore[arg-type]
    n = len(places)
    few = made.omega[::_SEEN_AT]
    truth = layered_compliance(
        made.layers, few, discs[:n], discs, surface=made.surface, tolerance=tolerance, orders=made.orders
    )
    found = made.compliance(few, discs).values[:, :, :n]
    disc = np.arange(len(discs)) < n
    kinds = [np.repeat(of[:, None], n, axis=1) for of in (disc, ~disc)]
    error = changed(truth.values, found, kinds)
    return np.asarray(np.interp(np.sqrt(made.omega), np.sqrt(few)[::-1], error[::-1]))


@dataclass(frozen=True)
class _Builder:
    """The integrals of one disc with itself, another disc and a point."""

    medium: Medium
    radius: float
    contact: str
    omega: FloatArray
    tolerance: float

    def system(self, near: bool, distances: Sequence[float]) -> Galerkin:
        """A disc, and discs (points unless ``near``) at ``distances`` [m] from it."""
        discs = [Disc(0.0, 0.0, self.radius, self.contact)]  # type: ignore[arg-type]
        radius, contact = (self.radius, self.contact) if near else (0.0, "pressure")
        discs += [Disc(d, 0.0, radius, contact) for d in distances]  # type: ignore[arg-type]
        orders = orders_of(self.contact)
        ends = np.array([self.omega.min(), self.omega.max()])
        return galerkin(discs, self.medium.surface, terms_of(discs, self.medium, ends), orders)

    def solved(self, table: HankelTable) -> ComplexArray:
        """Integrals (n_omega, n_column) of the ``table``."""
        integrals = Integrals(self.medium, table, self.tolerance)
        out = np.zeros((self.omega.size, table.a.size), dtype=complex)
        for chunk in integrals.chunks(self.omega):
            out[chunk] = integrals.solve(self.omega[chunk]).values
        return out

    def own(self) -> dict[Column, ComplexArray]:
        """Integrals (n_omega,) of a disc with itself, by kind of column."""
        table = self.system(True, [1.0]).table
        alone = _part(table, np.flatnonzero(table.distance == 0))
        values = self.solved(alone)
        return {named(alone, _column(alone, i)): values[:, i] for i in range(alone.a.size)}

    def over(self, root: FloatArray, edge: float, tell: Callable[[int], None]) -> tuple[dict[Column, int], BSpline]:
        """All kinds of columns at distances ``edge`` + ``root``^2 [m], and their splines over the root."""
        near = edge > self.radius
        one = self.system(near, [1.0]).table
        kinds = _part(one, np.flatnonzero(one.distance > 0))
        if not near:
            point = np.array([g.kind == "point" for g in kinds.radials])
            kinds = _part(kinds, np.flatnonzero(~(point[kinds.a] & point[kinds.b])))
        index = {named(kinds, _column(kinds, i)): i for i in range(kinds.a.size)}
        values = []
        distance, more = edge + root**2, _lacking(one, kinds)
        for start in range(0, len(root), _AT_ONCE):
            some = distance[start : start + _AT_ONCE]
            values.append(self._at(kinds, some, more))
            tell(len(some))
        return index, make_interp_spline(root, np.concatenate(values), k=DEGREE)

    def _at(self, kinds: HankelTable, distance: FloatArray, more: HankelTable) -> ComplexArray:
        """(n_distance, n_node, n_kind); the columns ``more`` are computed besides and left out."""
        m, n = len(distance), kinds.a.size
        columns = [np.concatenate([np.tile(x, m), y]) for x, y in zip(_columns(kinds), _columns(more), strict=True)]
        columns[-1][: m * n] = np.repeat(distance, n)
        order = np.argsort(columns[0], kind="stable")
        values = np.empty((self.omega.size, order.size), dtype=complex)
        values[:, order] = self.solved(HankelTable(kinds.radials, *(c[order] for c in columns)))
        return values[:, : m * n].reshape(self.omega.size, m, n).swapaxes(0, 1)


def _columns(table: HankelTable) -> tuple[IntArray, IntArray, IntArray, IntArray, FloatArray]:
    return table.kernel, table.a, table.b, table.order, table.distance


def _part(table: HankelTable, kept: IntArray) -> HankelTable:
    kernel, a, b, order, distance = _columns(table)
    return HankelTable(table.radials, kernel[kept], a[kept], b[kept], order[kept], distance[kept])


def _lacking(table: HankelTable, kinds: HankelTable) -> HankelTable:
    """A column of ``table`` for each kernel that ``kinds`` lack beside others than the first: the quadrature takes the
    first alone, or all four."""
    wanted = sorted(set(table.kernel.tolist()) - set(kinds.kernel.tolist())) if kinds.kernel.max() > 0 else []
    return _part(table, np.array([int(np.flatnonzero(table.kernel == k)[0]) for k in wanted], dtype=int))


def _column(table: HankelTable, i: int) -> Column:
    return Column(int(table.kernel[i]), int(table.a[i]), int(table.b[i]), int(table.order[i]))
