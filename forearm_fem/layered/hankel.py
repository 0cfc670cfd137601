r"""Tables of Hankel integrals :math:`\frac1{2\pi}\int_0^\infty k\,U(k)\,g_a(k)\,g_b(k)\,J_q(kd)\,dk`.

g are the transforms of the tractions and of the receivers of the twin, all of unit size:

- ``ball``: :math:`j_l(ka)`, spherical Bessel function, the transform of order m of
  :math:`x^m P_n^{(m,-1/2)}(1-2x^2)/\sqrt{1-x^2}` with l = m + 2n (Sonine's integral; Sneddon 1966): traction under a
  rigid disc, the same span as :math:`x^m(1-x^2)^{n-1/2}` without its loss of digits;
- ``ring``: :math:`J_m(ka)`, a line force on the rim;
- ``mean``: :math:`2J_1(ka)/(ka)`, uniform pressure, or the mean over a disc; ``point``: 1.

For :math:`kU\to` const the integrals have closed or line-integral forms (:meth:`HankelTable.static`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.polynomial import legendre
from scipy import special

from ..typing import ComplexArray, FloatArray, IntArray
from .asymptote import disc_interaction

Numbers = FloatArray | ComplexArray
_LINE = 128  # nodes of line integrals: exact to rounding for rims 0.5 % of the radius apart


@dataclass(frozen=True, order=True)
class Radial:
    """One transform g(k); ``degree`` is l of a ball, m of a ring, 0 otherwise; ``radius`` [m]."""

    kind: Literal["ball", "ring", "mean", "point"]
    radius: float = 0.0
    degree: int = 0

    def values(self, k: Numbers) -> Numbers:
        """g(k) (n_k,) [-]."""
        x = k * self.radius
        match self.kind:
            case "ball":
                return np.asarray(special.spherical_jn(self.degree, x))
            case "ring":
                return np.asarray(special.jv(self.degree, x))
            case "mean":
                return _jinc(x)
            case _:
                return np.ones_like(k)

    def size(self, k: FloatArray) -> FloatArray:
        """Envelope of \\|g\\| (n_k,)."""
        x = k * self.radius
        match self.kind:
            case "ball":
                return np.asarray(1 / np.maximum(1.0, x))
            case "ring":
                return bessel_size(x)
            case "mean":
                y = np.maximum(x, 2.0)
                return np.asarray(np.where(x < 2.0, 1.0, np.minimum(1.0, 2 / y * np.sqrt(2 / (np.pi * y)))))
            case _:
                return np.ones_like(k)

    @property
    def far(self) -> tuple[float, float, float]:
        """(c, p, phase) of g ~ c x^-p cos(x - phase) for large x = k a."""
        match self.kind:
            case "ball":
                return 1.0, 1.0, (self.degree + 1) * math.pi / 2
            case "ring":
                return math.sqrt(2 / math.pi), 0.5, (self.degree + 0.5) * math.pi / 2
            case "mean":
                return 2 * math.sqrt(2 / math.pi), 1.5, 0.75 * math.pi
            case _:
                return 1.0, 0.0, 0.0

    @cached_property
    def line(self) -> tuple[FloatArray, ComplexArray]:
        """Offsets y (n,) [m] and weights w (n,) of g(k) = sum w e^{iky}: a source spread over a line |y| <= radius."""
        if self.kind == "ball":
            t, w = legendre.leggauss(_LINE)
            return self.radius * t, 0.5 * (-1j) ** self.degree * w * special.eval_legendre(self.degree, t)
        if self.kind == "mean":
            angle = np.pi * np.arange(1, _LINE + 1) / (_LINE + 1)
            return self.radius * np.cos(angle), 2 / (_LINE + 1) * np.sin(angle) ** 2 + 0j
        if self.kind == "ring":
            raise NotImplementedError("a line force on a rim has no static limit; a sheet that carries it removes it")
        return np.zeros(1), np.ones(1, dtype=complex)


@dataclass(frozen=True)
class HankelTable:
    """Integrals of one kernel: ``radials``, and per column the indices ``a``, ``b`` of two of them, the ``order`` q of
    the Bessel function between their centres and their ``distance`` d [m], each (n_columns,)."""

    radials: tuple[Radial, ...]
    a: IntArray
    b: IntArray
    order: IntArray
    distance: FloatArray

    @cached_property
    def radii(self) -> tuple[FloatArray, FloatArray]:
        """Radii (n_columns,) [m] of both transforms."""
        radius = np.array([g.radius for g in self.radials])
        return radius[self.a], radius[self.b]

    @cached_property
    def extent(self) -> float:
        """Highest spatial rate, max(d + a + b) [m]."""
        return float(np.max(self.distance + self.radii[0] + self.radii[1], initial=0.0))

    @cached_property
    def smallest(self) -> float:
        """Size of the finest detail [m]: the smallest source or, of points, their distance."""
        size = np.where(np.maximum(*self.radii) > 0, np.maximum(*self.radii), self.distance)
        return float(np.min(size, initial=np.inf))

    @cached_property
    def _waves(self) -> tuple[IntArray, FloatArray, IntArray]:
        """Distinct (order), (distance) and the column of each entry among them."""
        both, at = np.unique(np.stack([self.order.astype(float), self.distance]), axis=1, return_inverse=True)
        return both[0].astype(int), both[1], at.ravel()

    def values(self, k: Numbers) -> Numbers:
        """g_a g_b J_q(kd)/(2 pi), (n_k, n_columns)."""
        g = np.stack([radial.values(k) for radial in self.radials], axis=1) / math.sqrt(2 * math.pi)
        order, distance, at = self._waves
        wave = _bessel(order, np.multiply.outer(k, distance))
        return np.asarray(wave[:, at] * g[:, self.a] * g[:, self.b])

    def mean(self, k: FloatArray) -> FloatArray:
        """Mean over the oscillation of :meth:`values` for large k, (n_k, n_columns): not zero at d = 0 only."""
        out = np.zeros((k.size, self.a.size))
        for column in np.flatnonzero((self.distance == 0) & (self.radii[0] == self.radii[1])):
            (c, p, s), (e, r, t) = self.radials[self.a[column]].far, self.radials[self.b[column]].far
            x = k * self.radii[0][column]
            if x[0] > 0:
                out[:, column] = c * e * x ** -(p + r) * 0.5 * math.cos(s - t) / (2 * math.pi)
        return out

    def envelope(self, k: FloatArray) -> FloatArray:
        """Bound (n_k,) [1/m] on the integral of :meth:`values` less :meth:`mean` from k on, the largest of columns.

        Product of the envelopes times k or, where it oscillates, the inverse of its slowest rate \\|d -+ a -+ b\\|.
        """
        if not self.a.size:
            return np.zeros(k.size)
        sizes = np.stack([radial.size(k) for radial in self.radials], axis=1)
        rates = [np.abs(self.distance + s * self.radii[0] + t * self.radii[1]) for s in (-1, 1) for t in (-1, 1)]
        slowest = np.minimum.reduce(rates)
        same = (self.distance == 0) & (self.radii[0] == self.radii[1]) & (self.radii[0] > 0)
        slowest = np.where(same, 2 * self.radii[0], slowest)
        with np.errstate(divide="ignore"):
            reach = np.minimum(k[:, None], 2 / slowest)
        size = bessel_size(np.multiply.outer(k, self.distance)) * sizes[:, self.a] * sizes[:, self.b]
        return np.asarray(np.max(size * reach, axis=1) / (2 * math.pi))

    def static(self) -> ComplexArray:
        r"""The integrals for kU = 1, (n_columns,) [1/m]."""
        columns = zip(self.a, self.b, self.order, self.distance, strict=True)
        made: dict[tuple[float, float, int, float], tuple[FloatArray, ComplexArray]] = {}
        return np.array([self._static(self.radials[a], self.radials[b], int(q), float(d), made) for a, b, q, d in columns],
                        dtype=float).reshape(self.a.size)  # fmt: skip

    def _static(
        self, a: Radial, b: Radial, q: int, d: float, made: dict[tuple[float, float, int, float], FloatArray]
    ) -> float:
        if {a.kind, b.kind} <= {"mean", "point"} and q == 0:
            return disc_interaction(d, a.radius, b.radius)
        if d == 0:
            return _same_disc(a.degree, b.degree) / (2 * math.pi * a.radius)
        (y, w), (z, v) = a.line, b.line
        key = (a.kind, b.kind, a.radius, b.radius, q, d)
        if key not in made:
            offset = np.add.outer(y, z)
            made[key] = np.exp(1j * q * np.arcsin(offset / d)) / np.sqrt(d * d - offset**2) / (2 * math.pi)
        return float((w @ made[key] @ v).real)


def _same_disc(a: int, b: int) -> float:
    r""":math:`\int_0^\infty j_a j_b\,dx`: pi/(2 (2a + 1)) if a = b, else sin((a - b) pi/2)/((a - b)(a + b + 1))."""
    if a == b:
        return math.pi / (2 * (2 * a + 1))
    return 0.0 if (a - b) % 2 == 0 else (-1) ** ((a - b - 1) // 2) / ((a - b) * (a + b + 1))


def bessel_size(x: FloatArray) -> FloatArray:
    """Envelope of \\|J_q(x)\\|."""
    return np.asarray(1 / np.sqrt(np.maximum(1.0, 0.5 * np.pi * x)))


def _bessel(order: IntArray, x: Numbers) -> Numbers:
    """J_order(x), x (n_k, n_waves), ``order`` (n_waves,)."""
    out = np.empty_like(x)
    for q in np.unique(order):
        at = order == q
        if np.iscomplexobj(x):
            out[:, at] = special.jv(q, x[:, at])
        else:
            out[:, at] = special.j0(x[:, at]) if q == 0 else special.j1(x[:, at]) if q == 1 else special.jn(q, x[:, at])
    return out


def _jinc(x: Numbers) -> Numbers:
    """2 J1(x)/x, 1 at the origin."""
    zero = x == 0
    y = np.where(zero, 1.0, x)
    j1 = special.jv(1, y) if np.iscomplexobj(x) else special.j1(y)
    return np.asarray(np.where(zero, 1.0, 2 * j1 / y))
