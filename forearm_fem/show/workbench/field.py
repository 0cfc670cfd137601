"""Motion of the skin, and of two sections through the limb, per newton on each contact: few shapes times amplitudes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...device import contact_state
from ...geometry.mesh.tissue_mesh import vertex_areas
from ...typing import ComplexArray, FloatArray, IntArray
from ..data import Results
from ..film import body_of
from ..scene import MM, volume_grid

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
