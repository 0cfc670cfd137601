"""Equal discs anywhere on a layered body, from integrals tabulated over distance once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from ..errors import GeometryError
from ..progress import Progress, tell
from ..typing import ComplexArray, FloatArray, IntArray
from .discs import Disc, Galerkin, changed, decay_of, galerkin
from .hankel import HankelTable
from .integrals import Integrals, Medium
from .kernel import Layer, Surface, check_layers
from .response import LayeredResult, chebyshev_between, chebyshev_nodes, distinct, layered_compliance, terms_of

# Equal discs anywhere on a layered body, from integrals tabulated over distance once.
# Two tractions meet in an integral that depends on nothing but the distance of their discs
# (:mod:`forearm_fem.layered.discs`). For discs of one radius the few hundred integrals are therefore functions of
# one number; tabulated at the frequencies of a Chebyshev rule they answer any arrangement without a quadrature.

_ORDERS = 2  # azimuthal, as the layered model's own for discs 12 radii apart
CLEAR = 2e-4  # [m] from a rim: nearer, the field of a rigid disc has a root that no table follows
DEGREE = 5  # of the splines over distance
MARGIN = 2.0  # times what one arrangement was seen to err by, for those not seen; and times what two orders foretell
_FEW = 2  # every so many nodes series of tractions are judged: 18 arrangements lacked up to 1.12 times as much between
_SPLINES = ("discs", "points")


class Column(NamedTuple):
    """Integral without its distance: kernel, both transforms (their places among the radials), order."""

    kernel: int
    a: int
    b: int
    order: int


@dataclass(frozen=True, eq=False)
class Tabulated:
    """Integrals (n_node, n_column) of a medium for discs of one ``radius`` [m] and ``contact``.

    ``omega`` (n_node,) [rad/s] are the nodes between ``low`` and ``high``; ``own`` are a disc's with itself, ``apart``
    splines of those of a disc and another or a point, over the root of their distance from touching. ``checked``
    (n_node,) is e(f), seen on one arrangement and doubled, against the layered model itself.
    """

    layers: tuple[Layer, ...]
    surface: Surface
    radius: float
    contact: str
    farthest: float
    low: float
    high: float
    omega: FloatArray
    own: dict[Column, ComplexArray]
    discs: tuple[dict[Column, int], BSpline]
    points: tuple[dict[Column, int], BSpline]
    checked: FloatArray

    def compliance(self, omega: FloatArray, discs: Sequence[Disc], *, free: bool = False) -> LayeredResult:
        """Displacement per force between ``discs`` (points among them), as
        :func:`~forearm_fem.layered.layered_compliance` of them, at ``omega`` (n_freq,) [rad/s] within the band.

        Entries between two points are NaN. Errors are over the largest of their kind, between discs or from discs to
        points, whichever is more: G divides the small ones by the large. ``interpolation`` is the table's error and
        that between its frequencies.
        With ``free`` rigid discs are let go, and rows and columns follow for the net forces of bonded ones along x,
        then along y, and for the moments of all against tilt along x, then along y
        (:meth:`~forearm_fem.layered.discs.Galerkin.free_compliance`); errors are those of held ones.
        Raises GeometryError for discs further apart than the table reaches, and for a point within 0.2 mm of a rim.
        """
        kinds, rows, _ = distinct(discs, discs)
        system, a = self.matrix(kinds)
        shown, by_order = system.by_order(a)
        whole = system.free_compliance(shown) if free else by_order[-1]
        judged = np.unique([*range(0, self.omega.size, _FEW), self.omega.size - 1])
        some = [c[judged] for c in by_order]
        decay = decay_of(kinds, self._medium.wavenumbers(self.omega[judged])[0].max(axis=0), self.orders)
        lacking = system.lacking(a[judged], some, system.kinds(), decay)
        sampled, _ = chebyshev_between(self.low, self.high, omega, whole)
        n = system.ports
        tails = [chebyshev_between(self.low, self.high, omega, whole[:, :n, :n][:, kind])[1] for kind in system.kinds()]
        x, at = np.sqrt(omega), np.sqrt(self.omega[judged])[::-1]
        above = np.clip(np.searchsorted(at, x), 1, at.size - 1)
        truncation = MARGIN * np.maximum(lacking[::-1][above - 1], lacking[::-1][above])
        table = np.interp(x, np.sqrt(self.omega)[::-1], self.checked[::-1])
        sampled[:, system.points[:, None], system.points] = np.nan
        held = [number for number, disc in zip(rows, discs, strict=True) if free and disc.radius > 0]
        each, blocks = len(system.radii), (whole.shape[1] - n) // max(1, len(system.radii))
        grip = n + np.cumsum([disc.radius > 0 for disc in kinds])[held] - 1
        at_ports = np.concatenate([rows, *(grip + each * block for block in range(blocks))]).astype(int)
        values = sampled[:, at_ports][:, :, at_ports]
        none = np.zeros(omega.size)
        return LayeredResult(values, none, truncation, table + np.max(tails, axis=0), 0, none)

    def matrix(self, discs: Sequence[Disc]) -> tuple[Galerkin, ComplexArray]:
        """Galerkin's system of ``discs``, and its matrix (n_node, n, n) [m/N] between all their tractions."""
        terms = terms_of(discs, self._medium, np.array([self.low, self.high]))
        system = galerkin(discs, self.surface, terms, self.orders)
        return system, system.matrix(self._integrals(system))

    def arrays(self) -> dict[str, FloatArray | IntArray | ComplexArray]:
        """Numbers for a file; :func:`from_arrays` takes them back with the layers."""

        def listed(columns: Mapping[Column, object]) -> IntArray:
            """Kinds of columns (n, 4) as numbers."""
            return np.array(list(columns), dtype=int).reshape(-1, 4)

        out: dict[str, Any] = {
            "own": np.array(list(self.own.values())), "own_keys": listed(self.own), "omega": self.omega,
            "checked": self.checked, "ends": np.array([self.low, self.high, self.farthest]),
        }  # fmt: skip
        for name in _SPLINES:
            index, spline = getattr(self, name)
            out |= {f"{name}_keys": listed(index), f"{name}_t": spline.t, f"{name}_c": spline.c}
        return out

    @property
    def orders(self) -> int:
        """Azimuthal orders taken."""
        return orders_of(self.contact)

    @property
    def _medium(self) -> Medium:
        return Medium(self.layers, "halfspace", self.surface)

    def _integrals(self, system: Galerkin) -> ComplexArray:
        table = system.table
        kinds, of = np.unique(np.stack([table.kernel, table.a, table.b, table.order]), axis=1, return_inverse=True)
        names = [named(table, Column(*map(int, kind))) for kind in kinds.T]
        point = np.array([g.kind == "point" for g in table.radials])
        points = point[table.a].astype(int) + point[table.b]
        own = (table.distance == 0) & (points == 0)
        out = np.zeros((self.omega.size, table.a.size), dtype=complex)
        for i in np.flatnonzero(own):
            out[:, i] = self.own[names[of[i]]]
        for count, (index, spline), edge in ((0, self.discs, 2 * self.radius), (1, self.points, self.radius)):
            chosen = np.flatnonzero((points == count) & ~own)
            if chosen.size:
                places, at = np.unique(table.distance[chosen], return_inverse=True)
                self._check(places, edge)
                values = spline(np.sqrt(places - edge))  # (n_place, n_node, n_kind)
                out[:, chosen] = values[at, :, [index[names[k]] for k in of[chosen]]].T
        return out

    def _check(self, distance: FloatArray, edge: float) -> None:
        if distance[-1] > self.farthest:
            raise GeometryError(
                f"two ports are {1e3 * distance[-1]:.3g} mm apart, the tables reach {1e3 * self.farthest:.3g} mm"
            )
        if distance[0] < edge:
            raise GeometryError("a point lies under a disc: tables hold for points beside them; move either")
        if distance[0] < edge + CLEAR:
            raise GeometryError(
                f"a disc's rim comes within {1e3 * (distance[0] - edge):.2g} mm of a point or another disc, expected "
                f"{1e3 * CLEAR:g} mm or more"
            )


def orders_of(contact: str) -> int:
    """Azimuthal orders of tractions that are tabulated for a contact."""
    return _ORDERS if contact != "pressure" else 0


def from_arrays(
    arrays: Mapping[str, Any], layers: Sequence[Layer], surface: Surface, radius: float, contact: str
) -> Tabulated:
    """Table from the arrays of :meth:`Tabulated.arrays`; KeyError or ValueError for others."""
    keys = {name: [Column(*map(int, row)) for row in arrays[f"{name}_keys"]] for name in ("own", *_SPLINES)}
    discs, points = (
        ({column: i for i, column in enumerate(keys[name])}, BSpline(arrays[f"{name}_t"], arrays[f"{name}_c"], DEGREE))
        for name in _SPLINES
    )
    own = dict(zip(keys["own"], arrays["own"], strict=True))
    low, high, farthest = map(float, arrays["ends"])
    return Tabulated(
        tuple(layers), surface, radius, contact, farthest, low, high, arrays["omega"], own, discs, points,
        arrays["checked"],
    )  # fmt: skip


def named(table: HankelTable, column: Column) -> Column:
    """The column by what its radials are, so that tables with other radials in them agree: balls and rings by degree,
    then means and points."""
    start = {"ball": 0, "ring": 1000, "mean": 3000, "point": 4000}
    a, b = sorted(start[g.kind] + g.degree for g in (table.radials[column.a], table.radials[column.b]))
    return Column(column.kernel, a, b, column.order)


# Tables of the integrals between equal discs over their distance: how :class:`~.tabulated.Tabulated` is made.

_DEGREE = 48  # of the Chebyshev rule in the root of the frequency, as the layered model's own first try
_STEP = 2e-3  # [m] at the far end of a table; they lie closer towards the rims (0.8 mm leaves 1e-9, by its 6th power)
_AT_ONCE = 6  # distances of one quadrature
_SEEN_AT = 6  # every so many nodes a table is held against the layered model's own quadrature


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
        tell(progress, "tables of the layered model", done[0], total)

    discs, points = (build.over(root, edge, counted) for root, edge in zip(grids, edges, strict=True))
    made = Tabulated(
        medium.layers, medium.surface, radius, contact, farthest, *band, omega, build.own(), discs, points,
        np.zeros(omega.size),
    )  # fmt: skip
    return replace(made, checked=MARGIN * _seen(made, tolerance))


def _seen(made: Tabulated, tolerance: float) -> FloatArray:
    """e(f) (n_node,), the worse of both kinds of entries, of an arrangement without symmetry against the layered
    model's own quadrature, as many orders taken: what they leave out, each arrangement says itself."""
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
        distance = edge + root**2
        for start in range(0, len(root), _AT_ONCE):
            some = distance[start : start + _AT_ONCE]
            values.append(self._at(kinds, some))
            tell(len(some))
        return index, make_interp_spline(root, np.concatenate(values), k=DEGREE)

    def _at(self, kinds: HankelTable, distance: FloatArray) -> ComplexArray:
        """(n_distance, n_node, n_kind)."""
        m, n = len(distance), kinds.a.size
        order = np.argsort(np.tile(kinds.kernel, m), kind="stable")
        values = np.empty((self.omega.size, order.size), dtype=complex)
        kernel, a, b, q = (np.tile(x, m)[order] for x in (kinds.kernel, kinds.a, kinds.b, kinds.order))
        table = HankelTable(kinds.radials, kernel, a, b, q, np.repeat(distance, n)[order])
        values[:, order] = self.solved(table)
        return values.reshape(self.omega.size, m, n).swapaxes(0, 1)


def _columns(table: HankelTable) -> tuple[IntArray, IntArray, IntArray, IntArray, FloatArray]:
    return table.kernel, table.a, table.b, table.order, table.distance


def _part(table: HankelTable, kept: IntArray) -> HankelTable:
    kernel, a, b, order, distance = _columns(table)
    return HankelTable(table.radials, kernel[kept], a[kept], b[kept], order[kept], distance[kept])


def _column(table: HankelTable, i: int) -> Column:
    return Column(int(table.kernel[i]), int(table.a[i]), int(table.b[i]), int(table.order[i]))
