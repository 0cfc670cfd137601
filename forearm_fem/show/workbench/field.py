"""Motion of the skin for the page, of finite elements or flat layers; arrays as text in JSON."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import Delaunay, QhullError

from ...device import contact_state
from ...engines.layered import flat_disc, flat_layers, flat_surface
from ...geometry.mesh.tissue_mesh import vertex_areas
from ...layered import Disc, layered_compliance
from ...ports import Port, positions
from ...scenario import Scenario
from ...typing import ComplexArray, FloatArray, IntArray
from ..data import Results
from ..film import body_of
from ..motion import MM, volume_grid

Kind = Literal["f4", "f8", "i2", "u2", "u4", "i4", "u1", "c8", "c16"]


def packed(values: Any, kind: Kind) -> dict[str, Any]:
    """``values`` as ``kind``; complex ones lie as pairs (real, imaginary). The page reads it in ``numeric.js``."""
    array = np.asarray(values)
    data = np.ascontiguousarray(array.astype(f"<{kind}")).tobytes()
    return {"kind": kind, "shape": list(array.shape), "data": base64.b64encode(data).decode()}


def in_half_precision(basis: Any) -> dict[str, Any]:
    """``basis`` (..., k) in 16 bits a value: column by column in parts of its largest, to 1.5e-5 of it."""
    array = np.asarray(basis)
    scale = np.abs(array).reshape(-1, array.shape[-1]).max(axis=0) / 32767
    scale[scale == 0] = 1.0
    return {"scale": packed(scale, "f4"), "values": packed(np.rint(array / scale), "i2")}


def amplitudes_in_half_precision(amplitudes: ComplexArray) -> dict[str, Any]:
    """``amplitudes`` (n_frequency, k, n_input) in 16 bits a part: each frequency and input in parts of its largest."""
    scale = np.abs(amplitudes).max(axis=1, keepdims=True) / 32767
    scale[scale == 0] = 1.0
    parts = np.stack([(amplitudes / scale).real, (amplitudes / scale).imag], axis=-1)
    return {"scale": packed(scale[:, 0], "f4"), "values": packed(np.rint(parts), "i2")}


_TOLERANCE = 3e-3  # of the motion at each frequency and contact, in the mean over the skin: far below G's own error
_MOST = 160  # shapes: what a page of 15 MB holds of the thesis' scene
_WEAK = 1e-10  # of the strongest combination of modes: below is rounding
_LEAST_FORCE = 1e-9  # of the largest: a drive that gives no force says nothing about the motion per newton


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface drawn: ``rest`` (n, 3) [mm], ``normals`` (n, 3), triangles ``faces`` (m, 3), ``shapes`` (n, 3 or 1,
    k).

    One component stands for the one along the normal. ``tissue`` (m,) numbers ``tissues`` in a section.
    """

    rest: FloatArray
    normals: FloatArray
    faces: IntArray
    shapes: FloatArray
    tissue: IntArray | None = None
    tissues: tuple[str, ...] = ()
    name: str = "skin"


@dataclass(frozen=True, eq=False)
class Field:
    """``amplitudes`` (n_frequency, k, n_contact) [m/N] of the surfaces' shapes, or None: the points' own displacements.

    ``error`` [-] is what the shapes leave out, relative to the skin's motion; ``words`` say what is drawn.
    """

    surfaces: tuple[Surface, ...]
    amplitudes: ComplexArray | None
    error: float
    words: str


def solved_field(results: Results) -> Field:
    """The field of a run by finite elements, on the bins of its sweep.

    The folder keeps motion per volt; the forces per volt, from the compliance, turn it into motion per newton.
    """
    skin = body_of(results, "", "")
    faces = np.asarray(skin.dataset.faces).reshape(-1, 4)[:, 1:]
    sections = _sections(results)
    modes = np.concatenate([skin.modes, *(s.shapes for s in sections)])
    weights = np.repeat(np.sqrt(vertex_areas(skin.rest, faces)), 3)  # a fine mesh weighs no more than a coarse one
    left, amplitudes, error = _fewer(skin.modes, weights, per_newton(results))
    shapes = (modes.reshape(-1, modes.shape[2]) @ left).reshape(len(modes), 3, -1)
    ends = np.cumsum([len(skin.rest), *(len(s.rest) for s in sections)])
    parts = np.split(shapes, ends[:-1])
    surfaces = [Surface(skin.rest, skin.normals, faces, parts[0])]
    surfaces += [
        Surface(s.rest, s.normals, s.faces, part, s.tissue, s.tissues, s.name)
        for s, part in zip(sections, parts[1:], strict=True)
    ]
    return Field(tuple(surfaces), amplitudes, error, "motion of the skin as solved")


def per_newton(results: Results) -> ComplexArray:
    """Amplitudes (n_frequency, r, n_contact) [m/N] of the wavefield's modes per unit force on each contact.

    A contact that no drive pushes (out of contact) keeps zero motion.
    """
    force = contact_state(results.compliance, results.scenario.device).force
    largest = np.linalg.norm(force, axis=(1, 2), ord=2)[:, None, None]
    inverse = np.linalg.pinv(force / largest, rcond=_LEAST_FORCE) / largest
    return np.asarray(results.wavefield.amplitudes @ inverse)


def _fewer(modes: FloatArray, weights: FloatArray, states: ComplexArray) -> tuple[FloatArray, ComplexArray, float]:
    """Combinations (r, k) of ``modes`` (n, 3, r) that hold the motion, their amplitudes, and what is left out.

    The motion at each frequency and contact counts alike; singular values of modes times states, by way of the modes'
    Gram matrix (585 x 585 in the thesis' scene, where the motion itself is 30 times as tall).
    """
    flat = weights[:, None] * modes.reshape(-1, modes.shape[2])
    values, vectors = np.linalg.eigh(flat.T @ flat)
    kept = values > _WEAK * values[-1]
    root = np.sqrt(values[kept])
    whitened = (root[:, None] * vectors[:, kept].T) @ states
    left, amplitudes, error = few_shapes(whitened)
    return np.asarray(vectors[:, kept] / root @ left), amplitudes, error


def few_shapes(motion: ComplexArray) -> tuple[FloatArray, ComplexArray, float]:
    """Real orthonormal ``shapes`` (n, k), ``amplitudes`` (n_frequency, k, n_input) and the rms of what they leave out.

    ``motion`` is (n_frequency, n, n_input); every column counts with length 1.
    """
    size = np.linalg.norm(motion, axis=1, keepdims=True)
    columns = np.moveaxis(motion / np.where(size > 0, size, 1), 1, 0).reshape(motion.shape[1], -1)
    parts = np.concatenate([columns.real, columns.imag], axis=1)
    tall = parts.shape[0] > parts.shape[1]  # then the smaller Gram matrix has the same values, in a tenth of the time
    values, vectors = np.linalg.eigh(parts.T @ parts if tall else parts @ parts.T)
    values, vectors = np.maximum(values[::-1], 0), vectors[:, ::-1]
    left_out = np.sqrt(np.maximum(1 - np.cumsum(values) / values.sum(), 0))
    count = min(int(np.searchsorted(-left_out, -_TOLERANCE)) + 1, _MOST, len(values))
    shapes = np.linalg.qr(parts @ vectors[:, :count])[0] if tall else vectors[:, :count]
    return shapes, np.asarray(shapes.T @ motion), float(left_out[count - 1])


def _sections(results: Results) -> tuple[Surface, ...]:
    """The limb cut along and across through the middle of the grid; ``shapes`` are still the wavefield's modes."""
    mesh = results.mesh
    modes = results.wavefield.modes[: len(mesh.points)]
    grid = volume_grid(mesh)
    grid.point_data["modes"] = modes.reshape(len(modes), -1).astype(np.float32)
    centre = MM * np.mean([p.position for p in results.transfer.outputs], axis=0)
    names = tuple(mesh.region_names)
    found = list[Surface]()
    for name, axis in (("along", "y"), ("across", "x")):
        # a plane through a layer of vertices would meet tetrahedra edge on
        cut = grid.slice(normal=axis, origin=centre + 1e-3).triangulate()
        if cut.n_cells:
            faces, rest = np.asarray(cut.faces).reshape(-1, 4)[:, 1:], np.asarray(cut.points, dtype=float)
            normals = np.tile(np.array([0.0, 0.0, 1.0]), (len(rest), 1))  # coloured by motion towards the volar side
            shapes = np.asarray(cut.point_data["modes"], dtype=float).reshape(len(rest), 3, -1)
            found.append(Surface(rest, normals, faces, shapes, np.asarray(cut.cell_data["region"]), names, name))
    return tuple(found)


MARGIN = 0.016  # [m] of skin around the run's ports, in which actuators can stand
_MM = 1e3
_SIDE = 61  # vertices along the longer side
_AT_ONCE = 12  # radii: motion from each to each is computed too, unasked
_FLAT_TOLERANCE = 1e-3  # of the picture's field; G itself is as the run computed it


def flat_field(ports: tuple[Port, ...]) -> Field:
    """Flat skin around the ports of a layered run; the page knows its motion from one disc's, at growing distance."""
    surface = _rectangle(positions(ports)[:, :2], MARGIN)
    shapes = np.zeros((len(surface.rest), 1, 1))
    words = "flat skin of the layered model; waves that rigid cones scatter are in G, not in the picture"
    return Field((_with(surface, shapes),), None, 0.0, words)


def profile(scenario: Scenario, contact: Port, frequency: FloatArray, radii: FloatArray) -> ComplexArray:
    """Normal motion (n_frequency, n_radius) [m/N] at radii from 0 on; the cone's own mean at radius 0."""
    disc = flat_disc(contact)
    centred = Disc(0.0, 0.0, disc.radius, disc.contact)

    def seen(some: FloatArray) -> ComplexArray:
        """Compliance (n_frequency, 1 + n) of the disc itself and of points at the radii ``some``."""
        found = layered_compliance(
            flat_layers(scenario), 2 * np.pi * frequency, [centred], [centred, *(Disc(float(r), 0.0) for r in some)],
            surface=flat_surface(scenario.tissues), tolerance=_FLAT_TOLERANCE,
        )  # fmt: skip
        return found.values[:, :, 0]

    groups = [seen(part) for part in np.split(radii[1:], range(_AT_ONCE, len(radii) - 1, _AT_ONCE))]
    return np.concatenate([groups[0][:, :1], *(g[:, 1:] for g in groups)], axis=1)


def between_points(ports: tuple[Port, ...]) -> Field:
    """A surface through measured points: thin plate between them, nothing beyond them; for the eye only.

    Points on a line carry a straight interpolation along it.
    """
    places = positions(ports)[:, :2]
    surface = _rectangle(places, 0.0)
    at = surface.rest[:, :2] / _MM
    try:
        net: Delaunay | None = Delaunay(places)
    except (QhullError, ValueError):  # the points span no area
        net = None
    if net is None:
        weights = RBFInterpolator(places, np.eye(len(places)), kernel="linear", degree=0)(at)
        inside = np.ones(len(at), dtype=bool)
    else:
        weights = RBFInterpolator(places, np.eye(len(places)), kernel="thin_plate_spline")(at)
        inside = net.find_simplex(at, tol=1e-6) >= 0
    faces = surface.faces[inside[surface.faces].all(axis=1)]
    words = "a surface drawn through the measured points: between them nothing was measured"
    return Field(
        (_with(Surface(surface.rest, surface.normals, faces, surface.shapes), weights[:, None, :]),), None, 0.0, words
    )


def _with(surface: Surface, shapes: FloatArray) -> Surface:
    return Surface(surface.rest, surface.normals, surface.faces, shapes)


def _rectangle(places: FloatArray, margin: float) -> Surface:
    """A regular net over ``places`` (n, 2) [m] and ``margin`` around them."""
    low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
    step = max(float((high - low).max()), 1e-3) / (_SIDE - 1)
    low, high = np.minimum(low, (low + high) / 2 - 2 * step), np.maximum(high, (low + high) / 2 + 2 * step)
    axes = [np.linspace(a, b, round((b - a) / step) + 1) for a, b in zip(low, high, strict=True)]
    x, y = (v.ravel() for v in np.meshgrid(*axes, indexing="ij"))
    rest = _MM * np.stack([x, y, np.zeros_like(x)], axis=1)
    return Surface(
        rest,
        np.tile([0.0, 0.0, 1.0], (len(rest), 1)),
        net_faces(len(axes[0]), len(axes[1])),
        np.zeros((len(rest), 1, 0)),
    )


def net_faces(rows: int, columns: int) -> IntArray:
    """Triangles of a regular net, counted row by row."""
    k = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    return np.concatenate(
        [np.stack([k, k + columns, k + columns + 1], axis=1), np.stack([k, k + columns + 1, k + 1], axis=1)]
    )
