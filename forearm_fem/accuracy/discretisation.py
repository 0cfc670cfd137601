"""Discretisation error from a second mesh, with the phase error of waves that neither mesh carries."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..geometry.device.place import place_ports
from ..geometry.device.sizing import tetrahedron_orders
from ..geometry.mesh.tissue_mesh import EDGES, TissueMesh
from ..ports import Port, distances
from ..scenario import Scenario
from ..tissue import Tissue, resolve_tissues
from ..transfer import ErrorEstimate, TransferMatrix, band_error, relative_error
from ..typing import ComplexArray, FloatArray, IntArray
from .estimates import raised_to_row_column_mean

# Phase error of shear waves by numerical dispersion (Ainsworth 2004), which two coarse meshes may share.

REACH = 0.045  # [m] from a contact: beyond, waves that small elements matter to have decayed
_MOST = 0.5  # relative: at larger errors of phase the series is no guide, the wave is simply not carried
_AT_MOST = 24  # frequencies; linear between them


def phase_error(order: int, kh: FloatArray) -> FloatArray:
    """Relative error of the wavenumber k on elements of size h of an ``order`` p, to leading order in ``kh``.

    (p! / (2p)!)^2 (k h)^(2p) / (2 (2p + 1)), Ainsworth (2004), SIAM J. Numer. Anal. 42, equation (3.4); of plane waves
    along an axis of a regular grid, and at most 0.5.
    """
    factor = (math.factorial(order) / math.factorial(2 * order)) ** 2 / (2 * (2 * order + 1))
    return np.asarray(np.minimum(factor * kh ** (2 * order), _MOST))


@dataclass(frozen=True, eq=False)
class NumericalDispersion:
    """By what phase a mesh delays shear waves of any tissue on their straight way from contacts to points.

    ``around`` is what there is near the contacts, ``regions`` name the mesh's tissues, ``away`` (n_out, n_in) [m] are
    the distances from contacts to points.
    """

    around: ElementsNearContacts
    regions: tuple[str, ...]
    away: FloatArray

    @classmethod
    def of(
        cls, scenario: Scenario, mesh: TissueMesh, outputs: tuple[Port, ...], inputs: tuple[Port, ...]
    ) -> NumericalDispersion:
        """Numerical dispersion of a scenario's own ``mesh``."""
        order = tetrahedron_orders(mesh, place_ports(scenario, mesh), scenario.element)
        return cls(ElementsNearContacts.of(mesh, order, inputs), tuple(mesh.region_names), distances(outputs, inputs))

    def phases(self, scenario: Scenario, frequency: FloatArray, scale: float = 1.0) -> FloatArray:
        """Phase [rad] (n_frequency, n_out, n_in) by which elements ``scale`` times as large as the mesh's delay waves
        of the ``scenario``'s tissues, in the one where that is most.

        A wave k = k' - i a gathers k' (error of k') per metre as long as it lasts, (1 - e^(-a r)) / a of r metres. The
        error is a mean over elements up to ``REACH`` from the nearest contact, weighted as a surface wave passes them:
        e^(-k' depth - a r) / r. What waves do that change from one tissue to another is not covered.
        """
        some = np.unique(np.linspace(0, len(frequency) - 1, _AT_MOST).round().astype(int))
        found, tissues = np.zeros((len(some), *self.away.shape)), resolve_tissues(scenario)
        for region, name in enumerate(self.regions):
            if name not in tissues:
                continue
            per_metre, decay = self.around.lag_per_metre(region, tissues[name], frequency[some], scale)
            lasting = -np.expm1(-decay[:, None, None] * self.away) / decay[:, None, None]
            found = np.maximum(found, per_metre[:, None, None] * lasting)
        rows = [np.interp(frequency, frequency[some], column) for column in found.reshape(len(some), -1).T]
        return np.array(rows).T.reshape(len(frequency), *self.away.shape)


@dataclass(frozen=True)
class ElementsNearContacts:
    """Elements around the contacts: root-mean-square edge [m], order, region, volume [m^3], depth and distance [m] from
    the nearest contact, all (n,)."""

    size: FloatArray
    order: IntArray
    region: IntArray
    volume: FloatArray
    depth: FloatArray
    away: FloatArray

    @classmethod
    def of(cls, mesh: TissueMesh, order: IntArray, contacts: tuple[Port, ...]) -> ElementsNearContacts:
        """Elements within ``REACH`` of the ``contacts`` along the skin."""
        corners = mesh.points[mesh.tetrahedra]
        edges = corners[:, EDGES[:, 0]] - corners[:, EDGES[:, 1]]
        size = np.sqrt((edges**2).sum(axis=2).mean(axis=1))
        gap = corners.mean(axis=1)[:, None] - np.array([p.position for p in contacts])
        depth = -np.einsum("ecx,cx->ec", gap, np.array([p.axis for p in contacts]))
        away = np.sqrt(np.maximum((gap**2).sum(axis=2) - depth**2, 0.0))
        nearest = (np.arange(len(away)), away.argmin(axis=1))
        radius = np.array([p.radius for p in contacts])[nearest[1]]
        near = away[nearest] < REACH
        place = np.maximum(depth[nearest], 0.0)[near], np.maximum(away[nearest], radius)[near]
        return cls(size[near], order[near], mesh.region[near], mesh.volumes[near], *place)

    def lag_per_metre(
        self, region: int, tissue: Tissue, frequency: FloatArray, scale: float
    ) -> tuple[FloatArray, FloatArray]:
        """Phase gathered [rad/m] and decay [1/m], both (n_frequency,), of shear waves in one region."""
        k = tissue.wavenumber(2 * np.pi * frequency)
        wave, decay = np.asarray(k.real), np.maximum(-k.imag, 1e-9)
        here = self.region == region
        if not here.any():
            return np.zeros(len(frequency)), decay
        error = np.zeros((len(frequency), int(here.sum())))
        for order in np.unique(self.order[here]):
            mine = self.order[here] == order
            error[:, mine] = phase_error(int(order), wave[:, None] * scale * self.size[here][mine])
        fading = wave[:, None] * self.depth[here] + decay[:, None] * self.away[here]
        weight = self.volume[here] / self.away[here] * np.exp(-(fading - fading.min(axis=1, keepdims=True)))
        return wave * (weight * error).sum(axis=1) / weight.sum(axis=1), decay


# Discretisation error: of a result on one mesh, from its change on a second one with other distances of nodes.

COARSER = 2.0  # size ratio of the second mesh, where it can be made
# Relative error, and the order assumed there: a change of 0.3 and of 0.82 with COARSER (decision 0015).
_RESOLVED, _UNRESOLVED = (0.3 / (COARSER**1.85 - 1), 1.85), (0.82 / (COARSER**3 - 1), 3.0)
# Lags [rad] of waves on the mesh itself between which the order assumed falls to the last number (same decision).
_IN_TIME, _LATE, _LATE_ORDER = 0.04, 0.08, 1.3
_NEIGHBOURHOOD = 1.25  # e(f) listens to frequencies up to this ratio away (a third of an octave)


@dataclass(frozen=True, eq=False)
class DiscretisationError:
    """Discretisation error of values on one mesh.

    band : e_band, as of :func:`estimated_errors`
    error : e(f) (n_frequency,), likewise
    unseen : errors of entries that no change between meshes shows (:func:`dispersion_floor`)
    order : order of convergence assumed (n_frequency,) (:func:`assumed_order`)
    """

    band: float
    error: FloatArray
    unseen: FloatArray
    order: FloatArray


def discretisation_error(
    other: ComplexArray, own: ComplexArray, frequency: FloatArray, ratio: float, lag: FloatArray, coarser: FloatArray
) -> DiscretisationError:
    """Discretisation error of ``own`` values (n_frequency, n_out, n_in): the one rule for scenes, arms and
    verification.

    ``other`` values are those on the second mesh, whose nodes are ``ratio`` times as far apart; waves arrive with a
    ``lag`` [rad] on the mesh itself, and ``coarser`` on the coarser of the two, both shaped like the values.
    """
    unseen, order = dispersion_floor(own, lag, coarser), assumed_order(own, lag)
    return DiscretisationError(*estimated_errors(other, own, frequency, ratio, unseen, order), unseen, order)


def discretisation_of(
    fine: TransferMatrix, coarse: TransferMatrix, scenario: Scenario, mesh: TissueMesh | None
) -> ErrorEstimate:
    """Discretisation error of G on the ``fine`` mesh by its change on the ``coarse`` one; a library has no ``mesh``."""
    ratio, lag = float(coarse.provenance["ratio"]), np.zeros(fine.values.shape)
    coarser = lag
    if mesh is not None:
        lags = NumericalDispersion.of(scenario, mesh, fine.outputs, fine.inputs)
        lag, coarser = (lags.phases(scenario, fine.frequency, scale) for scale in (1.0, max(ratio, 1.0)))
    found = discretisation_error(coarse.values, fine.values, fine.frequency, ratio, lag, coarser)
    pairs = over_pairs(found.error, coarse.values, fine.values, fine.frequency)
    pairs = np.maximum(pairs, found.unseen / np.abs(fine.values).max(axis=(1, 2), keepdims=True))
    largest, change = np.abs(fine.values).max(axis=(1, 2), keepdims=True), band_error(coarse.values, fine.values)
    together = (coarse.values - fine.values) / largest * (found.band / change if change > 0 else 0.0)
    lost = fine.frequency[found.unseen.any(axis=(1, 2))]
    blind = f"; from {lost[0]:g} Hz on at least the lag of waves too short for the elements" if len(lost) else ""
    if mesh is None:
        blind = "; waves too short for both meshes are not looked for, as a library has no mesh"
    return ErrorEstimate(
        "discretisation",
        found.band,
        f"change of G on a second mesh, nodes {ratio:.2g} times as far apart, over |{ratio:.2g}^p - 1|; order p is "
        f"1.85 where that is below 0.115 ({found.order.min():.3g} where waves are latest), 3 above 0.117{blind}",
        tuple(fine.frequency.tolist()),
        tuple(found.error.tolist()),
        pairs,
        together,
    )


def remaining_error(change: FloatArray, ratio: float = COARSER, order: FloatArray | float = _RESOLVED[1]) -> FloatArray:
    """Relative error of a mesh from the relative ``change`` to one whose sizes are ``ratio`` (not 1) times its own.

    An error C h^p changes by C h^p |ratio^p - 1|, so change / |ratio^p - 1| is left. P2 outputs converge like h^3 to
    h^4, like h at rigid rims: ``order`` 1.85 lies between and is on the safe side of what was seen up to an error of
    0.115 (a change of 0.3) where waves are in time (:func:`assumed_order`).
    Beyond a change of 0.82, nearly G itself, the coarser mesh does not carry the waves at all, and the finer one is
    better by order 3 at least. Changes between come from coarser meshes that are as good as useless, whose distance
    tells little: finer ones erred by 0.03 to 0.27 there, and 0.115 to 0.117 is stated.
    """
    (low, _), (high, last) = _RESOLVED, _UNRESOLVED
    near, far = np.abs(ratio**order - 1), abs(ratio**last - 1)
    useless = np.clip((change - low * near) / (high * far - low * near), 0.0, 1.0)
    return np.asarray(change / (near + useless * (far - near)))


def assumed_order(own: ComplexArray, lag: FloatArray) -> FloatArray:
    """Order of convergence (n_frequency,) assumed of ``own`` (n_frequency, n_out, n_in), whose waves arrive with a
    ``lag`` [rad] of the same shape.

    Waves that are late on the mesh itself are carried by elements that have not reached their order: coarser ones
    were seen to be hardly worse, 0.6 to 1.2 of the change was left. Lags count as G's entries do, by their size.
    """
    size = np.abs(own)
    late = (size * lag).max(axis=(1, 2)) / size.max(axis=(1, 2))
    return np.asarray(np.interp(late, (_IN_TIME, _LATE), (_RESOLVED[1], _LATE_ORDER)))


def estimated_errors(
    other: ComplexArray,
    own: ComplexArray,
    frequency: FloatArray,
    ratio: float = COARSER,
    unseen: FloatArray | None = None,
    order: FloatArray | float = _RESOLVED[1],
) -> tuple[float, FloatArray]:
    """e_band and e(f) (n_frequency,) of ``own`` (n_frequency, n_out, n_in), from ``other`` values on the second mesh.

    Errors of two meshes cancel at some frequencies by chance, so e(f) at ``frequency`` (n_frequency,) [Hz], increasing,
    comes from the change there or from the change of the third of an octave on either side, whichever is larger.
    ``order`` is that of :func:`assumed_order`. ``unseen`` are errors of the entries, shaped like them, that no change
    shows: less is never stated.
    """
    size = np.linalg.norm(own, axis=(1, 2))
    whole = remaining_error(np.linalg.norm(other - own, axis=(1, 2)) / size, ratio, order)
    single = remaining_error(smoothed_relative_change(other, own, frequency), ratio, order)
    if unseen is not None:
        whole = np.maximum(whole, np.linalg.norm(unseen, axis=(1, 2)) / size)
        single = np.maximum(single, unseen.max(axis=(1, 2)) / np.abs(own).max(axis=(1, 2)))
    return float(np.linalg.norm(whole * size) / np.linalg.norm(size)), single


def dispersion_floor(own: ComplexArray, lag: FloatArray, coarser: FloatArray) -> FloatArray:
    """Error of ``own`` (n_frequency, n_out, n_in) by the phase ``lag`` [rad] of its waves; zero where meshes tell more.

    Where waves lag by more than 1 rad on the ``coarser`` mesh, both meshes may agree and be wrong. Then the lag of the
    finer one is the error: |e^(-i lag) - 1| = 2 sin(lag / 2).
    """
    size = np.abs(own)
    lost = (size * coarser).max(axis=(1, 2)) > size.max(axis=(1, 2))
    return np.asarray(np.where(lost[:, None, None], size * 2 * np.sin(np.minimum(lag, np.pi) / 2), 0.0))


def smoothed_relative_change(other: ComplexArray, own: ComplexArray, frequency: FloatArray) -> FloatArray:
    """e(f) (n_frequency,) of ``other`` beside ``own``, there or over the third of an octave on either side."""
    worst, largest = relative_error(other, own), np.abs(own).max(axis=(1, 2))
    around = np.sqrt(_around((worst * largest) ** 2, frequency) / _around(largest**2, frequency))
    return np.asarray(np.maximum(worst, around))


def over_pairs(error: FloatArray, other: ComplexArray, own: ComplexArray, frequency: FloatArray) -> FloatArray:
    """|dG_ij| / max_ij |G_ij| (n_frequency, n_out, n_in) of ``own`` values, as large as ``error`` e(f) (n_frequency,)
    says and shared as they change to ``other`` ones on a second mesh; alike where nothing changes.

    Pairs that change less than their output and input do in the mean do so by chance
    (:func:`.raised_to_row_column_mean`).
    """
    change = raised_to_row_column_mean(spread_change(other, own, frequency))
    largest = change.max(axis=(1, 2), keepdims=True)
    shares = np.divide(change, largest, out=np.ones_like(change), where=largest > 0)
    return np.asarray(error[:, None, None] * shares)


def spread_change(other: ComplexArray, own: ComplexArray, frequency: FloatArray) -> FloatArray:
    """Difference of ``other`` from ``own`` values (n_frequency, n, n) at each pair, in the mean over a third of an
    octave on either side: the shape over pairs of an error whose size :func:`estimated_errors` tells. Unknown pairs
    count as equal."""
    change = np.abs(np.nan_to_num(other - own)).reshape(len(frequency), -1)
    rows = [np.sqrt(_around(column**2, frequency)) for column in change.T]
    return np.array(rows).T.reshape(own.shape)


def _around(values: FloatArray, frequency: FloatArray) -> FloatArray:
    """Sum (n_frequency,) of ``values`` over :data:`_NEIGHBOURHOOD` around each increasing frequency."""
    reach = _NEIGHBOURHOOD * (1 + 1e-9)
    first, last = np.searchsorted(frequency, frequency / reach), np.searchsorted(frequency, frequency * reach, "right")
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[last] - total[first])
