"""Models of an arm that answer for any device on it."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from ...accuracy.estimates import quadrature_estimate
from ...engines.engine import Engine
from ...engines.layered import LayeredEngine, flat_disc, flat_ports
from ...engines.tables import kept_tables, tables_reach
from ...layered.tables import Tabulated
from ...progress import Progress
from ...scenario import Scenario
from ...transfer import Compliance
from ...typing import FloatArray


class ArmModel(Engine, Protocol):
    """An engine for any device on one arm: what a design evaluates its candidates on."""

    @property
    def mark(self) -> str:
        """What tells its answers from another model's."""


class TwinArm:
    """The layered twin from tables: flat layers without end, any equal discs, a fraction of a second each.

    Tables are made once per tissue, radius and contact, and kept in ``folder`` (None: the cache).
    """

    def __init__(self, folder: Path | None = None, progress: Progress | None = None) -> None:
        self._folder, self._progress = folder, progress
        self._known: dict[str, Tabulated] = {}

    @property
    def mark(self) -> str:
        """The scenario says all."""
        return "flat twin"

    @property
    def name(self) -> str:
        """See :class:`.Engine`."""
        return "tables"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: as the layered model."""
        return LayeredEngine().holds(scenario)

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """See :class:`ArmModel`; entries between two points are NaN."""
        ports = flat_ports(scenario)
        omega = 2 * np.pi * frequency
        places = np.array([p.position[:2] for p in ports])
        reach = tables_reach(float(np.ptp(places, axis=0).max() * np.sqrt(2)))
        table = kept_tables(scenario, reach, folder=self._folder, progress=self._progress, known=self._known)
        result = table.compliance(omega, [flat_disc(port) for port in ports])
        e = result.error
        estimate = quadrature_estimate(
            frequency, e,
            "twice the tables' difference from the twin itself on one arrangement, the last coefficients between "
            "frequencies, and the last terms and orders of the tractions under rigid discs",
        )  # fmt: skip
        return Compliance(frequency, result.values, ports, (estimate,))
