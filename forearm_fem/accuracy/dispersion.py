"""Phase error of shear waves by numerical dispersion (Ainsworth 2004), which two coarse meshes may share."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..geometry.device.neighbourhood import tetrahedron_orders
from ..geometry.device.place import place_ports
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..geometry.mesh.topology import EDGES
from ..ports import Port, distances
from ..scenario import Scenario
from ..tissue import Tissue, resolve_tissues
from ..typing import FloatArray, IntArray

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
        """Those of a scenario's own ``mesh``."""
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
        """Those within ``REACH`` along the skin."""
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
