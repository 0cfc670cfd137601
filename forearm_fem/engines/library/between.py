"""Answers between the places and frequencies that were solved."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.linalg
from numpy.polynomial import chebyshev
from scipy.interpolate import CubicSpline
from scipy.special import j0, j1, spherical_jn

from ...ports import Port
from ...typing import ComplexArray, FloatArray, IntArray

# Parts of a band, in each of which waves are taken as equally long, and what is smooth in frequency follows from few
# nodes.

_RATIO = 1.6  # between the ends of a part, about
NODES = 12  # of each part


@dataclass(frozen=True)
class Bands:
    """Parts with ``edges`` (k + 1,) [Hz], rising."""

    edges: FloatArray

    @classmethod
    def of(cls, low: float, high: float) -> Bands:
        """The parts of ``low`` to ``high`` [Hz]."""
        count = max(1, round(np.log(high / low) / np.log(_RATIO)))
        return cls(np.geomspace(low, high, count + 1))

    @property
    def nodes(self) -> FloatArray:
        """Chebyshev nodes (k, NODES) [Hz] in the root of the frequency, rising."""
        x = -np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        low, high = np.sqrt(self.edges[:-1, None]), np.sqrt(self.edges[1:, None])
        return np.asarray((low + 0.5 * (high - low) * (x + 1)) ** 2)

    def number(self, frequency: FloatArray) -> IntArray:
        """The part (n,) that each ``frequency`` (n,) lies in."""
        return np.clip(np.searchsorted(self.edges, frequency, "right") - 1, 0, len(self.edges) - 2)

    def between(self, frequency: FloatArray) -> FloatArray:
        """Matrices (n, NODES) that carry values at the nodes of its part to each ``frequency`` (n,)."""
        part = self.number(frequency)
        low, high = np.sqrt(self.edges[part]), np.sqrt(self.edges[part + 1])
        x = 2 * (np.sqrt(frequency) - low) / (high - low) - 1
        at = -np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        inverse = np.linalg.inv(chebyshev.chebvander(at, NODES - 1))
        return np.asarray(chebyshev.chebvander(x, NODES - 1) @ inverse)


# From loads on a lattice to any disc or point: Gaussian-process regression with a prior of waves.
# The limb's difference from its layered model is smooth: waves no shorter than the tissues' carry it. Its
# prior is :math:`E|\hat d(k)|^2\propto(1+k^2/\kappa^2)^{-p}` with kappa a multiple of the shortest wavenumber, for the
# place of the source and that of the receiver alike. Gaussian loads on the lattice have the transform
# :math:`e^{-k^2w^2/2}`, rigid discs :math:`\sin ka/ka`, the tilt of these ik times :math:`3j_1(ka)/ka`, pressure
# :math:`2J_1(ka)/ka`, points 1: covariances between any two are one-dimensional integrals, and the regression both
# moves a load between lattice places and changes its shape.

_POWER = 4.0  # p of the prior
_NODES = 400  # of the rule over wavenumbers
_LONGEST = 6.0  # kappa: wavenumbers up to which the prior is integrated
_STEP, _FARTHEST = 1e-4, 0.05  # [m] between tabulated distances; of which tables are as long as multiples
_ASIDE = 1e-4  # [m] either way, for slopes: these err by (k times this)^2/6, .002 of the shortest waves' at 500 Hz
_X, _W = np.polynomial.legendre.leggauss(_NODES)


@dataclass(frozen=True)
class Shape:
    """Force distribution of a port: the ``kind`` of its transform and its ``size`` [m], radius or width."""

    kind: str
    size: float

    def transform(self, k: FloatArray) -> FloatArray:
        """Its transform at ``k`` (n,) [1/m]."""
        x = k * self.size
        match self.kind:
            case "bell":
                return np.asarray(np.exp(-0.5 * x**2))
            case "rigid":
                return np.asarray(np.sinc(x / np.pi))
            case "tilt":
                return np.asarray(np.where(x > 0.05, 3 * spherical_jn(1, x) / np.where(x > 0, x, 1.0), 1 - x**2 / 10))
            case "pressure":
                return np.asarray(np.where(x > 0, 2 * j1(x) / np.where(x > 0, x, 1.0), 1.0))
            case _:
                return np.ones_like(k)


def shape_of(port: Port) -> Shape:
    """The shape of a contact or point."""
    if port.kind == "point":
        return Shape("point", 0.0)
    return Shape("pressure" if port.contact == "pressure" else "rigid", port.radius)


@dataclass(frozen=True)
class Prior:
    """Waves up to about ``kappa`` [1/m], and what is no wave: ``noise``, relative to a bell's variance."""

    kappa: float
    noise: float

    def covariance(self, one: Shape, other: Shape, distance: FloatArray) -> FloatArray:
        """Covariance of what two shapes see at ``distance`` [m] (any shape)."""
        farthest = round(float(distance.max(initial=0.0)) / _FARTHEST + 0.5) * _FARTHEST
        return np.asarray(_curve(self.kappa, one, other, farthest)(distance))


@lru_cache(maxsize=512)
def _curve(kappa: float, one: Shape, other: Shape, farthest: float) -> CubicSpline:
    """Covariance over distance up to ``farthest`` [m]."""
    k = 0.5 * _LONGEST * kappa * (_X + 1)
    density = 0.5 * _LONGEST * kappa * _W * k * (1 + (k / kappa) ** 2) ** -_POWER
    density = density * one.transform(k) * other.transform(k)
    grid = np.arange(0.0, farthest + 2 * _STEP, _STEP)
    return CubicSpline(grid, j0(np.multiply.outer(grid, k)) @ density)


@dataclass(frozen=True)
class Lattice:
    """Gaussian loads of ``shape`` at ``centres`` (n, 2) under a ``prior``, with the inverse (n, n) of their
    covariance."""

    centres: FloatArray
    shape: Shape
    prior: Prior
    inverse: FloatArray

    @classmethod
    def of(cls, centres: FloatArray, width: float, prior: Prior) -> Lattice:
        """The lattice of bells of ``width`` [m]."""
        shape = Shape("bell", width)
        covariance = prior.covariance(shape, shape, _distances(centres, centres))
        covariance[np.diag_indices(len(centres))] *= 1 + prior.noise + 1e-9
        inverse = scipy.linalg.cho_solve(scipy.linalg.cho_factor(covariance), np.eye(len(centres)))
        return cls(centres, shape, prior, 0.5 * (inverse + inverse.T))

    def weights(self, shape: Shape, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gaussian loads (n, k) that stand for a ``shape`` at ``places`` (k, 2); the variance there (2, k), before and
        known."""
        seen = self.prior.covariance(shape, self.shape, _distances(self.centres, places))
        found = self.inverse @ seen
        own = self.prior.covariance(shape, shape, np.zeros(1))[0]
        known = np.einsum("nk,nk->k", seen, found)
        return found, np.stack([np.full(len(places), own), np.minimum(known, own)])

    def slopes(self, shape: Shape, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gaussian loads (n, 2 k) [1/m] that stand for the slopes, along u, then along v, of what a ``shape`` sees at
        ``places`` (k, 2); the variance there (2, 2 k) [1/m^2], before and known."""
        seen = np.hstack([
            self.prior.covariance(shape, self.shape, _distances(self.centres, places + way))
            - self.prior.covariance(shape, self.shape, _distances(self.centres, places - way))
            for way in np.eye(2) * _ASIDE
        ]) / (2 * _ASIDE)  # fmt: skip
        found = self.inverse @ seen
        here, beside = self.prior.covariance(shape, shape, np.array([0.0, 2 * _ASIDE]))
        own = (here - beside) / (2 * _ASIDE**2)
        return found, np.stack([np.full(seen.shape[1], own), np.minimum(np.einsum("nk,nk->k", seen, found), own)])

    def left_out(self, values: ComplexArray) -> ComplexArray:
        """Leave-one-out residuals of the rows of ``values`` (n, n), in units of the prior's spread."""
        return np.asarray((self.inverse @ values) / np.sqrt(self.inverse.diagonal())[:, None])


def _distances(some: FloatArray, others: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(some[:, None] - others[None], axis=2))
