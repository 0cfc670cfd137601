"""Diagnosis of this machine: versions, solver, threads, memory, rendering."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress

import psutil

from . import __version__
from .fem.linear.factor import available_backends
from .user_cache import default_cache_dir

_PICTURE = (
    "import pyvista as pv; pv.OFF_SCREEN = True; p = pv.Plotter(off_screen=True, window_size=(40, 40)); "
    "p.add_mesh(pv.Sphere()); p.show(auto_close=False); print(p.render_window.GetClassName())"
)


def diagnosis() -> dict[str, str]:
    """Name -> finding; nothing raises, what fails is said."""
    from .engines.simulation import versions

    found = {"forearm-fem": __version__, **versions()}
    found["direct solvers"] = ", ".join(available_backends())
    if available_backends()[0] == "superlu":
        found["direct solvers"] += " (small scenes only; python3 -m pip install mkl)"
    found["threads"] = f"{os.cpu_count()} cores, OMP_NUM_THREADS={os.environ.get('OMP_NUM_THREADS', 'unset')}"
    found["memory"] = (
        f"{psutil.virtual_memory().available / 1e9:.1f} of {psutil.virtual_memory().total / 1e9:.1f} GB free"
    )
    found["cache"] = _cache()
    found["rendering back end"] = rendering_backend()
    return found


def _cache() -> str:
    """Folder of finished meshes and solves, and its size."""
    folder = default_cache_dir()
    above = next(path for path in (folder, *folder.parents) if path.exists())
    if not above.is_dir() or not os.access(above, os.W_OK):
        return f"{folder}: nothing can be kept there ({above} is no folder that can be written); set FOREARM_FEM_CACHE"
    files, size = [path for path in folder.rglob("*") if path.is_file()], 0
    for path in files:
        with suppress(OSError):  # another command has just removed it
            size += path.stat().st_size
    return f"{folder}: {size / 1e6:.1f} MB in {len(files)} files"


def rendering_backend() -> str:
    """Class of the off-screen render window, tried in a process of its own because a missing driver may kill it."""
    try:
        done = subprocess.run([sys.executable, "-c", _PICTURE], capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.TimeoutExpired) as problem:
        return f"none ({problem})"
    if done.returncode == 0:
        return done.stdout.strip().splitlines()[-1]
    return "none: pyvista cannot render here; on Debian: apt-get install libgl1 libegl1 libxrender1"
