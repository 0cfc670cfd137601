"""Published measurements that predictions are compared with, and the same quantities of an arm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...engines.layered import flat_layers, flat_membrane
from ...layered import Disc, Layer, Surface, layered_compliance
from ...metrics import fit_waves
from ...scenario import Scenario
from ...scenario.actuators import ACTUATORS
from ...typing import ComplexArray, FloatArray

# Published measurements of forearms, to judge predictions by; values that were not seen are named, not invented.
# ``kind``: "value" is judged by whether it lies in the 5-95 % band of arms, "trend" by whether at least 5 % of the arms
# show it, "not comparable" says why neither is done. ``fitted`` marks what the joint fit of the tissue laws used: no
# test of the model, only of the fit.

Kind = Literal["value", "trend", "not comparable"]


@dataclass(frozen=True)
class Target:
    """A published finding: ``name`` of its observable (:mod:`.observables`), ``value`` in ``unit`` for a value."""

    name: str
    group: str
    what: str
    kind: Kind
    source: str
    value: float = float("nan")
    spread: str = ""
    unit: str = ""
    fitted: bool = False
    note: str = ""


_A = "de Vlam 2022, appendix A, one person; text seen, no numbers of figure A.2"
_SHAH = "Shah et al. 2019 (doi 10.3390/app9204329), six people; abstract and tables seen, accelerations not seen"
_SOFIA = "Sofia and Jones 2013 (doi 10.1109/TOH.2013.1); abstract seen"

TARGETS = (
    Target("appendix A, speed", "appendix A", "surface speed at 50-125 Hz, thesis' estimator", "value", _A, 4.0,
           unit="m/s"),
    Target("appendix A, speed rises", "appendix A", "speed at 300 Hz above that at 125 Hz", "trend", _A),
    Target("appendix A, decay rises", "appendix A", "decay at 250 Hz above that at 50 Hz", "trend", _A),
    Target("appendix A, decay levels off", "appendix A", "decay at 500 Hz within a quarter of that at 250 Hz", "trend",
           _A, note="a quarter is our reading of 'plateaus'"),
    Target("Zhang, speed", "Zhang", "surface speed at 200 Hz", "value",
           "Zhang et al. 2011, abstract seen; distances not seen", 3.25, "+-0.19", "m/s",
           fitted=True, note="5 to 15 mm taken, where the half-space of their mu and eta reads 4.2 m/s: near field, so "
           "that the fit leans soft"),
    Target("Zhang, speeds of 30", "Zhang", "surface speed at 100, 150 and 200 Hz, 30 people", "not comparable",
           "PMC5743597, abstract seen", note="the speeds were not seen"),
    Target("Sueda, relaxed", "Sueda", "stiffness under 0.50 cm^2, relaxed", "value", "Sueda 1972, abstract seen", 80.0,
           unit="N/m", fitted=True),
    Target("Sueda, tense", "Sueda", "stiffness under 0.50 cm^2, tense", "value", "Sueda 1972, abstract seen", 350.0, "",
           "N/m", note="the priors are of relaxed arms: no muscle is tense in them"),
    Target("Sofia, loss at 8 mm", "Sofia", "share of the motor's amplitude lost at 8 mm", "value",
           "Sofia and Jones 2013 as the thesis quotes it; the abstract says 'markedly attenuated'", 0.8, "", "-",
           note="motor's radius and frequency not seen: 5 mm, 200 Hz; 8 mm from its rim"),
    Target("Sofia, threshold at 24 mm", "Sofia", "above threshold at 24 mm", "not comparable", _SOFIA,
           note="the motor's amplitude and the threshold were not seen"),
    Target("Shah, 4 cm", "Shah", "acceleration at 4 cm larger at 241 Hz than at 102 Hz", "trend", _SHAH,
           note="present only above 150 Hz; the sensor's floor was not seen"),
    Target("Shah, 8 cm", "Shah", "acceleration at 8 cm below 5 % of the source's at every step", "trend", _SHAH,
           note="'substantially below thresholds'; these were not seen, 5 % is ours"),
    Target("Diller, impedance", "Diller", "impedance of a 0.5 mm probe, normal, larger at 200 Hz than at 20 Hz",
           "trend",
           "Diller 2001 (studylib 10821980), abstract seen: 'generally increasing with frequency'; range not seen"),
    Target("Diller, tangential", "Diller", "tangential impedance above normal", "not comparable",
           "Diller 2001, abstract seen", note="the layered model has no tangential ports"),
    Target("Parker, forearm", "Parker", "stiffness of the forearm half the thenar's", "not comparable",
           "Parker and Hunter 2017, abstract seen", note="there is no thenar here"),
)  # fmt: skip

SHAH_STEPS = ACTUATORS["ERM"].steps  # Shah's motor: frequency [Hz] and amplitude [g] by step
# Six people: sex, arm length and circumference [m] at the source and 4, 8, 12, 16 cm from it.
SHAH_ARMS = (
    ("m", 0.267, (0.279, 0.279, 0.266, 0.241, 0.203)),
    ("m", 0.279, (0.267, 0.260, 0.260, 0.232, 0.194)),
    ("f", 0.216, (0.254, 0.254, 0.241, 0.203, 0.178)),
    ("f", 0.229, (0.222, 0.222, 0.210, 0.178, 0.156)),
    ("f", 0.244, (0.199, 0.186, 0.173, 0.152, 0.136)),
    ("f", 0.216, (0.251, 0.248, 0.210, 0.178, 0.159)),
)
# Maughan 1984, CT of whole forearms: share of fat in the section, men and women.
FAT_SHARE = {"m": 0.150, "f": 0.293}


# Published measurements repeated on a drawn arm: speeds, decay, stiffness, loss over distance.

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
        """Arm of ``scenario``."""
        return cls(tuple(flat_layers(scenario)), flat_membrane(scenario.tissues))

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
