r"""Product integration of a smooth kernel against oscillating Bessel weights.

:math:`\int f(k)\,B(k)\,dk` with :math:`B = \frac1{2\pi}g_a(k)g_b(k)J_q(kd)` for many columns at once: on a panel f is
interpolated at Gauss-Legendre nodes, f = sum c_m P_m, and the moments of P_m against B are found once by a dense rule
that never sees f. So the number of kernel evaluations follows the kernel, not the oscillation, and all distances and
frequencies share them as matrix products. Panels are dyadic, so their weights are cached and shared by all frequencies.

The path is k(x) = x on the real axis or k(x) = x + i s tanh(x/s), above the poles of outgoing waves, which
lie just below the axis when losses are small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np
from numpy.polynomial import legendre

from ..typing import ComplexArray, FloatArray
from .hankel import HankelTable, Numbers

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
