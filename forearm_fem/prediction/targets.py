"""What was published of forearms, to judge predictions by; values that were not seen are named, not invented.

``kind``: "value" is judged by whether it lies in the 5-95 % band of arms, "trend" by whether at least 5 % of the arms
show it, "not comparable" says why neither is done. ``fitted`` marks what the joint fit of the tissue laws used: no test
of the model, only of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..scenario.actuators import ACTUATORS

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
           "Diller 2001, abstract seen", note="the twin has no tangential ports"),
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
