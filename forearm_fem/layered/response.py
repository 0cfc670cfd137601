"""Compliance of a layered half-space between uniform-pressure discs and discs or points on its surface."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..errors import AccuracyWarning, SolverError
from ..typing import BoolArray, ComplexArray, FloatArray, IntArray
from .asymptote import disc_interaction
from .kernel import (
    Base,
    Layer,
    Surface,
    check_layers,
    shear_modulus,
    static_asymptote,
    surface_kernel,
    wavenumbers,
)
from .quadrature import Pairs, Panel, Rules, octaves, panel_errors, split

_CHUNK = 32  # frequencies refined together
_LOW_LOSS_CHUNK = 8  # fewer, where each frequency has its own sharp poles
_MAX_LEVELS = 24  # halvings of a panel
_TAIL_OCTAVES = 16  # beyond sources and wavelengths, for the static tail
_MAX_PHASE = 1e6  # k times extent [rad] where the tail ends at the latest; what is left enters the error
_LOW_LOSS = 1e-3  # loss tangent below which the path leaves the real axis
_TEST_LOSS = 1e-3  # loss added to check that path
_SHARE = 0.02  # part of the tolerance given to one panel

Modulus = Callable[[FloatArray], ComplexArray]


@dataclass(frozen=True)
class Disc:
    """A disc on the surface, centre (x, y) and radius [m]; radius 0 is a point."""

    x: float
    y: float
    radius: float = 0.0


@dataclass(frozen=True)
class LayeredResult:
    """``values`` (n_freq, n_out, n_in) [m/N], positive along the force; a point receiver on its own point
    source is NaN (infinite). ``error`` (n_freq,) estimated absolute error over the largest |value| at that
    frequency. ``n_kernel``: kernel evaluations spent."""

    values: ComplexArray
    error: FloatArray
    n_kernel: int


class Medium(NamedTuple):
    """What the kernel needs besides k and omega."""

    layers: tuple[Layer, ...]
    base: Base
    surface: Surface

    def remainder(self, k: FloatArray | ComplexArray, omega: FloatArray) -> ComplexArray:
        """k U(k) minus its limit for k -> inf, (n_freq, n_k) [1/Pa]; exactly minus the limit at k = 0."""
        u = surface_kernel(k[None], omega[:, None], self.layers, self.base, self.surface)
        return np.asarray(k * u - self.limit(omega)[:, None])

    def limit(self, omega: FloatArray) -> ComplexArray:
        """lim k U(k), (n_freq,) [1/Pa]: of the top layer, none under tension."""
        value = static_asymptote(omega, self.layers[0])
        return value * 0 if self.surface.tension > 0 else value

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


class Block(NamedTuple):
    """Values (n_freq, n_pairs) [m/N], relative error (n_freq,) and kernel evaluations of one chunk."""

    values: ComplexArray
    error: FloatArray
    n_kernel: int


def layered_compliance(
    layers: Sequence[Layer],
    omega: FloatArray,
    discs_in: Sequence[Disc],
    discs_out: Sequence[Disc],
    *,
    base: Base = "halfspace",
    surface: Surface | None = None,
    tolerance: float = 1e-6,
    progress: Callable[[float], None] | None = None,
) -> LayeredResult:
    r"""Mean normal displacement of each output disc per force spread uniformly over each input disc.

    .. math:: \bar u/F = \frac1{2\pi}\int_0^\infty U(k)\,j(ka)\,j(kb)\,J_0(kd)\,k\,dk,\quad j(x)=2J_1(x)/x

    Parameters
    ----------
    layers : from the surface down, see :class:`Layer`; ``base`` says what carries the last.
    omega : (n_freq,) array, > 0 [rad/s], convention e^{+i omega t}.
    tolerance : error relative to the largest |value| at each frequency.
    progress : called with the fraction done.

    Not covered: rigid discs (mixed boundary conditions), tangential loads, anisotropy, omega = 0. With
    next to no loss (some loss tangent below 1e-3) the path passes above the real axis, which presumes that
    no wave travels with phase and group velocity opposed; layers on a rigid base have such in narrow bands.
    This is checked on a copy with loss 1e-3 added, at several times the cost, and SolverError is raised if
    it fails. AccuracyWarning if the tolerance was not reached.
    """
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    check_layers(layers, base)
    _check_omega(omega, tolerance)
    medium = Medium(tuple(layers), base, surface or Surface())
    if np.any(medium.loss(omega) < 0):
        raise ValueError("expected Im(modulus) >= 0 (convention e^{+i omega t}), got a layer that feeds energy in")
    pairs, index = _unique_pairs(discs_in, discs_out)
    out = np.full((omega.size, pairs.a.size + 1), np.nan + 0j)  # last column: coincident points
    error, n_kernel = np.zeros(omega.size), 0
    if pairs.a.size:
        static = np.array([disc_interaction(*t) for t in zip(pairs.distance, pairs.a, pairs.b, strict=True)])
        engine = Engine(medium, pairs, static, tolerance)
        for done, chunk in engine.chunks(omega):
            out[chunk, :-1], error[chunk], spent = engine.solve(omega[chunk])
            n_kernel += spent
            if progress is not None:
                progress(done)
    if np.any(error > tolerance):
        warnings.warn(f"layered: error {error.max():.1e} > tolerance {tolerance:.1e}", AccuracyWarning, 2)
    return LayeredResult(out[:, index], error, n_kernel)


class Engine:
    """Adaptive quadrature for fixed medium and pairs; keeps the weights of both paths."""

    def __init__(self, medium: Medium, pairs: Pairs, static: FloatArray, tolerance: float) -> None:
        self.medium, self.pairs, self.static, self.tolerance = medium, pairs, static, tolerance
        self.real = Rules(pairs)
        self.raised = Rules(pairs, 0.5 / pairs.extent)

    def chunks(self, omega: FloatArray) -> list[tuple[float, IntArray]]:
        """(fraction done, indices) in ascending frequency, each chunk within an octave."""
        order = np.argsort(omega, kind="stable")
        low = self.medium.loss(omega)[order] < _LOW_LOSS
        out: list[tuple[float, IntArray]] = []
        start = 0
        for i in range(1, omega.size + 1):
            size = _LOW_LOSS_CHUNK if low[start] else _CHUNK
            full = i == omega.size or i - start >= size or omega[order[i]] > 2 * omega[order[start]]
            if full or low[i] != low[start]:
                out.append((i / omega.size, order[start:i]))
                start = i
        return out

    def solve(self, omega: FloatArray) -> Block:
        """One chunk, on the path that its losses ask for."""
        if self.medium.loss(omega[:1])[0] >= _LOW_LOSS:
            return self._integrate(self.medium, self.real, omega)
        spent = self._check_raised(omega)
        block = self._integrate(self.medium, self.raised, omega)
        return block._replace(n_kernel=block.n_kernel + spent)

    def _check_raised(self, omega: FloatArray) -> int:
        """Both paths must agree once there is loss enough to integrate along the axis; evaluations spent."""
        medium = self.medium.lossier(_TEST_LOSS)
        axis, above = (self._integrate(medium, rules, omega) for rules in (self.real, self.raised))
        gap = np.max(np.abs(axis.values - above.values), axis=1) / np.max(np.abs(axis.values), axis=1)
        bad = gap > 10 * (axis.error + above.error) + 1e-9
        if np.any(bad):
            raise SolverError(
                f"layered: at {omega[bad][0] / (2 * math.pi):.4g} Hz a wave with opposed phase and group "
                f"velocity defies the lossless path; give every layer a loss tangent >= {_LOW_LOSS:g}"
            )
        return axis.n_kernel + above.n_kernel

    def _integrate(self, medium: Medium, rules: Rules, omega: FloatArray) -> Block:
        """Refine dyadic panels until every frequency of the chunk is converged."""
        first, core = _grid(medium, omega, self.pairs)
        ends = np.asarray(core * 2.0 ** np.arange(_TAIL_OCTAVES), dtype=float)
        ends = ends[ends <= max(core, _MAX_PHASE / self.pairs.extent)]
        tails = np.abs(medium.remainder(ends, omega)) * self.pairs.envelope(ends)
        active: list[Panel] = [(0.0, first), *octaves(first, core)]
        total = medium.limit(omega)[:, None] * self.static
        error, n_kernel, level = np.zeros(omega.size), omega.size * ends.size, 0
        while active:
            f = medium.remainder(rules.nodes(active), omega)
            n_kernel += f.size
            estimates = panel_errors(f, rules.gauges(active))
            whole = total + f @ rules.weights(active)
            scale = np.max(np.abs(whole), axis=1)
            good = np.all(estimates <= _SHARE * self.tolerance * scale[:, None], axis=0)
            good |= level >= _MAX_LEVELS
            bad = [panel for panel, g in zip(active, good, strict=True) if not g]
            total = whole - _columns(f, ~good) @ rules.weights(bad) if bad else whole
            error += estimates[:, good].sum(axis=1)
            active = [half for panel in bad for half in split(panel)]
            if level == 0:
                stop = _first_below(tails, 0.1 * self.tolerance * scale)
                error += tails[:, stop]
                active += octaves(core, ends[stop])
            level += 1
        return Block(total, error / np.max(np.abs(total), axis=1), n_kernel)


def _grid(medium: Medium, omega: FloatArray, pairs: Pairs) -> tuple[float, float]:
    """Powers of two [1/m]: below all compressional (shear, if incompressible) wavenumbers, so that no branch
    point hides inside a panel; and beyond all shear wavenumbers and the width of the smallest source."""
    shear, compression = medium.wavenumbers(omega)
    slow = compression[compression > 0].min() if np.any(compression > 0) else shear.min()
    size = float(np.min(np.where(pairs.a > 0, pairs.a, pairs.distance)))
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


def _check_omega(omega: FloatArray, tolerance: float) -> None:
    if omega.ndim != 1 or not np.all(np.isfinite(omega)) or np.any(omega <= 0):
        raise ValueError("expected omega as (n_freq,) with finite values > 0 rad/s")
    if not 1e-12 <= tolerance < 1:
        raise ValueError(f"expected 1e-12 <= tolerance < 1, got {tolerance}")


def _unique_pairs(discs_in: Sequence[Disc], discs_out: Sequence[Disc]) -> tuple[Pairs, IntArray]:
    """Distinct (distance, radii) to 1e-12 m, and the (n_out, n_in) index into them; -1: point on itself."""
    x_in, x_out = (np.array([(d.x, d.y, d.radius) for d in discs], dtype=float).reshape(-1, 3)
                   for discs in (discs_in, discs_out))  # fmt: skip
    if np.any(x_in[:, 2] < 0) or np.any(x_out[:, 2] < 0):
        raise ValueError("expected disc radii >= 0 m")
    distance = np.hypot(*(x_out[:, None, :2] - x_in[None, :, :2]).transpose(2, 0, 1))
    radii = np.broadcast_arrays(x_out[:, None, 2], x_in[None, :, 2])
    table = np.stack([distance, np.maximum(*radii), np.minimum(*radii)], axis=-1).round(12)
    unique, index = np.unique(table.reshape(-1, 3), axis=0, return_inverse=True)
    singular = (unique[:, 0] == 0) & (unique[:, 1] == 0)
    renumber = np.where(singular, -1, np.cumsum(~singular) - 1)
    return Pairs(*unique[~singular].T), renumber[index.reshape(distance.shape)]
