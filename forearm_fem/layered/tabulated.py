"""Equal discs anywhere on a layered body, from integrals tabulated over distance once.

Two tractions meet in an integral that depends on nothing but the distance of their discs
(:mod:`forearm_fem.layered.scattering`). For discs of one radius the few hundred integrals are therefore functions of
one number; tabulated at the frequencies of a Chebyshev rule they answer any arrangement without a quadrature.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import BSpline

from ..errors import GeometryError
from ..typing import ComplexArray, FloatArray, IntArray
from .hankel import HankelTable
from .integrals import Medium
from .kernel import Layer, Surface
from .response import LayeredResult, distinct, terms_of
from .rigid import Disc
from .sampling import chebyshev_between
from .scattering import Galerkin, galerkin

_ORDERS = 2  # azimuthal, as the twin's own for discs 12 radii apart
CLEAR = 2e-4  # [m] from a rim: nearer, the field of a rigid disc has a root that no table follows
DEGREE = 5  # of the splines over distance
MARGIN = 2.0  # times what one arrangement was seen to err by, for those not seen; and times what two orders foretell
_FEW = 2  # every so many nodes series of tractions are judged: 18 arrangements lacked up to 1.12 times as much between
_SPLINES = ("discs", "points")


class Column(NamedTuple):
    """What an integral is but for its distance: kernel, both transforms (their places among the radials), order."""

    kernel: int
    a: int
    b: int
    order: int


@dataclass(frozen=True, eq=False)
class Tabulated:
    """Integrals (n_node, n_column) of a medium for discs of one ``radius`` [m] and ``contact``.

    ``omega`` (n_node,) [rad/s] are the nodes between ``low`` and ``high``; ``own`` are a disc's with itself, ``apart``
    splines of those of a disc and another or a point, over the root of their distance from touching. ``checked``
    (n_node,) is e(f), seen on one arrangement and doubled, against the twin itself.
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
        (:meth:`~forearm_fem.layered.scattering.Galerkin.free_compliance`); errors are those of held ones.
        Raises GeometryError for discs further apart than the table reaches, and for a point within 0.2 mm of a rim.
        """
        kinds, rows, _ = distinct(discs, discs)
        terms = terms_of(kinds, self._medium, np.array([self.low, self.high]))
        system = galerkin(kinds, self.surface, terms, self.orders)
        a = system.matrix(self._integrals(system))
        shown, by_order = system.by_order(a)
        whole = system.free_compliance(shown) if free else by_order[-1]
        judged = np.unique([*range(0, self.omega.size, _FEW), self.omega.size - 1])
        some, decay = [c[judged] for c in by_order], self._decay(kinds, self.omega[judged])
        lacking = system.lacking(a[judged], some, apart=True, decay=decay)
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
        return LayeredResult(values, np.zeros(omega.size), truncation, table + np.max(tails, axis=0), 0)

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

    def _decay(self, discs: Sequence[Disc], omega: FloatArray) -> FloatArray:
        """Ratio (n_freq,) by which what azimuthal orders scatter falls at least, beyond the highest taken.

        A field from a distance d is about a disc a series in (a/d)^l, or where waves are short in J_l(ka), whose ratio
        is below ka/(2 l + 2). Two orders foretell nothing where they are as large as each other.
        """
        places = np.array([(disc.x, disc.y) for disc in discs if disc.radius > 0])
        away = np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(len(places), 1)]
        waves = self.radius * self._medium.wavenumbers(omega)[0].max(axis=0) / (2 * self.orders + 2)
        return np.asarray(np.clip(np.maximum(self.radius / away.min(initial=np.inf), waves), 0.0, 0.9))

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
    """What :meth:`Tabulated.arrays` gave, back; KeyError or ValueError where it is not that."""
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
