"""Discretisation error of an arm, whose waves may be shorter than those that the scene's mesh was made for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..accuracy.discretisation import DiscretisationError, estimated_errors, order_of, spread_change
from ..accuracy.estimates import PairErrors
from ..errors import MeshError
from ..geometry.build import cached_mesh
from ..progress import Progress
from ..scenario import Scenario
from ..transfer import Compliance, ErrorEstimate, relative_error
from ..typing import ComplexArray, FloatArray
from .fem import second_mesh
from .parametric import ParametricModel, parametric_model

_PROBED = 20  # frequencies at which the second mesh is asked


@dataclass(frozen=True, eq=False)
class ArmMeshes:
    """The ``second`` mesh of the scene as a parametric model, its nodes ``ratio`` times as far apart as the first's,
    and the ``order`` with which G converges (:func:`.order_of`)."""

    second: ParametricModel
    ratio: float
    order: float

    def error(self, arm: Scenario, found: Compliance) -> ErrorEstimate:
        """:meth:`missed` without its shape."""
        return self.missed(arm, found)[0]

    def missed(self, arm: Scenario, found: Compliance) -> tuple[ErrorEstimate, PairErrors]:
        """Of the compliance ``found`` for an ``arm`` on the first mesh, by the rule for a scene of its own.

        That is from the change on the second mesh (:func:`.estimated_errors`). Over pairs of ports its shape is that of
        the change, and the largest of points under contacts is e(f), but e_band at least, as two meshes agree by
        chance.
        """
        low, high = np.sqrt(found.frequency[[0, -1]])  # probes are dense where frequencies are low
        wanted = np.linspace(low, high, _PROBED) ** 2
        some = np.unique(np.abs(found.frequency[:, None] - wanted).argmin(axis=0))
        frequency = found.frequency[some]
        part = replace(found, frequency=frequency, values=found.values[some])
        second = self._second(arm, frequency)
        own, other = part.block("point", "contact"), second.block("point", "contact")
        rule = self._error(frequency, other, own)
        shape = spread_change(second.values, part.values, frequency)
        points, contacts = part.indices("point"), part.indices("contact")
        largest = shape[:, points][:, :, contacts].max(axis=(1, 2))
        known = np.divide(np.maximum(rule.error, rule.band), largest, out=np.zeros_like(largest), where=largest > 0)
        shares = known[:, None, None] * shape
        return ErrorEstimate(
            "discretisation", rule.band,
            f"change of the arm's compliance on a second mesh, nodes {self.ratio:.2g} times as far apart, at "
            f"{len(frequency)} frequencies",
            tuple(frequency.tolist()), tuple(rule.error.tolist()),
        ), PairErrors(frequency, shares)  # fmt: skip

    def share(self, arm: Scenario, found: Compliance) -> FloatArray:
        """Mesh error (n_frequency,), as e(f) in shares of that of the change on the second mesh.

        It is found at every frequency of ``found``: meant for tens of them.
        """
        own, frequency = found.block("point", "contact"), found.frequency
        other = self._second(arm, frequency).block("point", "contact")
        error, change = self._error(frequency, other, own).error, relative_error(other, own)
        return np.asarray(np.divide(error, change, out=np.zeros_like(error), where=change > 0))

    def _second(self, arm: Scenario, frequency: FloatArray) -> Compliance:
        return Compliance(frequency, self.second.bare(arm, frequency), self.second.ports)

    def _error(self, frequency: FloatArray, other: ComplexArray, own: ComplexArray) -> DiscretisationError:
        """Of what points do under contacts (n_frequency, n_point, n_contact), by the rule of a scene's own."""
        return estimated_errors(other, own, frequency, self.ratio, self.order)


def arm_meshes(
    scenario: Scenario, base: str | Path, draws: Sequence[Scenario] | None, progress: Progress | None
) -> ArmMeshes:
    """Made and kept as the first mesh's model is (:func:`.parametric_model`); MeshError where there is no coarser mesh.

    Its sentence says why.
    """
    if not scenario.solver.discretisation_estimate:
        raise MeshError("solver.discretisation_estimate is false; set it to true")
    mesh = cached_mesh(scenario, base=Path(base))
    second = second_mesh(scenario, mesh, base=Path(base))
    if second.ratio < 1:
        raise MeshError("only a finer second mesh can be made, which costs more than all else")
    model = parametric_model(second.scenario, base=base, draws=draws, mesh=second.mesh, progress=progress)
    return ArmMeshes(model, second.ratio, order_of(scenario))
