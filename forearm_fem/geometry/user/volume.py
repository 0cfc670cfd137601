"""Tetrahedra inside users' surfaces, by fTetWild."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ...errors import MeshError
from ...typing import BoolArray, FloatArray, IntArray
from ..limb.filling import oriented
from ..mesh.refinement import independent, split_edges
from ..mesh.tissue_mesh import EDGES, TissueMesh, boundary_faces, edges_of, triangle_normals

# fTetWild in a process of its own: it writes a stray file where it runs, and may take long or crash.

ENVELOPE = 1e-3  # of the bounding box's diagonal: fTetWild's surface stays this close to the given one
TIME_LIMIT = 600.0  # [s]
MEMORY_LIMIT = 6 * 2**30  # [bytes]; a default limb takes 0.5 GB, a size in the wrong unit took 20 GB
_WORK = f"""
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, ({MEMORY_LIMIT}, {MEMORY_LIMIT}))
except ImportError:
    pass  # not on this platform
import numpy as np, pytetwild
given = np.load("in.npz")
points, tetrahedra = pytetwild.tetrahedralize(
    given["vertices"], given["faces"], edge_length_abs=float(given["far"]), epsilon=float(given["envelope"]),
    num_threads=1, bg_vertices=given["grid"], bg_tets=given["cells"], bg_values=given["values"],
)
np.savez("out.npz", points=points, tetrahedra=tetrahedra)
"""


class MeshTimeout(MeshError):
    """Meshing took too long; trying again would take as long."""


def tetrahedralise(
    vertices: FloatArray, faces: IntArray, grid: FloatArray, cells: IntArray, values: FloatArray, far: float
) -> tuple[FloatArray, IntArray]:
    """Points (n, 3) [m] and positive tetrahedra (m, 4) inside the closed surface ``vertices``, ``faces``.

    Edge lengths ``values`` [m] are given on a background mesh ``grid``, ``cells``. fTetWild draws random numbers: two
    runs give meshes of the same sizes and quality, but not the same mesh.
    """
    with tempfile.TemporaryDirectory(prefix="forearm_fem_") as folder:
        np.savez(
            Path(folder, "in.npz"), vertices=vertices, faces=faces.astype(np.int32), grid=grid,
            cells=cells.astype(np.int32), values=values, far=far, envelope=ENVELOPE,
        )  # fmt: skip
        _run(folder)
        with np.load(Path(folder, "out.npz")) as made:
            points, tetrahedra = np.asarray(made["points"], float), np.asarray(made["tetrahedra"], np.int64)
    if not len(tetrahedra):
        raise MeshError("fTetWild returned no tetrahedra: the surface encloses nothing; check that it is closed")
    used, renumbered = np.unique(tetrahedra, return_inverse=True)
    return points[used], oriented(points[used], renumbered.reshape(tetrahedra.shape))


def _run(folder: str) -> None:
    if find_spec("pytetwild") is None:
        raise MeshError(
            "meshing this limb needs the package pytetwild (fTetWild), which is not installed here; "
            "python3 -m pip install pytetwild, or give a slab, a parametric limb or a mesh of your own"
        )
    try:
        done = subprocess.run(
            [sys.executable, "-c", _WORK],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=TIME_LIMIT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise MeshTimeout(
            f"fTetWild did not finish within {TIME_LIMIT:g} s; enlarge mesh.size_grid and mesh.size_contact"
        ) from None
    if done.returncode != 0 or not Path(folder, "out.npz").exists():
        last = (done.stderr.strip().splitlines() or ["no message, likely out of memory"])[-1]
        raise MeshError(f"fTetWild failed (exit status {done.returncode}: {last}); enlarge mesh sizes, check the unit")


def background_grid(low: FloatArray, high: FloatArray, step: float) -> tuple[FloatArray, IntArray]:
    """Points (n, 3) of a grid around a box, and its cubes cut into six tetrahedra each (m, 4)."""
    axes = [np.arange(a - step, b + 2 * step, step) for a, b in zip(low, high, strict=True)]
    nx, ny, nz = (len(a) for a in axes)
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(nx * ny * nz).reshape(nx, ny, nz)
    first = index[:-1, :-1, :-1].ravel()
    steps = np.array([ny * nz, nz, 1])
    orders = np.array([[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]])
    offsets = np.concatenate([np.zeros((6, 1), int), np.cumsum(steps[orders], axis=1)], axis=1)
    return points, (first[:, None, None] + offsets).reshape(-1, 4)


# Cutting a mesh along a surface given by signed distances, so that tetrahedra lie on one side of it.

Distance = Callable[[FloatArray], FloatArray]
_SNAP = 0.3  # a vertex nearer to the surface than this part of an edge across it moves onto it
_YIELD = 0.1  # a vertex still closer than this that cannot move is taken to lie on the surface
_ROUNDS = 200


def cut_along(mesh: TissueMesh, distance: Distance, *, name: str) -> tuple[TissueMesh, BoolArray]:
    """The mesh with edges cut where ``distance`` (n, 3) -> (n,) [m], negative inside, changes sign.

    Returns it with a flag (n_tet,) for the tetrahedra inside. Between cut points the interface is plane, so it lies
    within h^2 / (8 R) of a surface of curvature radius R; features smaller than an edge are lost.
    """
    mesh, value = _snapped(mesh, distance)
    for _ in range(_ROUNDS):
        edges = edges_of(mesh.tetrahedra, EDGES)
        crossing = edges[np.prod(np.sign(value[edges]), axis=1) < 0]
        if not len(crossing):
            total = value[mesh.tetrahedra].sum(axis=1)
            return mesh, np.asarray(total < 0)
        chosen = independent(mesh, crossing)
        a, b = value[chosen].T
        t = (a / (a - b))[:, None]
        middles = mesh.points[chosen[:, 0]] * (1 - t) + mesh.points[chosen[:, 1]] * t
        mesh = split_edges(mesh, chosen, middles)[0]
        value = np.concatenate([value, np.zeros(len(chosen))])
    raise MeshError(f"the mesh could not be cut along the surface '{name}'; set smaller mesh sizes")


def _snapped(mesh: TissueMesh, distance: Distance) -> tuple[TissueMesh, FloatArray]:
    """Vertices close to the surface moved onto it, within the plane of the boundary where they lie on it.

    Corners of the boundary and vertices of earlier interfaces stay; where they are very close the surface gives way to
    them by up to a tenth of an edge, rather than leave slivers.
    """
    value = distance(mesh.points)
    close = _close(mesh, value, _SNAP)
    step = value[close, None] * _gradient(distance, mesh.points[close])
    free, normal = _freedom(mesh)
    along = step - (step * normal[close]).sum(axis=1, keepdims=True) * normal[close]
    stretch = (step**2).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-30)  # the full way, sideways
    movable = free[close] & (stretch < 4)
    close, along, stretch = close[movable], along[movable], stretch[movable]
    moved = mesh.points.copy()
    moved[close] -= stretch[:, None] * along
    for _ in range(5):  # putting one back may spoil a neighbour
        trial = replace(mesh, points=moved)
        bad = np.intersect1d(mesh.tetrahedra[trial.volumes < 0.2 * mesh.volumes], close)
        moved[bad] = mesh.points[bad]
        close = np.setdiff1d(close, bad)
    value[close] = 0.0
    value[_close(mesh, value, _YIELD)] = 0.0
    return replace(mesh, points=moved), value


def _close(mesh: TissueMesh, value: FloatArray, part: float) -> IntArray:
    """Vertices nearer to the surface than ``part`` of an edge that crosses it."""
    edges = edges_of(mesh.tetrahedra, EDGES)
    across = edges[np.prod(np.sign(value[edges]), axis=1) < 0]
    size = np.abs(value[across])
    return np.unique(across[size < part * size.sum(axis=1, keepdims=True)])


def _freedom(mesh: TissueMesh) -> tuple[BoolArray, FloatArray]:
    """True where a vertex (n_point,) may move, and the normal (n_point, 3) it must not move along (zero inside)."""
    n = len(mesh.points)
    faces, _ = boundary_faces(mesh.tetrahedra)
    normal = triangle_normals(mesh.points, faces)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    total, count = np.zeros((n, 3)), np.bincount(faces.ravel(), minlength=n)
    for corner in faces.T:
        np.add.at(total, corner, normal)
    length = np.linalg.norm(total, axis=1)
    flat = length > 0.9999 * count  # all facets around face the same way; true inside, where there are none
    low, high = np.full(n, len(mesh.region_names)), np.full(n, -1)
    np.minimum.at(low, mesh.tetrahedra, mesh.region[:, None])
    np.maximum.at(high, mesh.tetrahedra, mesh.region[:, None])
    inside = count == 0
    return (inside | flat) & (low == high), total / np.where(inside, 1.0, np.maximum(length, 1e-30))[:, None]


def _gradient(distance: Distance, points: FloatArray) -> FloatArray:
    """Unit gradient (n, 3) of the distance by central differences."""
    step = 1e-6  # [m]
    slopes = [(distance(points + d) - distance(points - d)) / (2 * step) for d in step * np.eye(3)]
    raw = np.column_stack(slopes) if len(points) else np.zeros((0, 3))
    return np.asarray(raw / np.maximum(np.linalg.norm(raw, axis=1), 1e-12)[:, None])
