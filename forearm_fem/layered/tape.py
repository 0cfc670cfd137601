"""Tape on a rectangle of the surface: smooth motion of a sheet with edges, held to the skin by Galerkin's method."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import pairwise
from types import MappingProxyType
from typing import Self

import numpy as np
from numpy.polynomial import legendre

from ..typing import ComplexArray, FloatArray, IntArray
from .discs import Component, Disc, Galerkin, Traction
from .hankel import Radial, bessels, transforms
from .integrals import Medium, product
from .kernel import surface_compliance

# The sheet moves as products of Legendre polynomials P along x and y, the skin pulls at it by tractions
# :math:`T_p(x/a)T_q(y/b)/(\pi^2\sqrt{a^2-x^2}\sqrt{b^2-y^2})` along x, y and z, singular at the edges as under a stiff
# one, with the transforms :math:`(-i)^{p+q}J_p(k_xa)J_q(k_yb)`. With B the work of tractions on polynomials, K the
# sheet's dynamic stiffness, :math:`\kappa=B^{-T}KB^{-1}`, C the skin's compliance between tractions and H that from
# tractions under contacts to these,
# .. math:: A'=A-HYH^T,\quad Y=\kappa(1+C\kappa)^{-1}
# takes the place of A in :mod:`.discs`: contacts and sheet scatter each other's waves, and without stiffness and mass A
# is what it was. A point on the sheet moves as bare skin, less the polynomial whose work is that of what Y changes.
# What polynomials cannot follow of bare skin's motion there, the sheet lets through as it does the shortest that they
# can.
# Integrals over directions depend on places alone and are kept; over k the kernel is interpolated on panels, as in
# :mod:`.integrals`. Parity in x and in y parts C in four. Contacts may stand on the sheet.

_COUNTS = (14, 18, 22)  # polynomials along each side: least, of integrals that are kept, most
FEWER = 2  # polynomials less show what is left out
_BEYOND = 6  # polynomials more than resolve the shortest waves: pi for each along the longer side
_FIRST, _RATIO = 8.0, 0.2  # [1/m] first panel, others' width over k
_END = 1.6  # k times half the shorter side where panels end, over count^2: products of polynomials fall from there
_NODES = 10  # of a panel
_X, _W = legendre.leggauss(_NODES)
Parity = tuple[int, int]
_SECTORS: tuple[Parity, ...] = ((0, 0), (1, 0), (0, 1), (1, 1))  # of motion along z in x and in y


@dataclass(frozen=True)
class Sheet:
    """A free sheet of ``length`` along x and ``width`` along y about the origin [m], with the terms of
    :class:`~.kernel.Surface` and ``bending`` [N m], of an incompressible material."""

    length: float
    width: float
    mass: float = 0.0
    membrane: float = 0.0
    viscosity: float = 0.0
    bending: float = 0.0

    def covers(self, x: float, y: float) -> bool:
        """True where a point lies on it."""
        return abs(x) <= self.length / 2 and abs(y) <= self.width / 2


def _components(sector: Parity) -> tuple[Parity, Parity, Parity]:
    """Parities of motion along x, y and z in a sector."""
    sx, sy = sector
    return (1 - sx, sy), (sx, 1 - sy), sector


@lru_cache(maxsize=64)
def _degrees(parity: Parity, count: int) -> tuple[IntArray, IntArray]:
    """Degrees p and q below ``count`` of one parity along x and y; those below fewer come first."""
    p, q = np.meshgrid(np.arange(parity[0], count, 2), np.arange(parity[1], count, 2), indexing="ij")
    order = np.argsort((np.maximum(p, q) // 2).ravel(), kind="stable")
    return p.ravel()[order], q.ravel()[order]


def _size(parity: Parity, count: int) -> int:
    """How many these are."""
    return len(_degrees(parity, count)[0])


# What lies between two components of the skin's motion: the power of cos and sin of the wave's direction
_BETWEEN: Mapping[str, Callable[[FloatArray, FloatArray], FloatArray]] = MappingProxyType(
    {
        "1": lambda c, s: np.ones_like(c), "cos 2": lambda c, s: c * c - s * s, "sin 2": lambda c, s: 2 * s * c,
        "cos": lambda c, s: c, "sin": lambda c, s: s,
    }
)  # fmt: skip
Key = tuple[Parity, Parity, str]


@lru_cache(maxsize=4)
def _panels(half: float, count: int) -> tuple[tuple[float, float], ...]:
    """For ``count`` polynomials over a side of twice ``half`` [m]."""
    edges = [0.0, _FIRST]
    while edges[-1] < _END * count**2 / half:
        edges.append(edges[-1] + max(_RATIO * edges[-1], _FIRST))
    return tuple(pairwise(edges))


@lru_cache(maxsize=4)
def _nodes(half: float, count: int) -> FloatArray:
    """k (n,) [1/m] of all panels."""
    return np.concatenate([0.5 * (lo + hi) + 0.5 * (hi - lo) * _X for lo, hi in _panels(half, count)])


@dataclass(frozen=True, eq=False)
class _Rays:
    """A panel's dense nodes ``k`` (n,), what they give to the panel's own (nodes, n), directions ``phi`` (m,) of the
    first quadrant, the rule's ``step`` [rad], and transforms (n, m, functions) of tractions by parity."""

    k: FloatArray
    share: FloatArray
    phi: FloatArray
    step: float
    shapes: Mapping[Parity, FloatArray]


def _rays(panel: tuple[float, float], a: float, b: float, count: int, extent: float, orders: int) -> _Rays:
    """Enough for integrands that oscillate over ``extent`` [m], and e^{i orders phi}."""
    lo, hi = panel
    x, w = legendre.leggauss(_NODES + math.ceil(0.5 * (hi - lo) * extent) + 8)
    k = 0.5 * (lo + hi) + 0.5 * (hi - lo) * x
    to = (np.arange(_NODES)[:, None] + 0.5) * legendre.legvander(_X, _NODES - 1).T * _W
    share = np.asarray((legendre.legvander(x, _NODES - 1) @ to).T * (0.5 * (hi - lo) * w))
    n = math.ceil((hi * extent + 2 * count + orders + 20) / 4) + 4  # midpoint rule: exact beyond the highest rate
    phi = np.asarray((np.arange(n) + 0.5) * (0.5 * np.pi / n), dtype=float)
    along, across = (
        np.array(bessels(count - 1, np.multiply.outer(k, side))) for side in (a * np.cos(phi), b * np.sin(phi))
    )
    degrees = {parity: _degrees(parity, count) for parity in _SECTORS}
    shapes = {parity: np.asarray(np.moveaxis(along[p] * across[q], 0, 2).real) for parity, (p, q) in degrees.items()}
    return _Rays(k, share, phi, 0.5 * np.pi / n / (4 * np.pi**2), shapes)


@lru_cache(maxsize=len(_COUNTS))  # 70 MB of 14 polynomials, 500 MB of 22
def _under(a: float, b: float, count: int) -> Mapping[Key, FloatArray]:
    """Weights (nodes of all panels, f, f) of kernels k U for the skin's compliance between tractions, in single
    precision; the last of them is that of its limit beyond, where integrands fall as (c log k + d)/k^2 but for
    oscillations: from two octaves."""
    keys = dict.fromkeys(key for sector in _SECTORS for key in _keys(sector))
    parts: dict[Key, list[FloatArray]] = {key: [] for key in keys}
    panels = _panels(min(a, b), count)
    for panel in panels:
        rays = _rays(panel, a, b, count, 2 * math.hypot(a, b), 0)
        c, s = np.cos(rays.phi), np.sin(rays.phi)
        shapes = {parity: shape.astype(np.float32) for parity, shape in rays.shapes.items()}
        for key, found in parts.items():
            one, other, kind = key
            (p, q), (r, t) = _degrees(one, count), _degrees(other, count)
            # of the conjugate i^(p + q), of the other (-i)^(r + t), and i between z and x or y
            turns = (p + q)[:, None] - (r + t)[None] + (kind in ("cos", "sin"))
            weighted = shapes[one] * _BETWEEN[kind](c, s)[:, None].astype(np.float32)
            each = np.matmul(weighted.swapaxes(1, 2), shapes[other])
            sign = np.real(1j ** (turns % 4))
            found.append(np.tensordot(rays.share, each, axes=1) * (4 * rays.step * sign))
    top = np.array([hi for _, hi in panels])
    end, low = top[-1], [int(np.argmin(np.abs(top - top[-1] * share))) for share in (0.25, 0.5)]
    ends = [top[low[0]], top[low[1]], end]
    solved = np.linalg.inv([[_beyond(lo, power) - _beyond(hi, power) for power in (1, 0)]
                            for lo, hi in pairwise(ends)])  # fmt: skip
    whole: dict[Key, FloatArray] = {}
    for key, found in parts.items():
        octaves = [np.sum(found[i + 1 : j + 1], axis=(0, 1)) for i, j in zip(low, (low[1], len(top) - 1), strict=True)]
        c, d = np.tensordot(solved, np.array(octaves), axes=1)
        limit = c * _beyond(end, 1) + d * _beyond(end, 0)
        whole[key] = np.concatenate([*found, limit[None]], dtype=np.float32)
    return MappingProxyType(whole)


def _beyond(k: float, power: int) -> float:
    """Integral of log(k)^power / k^2 from k on."""
    return (1 + math.log(k)) / k if power else 1 / k


def _keys(sector: Parity) -> tuple[Key, ...]:
    """Those of xx, yy, xy, zz, zx and zy of a sector; the first two have two."""
    x, y, z = _components(sector)
    return ((x, x, "1"), (x, x, "cos 2"), (y, y, "1"), (y, y, "cos 2"), (x, y, "sin 2"), (z, z, "1"), (z, x, "cos"),
            (z, y, "sin"))  # fmt: skip


@lru_cache(maxsize=32)
def _towards(
    a: float, b: float, count: int, x: float, y: float, orders: int
) -> Mapping[tuple[int, Parity], ComplexArray]:
    """Weights (nodes of all panels, f) of k U g for order m of a contact at (x, y), x, y >= 0, by m and parity."""
    found: dict[tuple[int, Parity], list[ComplexArray]] = {}
    for panel in _panels(min(a, b), count):
        rays = _rays(panel, a, b, count, math.hypot(x + a, y + b), orders)
        kx = np.multiply.outer(rays.k, x * np.cos(rays.phi))
        ky = np.multiply.outer(rays.k, y * np.sin(rays.phi))
        outward, mirrored = np.exp(1j * (kx + ky)), np.exp(1j * (ky - kx))
        images = ((rays.phi, (1, 1), outward), (np.pi - rays.phi, (-1, 1), mirrored),
                  (-rays.phi, (1, -1), mirrored.conj()), (np.pi + rays.phi, (-1, -1), outward.conj()))  # fmt: skip
        for parity, shape in rays.shapes.items():
            p, q = _degrees(parity, count)
            phase = (-1j) ** (p + q) * rays.step
            waves = [sum(sx ** parity[0] * sy ** parity[1] * np.exp(1j * m * turned) * e
                         for turned, (sx, sy), e in images) for m in range(-orders, orders + 1)]  # fmt: skip
            both = np.matmul(np.stack([*np.real(waves), *np.imag(waves)], axis=1), shape)
            each = both[:, : len(waves)] + 1j * both[:, len(waves) :]
            for m, one in zip(range(-orders, orders + 1), np.moveaxis(each, 1, 0), strict=True):
                found.setdefault((m, parity), []).append((rays.share @ one) * phase)
    return MappingProxyType({key: np.concatenate(parts) for key, parts in found.items()})


@lru_cache(maxsize=8)
def _along(half: float, count: int) -> Mapping[str, FloatArray]:
    """Integrals (n, n) over |x| <= half of products of two polynomials, by the orders of their derivatives, and "B",
    the work of tractions on polynomials."""
    x, w = legendre.leggauss(count)
    derived = [np.array([legendre.legval(x, legendre.legder(c, d) if d else c) for c in np.eye(count)]) / half**d
               for d in range(3)]  # fmt: skip
    out = {f"{i}{j}": (derived[i] * (w * half)) @ derived[j].T for i in range(3) for j in range(3)}
    t = (np.arange(2 * count) + 0.5) * np.pi / (2 * count)
    work = np.cos(np.multiply.outer(np.arange(count), t)) @ legendre.legvander(np.cos(t), count - 1)
    return MappingProxyType(out | {"B": work / (2 * count)})


@lru_cache(maxsize=16)
def _stiffness(a: float, b: float, count: int, sector: Parity) -> tuple[tuple[FloatArray, ...], FloatArray]:
    """The stiffness kappa of a sector per membrane [N/m] and mass [kg/m^2] along the skin, per bending [N m] and mass
    along z, which have nothing to do with each other; and B^-1 (f, f)."""
    along, across = _along(a, count), _along(b, count)
    sides = [_degrees(parity, count) for parity in _components(sector)]
    at = np.cumsum([0, *(len(p) for p, _ in sides)])
    membrane, bending, mass, work = (np.zeros((at[-1], at[-1])) for _ in range(4))

    def block(i: int, j: int, x: str, y: str) -> FloatArray:
        """Integrals between components i and j, by the orders of derivatives along x and y."""
        (p, q), (r, t) = sides[i], sides[j]
        return along[x][p[:, None], r] * across[y][q[:, None], t]

    own = [slice(at[i], at[i + 1]) for i in range(3)]
    # (1 - nu) e:e + nu (tr e)^2 of in-plane strain, the same of curvature; nu = 1/2
    membrane[own[0], own[0]] = block(0, 0, "11", "00") + 0.25 * block(0, 0, "00", "11")
    membrane[own[1], own[1]] = block(1, 1, "00", "11") + 0.25 * block(1, 1, "11", "00")
    membrane[own[0], own[1]] = 0.5 * block(0, 1, "10", "01") + 0.25 * block(0, 1, "01", "10")
    membrane[own[1], own[0]] = membrane[own[0], own[1]].T
    both = block(2, 2, "20", "02")
    bending[own[2], own[2]] = block(2, 2, "22", "00") + block(2, 2, "00", "22") + block(2, 2, "11", "11")
    bending[own[2], own[2]] += 0.5 * (both + both.T)
    for i, mine in enumerate(own):
        mass[mine, mine], work[mine, mine] = block(i, i, "00", "00"), block(i, i, "B", "B")
    inverse = np.linalg.inv(work)
    flat, upright = slice(at[2]), slice(at[2], None)
    parts = (membrane, flat), (mass, flat), (bending, upright), (mass, upright)
    return tuple(inverse[part, part].T @ m[part, part] @ inverse[part, part] for m, part in parts), inverse


def degrees_of(sheet: Sheet, medium: Medium, omega: FloatArray) -> int:
    """Polynomials along each side: as resolve the waves that bend skin and sheet most at the highest frequency, and a
    few more, of which each two leave out a half to an eighth of what those before did."""
    k, top = np.linspace(_FIRST, 2 * _COUNTS[-1] / min(sheet.length, sheet.width), 200), omega.max(keepdims=True)
    u = surface_compliance(k[None], top[:, None], medium.layers, medium.base, medium.surface)
    held = (u.zz - u.zx**2 / u.xx)[0]  # nothing moves along the skin
    moved = np.abs(held / (1 + held * (sheet.bending * k**4 - top**2 * sheet.mass)))
    waves = float(k[np.argmax(moved)]) * max(sheet.length, sheet.width) / 2
    return min(max(2 * math.ceil((waves + _BEYOND) / 2), _COUNTS[0]), _COUNTS[-1])


def _times(kappas: Sequence[FloatArray | ComplexArray], m: ComplexArray) -> ComplexArray:
    """kappa @ m, of which ``kappas`` are the blocks on the diagonal, without a complex copy of real ones."""
    out, start = np.empty_like(m), 0
    for kappa in kappas:
        own = slice(start, start := start + kappa.shape[-1])
        part = m[:, own]
        out[:, own] = kappa @ part if np.iscomplexobj(kappa) else kappa @ part.real + 1j * (kappa @ part.imag)
    return out


@dataclass(frozen=True, eq=False)
class Tape:
    """A ``sheet`` on a ``medium`` with the tractions of a ``system`` of ``discs``."""

    sheet: Sheet
    medium: Medium
    system: Galerkin
    discs: Sequence[Disc]
    count: int
    top: int

    @classmethod
    def of(cls, sheet: Sheet, medium: Medium, system: Galerkin, discs: Sequence[Disc], omega: FloatArray) -> Self:
        """With as many polynomials as the waves of ``omega`` ask for."""
        count = degrees_of(sheet, medium, omega)
        return cls(sheet, medium, system, discs, count, min(top for top in _COUNTS if top >= count))

    @property
    def _halves(self) -> tuple[float, float]:
        return self.sheet.length / 2, self.sheet.width / 2

    @cached_property
    def _riding(self) -> IntArray:
        """Points on the sheet."""
        points = self.system.points
        return points[[self.sheet.covers(self.discs[i].x, self.discs[i].y) for i in points]]

    @cached_property
    def _others(self) -> IntArray:
        """All other tractions."""
        return np.setdiff1d(np.arange(self.system.order.size), self._riding)

    def applied(self, bare: ComplexArray, omega: FloatArray) -> ComplexArray:
        """A' (n_freq, n, n) from A of ``bare`` skin."""
        out, others, riding = bare.copy(), self._others, self._riding
        k = _nodes(min(self._halves), self.top)
        u = surface_compliance(k[None], omega[:, None], self.medium.layers, self.medium.base, self.medium.surface)
        kernels = [k * each for each in (u.zz, u.zx, 0.5 * (u.xx + u.yy), 0.5 * (u.xx - u.yy))]
        rows = self._rows(kernels)
        kernels = [np.concatenate([each, limit[:, None]], axis=1).astype(np.complex64)
                   for each, limit in zip(kernels, self.medium.limits(omega), strict=True)]  # fmt: skip
        known: dict[tuple[int, Key], ComplexArray] = {}
        cores, images, left = [], self._images, self._left(omega)
        out[:, riding[:, None], others] *= left[:, :, None]
        loss, inertia = self.sheet.viscosity, omega**2 * self.sheet.mass
        in_plane = self.sheet.membrane + 1j * omega * loss if loss else np.full(omega.size, self.sheet.membrane)
        for sector in _SECTORS:
            (membrane, along, bending, upright), inverse = _stiffness(*self._halves, self.count, sector)
            kappas = (np.multiply.outer(in_plane, membrane) - np.multiply.outer(inertia, along),
                      self.sheet.bending * bending - np.multiply.outer(inertia, upright))  # fmt: skip
            c, h = self._skin(kernels, sector, known), rows[sector]
            resisted, loaded = (_times(kappas, m) for m in (c, h.swapaxes(1, 2)))
            every = np.arange(c.shape[1])
            resisted[:, every, every] += 1
            held = np.linalg.solve(resisted, loaded)  # Y H^T, Y symmetric
            cores.append(h @ held)
            if riding.size:
                to, free = self._moved(sector) @ inverse, h.swapaxes(1, 2)
                moved = ((1 - left[:, :, None]) * to) @ free - to @ (c @ held)
                out[:, riding[:, None], others] += moved[:, :, images.number] * images.sign(sector)
        out[:, others[:, None], riding] = out[:, riding[:, None], others].swapaxes(1, 2)
        out[:, others[:, None], others] -= images.spread(np.array(cores))
        return 0.5 * (out + out.swapaxes(1, 2))

    def _skin(
        self, kernels: Sequence[ComplexArray], sector: Parity, known: dict[tuple[int, Key], ComplexArray]
    ) -> ComplexArray:
        """C (n_freq, f, f) of a sector: half sum and half difference along and across waves meet in x and y."""
        weights = _under(*self._halves, self.top)

        def of(kernel: int, key: Key) -> ComplexArray:
            """Integral of a kernel with the weights of ``key``."""
            if (kernel, key) not in known:  # along x in one sector is along y in another
                each = weights[key][:, : _size(key[0], self.count), : _size(key[1], self.count)]
                found = product(kernels[kernel], each.reshape(len(each), -1))
                known[kernel, key] = found.reshape(-1, *each.shape[1:]).astype(complex)
            return known[kernel, key]

        def turned(m: ComplexArray) -> ComplexArray:
            """Transpose at each frequency."""
            return m.swapaxes(1, 2)

        x, x2, y, y2, both, z, zx, zy = _keys(sector)
        xx, yy, xy = of(2, x) + of(3, x2), of(2, y) - of(3, y2), of(3, both)
        along, across = of(1, zx), of(1, zy)
        return np.asarray(
            np.block([[xx, xy, turned(along)], [turned(xy), yy, turned(across)], [along, across, of(0, z)]])
        )

    def _left(self, omega: FloatArray) -> ComplexArray:
        """Share (n_freq, n_point) that the sheet leaves of what polynomials cannot follow of the points' motion: of a
        wave as short as they can."""
        k, sheet = self.count / max(self._halves), self.sheet
        medium = self.medium
        u = surface_compliance(np.array([[k]]), omega[:, None], medium.layers, medium.base, medium.surface)
        inertia = omega**2 * sheet.mass
        upright = 1 / (1 + u.zz[:, 0] * (sheet.bending * k**4 - inertia))
        along = 1 / (1 + u.xx[:, 0] * ((sheet.membrane + 1j * omega * sheet.viscosity) * k**2 - inertia))
        each = [upright if self.discs[i].component == "z" else along for i in self._riding]
        return np.array(each, dtype=complex).reshape(-1, omega.size).T

    def _moved(self, sector: Parity) -> ComplexArray:
        """Motion (n_point, f) of the points on the sheet by its polynomials."""
        rows = []
        for disc in (self.discs[i] for i in self._riding):
            shares = {"z": (0, 0, 1), "+": (0.5, -0.5j, 0), "-": (0.5, 0.5j, 0)}[disc.component]
            x, y = (legendre.legvander(np.array([v / half]), self.count - 1)[0]
                    for v, half in zip((disc.x, disc.y), self._halves, strict=True))  # fmt: skip
            sides = [_degrees(parity, self.count) for parity in _components(sector)]
            rows.append(np.concatenate([part * x[p] * y[q] for part, (p, q) in zip(shares, sides, strict=True)]))
        return np.array(rows, dtype=complex)

    @cached_property
    def _images(self) -> _Images:
        """Mirror images of :attr:`_others` in the first quadrant."""
        return _Images.of([(self.system.tractions[i], self.discs[self.system.owner[i]]) for i in self._others])

    def _rows(self, kernels: Sequence[ComplexArray]) -> dict[Parity, ComplexArray]:
        """H (n_freq, images, f) of each sector, rings freed of their net force and moment, as in A."""
        images, known = self._images, dict[tuple[int, Radial, float, float, int, Parity], ComplexArray]()
        radials = tuple(dict.fromkeys(t.radial for t, _, _ in images.distinct))
        transform = dict(zip(radials, transforms(radials, _nodes(min(self._halves), self.top)).T, strict=True))
        orders = max(abs(t.m) for t, _, _ in images.distinct) + 2

        seen: dict[tuple[int, Radial], ComplexArray] = {}

        def each(kernel: int, m: int, traction: Traction, x: float, y: float, parity: Parity) -> ComplexArray:
            """Work on the tractions under the tape (n_freq, f), of order m in all."""
            key = kernel, traction.radial, x, y, m, parity
            if key not in known:
                if key[:2] not in seen:
                    seen[key[:2]] = kernels[kernel] * transform[traction.radial]
                weights = _towards(*self._halves, self.top, x, y, orders)[m, parity]
                known[key] = seen[key[:2]] @ weights[:, : _size(parity, self.count)]
            return known[key]

        place = {int(i): number for i, number in zip(self._others, images.number.tolist(), strict=True)}
        freed = {(place[ring], place[ball], share) for pairs, share in self.system.moved
                 for ring, ball in pairs.T.tolist()}  # fmt: skip
        out = {}
        for sector in _SECTORS:
            rows = []
            for t, px, py in images.distinct:
                one = partial(each, traction=t, x=px, y=py)
                rows.append(np.concatenate(_work(t, one, *_components(sector)), axis=1))
            h = np.stack(rows, axis=1)
            for ring, ball, share in freed:
                h[:, ring] -= share * h[:, ball]
            out[sector] = h
        return out


def _work(
    t: Traction, each: Callable[..., ComplexArray], x: Parity, y: Parity, z: Parity
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Of a traction on those along x, y and z: t_x is t_+ and t_-, t_y is i t_+ and -i t_-."""

    def both(parity: Parity) -> tuple[ComplexArray, ComplexArray]:
        """On t_+ and on t_-."""
        match t.component:
            case "z":
                return 0.5j * each(1, t.m - 1, parity=parity), 0.5j * each(1, t.m + 1, parity=parity)
            case "+":
                return 0.5 * each(3, t.m - 2, parity=parity), 0.5 * each(2, t.m, parity=parity)
            case _:
                return 0.5 * each(2, t.m, parity=parity), 0.5 * each(3, t.m + 2, parity=parity)

    (plus, minus), (left, right) = both(x), both(y)
    kernel, m, factor = {"z": (0, t.m, 1.0), "+": (1, t.m - 1, -0.5j), "-": (1, t.m + 1, -0.5j)}[t.component]
    phase = (-1j) ** abs(t.m) * (-1.0) ** t.m
    return phase * (plus + minus), phase * 1j * (left - right), phase * factor * each(kernel, m, parity=z)


@dataclass(frozen=True, eq=False)
class _Images:
    """The ``distinct`` mirror images of tractions in the first quadrant, with their places, and of each traction the
    ``number`` among them; in sectors odd in x or in y its work has the sign of ``odd`` (3, n): of neither, x, y."""

    distinct: tuple[tuple[Traction, float, float], ...]
    number: IntArray
    odd: FloatArray

    @classmethod
    def of(cls, own: Sequence[tuple[Traction, Disc]]) -> Self:
        """A mirror in x turns order m into -m and t_+ into t_- with the sign of m, that of t_+ and t_- the other way;
        one in y without these."""
        found: dict[tuple[Traction, float, float], int] = {}
        number, odd = [], []
        for t, disc in own:
            image, sign = t, 1.0
            for mirrored, in_x in ((disc.x < 0, True), (disc.y < 0, False)):
                if mirrored:
                    sign *= (-1.0) ** image.m * (1.0 if image.component == "z" else -1.0) if in_x else 1.0
                    swapped: Component = {"z": "z", "+": "-", "-": "+"}[image.component]  # type: ignore[assignment]
                    image = replace(image, m=-image.m, component=swapped)
            key = image, round(abs(disc.x), 9), round(abs(disc.y), 9)
            number.append(found.setdefault(key, len(found)))
            odd.append([sign, -1.0 if disc.x < 0 else 1.0, -1.0 if disc.y < 0 else 1.0])
        return cls(tuple(found), np.array(number), np.array(odd).T)

    def spread(self, cores: ComplexArray) -> ComplexArray:
        """Of the images' work in each sector (4, n_freq, images, images) that of all (n_freq, n, n): places that two
        tractions have relative to each other tell how sectors add up."""
        x, y = self.odd[1] < 0, self.odd[2] < 0
        relative = (x[:, None] ^ x) + 2 * (y[:, None] ^ y)
        signs = np.array([[(-1.0) ** (sx * (g % 2) + sy * (g // 2)) for sx, sy in _SECTORS] for g in range(4)])
        count = len(self.distinct)
        summed = np.moveaxis(np.tensordot(signs, cores, axes=1), 0, 1).reshape(cores.shape[1], -1)
        at = (relative * count + self.number[:, None]) * count + self.number
        found = np.take(summed, at.ravel(), axis=1).reshape(-1, *at.shape)
        return np.asarray(found * np.multiply.outer(self.odd[0], self.odd[0]))

    def sign(self, sector: Parity) -> FloatArray:
        """Of each traction's work in a sector, relative to its image's (n,)."""
        return np.asarray(self.odd[0] * self.odd[1] ** sector[0] * self.odd[2] ** sector[1])
