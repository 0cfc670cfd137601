"""The volar skin laid flat, on which the limb and its layered model are compared, and Gaussian loads on it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTri

from ...errors import GeometryError, MeshError
from ...fem.assembly.model import ForearmModel
from ...fem.space.numbering import MixedSpace, facet_points, tabulate
from ...geometry.device.place import Skin
from ...geometry.mesh.tissue_mesh import bent_places
from ...layered.hankel import HankelTable, Radial
from ...layered.integrals import Integrals, Medium
from ...typing import BoolArray, ComplexArray, FloatArray, IntArray

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


# Gaussian loads on the skin, and those of a flat layered body.

# Gaussian loads on the limb's layered model, along its normal and along it.
# Two bells at a distance d meet in four integrals :math:`K_q=\frac1{2\pi}\int_0^\infty k\,U\,e^{-k^2w^2}J_q(kd)\,dk`
# over the surface compliance: U is zz, zx, and half the sum and half the difference of the compliances along and across
# a wave (:mod:`forearm_fem.layered.discs`). With the unit vector e from the one that pushes to the one that reads,
# .. math:: T_{zz}=K_0^{zz},\quad T_{zt}=K_1^{zx}e,\quad T_{tt}=K_0^+I-K_2^-(2ee^T-I).

_TOLERANCE = 1e-6
_AT_ONCE = 64  # distances of one quadrature
_ORDERS = (0, 1, 0, 2)  # q of the four integrals


def between_flat_bells(
    medium: Medium, frequency: FloatArray, width: float, distances: FloatArray, *, sideways: bool = False
) -> ComplexArray:
    """Integrals (n_frequency, 1, n_distance) [m/N] of two bells of ``width`` [m] at increasing ``distances``; all four
    of them with ``sideways``."""
    omega, kinds, parts = 2 * np.pi * frequency, len(_ORDERS) if sideways else 1, []
    for piece in np.array_split(distances, max(1, len(distances) // _AT_ONCE)):
        kernel, place = (a.ravel() for a in np.indices((kinds, len(piece))))
        order = np.array(_ORDERS)[kernel]
        sure = (order > 0) & (piece[place] == 0)  # J_q(0) = 0
        kernel, place, order = kernel[~sure], place[~sure], order[~sure]
        zero = np.zeros(len(kernel), dtype=int)
        table = HankelTable((Radial("bell", width),), kernel, zero, zero, order, piece[place])
        integrals, out = Integrals(medium, table, _TOLERANCE), np.zeros((len(omega), kinds, len(piece)), dtype=complex)
        for chunk in integrals.chunks(omega):
            out[chunk[:, None], kernel, place] = integrals.solve(omega[chunk]).values
        parts.append(out)
    return np.concatenate(parts, axis=2)


def flat_compliance(
    integrals: ComplexArray, distances: FloatArray, centres: FloatArray, sideways: FloatArray
) -> ComplexArray:
    """Compliance (..., n + 2 s, n + 2 s) between bells along the normal at ``centres`` (n, 2), then along u and along v
    at ``sideways`` (s, 2), from ``integrals`` (..., 1 or 4, n_distance) at the ``distances`` of them all."""
    n, s = len(centres), len(sideways)
    out = np.empty((*integrals.shape[:-2], n + 2 * s, n + 2 * s), dtype=complex)
    out[..., :n, :n] = integrals[..., 0, :][..., _number(distances, centres, centres)]
    if s:
        number, e = _number(distances, centres, sideways), _directions(centres, sideways)
        coupling = np.concatenate([integrals[..., 1, :][..., number] * along for along in e], axis=-1)
        out[..., :n, n:], out[..., n:, :n] = coupling, coupling.swapaxes(-1, -2)
        number, e = _number(distances, sideways, sideways), _directions(sideways, sideways)
        even, odd = integrals[..., 2, :][..., number], integrals[..., 3, :][..., number]
        for i in range(2):
            for j in range(2):
                block = even * (i == j) - odd * (2 * e[i] * e[j] - (i == j))
                out[..., n + i * s : n + (i + 1) * s, n + j * s : n + (j + 1) * s] = block
    return out


def pair_distances(centres: FloatArray) -> FloatArray:
    """The distinct distances (m,) [m] between any two of ``centres`` (n, 2), rising."""
    return np.unique(_distances(centres, centres))


def _distances(some: FloatArray, others: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(some[:, None] - others[None], axis=2).round(9))


def _number(distances: FloatArray, some: FloatArray, others: FloatArray) -> IntArray:
    """Indices into ``distances`` for each pair (n, m)."""
    return np.searchsorted(distances, _distances(some, others))


def _directions(some: FloatArray, others: FloatArray) -> FloatArray:
    """Unit vectors (2, n, m) from ``others`` (m, 2) to ``some`` (n, 2); zero between a place and itself."""
    way = np.moveaxis(some[:, None] - others[None], 2, 0)
    length = np.linalg.norm(way, axis=0)
    return np.asarray(way / np.where(length > 0, length, 1.0))


# Smooth loads on the skin: bells of force, narrow beside waves, wide beside elements, that need no rim in a mesh.

_REACH = 4.5  # widths beyond which a bell is nothing: 4e-5 of its middle
_DEGREE = 19  # of the rule on a facet: exact enough for bells a quarter of a facet wide
_LEAST = 20  # points of the rule under a bell


@dataclass(frozen=True)
class GaussianLoads:
    """Loads exp(-r^2 / 2 width^2) about ``centres`` (n, 2), flat coordinates, along ``axes`` (n, 3); ``width`` [m]."""

    centres: FloatArray
    axes: FloatArray
    width: float


def bell_functionals(model: ForearmModel, skin: FlatSkin, bells: GaussianLoads) -> csr_array:
    """Functionals (n, n_bell): the mean of the displacement along each bell's axis, weighted with it.

    A unit force on a bell loads the system with the same vector, so what is found is reciprocal.
    """
    space = model.space
    places, values = _skin_rule(space, skin, bells)
    weights = _weights(places, bells)
    scalar = csr_array(weights @ values)
    scalar = coo_array(csr_array((1 / scalar.sum(axis=1))[:, None] * scalar))  # the basis adds up to one
    rows = (3 * scalar.col[:, None] + np.arange(3)).ravel()
    entries = (scalar.data[:, None] * bells.axes[scalar.row]).ravel()
    shape = (3 * space.n_nodes, len(bells.centres))
    full = csr_array(coo_array((entries, (rows, np.repeat(scalar.row, 3))), shape=shape))
    free = csr_array(model.constraints.transform.T @ full)
    n = model.operator.n
    return csr_array((free.data, free.indices, np.pad(free.indptr, (0, n - free.shape[0]), "edge")), (n, shape[1]))


def _skin_rule(space: MixedSpace, skin: FlatSkin, bells: GaussianLoads) -> tuple[FloatArray, csr_array]:
    """Flat places (m, 2) of a rule on the skin under the bells; matrix (m, n_nodes) of its weights times the basis."""
    reference, weights = get_quadrature(RefTri, _DEGREE)
    tets, local = space.owners(_facets_under(space, skin, bells))
    places, rows, columns, entries, count = [], [], [], [], 0
    for f in np.unique(local):
        mine, points = tets[local == f], facet_points(int(f), reference)
        values, _ = tabulate(space.pair.displacement, points)
        jacobians = space.jacobians_at(mine, points)
        sides = jacobians @ facet_points(int(f), np.eye(2)) - jacobians @ facet_points(int(f), np.zeros((2, 1)))
        measure = np.linalg.norm(np.cross(sides[..., 0], sides[..., 1]), axis=2) * weights
        where = bent_places(space.mesh.points[space.vertices[mine]], space.offsets[mine], points)
        places.append(skin.flat(where.reshape(-1, 3)))
        number = count + np.arange(measure.size).reshape(measure.shape)
        block = measure[:, None, :] * values[None]
        rows.append(np.broadcast_to(number[:, None], block.shape).ravel())
        columns.append(np.broadcast_to(space.nodes[mine][:, :, None], block.shape).ravel())
        entries.append(block.ravel())
        count += measure.size
    matrix = coo_array((np.hstack(entries), (np.hstack(rows), np.hstack(columns))), shape=(count, space.n_nodes))
    return np.vstack(places), csr_array(matrix)


def _facets_under(space: MixedSpace, skin: FlatSkin, bells: GaussianLoads) -> IntArray:
    """Facets (k, 3) of the skin with a corner near a bell, or wide enough to have one inside."""
    facets = space.mesh.facets["skin"]
    corners = skin.flat(space.mesh.points[facets.ravel()]).reshape(-1, 3, 2)
    size = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    reach = _REACH * bells.width + np.where(np.isfinite(size), size, 0.0)[:, None]
    low, high = bells.centres.min(axis=0), bells.centres.max(axis=0)
    inside = ((corners > low - reach[..., None]) & (corners < high + reach[..., None])).all(axis=2)
    return np.asarray(facets[inside.any(axis=1)])


def _weights(places: FloatArray, bells: GaussianLoads) -> csr_array:
    """Gaussian loads (n, m) at flat ``places`` (m, 2); those off the volar skin have none."""
    known = np.flatnonzero(np.isfinite(places).all(axis=1))
    near = cKDTree(places[known]).query_ball_point(bells.centres, _REACH * bells.width)
    counts = np.array([len(found) for found in near])
    if counts.min() < _LEAST:
        raise MeshError("the skin under the library's patch has gaps; use smaller elements (accuracy, mesh.size_grid)")
    rows, columns = np.repeat(np.arange(len(near)), counts), known[np.concatenate(near).astype(int)]
    away = np.linalg.norm(places[columns] - bells.centres[rows], axis=1)
    return csr_array(
        coo_array((np.exp(-0.5 * (away / bells.width) ** 2), (rows, columns)), shape=(len(near), len(places)))
    )
