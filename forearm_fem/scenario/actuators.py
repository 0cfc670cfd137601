"""Presets of actuators: keys of [device] with their sources, and what each can and cannot be used for.

Only numbers that were seen are here; what a source does not say stays as the scenario has it and is named in
``unseen``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

Kind = Literal["voice coil", "LRA", "ERM", "piezo", "shaker"]


@dataclass(frozen=True)
class Actuator:
    """One product. ``keys`` are what it sets under [device], ``drive`` among them: what a unit drive is.

    ``band`` [Hz] is what its source says it plays, None where it does not. ``steps`` are (frequency [Hz], acceleration
    [g]) of a rotating mass, whose amplitude cannot be chosen apart from its frequency. ``mass`` [kg] is all of it.
    """

    name: str
    kind: Kind
    source: str
    use: str
    unseen: str = ""
    keys: Mapping[str, Any] = field(default_factory=dict)
    band: tuple[float, float] | None = None
    steps: tuple[tuple[float, float], ...] = ()
    mass: float | None = None

    @property
    def drive(self) -> str:
        """Quantity of a unit drive: "voltage" (1 V), "force" (1 N) or "displacement" (1 m)."""
        return str(self.keys.get("drive", "voltage"))


_SHAH = (
    (102.3, 0.45), (121.7, 0.65), (139.7, 0.85), (156.3, 1.05), (171.6, 1.20), (185.6, 1.40), (198.2, 1.55),
    (209.5, 1.75), (219.4, 1.90), (228.0, 2.15), (235.3, 2.25), (241.2, 2.35),
)  # fmt: skip
_FORCE = "its motor constant was not seen, so it is a source of force, G is in m/N and voltages stay unknown"

_ALL = (
    Actuator(
        "TEAX14C02-8", "voice coil", "de Vlam 2022; a distributor's copy of Tectonic's data sheet (physics_data.md 4)",
        "the thesis' actuator; every method", "moving mass (derived: 0.2-0.6 g), quality", mass=12.5e-3,
    ),
    Actuator(
        "TEAX09C005-8", "voice coil", "Tectonic's smaller sister, by the same secondary source (physics_data.md 4)",
        "every method, with lower forces", "resistance, inductance, quality, limits: those of the TEAX14C02-8 are kept",
        {
            "coil": {"force_factor": 1.1, "moving_mass": 0.13e-3, "resonance": 635.0},
            "housing": {"mass": 4 * 3.2e-3 + 0.040},  # four of 3.2 g in the default shell of 40 g
        }, mass=3.2e-3,
    ),
    Actuator(
        "EAI C-MF", "voice coil", "Engineering Acoustics, C-MF product data sheet 2021", f"sine bursts; {_FORCE}",
        "force factor, moving mass", {"drive": "force", "cone": {"radius": 2.55e-3}}, (180.0, 280.0),
    ),
    Actuator(
        "DAEX-13-4SM", "voice coil", "Dayton Audio, by a component library (4 ohm, 3 W, resonance 200 Hz, 15 g)",
        _FORCE, "force factor, moving mass, contact area", {"drive": "force"}, mass=15e-3,
    ),
    Actuator(
        "LRA 10 mm", "LRA", "Kim et al. 2021, Heterogeneous Stroke (10 mm across, resonance 170 Hz)",
        f"long tones at its resonance of 170 Hz only: no wavelet, no wide band; {_FORCE}",
        "quality, moving mass, force", {"drive": "force", "cone": {"radius": 5e-3}},
    ),
    Actuator(
        "ERM", "ERM", "Shah et al. 2019, doi 10.3390/app9204329, table of its motor",
        "steady tones at its own steps, where amplitude goes with frequency squared (device.RotatingMass): neither "
        "wavelets, nor phases between motors, so that S of the renderers means nothing for it",
        "mass that the accelerations hold for, unbalance, contact area", {"drive": "force"}, (102.3, 241.2), _SHAH,
    ),
    Actuator(
        "PowerHap 2.5G", "piezo", "TDK's key data (60 V, 5 N, 35 um) by All About Circuits 2018; 1 Hz-1 kHz, EDN",
        "every method: 5 N over 35 um is 140 kN/m, a hundred times the skin's, so it moves as told; 0.58 um/V",
        "stiffness itself, contact area, hysteresis", {"drive": "displacement"}, (1.0, 1000.0),
    ),
    Actuator(
        "B&K 4809", "shaker", "Brüel & Kjær 4809 manual, section 3.1: resonances at about 150 Hz and 16 kHz",
        f"every method, on a stand; {_FORCE}", "moving mass, stiffness, force factor", {"drive": "force"},
    ),
)  # fmt: skip

ACTUATORS: Mapping[str, Actuator] = MappingProxyType({a.name: a for a in _ALL})
"""All presets by the name that ``device.actuator`` takes.

:meta hide-value:
"""

ActuatorName = Literal[
    "TEAX14C02-8", "TEAX09C005-8", "EAI C-MF", "DAEX-13-4SM", "LRA 10 mm", "ERM", "PowerHap 2.5G", "B&K 4809"
]


def beneath(preset: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """``given`` over ``preset``, table by table: what is given counts."""
    out: dict[str, Any] = {**preset, **given}
    for key, value in preset.items():
        if isinstance(value, Mapping) and isinstance(given.get(key), Mapping):
            out[key] = beneath(value, given[key])
    return out
