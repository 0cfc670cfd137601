"""Compliance of a layered half-space between contacts and points on its surface, sampled smoothly over frequency."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy.linalg import block_diag

from ..errors import AccuracyWarning
from ..progress import Progress, tell
from ..typing import BoolArray, ComplexArray, FloatArray, IntArray
from .discs import UPRIGHT, Disc, Galerkin, decay_of, galerkin
from .integrals import LOW_LOSS, Integrals, Medium
from .kernel import Base, Layer, Surface, check_layers
from .tape import FEWER, Sheet, Tape

# Smooth functions of frequency from few of their values: Chebyshev polynomials in the root of the frequency.

_DEGREES = (48, 96)  # nested: the second uses the values of the first
MOST = _DEGREES[-1]
_TAIL = 8  # coefficients whose sum bounds what a geometric series leaves beyond them, were they to fall by a tenth each


class Sampled(NamedTuple):
    """Values (n_freq, ...), the errors (n_freq, k) that came with them, and that of the interpolation (n_freq,) over
    the largest |value|."""

    values: ComplexArray
    errors: FloatArray
    interpolation: FloatArray


Evaluate = Callable[[FloatArray], tuple[ComplexArray, FloatArray]]


def sampled(evaluate: Evaluate, omega: FloatArray, tolerance: float) -> Sampled:
    """``evaluate`` (values (n, ...) and their errors (n, k) at n angular frequencies) at all of ``omega`` (n_freq,).

    Where ``omega`` has many more values than the degree it takes to follow the function to ``tolerance`` of the largest
    |value| at each frequency, only the degree's nodes are evaluated; elsewhere all of ``omega``.
    """
    low, high = np.sqrt(omega.min()), np.sqrt(omega.max())
    x = 2 * (np.sqrt(omega) - low) / (high - low) - 1 if high > low else np.zeros(omega.size)
    known: tuple[ComplexArray, FloatArray] | None = None
    for degree in _DEGREES:
        if omega.size < 2 * degree:
            break
        nodes = np.cos(np.pi * np.arange(degree + 1) / degree)
        wanted = np.ones(degree + 1, dtype=bool) if known is None else np.arange(degree + 1) % 2 == 1
        found = evaluate((low + 0.5 * (high - low) * (nodes[wanted] + 1)) ** 2)
        known = found if known is None else _merged(known, found, wanted)
        result = _interpolated(x, nodes, *known)
        if np.all(result.interpolation <= tolerance):
            return result
    values, errors = evaluate(omega)
    return Sampled(values, errors, np.zeros(omega.size))


def chebyshev_nodes(low: float, high: float, degree: int) -> FloatArray:
    """Angular frequencies (degree + 1,) [rad/s], falling from ``high`` to ``low``: the rule's nodes in their root."""
    x = np.cos(np.pi * np.arange(degree + 1) / degree)
    return np.asarray((np.sqrt(low) + 0.5 * (np.sqrt(high) - np.sqrt(low)) * (x + 1)) ** 2)


def chebyshev_between(
    low: float, high: float, omega: FloatArray, values: ComplexArray
) -> tuple[ComplexArray, FloatArray]:
    """``values`` (degree + 1, ...) at the nodes of :func:`chebyshev_nodes`, at ``omega`` (n_freq,) [rad/s], and what
    the rule's last coefficients say is missing, over the largest |value| (n_freq,)."""
    x = 2 * (np.sqrt(omega) - np.sqrt(low)) / (np.sqrt(high) - np.sqrt(low)) - 1
    nodes = np.cos(np.pi * np.arange(len(values)) / (len(values) - 1))
    found = _interpolated(x, nodes, values, np.zeros((len(values), 1)))
    return found.values, found.interpolation


def _merged(
    old: tuple[ComplexArray, FloatArray], new: tuple[ComplexArray, FloatArray], is_new: BoolArray
) -> tuple[ComplexArray, FloatArray]:
    """Values and errors of both, in the order of the finer nodes."""
    out = []
    for before, now in zip(old, new, strict=True):
        both = np.empty((is_new.size, *before.shape[1:]), dtype=before.dtype)
        both[~is_new], both[is_new] = before, now
        out.append(both)
    return out[0], out[1]


def _interpolated(x: FloatArray, nodes: FloatArray, values: ComplexArray, errors: FloatArray) -> Sampled:
    """Interpolant at ``x``, in (-1, 1), of values at ``nodes`` (falling from 1 to -1)."""
    degree = nodes.size - 1
    flat = values.reshape(nodes.size, -1)
    coefficients = np.linalg.solve(chebyshev.chebvander(nodes, degree), flat)
    found = chebyshev.chebvander(x, degree) @ coefficients
    tail = np.abs(coefficients[-_TAIL:]).sum(axis=0).max()
    size = np.abs(found).max(axis=1)
    between = np.stack([np.interp(x, nodes[::-1], column[::-1]) for column in errors.T], axis=1)
    return Sampled(found.reshape(x.size, *values.shape[1:]), between, np.asarray(tail / size))


# Compliance of a layered half-space between contacts and points on its surface.

_TERMS = (6, 24)  # of the axisymmetric tractions under a rigid disc, least and most
_SCATTERED = 1e-5  # what the azimuthal orders above those taken may still scatter, by the distances of the discs
_ORDERS = (2, 6)  # of them, least and most
_JUDGED = 7  # frequencies where a sheet's polynomials are
_RATIOS, _SLOW = (0.3, 0.75), 3.0  # of what they leave out, least and most; sum of the series of the latter


@dataclass(frozen=True)
class LayeredResult:
    """``values`` (n_freq, n_out, n_in) [m/N], positive along the force; a point receiver on its own point
    source is NaN (infinite).

    ``quadrature``, ``truncation`` and ``interpolation`` (n_freq,) are estimated absolute errors over the largest
    |value| at that frequency: of the integrals, of the series of tractions under rigid discs (0 without any), and of
    what lies between the frequencies that were computed; ``sheet`` is of its polynomials. ``n_kernel``: kernel
    evaluations spent.
    """

    values: ComplexArray
    quadrature: FloatArray
    truncation: FloatArray
    interpolation: FloatArray
    n_kernel: int
    sheet: FloatArray

    @property
    def error(self) -> FloatArray:
        """All errors together (n_freq,)."""
        return self.quadrature + self.truncation + self.interpolation + self.sheet


def layered_compliance(
    layers: Sequence[Layer],
    omega: FloatArray,
    discs_in: Sequence[Disc],
    discs_out: Sequence[Disc],
    *,
    base: Base = "halfspace",
    surface: Surface | None = None,
    sheet: Sheet | None = None,
    tolerance: float = 1e-6,
    terms: int | None = None,
    orders: int | None = None,
    judged: int = 1,
    progress: Progress | None = None,
) -> LayeredResult:
    r"""Normal displacement of each output disc per normal force on each input disc.

    Between discs of uniform pressure, of which the mean displacement is meant, it is

    .. math:: \bar u/F = \frac1{2\pi}\int_0^\infty U(k)\,j(ka)\,j(kb)\,J_0(kd)\,k\,dk,\quad j(x)=2J_1(x)/x;

    rigid discs, bonded or frictionless, are solved by Galerkin's method (:mod:`forearm_fem.layered.discs`,
    :mod:`forearm_fem.layered.discs`): statically F = 8 mu a d on an incompressible body, and
    4 mu a d/(1 - nu) frictionless, 4 mu a d ln(3 - 4 nu)/(1 - 2 nu) bonded on a compressible one (Sneddon 1966;
    Mossakovskii 1954; Spence 1968). All rigid discs of both lists are there at once, free of net force where not
    driven, and scatter the waves of the others; a point under one moves with it.

    Parameters
    ----------
    layers : from the surface down, see :class:`Layer`; ``base`` says what carries the last.
    surface, sheet : on all of it, and on a rectangle (:mod:`forearm_fem.layered.tape`).
    omega : (n_freq,) array, > 0 [rad/s], convention e^{+i omega t}.
    tolerance : error of the integrals relative to the largest |value| at each frequency.
    terms, orders : of the tractions under rigid discs; None: as waves, layers and distances ask for. What they
        leave out is ``truncation`` of the result; NaN with ``orders`` = 0 where a disc is not alone.
    judged : every so many of the frequencies computed truncation is found; between two of them the larger is stated.
    progress : counts frequencies against those expected.

    Not covered: tilt and sideways motion of rigid discs, tangential loads, anisotropy, omega = 0. With
    next to no loss (some loss tangent below 1e-3) the path passes above the real axis, which presumes that
    no wave travels with phase and group velocity opposed; layers on a rigid base have such in narrow bands.
    This is checked on a copy with loss 1e-3 added, at several times the cost, and SolverError is raised if
    it fails. ValueError where rigid discs overlap others. AccuracyWarning if the tolerance was not reached.
    """
    omega = np.atleast_1d(np.asarray(omega, dtype=float))
    check_layers(layers, base)
    _check_omega(omega, tolerance)
    medium = Medium(tuple(layers), base, surface or Surface())
    if np.any(medium.loss(omega) < 0):
        raise ValueError("expected Im(modulus) >= 0 (convention e^{+i omega t}), got a layer that feeds energy in")
    discs, rows, columns, seen, driven = _components(discs_in, discs_out)
    terms = terms_of(discs, medium, omega) if terms is None else terms
    orders = scattered_orders(discs) if orders is None else orders
    silent = [i for i, disc in enumerate(discs) if not disc.rigid and i not in columns]
    system = galerkin(discs, medium.surface, terms, orders, silent=silent)
    expected = min(omega.size, MOST + 1)
    asked = np.zeros((system.ports, system.ports), dtype=bool)
    asked[np.ix_(rows, columns)] = True
    kinds = tuple(kind for each in system.kinds() if (kind := each & (asked | asked.T)).any()) or (asked | asked.T,)
    integrals = Integrals(medium, system.table, tolerance)
    tape = None if sheet is None else Tape.of(sheet, medium, system, tuple(discs), omega)
    evaluate = _Evaluation(integrals, system, discs, kinds, (rows, columns), judged, expected, progress, tape)
    sharp = bool(np.any(medium.loss(omega) < LOW_LOSS))  # poles near the axis: nothing smooth to follow
    found = (*evaluate(omega), np.zeros(omega.size)) if sharp else sampled(evaluate, omega, tolerance)
    values, errors, interpolation = found
    quadrature, truncation = errors.T
    missed = np.zeros(omega.size)
    if tape is not None:
        missed = _missed(evaluate, omega, values)
    if np.any(quadrature > tolerance):
        warnings.warn(f"layered: error {quadrature.max():.1e} > tolerance {tolerance:.1e}", AccuracyWarning, 2)
    if seen is not None and driven is not None:
        values = seen @ values @ driven.T
    rigid = [disc for disc in discs if disc.rigid]
    free = {(d.x, d.y) for d in (*discs_in, *discs_out) if d.radius == 0 and _carrier(d, rigid) is d}
    alone = [[a.radius == b.radius == 0 and (a.x, a.y) == (b.x, b.y) and (a.x, a.y) in free for b in discs_in]
             for a in discs_out]  # fmt: skip
    values[:, np.array(alone, dtype=bool)] = np.nan
    return LayeredResult(values, quadrature, truncation, interpolation, evaluate.n_kernel, missed)


@dataclass
class _Evaluation:
    """Values (n, n_row, n_column) of the rows and columns ``asked`` for and errors (n, 2), quadrature and truncation.

    The latter is of the worst of the ``kinds`` of entries, found at ``every`` so many frequencies. Counts its work
    against the ``expected`` number of them."""

    integrals: Integrals
    system: Galerkin
    discs: Sequence[Disc]
    kinds: tuple[BoolArray, ...]
    asked: tuple[IntArray, IntArray]
    every: int
    expected: int
    progress: Progress | None
    tape: Tape | None = None
    n_kernel: int = 0
    n_frequency: int = 0

    def __call__(self, omega: FloatArray) -> tuple[ComplexArray, FloatArray]:
        rows, columns = self.asked
        values, errors = np.empty((omega.size, rows.size, columns.size), dtype=complex), np.empty((omega.size, 2))
        rising = np.argsort(omega, kind="stable")
        known = np.unique([*range(0, omega.size, self.every), omega.size - 1])
        judged = np.isin(np.arange(omega.size), rising[known])
        for chunk in self.integrals.chunks(omega):
            block = self.integrals.solve(omega[chunk])
            a = self.system.matrix(block.values)
            if self.tape is not None:
                a = self.tape.applied(a, omega[chunk])
            waves = self.integrals.medium.wavenumbers(omega[chunk])[0].max(axis=0)
            decay = decay_of(self.discs, waves, int(self.system.order.max()))
            found, errors[chunk, 1] = self.system.compliance(a, self.kinds, judged[chunk], decay)
            values[chunk], errors[chunk, 0] = found[:, rows][:, :, columns], block.error
            self.n_kernel += block.n_kernel
            self.n_frequency += chunk.size
            tell(self.progress, "layered half-space", min(self.n_frequency, self.expected), self.expected)
        above = np.searchsorted(known, np.arange(omega.size))  # the judged one at or above each
        both = errors[rising[known[above]], 1], errors[rising[known[np.maximum(above - 1, 0)]], 1]
        errors[rising, 1] = np.where(judged[rising], both[0], np.maximum(*both))
        return values, errors


def _missed(evaluate: _Evaluation, omega: FloatArray, values: ComplexArray) -> FloatArray:
    """What the polynomials of a sheet leave out (n_freq,), relative to the largest entry among the driving discs, or
    elsewhere, where that is more.

    From what the last two degrees along each side change, and the two before those, at a few frequencies; between
    these the larger counts. Once polynomials resolve a wave, each two leave out a smaller share of what those before
    did, and the geometric series of these changes holds the rest. What contacts beside the edges excite falls slowly:
    it is alike at all frequencies, so that the least of the changes shows its size.
    """
    tape = evaluate.tape
    assert tape is not None
    rising = np.argsort(omega, kind="stable")
    some = np.unique(np.linspace(0, omega.size - 1, _JUDGED).round().astype(int))
    at = omega[rising[some]]
    found = [values[rising[some]]]
    for count in (tape.count - FEWER, tape.count - 2 * FEWER):
        less = replace(evaluate, tape=replace(tape, count=count), every=omega.size, progress=None)
        found.append(less(at)[0])
    driving = np.isin(evaluate.asked[0], evaluate.asked[1])
    missed = np.zeros(some.size)
    for kind in (driving, ~driving):
        if kind.any():
            size = np.abs(found[0])[:, kind].max(axis=(1, 2))
            last, before = (np.abs(more - less)[:, kind].max(axis=(1, 2)) for more, less in pairwise(found))
            ratio = np.clip(last / np.maximum(before, 1e-300), *_RATIOS)
            missed = np.maximum(missed, np.maximum(last * ratio / (1 - ratio), _SLOW * last.min()) / size)
    above = np.clip(np.searchsorted(some, np.arange(omega.size)), 0, some.size - 1)
    out = np.empty(omega.size)
    out[rising] = np.maximum(missed[above], missed[np.maximum(above - 1, 0)])
    return out


def terms_of(discs: Sequence[Disc], medium: Medium, omega: FloatArray) -> int:
    """Terms that leave about 1e-5, as seen on layers of 80 um to 3 mm and waves to k a = 4; a layer h thin near the top
    makes stresses as narrow as sqrt(a h) at the rim."""
    radius = max((disc.radius for disc in discs if disc.rigid), default=0.0)
    depths = np.cumsum([0.0, *(layer.thickness_m for layer in medium.layers[:-1])])
    near = [layer.thickness_m for layer, top in zip(medium.layers, depths, strict=True) if top < radius]
    thin, wave = math.sqrt(radius / min(near, default=math.inf)), float(medium.wavenumbers(omega)[0].max()) * radius
    return min(max(round(3.5 + 1.5 * thin), round(2 + wave), _TERMS[0]), _TERMS[1])


def scattered_orders(discs: Sequence[Disc]) -> int:
    """Azimuthal orders: a disc answers order l of a wave from r by (a/r)^2l; none where nothing is beside it."""
    if len(discs) == 1:
        return 0
    gaps = [a.radius / (math.hypot(a.x - b.x, a.y - b.y) - b.radius) for a in discs for b in discs
            if a is not b and a.rigid and b.radius > 0]  # fmt: skip
    ratio = min(max(gaps, default=0.1), 0.99)
    return min(max(math.ceil(math.log(_SCATTERED) / (2 * math.log(ratio))), _ORDERS[0]), _ORDERS[1])


def _components(
    discs_in: Sequence[Disc], discs_out: Sequence[Disc]
) -> tuple[list[Disc], IntArray, IntArray, ComplexArray | None, ComplexArray | None]:
    """As :func:`distinct` of the components of all discs, and what each output and input has of them (n, n_components);
    None where all stand upright."""
    if all(disc.axis == UPRIGHT for disc in (*discs_in, *discs_out)):
        return *distinct(discs_in, discs_out), None, None
    rigid = [disc for disc in (*discs_in, *discs_out) if disc.rigid]
    both = []
    for discs in (discs_in, discs_out):
        parts = [
            [(part, share) for part, share in disc.parts if part.component == "z" or _carrier(part, rigid) is part]
            for disc in discs
        ]
        shares = block_diag(*[np.array([[share for _, share in each]], dtype=complex) for each in parts])
        both.append(([part for each in parts for part, _ in each], shares))
    (inputs, driven), (outputs, seen) = both
    return *distinct(inputs, outputs), seen, driven


def _check_omega(omega: FloatArray, tolerance: float) -> None:
    if omega.ndim != 1 or not np.all(np.isfinite(omega)) or np.any(omega <= 0):
        raise ValueError("expected omega as (n_freq,) with finite values > 0 rad/s")
    if not 1e-12 <= tolerance < 1:
        raise ValueError(f"expected 1e-12 <= tolerance < 1, got {tolerance}")


def distinct(discs_in: Sequence[Disc], discs_out: Sequence[Disc]) -> tuple[list[Disc], IntArray, IntArray]:
    """Discs that differ, points under rigid ones left out, and the index (n_out,), (n_in,) of each among them."""
    both = [*discs_out, *discs_in]
    if any(disc.radius < 0 or (disc.rigid and disc.radius == 0) for disc in both):
        raise ValueError("expected disc radii >= 0 m, of rigid discs > 0")
    rigid = list(dict.fromkeys(disc for disc in both if disc.rigid))
    carried = [_carrier(disc, rigid) for disc in both]
    discs = list(dict.fromkeys(carried))
    for a, b in combinations(discs, 2):
        if (a.rigid or b.rigid) and math.hypot(a.x - b.x, a.y - b.y) <= a.radius + b.radius:
            raise ValueError(f"rigid discs may not touch others, got {a} and {b}")
    index = np.array([discs.index(disc) for disc in carried], dtype=int)
    return discs, index[: len(discs_out)], index[len(discs_out) :]


def _carrier(disc: Disc, rigid: Sequence[Disc]) -> Disc:
    """The rigid disc that a point lies under, or ``disc`` itself."""
    if disc.radius > 0:
        return disc
    return next((r for r in rigid if math.hypot(disc.x - r.x, disc.y - r.y) <= r.radius * (1 + 1e-9)), disc)
