"""Models of arms: what answers a draw with the compliance between its ports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..layered import layered_compliance
from ..pipeline.layered_engine import flat_disc, flat_layers, flat_ports, flat_surface
from ..scenario import Scenario
from ..transfer import Compliance, ErrorEstimate
from ..typing import FloatArray

_TOLERANCE, _TERMS, _ORDERS = 1e-3, 4, 3  # a third of the time of the twin's own; what it costs is stated per draw


class ArmModel(Protocol):
    """Compliance of any draw, with its error. A draw is a :class:`Scenario` (:func:`.draws.scenario_of`)."""

    @property
    def name(self) -> str:
        """For the report, e.g. "layered twin"."""
        ...

    @property
    def held(self) -> frozenset[str]:
        """Inputs of the priors that the model cannot follow: they stay the scenario's."""
        ...

    @property
    def left_out(self) -> str:
        """What of an arm the model has not, in a sentence."""
        ...

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """Of the ports of ``scenario`` at ``frequency`` (n,) [Hz], with an estimate per source of error."""
        ...


@dataclass(frozen=True)
class LayeredArm:
    """The semi-analytic twin with fewer terms: 981 bins in about half a second, with a true error of G below 1 %."""

    solved: bool = False  # whether the scene itself is solved by finite elements

    @property
    def name(self) -> str:
        """See :class:`ArmModel`."""
        return "layered twin"

    @property
    def held(self) -> frozenset[str]:
        """See :class:`ArmModel`: nothing."""
        return frozenset()

    @property
    def left_out(self) -> str:
        """See :class:`ArmModel`."""
        beside = "; the scene itself is solved by finite elements, so that it may lie beside its own arms"
        return (
            "the arms are flat layers without end: girth, taper, bones and the device's place on the limb are not in "
            f"the band{beside if self.solved else ''}"
        )

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """See :class:`ArmModel`."""
        scenario = without_bones(scenario)
        ports = flat_ports(scenario)
        discs = [flat_disc(port) for port in ports]
        found = layered_compliance(
            flat_layers(scenario), 2 * np.pi * frequency, discs, discs, surface=flat_surface(scenario.tissues),
            tolerance=_TOLERANCE, terms=_TERMS, orders=_ORDERS, judge_all=False,
        )  # fmt: skip
        error = np.asarray(found.error)
        estimate = ErrorEstimate(
            "quadrature", float(error.max()), "the twin's own control, with fewer terms than it takes for a scene",
            tuple(frequency.tolist()), tuple(error.tolist()),
        )  # fmt: skip
        return Compliance(frequency, found.values, ports, (estimate,))


def without_bones(scenario: Scenario) -> Scenario:
    """The same without bones, which the twin has not: thick fat need not fit around them."""
    if not getattr(scenario.limb, "bones", ()):
        return scenario
    return scenario.model_copy(update={"limb": scenario.limb.model_copy(update={"bones": ()})})


def arm_model(scenario: Scenario) -> ArmModel:
    """The model that answers draws of ``scenario``."""
    return LayeredArm(scenario.engine == "fem")
