"""The folder in which meshes, solves and compiled kernels are kept between runs."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from platformdirs import user_cache_path


def default_cache_dir() -> Path:
    """$FOREARM_FEM_CACHE, else the system's place: on Linux $XDG_CACHE_HOME/forearm_fem or ~/.cache/forearm_fem.

    A private temporary folder where that cannot be written.
    """
    if own := os.environ.get("FOREARM_FEM_CACHE"):
        return Path(own)
    usual = user_cache_path("forearm_fem", appauthor=False)
    return next((folder for folder in (usual, private_temporary()) if is_writable(folder)), usual)


def private_temporary(end: str = "") -> Path:
    """A folder for this user below the system's temporary one; ask :func:`is_writable` before it is used."""
    user = os.getuid() if hasattr(os, "getuid") else "user"  # Windows has a temporary folder for each user
    return Path(tempfile.gettempdir()) / f"forearm_fem-{user}{end}"


def is_writable(folder: Path) -> bool:
    """True if it is there or can be made, is nobody else's (code that lies in it is run), and takes a file."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
            return False
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True
