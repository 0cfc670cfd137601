"""Tables of Hankel integrals between discs, with the static interaction of two discs in closed form."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np
from numpy.polynomial import legendre
from scipy import special

from ..typing import BoolArray, ComplexArray, FloatArray, IntArray

# Static interaction of two discs on a half-space: :math:`\frac1{2\pi}\int_0^\infty j(ka)j(kb)J_0(kd)\,dk`.
# With :math:`j(x)=2J_1(x)/x` this times (1 - nu)/mu is the displacement, averaged over a disc of radius b at
# distance d, due to a unit force spread uniformly over a disc of radius a. [1/m]

# Tanh-sinh rule on (-1, 1): exact to rounding with square-root and logarithmic ends.
_STEP = np.arange(-3.6, 3.6001, 0.06)
_ABSCISSAE = np.tanh(0.5 * np.pi * np.sinh(_STEP))
_WEIGHTS = 0.06 * 0.5 * np.pi * np.cosh(_STEP) / np.cosh(0.5 * np.pi * np.sinh(_STEP)) ** 2


def disc_potential(r: FloatArray, radius: float) -> FloatArray:
    """One uniform disc, seen at points: Weber-Schafheitlin integrals.

    (1/(pi a)) F(1/2, -1/2; 1; r^2/a^2) inside, (1/(2 pi r)) F(1/2, 1/2; 2; a^2/r^2) outside; inf at a point
    source itself.
    """
    r = np.asarray(r, dtype=float)
    inside = r < radius
    near, far = np.where(inside, r, 0.0), np.where(inside, 1.0, r)
    with np.errstate(divide="ignore", invalid="ignore"):
        out = special.hyp2f1(0.5, 0.5, 2.0, np.where(inside, 0.0, (radius / far) ** 2)) / (2 * np.pi * far)
        if radius > 0:
            within = special.hyp2f1(0.5, -0.5, 1.0, (near / radius) ** 2) / (np.pi * radius)
            out = np.where(inside, within, out)
    return np.where((r == 0) & (radius == 0), np.inf, out)


def disc_interaction(distance: float, a: float, b: float) -> float:
    """Two uniform discs, coincident, overlapping or apart; symmetric in a and b [1/m].

    The larger disc is the source; the mean over the smaller, b, is an integral over rings around the source,
    2 r theta(r) dr, theta = arccos((r^2 + d^2 - b^2)/(2 r d)) the half angle of the ring inside b.
    """
    a, b = max(a, b), min(a, b)
    if b == 0:
        return float(disc_potential(np.array(distance), a))
    if distance == 0:
        return float(special.hyp2f1(0.5, -0.5, 2.0, (b / a) ** 2) / (math.pi * a))
    cuts = {abs(distance - b), distance + b}
    cuts |= {a} if min(cuts) < a < max(cuts) else set()
    cuts |= {0.0} if distance < b else set()
    edges = sorted(cuts)
    total = sum(_ring_integral(lo, hi, distance, a, b) for lo, hi in itertools.pairwise(edges))
    return total / (math.pi * b * b)


def _ring_integral(lo: float, hi: float, distance: float, a: float, b: float) -> float:
    """Integral of 2 r theta(r) times the potential of disc a over lo < r < hi."""
    r = np.maximum(0.5 * (lo + hi) + 0.5 * (hi - lo) * _ABSCISSAE, 1e-12 * hi)
    weight = 0.5 * (hi - lo) * _WEIGHTS
    cosine = (r * r + distance * distance - b * b) / (2 * r * distance)
    theta = np.arccos(np.clip(cosine, -1.0, 1.0))
    return float(np.sum(weight * 2 * r * theta * disc_potential(r, a)))


# Tables of Hankel integrals :math:`\frac1{2\pi}\int_0^\infty k\,U(k)\,g_a(k)\,g_b(k)\,J_q(kd)\,dk`.
# g are the transforms of the tractions and of the receivers of the layered model, all of unit size:
# - ``ball``: :math:`j_l(ka)`, spherical Bessel function, the transform of order m of
# :math:`x^m P_n^{(m,-1/2)}(1-2x^2)/\sqrt{1-x^2}` with l = m + 2n (Sonine's integral; Sneddon 1966): traction under a
# rigid disc, the same span as :math:`x^m(1-x^2)^{n-1/2}` without its loss of digits;
# - ``ring``: :math:`J_m(ka)`, a line force on the rim;
# - ``mean``: :math:`2J_1(ka)/(ka)`, uniform pressure, or the mean over a disc; ``point``: 1;
# - ``bell``: :math:`e^{-(ka)^2/2}`, a force spread as :math:`e^{-r^2/2a^2}`, or the mean so weighted.
# For :math:`kU\to` const the integrals have closed or line-integral forms (:meth:`HankelTable.static`).

Numbers = FloatArray | ComplexArray
_NARROW = 16.0  # k end times the slowest rate over which the window acts: leaks exp(-(that/16)^2)
_ABOVE = 24  # orders above the highest at which recurrence downwards starts: exact to rounding
_TINY = 1e-4  # and x below which it does not
_LINE = 128  # nodes of line integrals: exact to rounding for rims 0.5 % of the radius apart


@dataclass(frozen=True, order=True)
class Radial:
    """One transform g(k); ``degree`` is l of a ball, m of a ring, 0 otherwise; ``radius`` [m]."""

    kind: Literal["ball", "ring", "mean", "point", "bell"]
    radius: float = 0.0
    degree: int = 0

    def size(self, k: FloatArray) -> FloatArray:
        """Envelope of |g| (n_k,)."""
        x = k * self.radius
        match self.kind:
            case "ball":
                return np.asarray(1 / np.maximum(1.0, x))
            case "ring":
                return _bessel_size(x)
            case "mean":
                y = np.maximum(x, 2.0)
                return np.asarray(np.where(x < 2.0, 1.0, np.minimum(1.0, 2 / y * np.sqrt(2 / (np.pi * y)))))
            case "bell":
                return np.asarray(np.exp(-0.5 * np.minimum(x, 38.0) ** 2))
            case _:
                return np.ones_like(k)

    @property
    def bessel(self) -> tuple[float, float, float]:
        """(c, p, nu) of g = c x^-p J_nu(x), x = k a."""
        match self.kind:
            case "ball":
                return math.sqrt(math.pi / 2), 0.5, self.degree + 0.5
            case "ring":
                return 1.0, 0.0, float(self.degree)
            case _:
                return 2.0, 1.0, 1.0

    @cached_property
    def line(self) -> tuple[FloatArray, ComplexArray]:
        """Offsets y (n,) [m] and weights w (n,) of g(k) = sum w e^{iky}: a source spread over the line |y| <= radius
        (balls by Gauss-Legendre's rule, means by Gauss-Chebyshev's); rings have none."""
        if self.kind == "ball":
            t, w = _gauss()
            weight = 0.5 * (-1j) ** self.degree * w * special.eval_legendre(self.degree, t)
            return self.radius * t, np.asarray(weight, dtype=complex)
        if self.kind == "mean":
            angle = np.pi * np.arange(1, _LINE + 1) / (_LINE + 1)
            return self.radius * np.cos(angle), np.asarray(2 / (_LINE + 1) * np.sin(angle) ** 2, dtype=complex)
        return np.zeros(1), np.ones(1, dtype=complex)


@dataclass(frozen=True)
class HankelTable:
    """Columns of integrals, (n_columns,) each: ``kernel`` (ascending numbers of the kernels U), indices ``a``, ``b`` of
    two ``radials``, ``order`` q of the Bessel function between their centres and their ``distance`` d [m]."""

    radials: tuple[Radial, ...]
    kernel: IntArray
    a: IntArray
    b: IntArray
    order: IntArray
    distance: FloatArray

    @cached_property
    def parts(self) -> list[slice]:
        """Columns of each kernel: of the first, or of all four."""
        edges = np.searchsorted(self.kernel, np.arange(5 if self.kernel[-1] > 0 else 2))
        return [slice(int(lo), int(hi)) for lo, hi in itertools.pairwise(edges)]

    @cached_property
    def radii(self) -> tuple[FloatArray, FloatArray]:
        """Radii (n_columns,) [m] of both transforms."""
        radius = np.array([g.radius for g in self.radials])
        return radius[self.a], radius[self.b]

    @cached_property
    def extent(self) -> float:
        """Highest spatial rate, max(d + a + b) [m]."""
        return float(np.max(self.distance + self.radii[0] + self.radii[1]))

    @cached_property
    def smallest(self) -> float:
        """Size of the finest detail [m]: the smallest source or, of points, their distance."""
        size = np.maximum(*self.radii)
        return float(np.min(np.where(size > 0, size, self.distance)))

    @cached_property
    def slowest(self) -> FloatArray:
        """Slowest rate of each column (n_columns,) [m], |d -+ a -+ b|; of a disc on itself, whose mean is known, 2a."""
        a, b = self.radii
        rates = [np.abs(self.distance + s * a + t * b) for s in (-1, 1) for t in (-1, 1)]
        return np.asarray(np.where(self._alone, 2 * a, np.minimum.reduce(rates)))

    @cached_property
    def _alone(self) -> BoolArray:
        a, b = self.radii
        bell = np.array([g.kind == "bell" for g in self.radials])
        return np.asarray((self.distance == 0) & (a == b) & (a > 0) & ~bell[self.a])

    @cached_property
    def _waves(self) -> tuple[IntArray, FloatArray, IntArray]:
        """Distinct orders and distances, and the place of each column among them."""
        both, at = np.unique(np.stack([self.order.astype(float), self.distance]), axis=1, return_inverse=True)
        return both[0].astype(int), both[1], at.ravel()

    def values(self, k: Numbers) -> Numbers:
        """g_a g_b J_q(kd)/(2 pi), (n_k, n_columns)."""
        return self.joined(*self.factors(k))

    def factors(self, k: Numbers) -> tuple[Numbers, Numbers]:
        """Factors of :meth:`values`: J_q(kd)/(2 pi) of the distinct (q, d), (n_k, n_waves), and g of the radials,
        (n_k, n_radials)."""
        order, distance, _ = self._waves
        return _waves(order, distance, k) / (2 * math.pi), transforms(self.radials, k)

    def joined(self, waves: Numbers, transforms: Numbers) -> Numbers:
        """:meth:`values` from their factors, at the same k."""
        out = waves[:, self._waves[2]]
        out *= transforms[:, self.a]
        out *= transforms[:, self.b]
        return out

    def mean(self, k: Numbers) -> tuple[IntArray, Numbers]:
        """Columns (n,) of discs on themselves, and the mean over the oscillation of their :meth:`values` for large k,
        (n_k, n); that of all others is zero.

        From J_nu(x) ~ sqrt(2/(pi x)) (1 + n/(2x)^2) cos(x - (nu + 1/2) pi/2 + n/x), n = (4 nu^2 - 1)/8.
        """
        columns = np.flatnonzero(self._alone)
        bessel = np.array([radial.bessel for radial in self.radials])
        (c, p, u), (d, q, v) = bessel[self.a[columns]].T, bessel[self.b[columns]].T
        x, n, m = np.multiply.outer(k, self.radii[0][columns]), (4 * u * u - 1) / 8, (4 * v * v - 1) / 8
        size = c * d * x ** -(p + q + 1) / math.pi * (1 + (n + m) / (2 * x) ** 2) / (2 * math.pi)
        return columns, np.asarray(size * np.cos((u - v) * math.pi / 2 - (n - m) / x))

    def envelope(self, k: FloatArray) -> FloatArray:
        """Bound (n_k,) [1/m] on what is lost of the integral of :meth:`values` by :func:`window` at k.

        Product of the envelopes times k or, where it oscillates, the inverse of its slowest rate, times what the window
        leaks at that rate; and the error of the mean.
        """
        sizes = np.stack([radial.size(k) for radial in self.radials], axis=1)
        size = _bessel_size(np.multiply.outer(k, self.distance)) * sizes[:, self.a] * sizes[:, self.b]
        with np.errstate(divide="ignore"):
            reach = np.minimum(k[:, None], 2 / self.slowest)
        leak = np.exp(-np.minimum((k[:, None] * self.slowest / _NARROW) ** 2, 700.0))
        fourth = np.array([radial.bessel[2] ** 4 for radial in self.radials])  # of the next term of the mean's series
        x = np.maximum(np.multiply.outer(k, self.radii[0]), 1e-9)
        missed = np.where(self._alone, np.minimum(1.0, (fourth[self.a] + fourth[self.b]) / (16 * x**3)), 0.0)
        lost = reach * np.maximum(leak, _CUT) + missed * k[:, None]
        return np.asarray(np.max(size * lost, axis=1) / (2 * math.pi))

    def static(self) -> FloatArray:
        """The integrals for kU = 1, (n_columns,) [1/m]; zero for
        rings, which a sheet calls for that removes the static limit."""
        spread = dict[tuple[str, str, float, float, int, float], list[int]]()
        out = np.zeros(self.a.size)
        columns = zip(self.a.tolist(), self.b.tolist(), self.order.tolist(), self.distance.tolist(), strict=True)
        for i, (a, b, q, d) in enumerate(columns):
            f, g = self.radials[a], self.radials[b]
            if {f.kind, g.kind} <= {"mean", "point"} and q == 0:
                out[i] = disc_interaction(d, f.radius, g.radius)
            elif {f.kind, g.kind} == {"bell"}:
                out[i] = _between_bells(f.radius, g.radius, d, q)
            elif "ring" in (f.kind, g.kind):
                continue
            elif d == 0:
                out[i] = _same_disc(f.degree, g.degree) / (2 * math.pi * f.radius)
            else:
                spread.setdefault((f.kind, g.kind, f.radius, g.radius, q, d), []).append(i)
        for (*_, q, d), alike in spread.items():  # the same lines, with weights of their own
            (y, _), (z, _) = (self.radials[at[alike[0]]].line for at in (self.a, self.b))
            v, w = (np.array([self.radials[n].line[1] for n in at[alike].tolist()]) for at in (self.a, self.b))
            out[alike] = ((v @ _between_lines(y, z, q, d)) * w).sum(axis=1).real
        return out


def window(k: Numbers, end: float) -> Numbers:
    """1 up to ``end`` [1/m], then falling smoothly to 0 at twice that; analytic, so that oscillations do not see it."""
    if math.isinf(end):
        return np.ones_like(k)
    return np.asarray(np.where(np.real(k) <= end, 1.0, 0.5 * special.erfc(8 / end * (k - 1.5 * end))))


_CUT = 1e-7  # what the window has lost where it starts and ends, erfc(4)/2, with some room


@lru_cache  # the rule is the same whatever the disc
def _gauss() -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre's rule of :data:`_LINE` nodes on (-1, 1)."""
    return legendre.leggauss(_LINE)


def _between_lines(y: FloatArray, z: FloatArray, q: int, d: float) -> ComplexArray:
    r""":math:`\frac1{2\pi}\int_0^\infty J_q(kd)\,e^{ik(y+z)}dk` for all pairs of offsets, |y + z| < d."""
    offset = np.add.outer(y, z)
    return np.asarray(np.exp(1j * q * np.arcsin(offset / d)) / np.sqrt(d * d - offset**2) / (2 * math.pi))


def _between_bells(a: float, b: float, d: float, q: int) -> float:
    r""":math:`\frac1{2\pi}\int_0^\infty e^{-k^2(a^2+b^2)/2}J_q(kd)\,dk`, by scaled Bessel functions."""
    both = a * a + b * b
    return float(special.ive(q / 2, d * d / (4 * both)) * math.sqrt(math.pi / (2 * both)) / (2 * math.pi))


def _same_disc(a: int, b: int) -> float:
    r""":math:`\int_0^\infty j_a j_b\,dx`: pi/(2 (2a + 1)) if a = b, else sin((a - b) pi/2)/((a - b)(a + b + 1))."""
    if a == b:
        return math.pi / (2 * (2 * a + 1))
    return 0.0 if (a - b) % 2 == 0 else float((-1) ** ((a - b - 1) // 2) / ((a - b) * (a + b + 1)))


def _filled(value: float, k: Numbers, n_columns: int) -> Numbers:
    """(n_k, n_columns) of ``value``, complex where k is."""
    shape = (k.size, n_columns)
    return np.full(shape, value, dtype=complex) if np.iscomplexobj(k) else np.full(shape, value)


def _bessel_size(x: FloatArray) -> FloatArray:
    """Envelope of |J_q(x)|."""
    return np.asarray(1 / np.sqrt(np.maximum(1.0, 0.5 * np.pi * x)))


def transforms(radials: tuple[Radial, ...], k: Numbers) -> Numbers:
    """g(k) of all ``radials``, (n_k, n_radials)."""
    out = _filled(1.0, k, len(radials))
    for i, g in enumerate(radials):
        if g.kind == "bell":  # zero where that is below what numbers hold
            x = k * g.radius
            out[:, i] = np.exp(-0.5 * np.where(np.real(x) < 38, x, 38.0) ** 2)
    for radius in {g.radius for g in radials if g.kind not in ("point", "bell")}:
        x = k * radius
        own = [(i, g) for i, g in enumerate(radials) if g.radius == radius and g.kind not in ("point", "bell")]
        top = {kind: max((g.degree for _, g in own if g.kind == kind), default=-1) for kind in ("ball", "ring", "mean")}
        balls, rings = _balls(top["ball"], x), bessels(max(top["ring"], top["mean"] + 1), x)
        for i, g in own:
            if g.kind == "mean":
                out[:, i] = np.where(x == 0, 1.0, 2 * rings[1] / np.where(x == 0, 1.0, x))
            else:
                out[:, i] = balls[g.degree] if g.kind == "ball" else rings[g.degree]
    return out


def _waves(order: IntArray, distance: FloatArray, k: Numbers) -> Numbers:
    """J_order(k distance), (n_k, n_waves)."""
    distances, at = np.unique(distance, return_inverse=True)
    found = bessels(int(order.max(initial=0)), np.multiply.outer(k, distances))
    out = _filled(0.0, k, order.size)
    for q in np.unique(order):
        out[:, order == q] = found[q][:, at[order == q]]
    return out


def bessels(top: int, x: Numbers) -> list[Numbers]:
    """J_0 ... J_top of x."""
    if np.iscomplexobj(x):
        return [np.asarray(special.jv(q, x)) for q in range(top + 1)]
    real = np.asarray(x, dtype=float)
    start = [np.asarray(f(real)) for f in (special.j0, special.j1)[: top + 1]]
    return _upwards(start, top, real, lambda q: 2.0 * q)


def _balls(top: int, x: Numbers) -> list[Numbers]:
    """Spherical Bessel functions j_0 ... j_top of x."""
    if np.iscomplexobj(x):
        return [np.asarray(special.spherical_jn(n, x)) for n in range(top + 1)]
    real = np.asarray(x, dtype=float)
    start = [np.asarray(special.spherical_jn(n, real)) for n in range(min(top, 1) + 1)]
    return _upwards(start, top, real, lambda n: 2.0 * n + 1)


def _upwards(start: list[FloatArray], top: int, x: FloatArray, factor: Callable[[int], float]) -> list[Numbers]:
    """Orders up to ``top`` from f_{n+1} = factor(n) f_n/x - f_{n-1}, stable for x > n; downwards below (:func:`_down`).

    Both families obey it with their own factor, of the first two orders given by ``start``.
    """
    out = start[: top + 1]
    if top < 2:
        return list(out)
    small = x < top + 1
    y = np.where(small, 1.0, x)
    for n in range(1, top):
        out.append(np.asarray(factor(n) * out[n] / y - out[n - 1]))
    for f, low in zip(out[2:], _down(top, x[small], factor, start[0][small], start[1][small])[2:], strict=True):
        f[small] = low
    return list(out)


def _down(
    top: int, x: FloatArray, factor: Callable[[int], float], zeroth: FloatArray, first: FloatArray
) -> list[FloatArray]:
    """Orders up to ``top`` at x (n,) below ``top`` + 1 by Miller's algorithm: f_{n-1} = factor(n) f_n/x - f_{n+1} from
    far above, where it starts from nothing, scaled to the larger of the first two orders (no zero of both)."""
    least = np.maximum(x, _TINY)  # below, order n is that there times the ratio to the n-th, to 1e-9 of itself
    above, here, out = np.zeros_like(x), np.full_like(x, 1e-200), list[FloatArray]()
    for n in range(top + _ABOVE, 0, -1):
        above, here = here, factor(n) * here / least - above
        if n <= top + 1:
            out.append(here)
        large = np.abs(here) > 1e100  # all orders kept so far shrink alike
        if large.any():
            shrink = np.where(large, 1e-150, 1.0)
            above, here, out = above * shrink, here * shrink, [f * shrink for f in out]
    low = out[::-1]
    by = np.abs(zeroth) >= np.abs(first)
    scale = np.where(by, zeroth, first) / np.where(by, low[0], low[1])
    return [f * scale * (x / least) ** n for n, f in enumerate(low)]
