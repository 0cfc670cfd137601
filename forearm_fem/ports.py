"""Ports: all that a model of the limb ever has to answer for (contacts in, grid points out)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .typing import FloatArray

__all__ = ["Port", "distances", "positions"]

PortKind = Literal["contact", "point"]
ContactKind = Literal["pressure", "bonded", "frictionless"]


@dataclass(frozen=True)
class Port:
    """One scalar displacement and the force conjugate to it.

    A *contact* port is a disc of ``radius`` [m] under a cone: its displacement is that of the rigid disc
    along ``axis`` (``bonded`` or ``frictionless``), or the mean normal displacement under a uniform
    pressure. A *point* port is the skin's displacement along ``axis`` at ``position``.
    ``axis`` is the outward unit normal of the skin; displacement and force are positive along it.
    """

    name: str
    kind: PortKind
    position: tuple[float, float, float]
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    radius: float = 0.0
    contact: ContactKind = "pressure"


def positions(ports: tuple[Port, ...]) -> FloatArray:
    """Positions of ``ports`` as an (n, 3) array [m]."""
    return np.array([p.position for p in ports], dtype=float).reshape(-1, 3)


def distances(outputs: tuple[Port, ...], inputs: tuple[Port, ...]) -> FloatArray:
    """Straight distances (n_out, n_in) [m] between two sets of ports."""
    return np.asarray(np.linalg.norm(positions(outputs)[:, None] - positions(inputs)[None], axis=2))
