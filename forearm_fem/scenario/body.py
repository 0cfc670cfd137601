"""A forearm from a tape measure: circumferences, length and a skinfold; and three arms that were measured so."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from ..errors import ScenarioError
from .limb import DEFAULT_BONES, DEFAULT_CIRCUMFERENCE, DEFAULT_LAYERS

SKIN = DEFAULT_LAYERS[0].thickness
_LEAST_FAT = 0.5e-3  # m: calipers do not resolve less
_NOMINAL = dict(DEFAULT_CIRCUMFERENCE)[0.0] / (2 * math.pi)  # radius that the default bones belong to
_COVER = sum(layer.thickness for layer in DEFAULT_LAYERS)


@dataclass(frozen=True)
class Tape:
    """Circumferences [m] at distances [m] from the proximal end (near the elbow), both measured along the arm.

    ``device`` [m] is the device's middle from that end; None: the middle of ``length``, from there to the wrist, as the
    thesis puts it. ``skinfold`` [m] is a caliper's reading, twice skin and fat: what it makes of fat is uncertain by
    x/÷ 1.6, for calipers over ultrasound read 1.35 to 3.4 from site to site (J Tech Educ Health Phys Educ 1:9, seen).
    """

    circumference: tuple[tuple[float, float], ...]
    length: float
    skinfold: float | None = None
    device: float | None = None

    def limb(self) -> dict[str, Any]:
        """Keys of ``[limb]``: circumferences about the device, layers, and bones drawn to the scale of the muscle.

        ScenarioError for places that do not increase or that the device lies beyond, for more fat than arm, and for a
        fold that is none.
        """
        if self.skinfold is not None and not 0 < self.skinfold < math.inf:
            raise ScenarioError(
                f"skinfold: expected a caliper's reading above 0 m, got {self.skinfold:g}; or leave it out"
            )
        at = self.length / 2 if self.device is None else self.device
        places = [d for d, _ in self.circumference]
        if len(places) < 2 or sorted(set(places)) != places:
            raise ScenarioError("a tape measure needs two or more distances from the elbow, each larger than the last")
        if not places[0] <= at <= places[-1]:
            raise ScenarioError(
                f"the device's middle is {at:g} m from the elbow, but circumferences are known from {places[0]:g} to "
                f"{places[-1]:g} m; measure further, or say where the device sits"
            )
        pairs = sorted((round(at - d, 6), c) for d, c in self.circumference)
        return {"circumference": pairs, "layers": self._layers(), "bones": self._bones(at)}

    def _layers(self) -> list[dict[str, Any]]:
        fat = DEFAULT_LAYERS[1].thickness if self.skinfold is None else max(self.skinfold / 2 - SKIN, _LEAST_FAT)
        return [{"tissue": "skin", "thickness": SKIN}, {"tissue": "fat", "thickness": round(fat, 6)}]

    def _bones(self, at: float) -> list[dict[str, Any]]:
        """The default bones, drawn to the scale of the muscle under the device."""
        places, girths = np.array(self.circumference, dtype=float).T
        cover = sum(layer["thickness"] for layer in self._layers())
        radius = float(np.interp(at, places, girths)) / (2 * math.pi)
        if cover >= radius:
            raise ScenarioError(
                f"skin and fat of {1e3 * cover:.3g} mm leave no muscle in an arm of {1e3 * radius:.3g} mm radius; "
                "is the skinfold in metres?"
            )
        scale = (radius - cover) / (_NOMINAL - _COVER)
        return [
            {"name": b.name, "y": round(scale * b.y, 6), "depth": round(cover + scale * (b.depth - _COVER), 6),
             "diameter": round(scale * b.diameter, 6)}
            for b in DEFAULT_BONES
        ]  # fmt: skip


def _shah(*girths: float, length: float) -> Tape:
    """An arm of Shah et al. 2019, girths [cm] every 4 cm; the device where the default forearm has it, at 8 cm."""
    return Tape(tuple((round(0.04 * k, 2), round(c / 100, 4)) for k, c in enumerate(girths)), length, device=0.08)


# Shah et al. 2019 (physics_data.md 1.3): the thinnest and the thickest of six arms, and the medians of all six.
BODIES: Mapping[str, Tape] = MappingProxyType(
    {
        "small": _shah(19.9, 18.6, 17.3, 15.2, 13.6, length=0.244),
        "median": _shah(25.25, 25.1, 22.55, 19.05, 16.85, length=0.2365),
        "large": _shah(27.9, 27.9, 26.6, 24.1, 20.3, length=0.267),
    }
)
