"""What published measurements would have found on a drawn arm: speeds, decay, stiffness, loss over distance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..engines.layered import flat_layers, flat_surface
from ..layered import Disc, Layer, Surface, layered_compliance
from ..metrics import fit_waves
from ..scenario import Scenario
from ..typing import ComplexArray, FloatArray
from .targets import FAT_SHARE, SHAH_STEPS

TOLERANCE = 1e-7  # of the largest displacement at each frequency; 8 cm from a motor there are 1e-4 of it left
_CONE = Disc(0.0, 0.0, 3.5e-3)
_A2 = np.array([50.0, 75.0, 100.0, 125.0, 250.0, 300.0, 500.0])
_A2_LINE: FloatArray = np.arange(6.0, 29.0, 2.5) * 1e-3  # ten points every 2.5 mm, counted from the cone's rim
_BALL, _BALL_LINE = Disc(0.0, 0.0, 1.5e-3), np.linspace(5e-3, 15e-3, 5)
_PLATE = Disc(0.0, 0.0, math.sqrt(0.5e-4 / math.pi), "bonded")
_MOTOR, _MOTOR_LINE = Disc(0.0, 0.0, 5e-3), (13e-3, 40e-3, 80e-3)  # 8 mm from its rim, then Shah's from its centre
_PROBE = Disc(0.0, 0.0, 0.25e-3)
_MOST_LEFT = 0.05  # of the source at 8 cm


@dataclass(frozen=True)
class Arm:
    """Layers and sheet of a drawn arm, flat and without end."""

    layers: tuple[Layer, ...]
    surface: Surface

    @classmethod
    def of(cls, scenario: Scenario) -> Arm:
        """Those of ``scenario``."""
        return cls(tuple(flat_layers(scenario)), flat_surface(scenario.tissues))

    def respond(self, frequency: FloatArray, source: Disc, line: Sequence[float] | FloatArray) -> ComplexArray:
        """Displacement per force (n_frequency, 1 + n_line) [m/N] under ``source`` and along x."""
        receivers = [source, *(Disc(float(x), 0.0) for x in line)]
        omega = 2 * np.pi * np.asarray(frequency, dtype=float)
        found = layered_compliance(self.layers, omega, [source], receivers, surface=self.surface, tolerance=TOLERANCE)
        return np.asarray(found.values[:, :, 0])


def observables(arm: Arm) -> dict[str, float]:
    """Every observable of :data:`.targets.TARGETS` on ``arm``; trends are 1 where they show, else 0.

    By the same estimator as the thesis for its appendix. Distances and radii that the sources do not say are named in
    the targets' notes.
    """
    fit = fit_waves(_A2, _A2_LINE, arm.respond(_A2, _CONE, _A2_LINE)[:, 1:])
    speed, decay = (dict(zip(_A2, each, strict=True)) for each in (fit.speed, fit.attenuation))
    at = np.array([200.0])
    zhang = fit_waves(at, _BALL_LINE, arm.respond(at, _BALL, _BALL_LINE)[:, 1:])
    stiffness = float((1 / arm.respond(np.array([20.0]), _PLATE, ())[0, 0]).real)
    # relative motion along the arm; a motor that is its own source of motion keeps its amplitude
    ratio = motor_ratios(arm, np.array([SHAH_STEPS[0][0], 200.0, SHAH_STEPS[-1][0]]))
    near = np.array([SHAH_STEPS[0][1], 1.0, SHAH_STEPS[-1][1]]) * ratio[:, 1]
    band = np.array([20.0, 200.0])
    impedance = 1 / np.abs(2j * np.pi * band * arm.respond(band, _PROBE, ())[:, 0])
    return {
        "appendix A, speed": float(1 / np.mean(1 / fit.speed[:4])),
        "appendix A, speed rises": float(1 / speed[300.0] < 1 / speed[125.0]),  # a near field passes infinity
        "appendix A, decay rises": float(decay[250.0] > decay[50.0]),
        "appendix A, decay levels off": float(0.8 <= decay[500.0] / decay[250.0] <= 1.25),
        "Zhang, speed": float(zhang.speed[0]),
        "Sueda, relaxed": stiffness,
        "Sueda, tense": stiffness,
        "Sofia, loss at 8 mm": float(1 - ratio[1, 0]),
        "Shah, 4 cm": float(near[2] > near[0]),
        "Shah, 8 cm": float((ratio[:, 2] < _MOST_LEFT).all()),
        "Diller, impedance": float(impedance[1] > impedance[0]),
    }


def motor_ratios(arm: Arm, frequency: FloatArray) -> FloatArray:
    """|u| at 8 mm from the motor's rim, 4 and 8 cm from its centre, over that under it (n_frequency, 3) [-]."""
    found = np.abs(arm.respond(frequency, _MOTOR, _MOTOR_LINE))
    return np.asarray(found[:, 1:] / found[:, :1])


def fat_of(sex: str, circumference: float, skin: float) -> float:
    """Fat [m] below ``skin`` [m] that makes Maughan's share of a round section of ``circumference`` [m]."""
    radius = circumference / (2 * math.pi)
    ring = radius * (1 - math.sqrt(1 - FAT_SHARE[sex]))
    return max(ring - skin, 0.5e-3)
