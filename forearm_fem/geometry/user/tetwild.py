"""fTetWild in a process of its own: it writes a stray file where it runs, and may take long or crash."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ...errors import MeshError
from ...typing import FloatArray, IntArray
from ..limb.prisms import oriented

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
