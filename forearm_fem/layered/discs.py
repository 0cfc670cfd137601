"""Rigid and pressure discs on a layered body: tractions, and Galerkin's matrix of all contacts and points."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import Literal

import numpy as np
from scipy.linalg import block_diag

from ..typing import BoolArray, ComplexArray, FloatArray, IntArray
from .hankel import HankelTable, Radial
from .kernel import Surface

# Tractions under the contacts of a layered body: uniform pressure, and what a rigid disc can call forth.
# Each traction is one of the components z (normal, outward), + or - (:math:`t_x\pm it_y`, none without friction), of
# azimuthal order m, with the transform :math:`(-i)^{|m|}g(k)e^{im\varphi}`, g a ball :math:`j_{|m|+2n}(ka)` of
# :mod:`forearm_fem.layered.hankel`: the span of :math:`x^{|m|}(1-x^2)^{n-1/2}e^{im\theta}`, which has the root
# singularity at the rim. A bonded disc on a compressible body has :math:`(1-x^2)^{-1/2\pm i\epsilon}` instead
# (Mossakovskii 1954; Spence 1968), which the series nears algebraically. Where a sheet on the skin resists, it carries
# line forces on the rim, and a ring joins the balls.
# Only the first, z of order 0 and n = 0, has a net force; it belongs to the port of the disc.

Contact = Literal["pressure", "bonded", "frictionless"]
Component = Literal["z", "+", "-"]
_NEVER = 99  # place from the end of tractions that no shorter series leaves out
_BESIDE = 6  # terms at most, less two per order, of what answers neighbours


UPRIGHT = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Disc:
    """A disc on the surface, centre (x, y) and radius [m]; radius 0 is a point.

    ``contact``: uniform ``pressure`` (its displacement is the mean over it), or a rigid disc that moves along its
    normal only, ``bonded`` or ``frictionless``, as the finite elements have them (:mod:`forearm_fem.ports`). A point
    may have an ``axis`` of its own along x, y and the outward normal; one that moves with a rigid disc shows what that
    has along it.
    """

    x: float
    y: float
    radius: float = 0.0
    contact: Contact = "pressure"
    axis: tuple[float, float, float] = UPRIGHT
    component: Component = "z"

    @property
    def rigid(self) -> bool:
        """True if the skin under it moves as one."""
        return self.contact != "pressure"

    @property
    def parts(self) -> tuple[tuple[Disc, complex], ...]:
        """Discs with tractions along the components, and the share of each: tractions have z into the body, so that x
        and y turn round (see :meth:`Galerkin.free_compliance`)."""
        if self.axis == UPRIGHT or self.radius > 0:
            return ((self, 1.0),)
        x, y, z = self.axis
        shares: dict[Component, complex] = {"z": z, "+": -(x + 1j * y), "-": -(x - 1j * y)}
        return tuple((replace(self, axis=UPRIGHT, component=c), share) for c, share in shares.items())


@dataclass(frozen=True)
class Traction:
    """One traction: ``component``, azimuthal order ``m``, transform; the ``order`` of the whole vector that it is part
    of, and its place from the end of its series, ``last`` (0 for the last; never the first of a series)."""

    component: Component
    m: int
    radial: Radial
    order: int = 0
    last: int = _NEVER


def port_traction(disc: Disc) -> Traction:
    """The traction with a unit net force."""
    kind: Literal["ball", "mean", "point"] = "ball" if disc.rigid else "mean" if disc.radius > 0 else "point"
    return Traction(disc.component, 0, Radial(kind, disc.radius))


def inner_tractions(disc: Disc, surface: Surface, terms: int, orders: int) -> list[Traction]:
    """Tractions without net force under a rigid disc, ``terms`` of the axisymmetric ones.

    Order l of the whole vector has m = l of the normal, l + 1 and l - 1 of the tangential components; |l| goes up to
    ``orders``, each order with two terms less than six, at least one. Without neighbours l = 0 is all there is.
    """
    components: tuple[Component, ...] = ("z", "+", "-") if disc.contact == "bonded" else ("z",)
    out: list[Traction] = []
    for order in range(-orders, orders + 1):
        count = terms if order == 0 else max(1, min(terms, _BESIDE) - 2 * abs(order))
        for component in components:
            m = order + {"z": 0, "+": 1, "-": -1}[component]
            balls = [Radial("ball", disc.radius, abs(m) + 2 * n) for n in range(count)]
            ends = [_NEVER, *range(count - 2, -1, -1)]
            series = [Traction(component, m, g, abs(order), end) for g, end in zip(balls, ends, strict=True)]
            out += series[1:] if (component, m) == ("z", 0) else series
            if surface.tension > 0 if component == "z" else surface.sheet:  # a sheet carries line forces there
                out.append(Traction(component, m, Radial("ring", disc.radius, abs(m)), abs(order)))
    return out


# All contacts and points of a layered body at once: Galerkin's matrix of their tractions, condensed to their ports.
# For tractions :math:`\alpha` at :math:`x_\alpha` and :math:`\beta` at :math:`x_\beta` (:mod:`.rigid`), the work of one
# on the displacement of the other is
# .. math::
# A_{\alpha\beta}=\int\hat t_\alpha(-k)\cdot U(k)\,\hat t_\beta(k)\,e^{ik\cdot(x_\alpha-x_\beta)}\frac{d^2k}{4\pi^2}
# = c\,(-i)^{|m_\alpha|+|m_\beta|}(-1)^{m_\alpha}\,i^{|q|}e^{-iq\theta}\;
# \frac1{2\pi}\int_0^\infty k\,U\,g_\alpha g_\beta\,J_{|q|}(kd)\,dk,\quad q=-(m_\alpha+m_\beta+s),
# d and theta the distance and direction of their centres, with the kernel U, factor c and shift s of the two components
# (``_PAIRS``): for :math:`t_\pm=e^{\pm i\varphi}(t_L\pm it_T)` tangential tractions meet in
# half the sum and half the difference of the compliances along and across the wave. Under rigid discs the displacement
# is that of the disc; with forces on ports (points are ports too) the inner tractions follow from
# :math:`A_{ri}f_i+A_{rr}c=0`, so that
# .. math:: C = A_{ii}-A_{ir}A_{rr}^{-1}A_{ri}.
# Each disc thus scatters the waves of all others, to all orders of reflection; held are its tilt and its sideways
# motion. A is symmetric entry by entry, so C is reciprocal.

# (component of alpha, of beta) -> kernel (0 zz, 1 zx, 2 sum, 3 difference), factor c, shift s
_PAIRS = MappingProxyType(
    {
        ("z", "z"): (0, 1.0, 0), ("z", "+"): (1, 0.5j, -1), ("z", "-"): (1, 0.5j, 1),
        ("+", "z"): (1, -0.5j, -1), ("+", "+"): (3, 0.5, -2), ("+", "-"): (2, 0.5, 0),
        ("-", "z"): (1, -0.5j, 1), ("-", "+"): (2, 0.5, 0), ("-", "-"): (3, 0.5, 2),
    }
)  # fmt: skip
_NAMES = ("z", "+", "-")
_LEAST_LEFT = 0.5  # of what the last terms of orders above 0 change: the highest orders have one term only
_AT_ONCE = 4  # frequencies whose systems stay in the cache


@dataclass(frozen=True)
class Galerkin:
    """The system: a ``table`` of integrals and, for each pair i <= j of tractions whose entry is not zero, its
    ``place`` (2, n_pairs), ``column`` in the table, and ``factor``.

    The first ``ports`` tractions are the ports', ``points`` those of points; ``last`` is the place from the end of
    ``terms``, ``order`` is the azimuthal order; ``rings`` (2, n) are ring tractions with a net force, and the ball
    that takes it over; ``grips`` (2, r) the tractions + and - of each bonded disc that hold it sideways, with a net
    force; ``tilts`` (2, t) those along z of orders 1 and -1 that hold each rigid disc of ``radii`` (t,) against tilt,
    with a moment, and ``moments`` (2, n) rings with one, and the ball that takes it over. ``tractions`` are all of
    them, ``owner`` the number of the disc of each.

    Truncation error: what the last axisymmetric term changes, times terms/2, as the rim's singularity may make
    convergence a power of -2. Of the other series, geometric ones: what their last terms change, times their fall over
    the last two. Of azimuthal orders the sum of a geometric series that falls as distances and waves say
    (:func:`decay_of`), or as the slower of the last two falls where that is less; it begins with the root mean square
    of the last two changes, as one alone may vanish where a point lies."""

    table: HankelTable
    place: IntArray
    column: IntArray
    factor: ComplexArray
    ports: int
    points: IntArray
    terms: int
    last: IntArray
    order: IntArray
    radii: FloatArray
    rings: IntArray
    grips: IntArray
    tilts: IntArray
    moments: IntArray
    tractions: tuple[Traction, ...]
    owner: tuple[int, ...]

    def matrix(self, integrals: ComplexArray) -> ComplexArray:
        """A (n_freq, n, n) [m/N] from the integrals (n_freq, n_columns); rings freed of their net force and moment."""
        n, (i, j) = self.last.size, self.place
        entry = np.full((n, n), self.column.size)
        entry[i, j] = entry[j, i] = np.arange(self.column.size)
        values = np.zeros((integrals.shape[0], self.column.size + 1), dtype=complex)  # the last stands for none
        np.multiply(self.factor, np.take(integrals, self.column, axis=1), out=values[:, :-1])
        out = np.take(values, entry.ravel(), axis=1).reshape(-1, n, n)
        for (ring, ball), share in ((pair, share) for pairs, share in self.moved for pair in pairs.T):
            out[:, ring] -= share * out[:, ball]
            out[:, :, ring] -= share * out[:, :, ball]
        return out

    @property
    def moved(self) -> tuple[tuple[IntArray, float], ...]:
        """Pairs of rings and balls, and by how much a ring's force or moment is larger: J_1(x) is x/2, j_1(x) x/3."""
        return (self.rings, 1.0), (self.moments, 1.5)

    def compliance(
        self, a: ComplexArray, kinds: Sequence[BoolArray], judged: BoolArray, decay: FloatArray
    ) -> tuple[ComplexArray, FloatArray]:
        """Ports' displacement per force (n_freq, ports, ports) [m/N] from A (n_freq, n, n), and its truncation error by
        the series (n_freq,) where ``judged`` (n_freq,).

        That is of the worst of the ``kinds`` of entries (ports, ports), over their largest; NaN, unknown, where there
        are neighbours and no azimuthal orders for them. To judge takes four times as long as the answer itself."""
        n = self.ports
        out, lacking = np.empty((len(a), n, n), dtype=complex), np.zeros(len(a))
        if judged.any():
            by_order = self.by_order(a[judged])[1]
            out[judged], lacking[judged] = by_order[-1], self.lacking(a[judged], by_order, kinds, decay[judged])
        if not judged.all():
            out[~judged] = self._alone(_without_last(a[~judged], n))
        return out, lacking

    def by_order(self, a: ComplexArray) -> tuple[ComplexArray, list[ComplexArray]]:
        """From A what ports, then grips and tilts, show (n_freq, m, m), m = ports + 2 r + 2 t, discs let go; and C of
        held ones (n_freq, ports, ports) with azimuthal orders up to 0, 1, ..., symmetric to the last bit; 0 of a point
        on itself.

        Orders are eliminated one after another, so that all of this costs no more than the last.
        """
        n, grips, found = self.ports, np.concatenate([*self.grips, *self.tilts]), list[ComplexArray]()
        free = np.setdiff1d(np.arange(n, self.order.size), grips)
        last_first = free[np.argsort(-self.order[free], kind="stable")]
        a = a[:, (places := np.concatenate([np.arange(n), grips, last_first]))[:, None], places]
        for order in range(int(self.order.max()) + 1):
            a = _without_last(a, n + grips.size + int(np.sum(self.order[free] > order)))
            held = n + np.flatnonzero(self.order[grips] <= order)
            found.append(self._alone(eliminated(a, np.arange(n), held)))
        return self._alone(a), found

    def lacking(
        self,
        a: ComplexArray,
        by_order: Sequence[ComplexArray],
        kinds: Sequence[BoolArray],
        decay: FloatArray,
    ) -> FloatArray:
        """Truncation error (n_freq,) of C, ``by_order`` of :meth:`by_order`, by the tractions that A leaves out.

        It is relative to the largest entry of each of the ``kinds`` (ports, ports) of entries, for the worst of them.
        ``decay`` (n_freq,) is the largest ratio of what one azimuthal order scatters to what the one before does."""
        whole, top = by_order[-1], len(by_order) - 1
        if self.order.size == self.ports:
            return np.zeros(len(a))
        axial = self.order == 0
        lacking = self.terms / 2 * changed(whole, self._without(a, axial & (self.last == 0)), kinds)
        if top == 0:  # exact of a disc alone; with neighbours nothing tells what leaving out their waves costs
            return lacking if self.ports == 1 else np.full(len(a), np.nan)
        first = self.order == 1  # the longest of these series: its last two terms show how fast they fall
        less, least = (self._without(a, first & (self.last < n)) for n in (1, 2))
        fall = changed(whole, less, kinds) / np.maximum(changed(less, least, kinds), 1e-300)
        step = changed(whole, self._without(a, ~axial & (self.last == 0)), kinds)
        fall = np.clip(2 * fall / np.maximum(1 - fall, 1e-3), _LEAST_LEFT, self.terms / 2)
        lacking = lacking + fall * step
        step = changed(whole, by_order[-2], kinds)
        if top == 1:
            return lacking + step
        steps = [step, *(changed(by_order[-i], by_order[-i - 1], kinds) for i in range(2, min(top, 3) + 1))]
        falls = [later / np.maximum(earlier, 1e-300) for later, earlier in pairwise(steps)]
        decay = np.minimum(decay, np.max(falls, axis=0))
        return np.asarray(lacking + np.hypot(step, decay * steps[1]) / np.sqrt(2) * decay / (1 - decay))

    def _without(self, a: ComplexArray, left_out: BoolArray) -> ComplexArray:
        """C from A without the tractions ``left_out`` (n,)."""
        kept = np.flatnonzero(~left_out)
        return self._alone(eliminated(a, np.arange(self.ports), kept[kept >= self.ports]))

    def free_compliance(self, shown: ComplexArray) -> ComplexArray:
        r"""C of rigid discs let go, from the first of :meth:`by_order`: after the ports, the net forces of bonded ones
        along x, then those along y, then moments of all: of forces along z times x, then times y.

        A force along x is :math:`t_+=t_-=-1`, along y :math:`t_\pm=\mp i`: tractions have z into the body, where ports
        are positive outward, so that x and y turn round instead. A moment along x is :math:`t_z=3/2a` of both orders,
        along y :math:`\mp 3i/2a`. Holding them again by :math:`C_{zz}-C_{zt}C_{tt}^{-1}C_{tz}` gives the last of
        :meth:`by_order`.
        """
        one, tilt = np.eye(self.grips.shape[1]), np.diag(1.5 / self.radii)
        sideways = -np.block([[one, 1j * one], [one, -1j * one]])
        turned = block_diag(np.eye(self.ports), sideways, np.block([[tilt, -1j * tilt], [tilt, 1j * tilt]]))
        return np.asarray(turned.T @ shown @ turned)

    def kinds(self) -> tuple[BoolArray, ...]:
        """Entries (ports, ports) between discs, and those between a disc and a point, where there are such."""
        point = np.zeros(self.ports, dtype=bool)
        point[self.points] = True
        both = (~point[:, None] & ~point, point[:, None] ^ point)
        return tuple(kind for kind in both if kind.any())

    def _alone(self, values: ComplexArray) -> ComplexArray:
        """The same with 0 of a point on itself."""
        values[:, self.points, self.points] = 0
        return values


def eliminated(a: ComplexArray, shown: IntArray, hidden: IntArray) -> ComplexArray:
    """A_ss - A_sh A_hh^-1 A_hs (n_freq, n, n) of a symmetric A, symmetric to the last bit: what ``shown`` places see
    where ``hidden`` ones are held, or are as no work is done on them."""
    places = np.concatenate([shown, hidden])
    return _without_last(a[:, places[:, None], places], shown.size)


def _without_last(a: ComplexArray, shown: int) -> ComplexArray:
    """The same where the first so many places of ``a`` are ``shown``; ``a`` is used up."""
    whole = a[:, :shown, :shown]
    if shown < a.shape[1]:
        for part in (a[start : start + _AT_ONCE] for start in range(0, len(a), _AT_ONCE)):
            coupling = part[:, shown:, :shown]
            scattered = coupling.swapaxes(1, 2) @ np.linalg.solve(part[:, shown:, shown:], coupling)
            part[:, :shown, :shown] -= 0.5 * (scattered + scattered.swapaxes(1, 2))
    return whole


def changed(more: ComplexArray, less: ComplexArray, kinds: Sequence[BoolArray]) -> FloatArray:
    """Largest change over the largest value, per frequency (n_freq,), of the kind of entries where that is most."""
    each = [np.abs(more - less)[:, kind].max(axis=1) / np.abs(more)[:, kind].max(axis=1) for kind in kinds]
    return np.asarray(np.max(each, axis=0))


def decay_of(discs: Sequence[Disc], waves: FloatArray, orders: int) -> FloatArray:
    """Ratio (n_freq,) by which what azimuthal orders above ``orders`` scatter falls, at wavenumbers ``waves`` [1/m].

    A field from a distance d is about a disc of radius a a series in (a/d)^l, where waves are short in J_l(ka), whose
    ratio is below ka/(2 l + 2).
    """
    ratio = np.zeros(len(waves))
    for disc in (disc for disc in discs if disc.rigid):
        away = (math.hypot(disc.x - b.x, disc.y - b.y) for b in discs if b is not disc and b.radius > 0)
        nearest = disc.radius / min(away, default=math.inf)
        ratio = np.maximum(ratio, np.maximum(nearest, disc.radius * waves / (2 * orders + 2)))
    return np.minimum(ratio, 0.9)


def galerkin(
    discs: Sequence[Disc], surface: Surface, terms: int, orders: int, *, silent: Collection[int] = ()
) -> Galerkin:
    """The system of ``discs`` (points among them), no two the same, points under rigid discs left out.

    Nothing between two of the ``silent`` ones is in it, points and pressed discs that do not drive: two points that
    nearly meet ask for the shortest waves of all.
    """
    tractions, owner = [port_traction(disc) for disc in discs], list(range(len(discs)))
    for i, disc in enumerate(discs):
        inner = inner_tractions(disc, surface, terms, orders) if disc.rigid else []
        tractions += inner
        owner += [i] * len(inner)
    where = np.array([(disc.x, disc.y) for disc in discs])[owner]
    carrying = {(owner[i], t.component): i for i, t in enumerate(tractions)
                if t.m == 0 and t.radial.degree == 0 and t.radial.kind not in ("ring", "point")}  # fmt: skip
    rings = [(i, carrying[owner[i], t.component]) for i, t in enumerate(tractions)
             if t.radial.kind == "ring" and t.m == 0]  # fmt: skip
    grips = [[carrying[i, sign] for sign in ("+", "-")] for i, disc in enumerate(discs)
             if disc.rigid and (i, "+") in carrying]  # fmt: skip
    tilting = {(owner[i], t.m): i for i, t in enumerate(tractions)
               if t.component == "z" and abs(t.m) == 1 and t.radial == Radial("ball", t.radial.radius, 1)}  # fmt: skip
    tilts = [[tilting[i, m] for m in (1, -1)] for i in range(len(discs)) if (i, 1) in tilting]
    moments = [(i, tilting[owner[i], t.m]) for i, t in enumerate(tractions)
               if t.radial.kind == "ring" and t.component == "z" and abs(t.m) == 1]  # fmt: skip
    table, place, column, factor = _pairs(tractions, where, np.isin(np.arange(len(tractions)), [*silent]))
    last, order = np.array([(t.last, t.order) for t in tractions], dtype=int).T
    points = np.flatnonzero([disc.radius == 0 for disc in discs])
    radii = np.array([discs[owner[i]].radius for i, _ in tilts])
    ring, grip, tilt, moment = (np.array(found, dtype=int).reshape(-1, 2).T for found in (rings, grips, tilts, moments))
    return Galerkin(table, place, column, factor, len(discs), points, terms, last, order, radii, ring,
                    grip, tilt, moment, tuple(tractions), tuple(owner))  # fmt: skip


def _pairs(
    tractions: Sequence[Traction], where: FloatArray, silent: BoolArray
) -> tuple[HankelTable, IntArray, IntArray, ComplexArray]:
    """Table, and place, column and factor of each pair i <= j with a non-zero entry."""
    radials = tuple(sorted({t.radial for t in tractions}))
    number = {g: i for i, g in enumerate(radials)}
    g = np.array([number[t.radial] for t in tractions])
    m = np.array([t.m for t in tractions])
    c = np.array([_NAMES.index(t.component) for t in tractions])
    number_of, factors, shifts = (np.array([[_PAIRS[a, b][i] for b in _NAMES] for a in _NAMES]) for i in range(3))
    i, j = np.triu_indices(len(tractions))
    across = (where[i] - where[j]).round(12)
    distance, angle = np.hypot(*across.T).round(12), np.arctan2(across[:, 1], across[:, 0])
    q = -(m[i] + m[j] + np.real(shifts[c[i], c[j]]).astype(int))
    points = np.array([r.kind == "point" for r in radials])
    left_out = (points[g[i]] & points[g[j]] & (distance == 0)) | (silent[i] & silent[j])
    kept = ((distance > 0) | (q == 0)) & ~left_out
    i, j, q, distance, angle = i[kept], j[kept], q[kept], distance[kept], angle[kept]
    phase = (-1j) ** (np.abs(m[i]) + np.abs(m[j])) * (-1.0) ** m[i] * 1j ** np.abs(q) * np.exp(-1j * q * angle)
    kernel = np.real(number_of[c[i], c[j]]).astype(int)
    pair = np.sort([g[i], g[j]], axis=0)
    lengths, length = np.unique(distance, return_inverse=True)
    keys = np.stack([kernel, pair[0], pair[1], np.abs(q), length])
    sizes = tuple((keys.max(axis=1, initial=0) + 1).tolist())
    unique, column = np.unique(np.ravel_multi_index(tuple(keys), sizes), return_inverse=True)
    kernels, first, second, order, at = np.unravel_index(unique, sizes)
    table = HankelTable(radials, kernels, first, second, order, lengths[at])
    return table, np.stack([i, j]), column.ravel(), phase * factors[c[i], c[j]]
