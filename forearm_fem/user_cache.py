"""The folder in which meshes, solves and compiled kernels are kept between runs."""

from __future__ import annotations

import os
from pathlib import Path

from platformdirs import user_cache_path


def default_cache_dir() -> Path:
    """$FOREARM_FEM_CACHE, else the system's place: on Linux $XDG_CACHE_HOME/forearm_fem or ~/.cache/forearm_fem."""
    return Path(os.environ.get("FOREARM_FEM_CACHE") or user_cache_path("forearm_fem", appauthor=False))
