"""The volar skin laid flat: lengths along it, in which the limb and its layered model are compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from ...errors import GeometryError
from ...geometry.device.place import Skin
from ...typing import BoolArray, FloatArray

_STEP = 2.5e-4  # [m] between samples of the skin across the limb; ten times that along it
_FACING = 0.1  # smallest n_z of skin that is laid flat: 84 degrees to the side
_SHORT = 5e-4  # [m] between places whose difference is a tangent
_ROUNDS = 5  # from flat places to those on the limb: each leaves a hundredth or less
_ROUNDING = 1e-9  # [m] beyond the last sample that is none
_NEAR = 5e-3  # [m] from the volar skin: points of the mesh further away are the limb's other side


@dataclass(frozen=True)
class FlatSkin:
    """Flat coordinates (u, v) [m] of the volar skin: u along the line y = 0, v along the section, both from the origin.

    ``x`` (n,), ``y`` (m,) are samples, ``along`` (n, m) u, ``across`` (n, m) v, NaN off the skin, ``height`` (n, m) its
    z. Distances in (u, v) are those on a cylinder exactly and on a cone nearly: its sections are bent where it is laid
    flat (:func:`_flattened`). What no plane has, a profile that bends along the limb, stretches u: by 6 % at most on
    the default forearm 30 mm off its middle line. ``skin`` lands places on the limb itself.
    """

    x: FloatArray
    y: FloatArray
    along: FloatArray
    across: FloatArray
    height: FloatArray
    skin: Skin

    def flat(self, points: FloatArray) -> FloatArray:
        """(u, v) (n, 2) of ``points`` (n, 3) on or near the skin; NaN where the volar skin is not."""
        u, v, z = (self._at(a, points[:, :2]) for a in (self.along, self.across, self.height))
        result = np.column_stack([u, v])
        result[~(np.abs(points[:, 2] - z) < _NEAR)] = np.nan
        return result

    @cached_property
    def curvature(self) -> float:
        """Of the section, in its middle half [1/m]: the angle that the skin turns by over a length along it."""
        angle = np.arctan(np.gradient(self.height, self.y, axis=1))
        quarter = len(self.y) // 4
        turned = np.gradient(angle, axis=1) / np.gradient(self.across, axis=1)
        return float(np.nanmedian(np.abs(turned[:, quarter:-quarter])))

    def places(self, flat: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (n, 3) and outward normals (n, 3) at ``flat`` (n, 2); NaN off the skin."""
        middle, bent = self.along[:, len(self.y) // 2], np.zeros(len(flat))
        for _ in range(_ROUNDS):
            u = flat[:, 0] - bent
            there = np.clip(u, *middle[[0, -1]])
            x = np.where(np.abs(u - there) < _ROUNDING, np.interp(there, middle, self.x), np.nan)
            after = np.clip(np.searchsorted(self.x, x), 1, len(self.x) - 1)
            share = (x - self.x[after - 1]) / (self.x[after] - self.x[after - 1])
            rows = self.across[after - 1] * (1 - share)[:, None] + self.across[after] * share[:, None]
            y = np.array([_inverse(v, row, self.y) for v, row in zip(flat[:, 1], rows, strict=True)])
            bent = self._at(self.along - middle[:, None], np.column_stack([x, y]))
        return self.skin(np.column_stack([x, y]))

    def tangents(self, flat: FloatArray) -> FloatArray:
        """Unit vectors (2, n, 3) along u and along v at ``flat`` (n, 2), at right angles to the normal and each other.

        Differences over a short way towards the middle, where there is skin. What is left of an angle between lines of
        u and of v on a limb that is no cone is taken from that of v.
        """
        here, normals = self.places(flat)
        inward = np.where(flat > 0, -_SHORT, _SHORT)
        u, v = (sign[:, None] * (self.places(flat + inward * way)[0] - here)
                for way, sign in zip(np.eye(2), np.sign(inward).T, strict=True))  # fmt: skip
        along = _unit(_across(u, normals))
        return np.stack([along, _unit(_across(_across(v, normals), along))])

    def stretch(self, places: FloatArray) -> FloatArray:
        """By which share (n, n) lengths on the limb are longer than flat ones between any two ``places`` (n, 2).

        It is that of the skin halfway, along the line between; zero between a place and itself.
        """
        i, j = np.indices((len(places), len(places))).reshape(2, -1)
        way, middle = places[i] - places[j], 0.5 * (places[i] + places[j])
        length = np.linalg.norm(way, axis=1)
        step = _SHORT * way / np.where(length > 0, length, 1.0)[:, None]
        ends = [self.places(middle + side * step)[0] for side in (-0.5, 0.5)]
        longer = np.linalg.norm(ends[1] - ends[0], axis=1) / _SHORT - 1
        return np.asarray(np.where(length > 0, longer, 0.0).reshape(len(places), -1))

    def _at(self, values: FloatArray, places: FloatArray) -> FloatArray:
        """``values`` (n, m) of the samples at ``places`` (k, 2) in x and y; NaN off them."""
        return np.asarray(RegularGridInterpolator((self.x, self.y), values, bounds_error=False)(places))


def flat_skin(skin: Skin, length: float, width: float, margin: float = 0.0) -> FlatSkin:
    """The skin over at least ``length`` by ``width`` [m], in its own lengths, about the origin.

    What lies up to ``margin`` [m] beside it is laid flat, too, as far as there is skin. Raises GeometryError where the
    limb is shorter or narrower than the patch.
    """
    x = np.linspace(-0.5, 0.5, 2 * round(length / (20 * _STEP)) + 1) * (length + 2 * margin)
    y = np.linspace(-0.5, 0.5, 2 * round(width / (2 * _STEP)) + 1) * (width + 2 * margin)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    points, normals = skin(grid)
    z = np.where(normals[:, 2] > _FACING, points[:, 2], np.nan).reshape(len(x), len(y))
    made = FlatSkin(x, y, *_flattened(x, y, z), z, skin)
    corners = np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 1)]) * 0.499 * np.array([length, width])
    if not np.isfinite(made.places(corners)[0]).all():
        raise GeometryError(
            f"the library's patch of {length * 1e3:.3g} x {width * 1e3:.3g} mm reaches beyond the volar skin of this "
            "limb; reduce library.length or library.width, or use a longer or wider limb"
        )
    return made


def _from_middle(steps: FloatArray) -> FloatArray:
    """Sums (..., n + 1) of ``steps`` (..., n) from the middle, against it with their sign; NaN beyond the first gap on
    either side."""
    middle = steps.shape[-1] // 2
    after = np.cumsum(steps[..., middle:], axis=-1)
    before = np.cumsum(steps[..., :middle][..., ::-1], axis=-1)[..., ::-1]
    return np.concatenate([-before, np.zeros((*steps.shape[:-1], 1)), after], axis=-1)


def _flattened(x: FloatArray, y: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """u and v (n, m) of the skin of height ``z`` (n, m), NaN off it.

    With s the length along a section from its middle, places of equal s run on at an angle of sine F = r_x . t, the
    derivative of the place with x at constant s times the section's unit tangent t. So that lengths and angles are kept
    once flat, u grows by F and v by sqrt(1 - F^2) along a section. F s' is z_x z_y - s_x s' with s' = ds/dy.
    """
    length = _from_middle(np.hypot(np.diff(y), np.diff(z, axis=1)))
    slope_x, slope_y, per_y = np.gradient(z, x, axis=0), np.gradient(z, y, axis=1), np.gradient(length, y, axis=1)
    shift = slope_x * slope_y - np.gradient(length, x, axis=0) * per_y
    less = per_y - np.sqrt(np.maximum(per_y**2 - shift**2, 0.0))
    bent, short = (_from_middle(0.5 * (rate[:, 1:] + rate[:, :-1]) * np.diff(y)) for rate in (shift, less))
    along = _from_middle(np.hypot(np.diff(x), np.diff(z[:, len(y) // 2])))
    return along[:, None] + bent, length - short


def _inverse(v: float, lengths: FloatArray, y: FloatArray) -> float:
    known: BoolArray = np.isfinite(lengths)
    if not known.any():
        return float("nan")
    return float(np.interp(v, lengths[known], y[known], left=np.nan, right=np.nan))


def _across(vectors: FloatArray, axes: FloatArray) -> FloatArray:
    """Components of ``vectors`` (n, 3) across the unit vectors ``axes`` (n, 3)."""
    return np.asarray(vectors - (vectors * axes).sum(axis=1)[:, None] * axes)


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])
