"""What stands in the files that a scenario names: part of every question whose answer is kept."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

from .limb import Limb, MeshLimb, SurfacesLimb
from .model import Scenario
from .rendering import SampledWavelet


def named_files(scenario: Scenario) -> tuple[str, ...]:
    """Files that ``scenario`` names, seen from its own folder: of the limb, and of the wavelet."""
    wave = scenario.rendering.wavelet
    return (*limb_files(scenario.limb), *((wave.file,) if isinstance(wave, SampledWavelet) else ()))


def limb_files(limb: Limb) -> tuple[str, ...]:
    """Files that a ``limb`` is made of; none for a parametric one."""
    if isinstance(limb, MeshLimb):
        return (limb.file,)
    return tuple(limb.surfaces.values()) if isinstance(limb, SurfacesLimb) else ()


def contents(files: Iterable[str], base: str | Path) -> list[str]:
    """SHA-256 of each of the ``files`` seen from ``base``; "missing" for one that is not there."""
    paths = [Path(base) / file for file in files]
    return [hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "missing" for path in paths]
