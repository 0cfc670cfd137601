"""Hankel integrals of the surface compliance of a layered medium, refined until every frequency is converged."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.polynomial import legendre

from ..errors import SolverError
from ..typing import BoolArray, ComplexArray, FloatArray, IntArray
from .hankel import HankelTable, Numbers, window
from .kernel import (
    Base,
    Layer,
    Surface,
    SurfaceCompliance,
    compliance_limits,
    shear_modulus,
    surface_compliance,
    surface_kernel,
    wavenumbers,
)

# Product integration of a smooth kernel against oscillating Bessel weights.
# :math:`\int f(k)\,B(k)\,dk` with :math:`B = \frac1{2\pi}g_a(k)g_b(k)J_q(kd)` for many columns at once: on a panel f is
# interpolated at Gauss-Legendre nodes, f = sum c_m P_m, and the moments of P_m against B are found once by a dense rule
# that never sees f. So the number of kernel evaluations follows the kernel, not the oscillation, and all distances and
# frequencies share them as matrix products. Panels are dyadic, so their weights are cached and shared by all
# frequencies.
# The path is k(x) = x on the real axis or k(x) = x + i s tanh(x/s), above the poles of outgoing waves, which
# lie just below the axis when losses are small.

NODES = 12  # Legendre nodes per panel
_EXTRA = 4  # moments beyond the interpolant, for the error gauge
_DENSE = 16  # dense Gauss nodes per 2.5 periods of the weight: exact to rounding
_AT_ONCE = 256  # of these at a time, whose columns stay near the processor
_X, _W = legendre.leggauss(NODES)
_XD, _WD = legendre.leggauss(_DENSE)
# c = _TO_LEGENDRE @ f(nodes): (2m + 1)/2 w_j P_m(x_j)
_TO_LEGENDRE = (np.arange(NODES)[:, None] + 0.5) * legendre.legvander(_X, NODES - 1).T * _W

Panel = tuple[float, float]


@dataclass(frozen=True)
class Rule:
    """Weights of one panel: ``values`` (NODES, n_columns) and ``gauge`` (n_kernel, NODES + extra), the largest
    moment of each order over the columns of each kernel."""

    values: Numbers
    gauge: FloatArray


class _Dense(NamedTuple):
    """Nodes ``x`` (n,) [1/m] of a dense rule on a panel, and its weights times the Legendre polynomials, ``basis``
    (NODES + extra, n)."""

    x: FloatArray
    basis: FloatArray

    @classmethod
    def of(cls, panel: Panel, extent: float) -> Self:
        """For weights that oscillate at up to ``extent`` [m]."""
        lo, hi = panel
        edges = np.linspace(-1.0, 1.0, 3 + math.ceil((hi - lo) * extent / (2 * math.pi * 2.5)))
        half = 0.5 * (edges[1] - edges[0])
        t = (0.5 * (edges[:-1] + edges[1:])[:, None] + half * _XD).ravel()
        weight = np.tile(0.5 * (hi - lo) * half * _WD, edges.size - 1)
        return cls(0.5 * (lo + hi) + 0.5 * (hi - lo) * t, legendre.legvander(t, NODES + _EXTRA - 1).T * weight)


@dataclass
class Rules:
    """Weights for ``table`` on the path with ``offset`` s [1/m] (0: real axis), computed once per panel."""

    table: HankelTable
    offset: float = 0.0
    _cache: dict[Panel, Rule] = field(default_factory=dict)

    def path(self, x: FloatArray) -> Numbers:
        """k(x) [1/m]."""
        if self.offset == 0:
            return x
        return np.asarray(x + 1j * self.offset * np.tanh(x / self.offset))

    def nodes(self, panels: list[Panel]) -> Numbers:
        """k at the nodes of all panels, (len(panels) * NODES,)."""
        lo, hi = np.array(panels, dtype=float).T
        return self.path((0.5 * (lo + hi)[:, None] + 0.5 * (hi - lo)[:, None] * _X).ravel())

    def weights(self, panels: list[Panel]) -> Numbers:
        """(len(panels) * NODES, n_columns)."""
        return np.concatenate([rule.values for rule in self.rules(panels)])

    def gauges(self, panels: list[Panel]) -> FloatArray:
        """Largest moments over columns, (n_kernel, len(panels), NODES + extra)."""
        return np.stack([rule.gauge for rule in self.rules(panels)], axis=1)

    def rule(self, panel: Panel) -> Rule:
        """Weights of one panel, from the cache if seen before."""
        return self.rules([panel])[0]

    def rules(self, panels: list[Panel]) -> list[Rule]:
        """Weights of each panel, from the cache if seen before; Bessel functions of all others are found together."""
        fresh = [panel for panel in dict.fromkeys(panels) if panel not in self._cache]
        dense = [_Dense.of(panel, self.table.extent) for panel in fresh]
        if fresh:
            factors = self.table.factors(self.path(np.concatenate([d.x for d in dense])))
            ends = np.cumsum([len(d.x) for d in dense])
            for panel, one, end in zip(fresh, dense, ends.tolist(), strict=True):
                waves, transforms = (f[end - len(one.x) : end] for f in factors)
                weighted: Numbers = one.basis
                if self.offset != 0:  # dk/dx
                    weighted = weighted * (1 + 1j / np.cosh(np.minimum(one.x / self.offset, 300.0)) ** 2)
                some = [slice(start, start + _AT_ONCE) for start in range(0, len(one.x), _AT_ONCE)]
                moments = np.sum([weighted[:, s] @ self.table.joined(waves[s], transforms[s]) for s in some], axis=0)
                gauge = [np.max(np.abs(moments[:, part]), axis=1, initial=0.0) for part in self.table.parts]
                self._cache[panel] = Rule(_TO_LEGENDRE.T @ moments[:NODES], np.array(gauge))
        return [self._cache[panel] for panel in panels]


def panel_errors(values: ComplexArray, gauges: FloatArray) -> FloatArray:
    r"""Estimated errors (n_freq, n_panels) of the product rule, from node values (n_freq, n_panels * NODES).

    If Legendre coefficients go on decaying like t^m from L, the largest of the last three, the interpolant
    misses L t^{m-n+2} for m >= n, and those alias into lower orders as L t^{n+1-m}; each meets the moment
    M_m, ``gauges`` (n_panels, n + extra). t is the slower of the decay over all and over the last six
    coefficients: a weak sharp pole under a smooth kernel shows only in the latter.
    """
    c = np.abs(values.reshape(values.shape[0], -1, NODES) @ _TO_LEGENDRE.T)
    last, before, size = c[:, :, -3:].max(axis=2), c[:, :, -6:-3].max(axis=2), c.max(axis=2)
    overall = (last / np.where(size > 0, size, 1.0)) ** (1 / (NODES - 2))
    recent = np.minimum(last / np.where(before > 0, before, 1.0), 1.0) ** (1 / 3)
    t = np.maximum(overall, recent)
    order = np.arange(NODES + _EXTRA) - NODES + 2
    order[:NODES] = 3 - order[:NODES]
    sums, power = np.zeros_like(t), t**2
    for n in range(2, NODES + 2):
        sums += power * gauges[:, order == n].sum(axis=1)
        power = power * t
    return np.asarray(last * sums)


def split(panel: Panel) -> list[Panel]:
    """Both halves; dyadic numbers stay exact."""
    middle = 0.5 * (panel[0] + panel[1])
    return [(panel[0], middle), (middle, panel[1])]


def octaves(first: float, last: float) -> list[Panel]:
    """(first, 2 first), (2 first, 4 first), ... up to ``last``."""
    n = max(0, round(math.log2(last / first)))
    return [(first * 2.0**i, first * 2.0 ** (i + 1)) for i in range(n)]


# Hankel integrals of the surface compliance of a layered medium, refined until every frequency is converged.

_CHUNK = 32  # frequencies refined together
_LOW_LOSS_CHUNK = 8  # fewer, where each frequency has its own sharp poles
_MAX_LEVELS = 24  # halvings of a panel
_TAIL_OCTAVES = 16  # beyond sources and wavelengths, for the static tail
_MAX_PHASE = 1e6  # k times extent [rad] where the tail ends at the latest; what is left enters the error
_MEAN_OCTAVES = 30  # beyond that, for the mean over the oscillation
LOW_LOSS = 1e-3  # loss tangent below which the path leaves the real axis
_TEST_LOSS = 1e-3  # loss added to check that path
_SHARE = 0.02  # part of the tolerance given to one panel

Modulus = Callable[[FloatArray], ComplexArray]


class Medium(NamedTuple):
    """Parameters of the kernels besides k and omega.

    The four kernels of the tables are zz, zx, and half the sum and half the difference of xx and yy, in which the
    azimuthal orders of tangential tractions meet (:mod:`forearm_fem.layered.discs`).
    """

    layers: tuple[Layer, ...]
    base: Base
    surface: Surface

    def remainders(self, k: FloatArray | ComplexArray, omega: FloatArray, tangential: bool) -> list[ComplexArray]:
        """k U(k) minus its limit for k -> inf, each (n_freq, n_k) [1/Pa]; zz alone unless ``tangential``."""
        arguments = (k[None], omega[:, None], self.layers, self.base, self.surface)
        kernels = _mixed(surface_compliance(*arguments)) if tangential else [surface_kernel(*arguments)]
        return [np.asarray(k * u - limit[:, None]) for u, limit in zip(kernels, self.limits(omega), strict=False)]

    def limits(self, omega: FloatArray) -> list[ComplexArray]:
        """lim k U(k) of the four kernels, each (n_freq,) [1/Pa]."""
        return _mixed(compliance_limits(omega, self.layers[0], self.surface))

    def wavenumbers(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """|k_s| and |k_p| of all layers, each (n_layers, n_freq) [1/m]."""
        both = [wavenumbers(omega, layer) for layer in self.layers]
        return np.abs([ks for ks, _ in both]), np.abs([kp for _, kp in both])

    def loss(self, omega: FloatArray) -> FloatArray:
        """Smallest loss tangent over layers, (n_freq,)."""
        modulus = np.array([shear_modulus(omega, layer) for layer in self.layers])
        return np.asarray(np.min(modulus.imag / modulus.real, axis=0))

    def lossier(self, loss: float) -> Medium:
        """The same medium with all moduli times 1 + i loss."""
        return self._replace(layers=tuple(replace(x, modulus=_lossy(x.modulus, loss)) for x in self.layers))


class IntegralBlock(NamedTuple):
    """Values (n_freq, n_columns) [m/N], relative error (n_freq,) and kernel evaluations of one chunk."""

    values: ComplexArray
    error: FloatArray
    n_kernel: int


class Integrals:
    """Adaptive quadrature for a fixed medium and table; keeps the weights of both paths."""

    def __init__(self, medium: Medium, table: HankelTable, tolerance: float) -> None:
        self.medium, self.table, self.tolerance = medium, table, tolerance
        self.real = Rules(table)
        self.raised = Rules(table, 0.5 / table.extent)

    @cached_property
    def static(self) -> FloatArray:
        """Integrals for kU = 1 (n_columns,) [1/m]."""
        return self.table.static()

    def chunks(self, omega: FloatArray) -> list[IntArray]:
        """Indices in ascending frequency, each chunk within an octave."""
        order = np.argsort(omega, kind="stable")
        low = self.medium.loss(omega)[order] < LOW_LOSS
        out: list[IntArray] = []
        start = 0
        for i in range(1, omega.size + 1):
            size = _LOW_LOSS_CHUNK if low[start] else _CHUNK
            full = i == omega.size or i - start >= size or omega[order[i]] > 2 * omega[order[start]]
            if full or low[i] != low[start]:
                out.append(order[start:i])
                start = i
        return out

    def solve(self, omega: FloatArray) -> IntegralBlock:
        """One chunk, on the path that its losses ask for; SolverError where no path is safe."""
        if self.medium.loss(omega[:1])[0] >= LOW_LOSS:
            return self._integrate(self.medium, self.real, omega)
        medium = self.medium.lossier(_TEST_LOSS)  # both paths must agree once there is loss enough for the axis
        axis, above = (self._integrate(medium, rules, omega) for rules in (self.real, self.raised))
        gap = np.max(np.abs(axis.values - above.values), axis=1) / np.max(np.abs(axis.values), axis=1)
        bad = gap > 10 * (axis.error + above.error) + 1e-9
        if np.any(bad):
            raise SolverError(
                f"layered: at {omega[bad][0] / (2 * math.pi):.4g} Hz a wave with opposed phase and group "
                f"velocity defies the lossless path; give every layer a loss tangent >= {LOW_LOSS:g}"
            )
        block = self._integrate(self.medium, self.raised, omega)
        return block._replace(n_kernel=block.n_kernel + axis.n_kernel + above.n_kernel)

    def _integrate(self, medium: Medium, rules: Rules, omega: FloatArray) -> IntegralBlock:
        """Refine dyadic panels until every frequency of the chunk is converged."""
        first, core = _grid(medium, omega, self.table.smallest)
        ends = np.asarray(core * 2.0 ** np.arange(_TAIL_OCTAVES), dtype=float)
        ends = ends[ends <= max(core, _MAX_PHASE / self.table.extent)]
        lost = np.abs(self._remainders(medium, ends, omega))
        tails = np.max(lost, axis=0) * self.table.envelope(ends)  # of what the window loses at each end
        active: list[Panel] = [(0.0, first), *octaves(first, core)]
        limits = medium.limits(omega)  # none where the skin is tense
        static = self.static if np.any(limits) else np.zeros(self.table.a.size)
        total = self._each(lambda i, part: limits[i][:, None] * static[part])
        end, error, n_kernel, level = math.inf, np.zeros(omega.size), omega.size * ends.size, 0
        while active:
            k = rules.nodes(active)
            values = [f * window(k, end) for f in self._remainders(medium, k, omega)]
            n_kernel += values[0].size
            gauges = rules.gauges(active)
            estimates = np.max([panel_errors(f, g) for f, g in zip(values, gauges, strict=True)], axis=0)
            whole = total + self._sums(values, rules.weights(active))
            scale = np.max(np.abs(whole), axis=1)
            good = np.all(estimates <= _SHARE * self.tolerance * scale[:, None], axis=0)
            good |= level >= _MAX_LEVELS
            bad = [panel for panel, g in zip(active, good, strict=True) if not g]
            total = whole - self._sums([_columns(f, ~good) for f in values], rules.weights(bad)) if bad else whole
            error += estimates[:, good].sum(axis=1)
            active = [half for panel in bad for half in split(panel)]
            if level == 0:
                stop = _first_below(tails, 0.1 * self.tolerance * scale)
                error += tails[:, stop]
                end = float(ends[stop])
                active += [*octaves(core, end), *_quarters(end)]
                total = total + self._mean_tail(medium, rules, end, omega)
            level += 1
        return IntegralBlock(total, error / np.max(np.abs(total), axis=1), n_kernel)

    def _remainders(self, medium: Medium, k: Numbers, omega: FloatArray) -> list[ComplexArray]:
        return medium.remainders(k, omega, len(self.table.parts) > 1)

    def _each(self, make: Callable[[int, slice], ComplexArray]) -> ComplexArray:
        """Results of ``make`` for each kernel and its columns, side by side."""
        return np.hstack([make(i, part) for i, part in enumerate(self.table.parts)])

    def _sums(self, values: list[ComplexArray], weights: Numbers) -> ComplexArray:
        """Sums of each kernel's values (n_freq, n_k) with the weights (n_k, n_columns) of its columns."""
        return self._each(lambda i, part: product(values[i], weights[:, part]))

    def _mean_tail(self, medium: Medium, rules: Rules, end: float, omega: FloatArray) -> ComplexArray:
        """Loss of the window from the mean of the weights over their oscillation: panels by Gauss's rule."""
        x, w = np.polynomial.legendre.leggauss(10)
        panels = [*_quarters(end), *octaves(2 * end, 2.0**_MEAN_OCTAVES * end)]
        lo, hi = np.array(panels).T
        k = rules.path((0.5 * (lo + hi)[:, None] + 0.5 * (hi - lo)[:, None] * x).ravel())
        weight = (0.5 * (hi - lo)[:, None] * w).ravel() * (1 - window(k, end))
        columns, mean = self.table.mean(k)
        out = np.zeros((omega.size, self.table.a.size), dtype=complex)
        for f, part in zip(self._remainders(medium, k, omega), self.table.parts, strict=False):
            mine = (columns >= part.start) & (columns < part.stop)
            out[:, columns[mine]] = product(f, weight[:, None] * mean[:, mine])
        return out


def product(values: ComplexArray, weights: Numbers) -> ComplexArray:
    """values @ weights, without a complex copy of real weights."""
    if np.iscomplexobj(weights):
        return np.asarray(values @ weights)
    both = np.concatenate([values.real, values.imag]) @ weights
    return np.asarray(both[: len(values)] + 1j * both[len(values) :])


def _mixed(u: SurfaceCompliance) -> list[ComplexArray]:
    """zz, zx, half the sum and half the difference of xx and yy."""
    return [u.zz, u.zx, np.asarray(0.5 * (u.xx + u.yy)), np.asarray(0.5 * (u.xx - u.yy))]


def _quarters(end: float) -> list[Panel]:
    """The octave beyond ``end`` in four, over which the window falls."""
    return [(end * (1 + 0.25 * i), end * (1.25 + 0.25 * i)) for i in range(4)]


def _grid(medium: Medium, omega: FloatArray, size: float) -> tuple[float, float]:
    """Powers of two [1/m]: below all compressional (shear, if incompressible) wavenumbers, so that no branch
    point hides inside a panel; and beyond all shear wavenumbers and the width ``size`` [m] of the smallest source."""
    shear, compression = medium.wavenumbers(omega)
    slow = compression[compression > 0].min() if np.any(compression > 0) else shear.min()
    core = max(4 * float(shear.max()), 8 / size)
    return 2.0 ** math.floor(math.log2(slow / 2)), 2.0 ** math.ceil(math.log2(core))


def _first_below(tails: FloatArray, bound: FloatArray) -> int:
    """Index of the first octave end from which all frequencies' tails stay below ``bound``."""
    above = np.flatnonzero(np.any(tails > bound[:, None], axis=0))
    return int(min(above[-1] + 1 if above.size else 0, tails.shape[1] - 1))


def _columns(f: ComplexArray, chosen: BoolArray) -> ComplexArray:
    """Node values of the chosen panels, (n_freq, n_chosen * nodes)."""
    by_panel = f.reshape(f.shape[0], chosen.size, -1)
    return np.asarray(by_panel[:, chosen].reshape(f.shape[0], -1))


def _lossy(modulus: Modulus, loss: float) -> Modulus:
    return lambda omega: np.asarray(np.asarray(modulus(omega), dtype=complex) * (1 + 1j * loss))
