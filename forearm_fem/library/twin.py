"""The flat twin of any arrangement in a moment: its integrals over distance, tabulated once for a limb and radius."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from ..layered import Disc, Surface
from ..layered.hankel import HankelTable, Radial
from ..layered.integrals import Integrals, Medium
from ..layered.rigid import Contact
from ..layered.scattering import Galerkin, galerkin
from ..progress import Progress, tell
from ..typing import BoolArray, ComplexArray, FloatArray, IntArray

TERMS, ORDERS = 5, 2  # of tractions under rigid discs: leave 1e-4 of an arrangement (docs/decisions/0037-library.md)
_STEP = 0.035  # between tabulated sqrt(distance/radius - 1): 0.9 mm at 100 mm for a radius of 3.5 mm
_CLOSEST = 0.05  # the first of them: 9 um from a rim of 3.5 mm
_TOUCHING = 1.01  # between discs: 2.02 radii apart
_AT_ONCE = 8  # distances of one quadrature
_TOLERANCE = 1e-6
_KERNELS = 4  # of the quadrature: zz, zx, half the sum and half the difference of xx and yy
_DEGREE = 5  # of the spline over distance

Key = tuple[int, int, int, int]  # kernel, two radials, order of the Bessel function


@dataclass(frozen=True, eq=False)
class Curves:
    """Integrals ``values`` (n_frequency, n_key, n_distance) for ``keys`` (n_key, 4) at increasing ``distances``
    (n_distance,) [m]; smooth functions of sqrt(distance - ``radius``), as fields beside a rim are."""

    radius: float
    keys: IntArray
    distances: FloatArray
    values: ComplexArray

    def at(self, keys: IntArray, distances: FloatArray) -> ComplexArray:
        """Integrals (n_frequency, n) for ``keys`` (n, 4) at ``distances`` (n,), within those that are known."""
        rows, t = _rows(self.keys, keys), self._parameter(distances)
        if len(self.distances) == 1 or not len(rows):
            return np.asarray(self.values[:, rows, 0])
        t = np.clip(t, self._knots[_DEGREE], self._knots[-_DEGREE - 1])
        weights = BSpline.design_matrix(t, self._knots, _DEGREE)
        first = weights.indices.reshape(len(t), _DEGREE + 1)
        chosen = self._coefficients[:, rows[:, None], first]
        return np.asarray(np.einsum("nk,fnk->fn", weights.data.reshape(first.shape), chosen))

    def _parameter(self, distance: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt(np.maximum(distance / self.radius - 1, 0.0)))

    @cached_property
    def _knots(self) -> FloatArray:
        return np.asarray(make_interp_spline(self._parameter(self.distances), self.distances, _DEGREE).t)

    @cached_property
    def _coefficients(self) -> ComplexArray:
        """Of the spline, (n_frequency, n_key, n_distance)."""
        t = self._parameter(self.distances)
        parts = self.values.real, self.values.imag
        real, imaginary = (make_interp_spline(t, part, _DEGREE, axis=2).c for part in parts)
        return np.asarray(np.moveaxis(real + 1j * imaginary, 0, 2))


@dataclass(frozen=True, eq=False)
class TwinTable:
    """Integrals of the twin for discs of one ``radius`` [m] and ``contact``, and points.

    ``alone`` of a disc with itself, ``beside`` between discs, ``points`` between a disc and a point; points among
    themselves are not tabulated.
    """

    radius: float
    contact: str
    frequency: FloatArray
    alone: Curves
    beside: Curves
    points: Curves

    def compliance(self, centres: FloatArray, points: FloatArray, surface: Surface) -> tuple[ComplexArray, FloatArray]:
        """Compliance (n_frequency, n, n) [m/N] of discs at ``centres`` (k, 2), then ``points`` (m, 2), and what the
        tractions' series lack (n_frequency,), relative to the largest entry.

        Points move with the rigid disc that they lie under. Entries between points are NaN. Not covered: points under
        pressed discs.
        """
        discs = [_disc(x, y, self.radius, self.contact) for x, y in centres.tolist()]
        under = [self._carrier(centres, p) for p in points]
        free = [i for i, disc in enumerate(under) if disc is None]
        all_discs = [*discs, *(Disc(*points[i].tolist()) for i in free)]
        system = galerkin(all_discs, surface, TERMS, ORDERS if len(centres) + len(free) > 1 else 0)
        found, lacking = system.compliance(self._integrals(system))
        place = {i: len(discs) + n for n, i in enumerate(free)}
        at = [*range(len(discs)), *(place[i] if disc is None else disc for i, disc in enumerate(under))]
        whole = found[:, at][:, :, at]
        whole[:, len(discs) :, len(discs) :] = np.nan
        return whole, lacking

    def _carrier(self, centres: FloatArray, point: FloatArray) -> int | None:
        """The rigid disc that a point lies under."""
        if self.contact == "pressure":
            return None
        away = np.linalg.norm(centres - point, axis=1)
        return int(np.argmin(away)) if away.min() <= self.radius * (1 + 1e-9) else None

    def _integrals(self, system: Galerkin) -> ComplexArray:
        """Integrals (n_frequency, n_column) of the ``system``'s table, from this one."""
        table = system.table
        wanted = np.column_stack([table.kernel, table.a, table.b, table.order])
        out = np.zeros((len(self.frequency), len(wanted)), dtype=complex)
        point = np.array([r.kind == "point" for r in table.radials])
        ends = point[table.a].astype(int) + point[table.b]
        parts = ((table.distance == 0, self.alone), (ends == 0, self.beside), (ends == 1, self.points))
        for chosen, curves in parts:
            mine = chosen & (ends < 2) & ((table.distance == 0) == (curves is self.alone))
            out[:, mine] = curves.at(wanted[mine], table.distance[mine])
        return out


def twin_table(
    medium: Medium,
    frequency: FloatArray,
    radius: float,
    contact: str,
    farthest: float,
    *,
    progress: Progress | None = None,
) -> TwinTable:
    """Tabulate the twin of ``medium`` at ``frequency`` (n,) [Hz] up to the ``farthest`` distance [m]."""
    system = galerkin(_samples(radius, contact), medium.surface, TERMS, ORDERS)
    table = system.table
    wanted = np.column_stack([table.kernel, table.a, table.b, table.order])
    point = np.array([r.kind == "point" for r in table.radials])
    ends, apart = point[table.a].astype(int) + point[table.b], table.distance > 0
    last = np.sqrt(farthest / radius - 1)
    done = 0

    def curves(chosen: BoolArray, first: float) -> Curves:
        nonlocal done
        keys = np.unique(wanted[chosen], axis=0)
        t = np.linspace(first, last, max(2 * _DEGREE, int(np.ceil((last - first) / _STEP))))
        distances = radius * (1 + t**2) if first else np.zeros(1)
        parts = []
        for piece in np.array_split(distances, max(1, len(distances) // _AT_ONCE)):
            parts.append(_tabulated(medium, frequency, table.radials, keys, piece))
            done += 1
            tell(progress, "tables of the flat twin", done, 0)
        return Curves(radius, keys, distances, np.concatenate(parts, axis=2))

    alone = curves(~apart & (ends < 2), 0.0)
    beside, points = curves(apart & (ends == 0), _TOUCHING), curves(apart & (ends == 1), _CLOSEST)
    return TwinTable(radius, contact, frequency, alone, beside, points)


def _samples(radius: float, contact: str) -> list[Disc]:
    """Two discs and a point: every integral that an arrangement asks for is among theirs."""
    return [_disc(0.0, 0.0, radius, contact), _disc(3 * radius, radius, radius, contact), Disc(0.0, 5 * radius)]


def _disc(x: float, y: float, radius: float, contact: str) -> Disc:
    kind: Contact = "bonded" if contact == "bonded" else "frictionless" if contact == "frictionless" else "pressure"
    return Disc(x, y, radius, kind)


def bell_table(medium: Medium, frequency: FloatArray, width: float, distances: FloatArray) -> ComplexArray:
    """Compliance (n_frequency, n_distance) [m/N] between two bells of ``width`` [m] at increasing ``distances``."""
    pieces = np.array_split(distances, max(1, len(distances) // 64))
    key = np.zeros((1, 4), dtype=int)
    radials = (Radial("bell", width),)
    return np.concatenate([_tabulated(medium, frequency, radials, key, piece)[:, 0] for piece in pieces], axis=1)


def _tabulated(
    medium: Medium, frequency: FloatArray, radials: tuple[Radial, ...], keys: IntArray, distances: FloatArray
) -> ComplexArray:
    """Integrals (n_frequency, n_key, n_distance); a disc and a point closer than the other's rim are left zero."""
    columns = np.repeat(keys, len(distances), axis=0)
    far = np.tile(distances, len(keys))
    count = len(far)
    if 0 < keys[:, 0].max() < _KERNELS - 1:  # the quadrature takes one kernel or all
        columns, far = np.vstack([columns, [[_KERNELS - 1, 0, 0, 0]]]), np.append(far, 0.0)
    kernel, a, b, order = columns.T
    table = HankelTable(radials, kernel, a, b, order, far)
    integrals, omega = Integrals(medium, table, _TOLERANCE), 2 * np.pi * frequency
    out = np.empty((len(frequency), len(far)), dtype=complex)
    for chunk in integrals.chunks(omega):
        out[chunk] = integrals.solve(omega[chunk]).values
    return out[:, :count].reshape(len(frequency), len(keys), len(distances))


def _rows(keys: IntArray, wanted: IntArray) -> IntArray:
    """Row of each of ``wanted`` (n, 4) among ``keys``."""
    number = {tuple(key): i for i, key in enumerate(keys.tolist())}
    return np.array([number[tuple(key)] for key in wanted.tolist()], dtype=int)
