"""The second mesh, whose distance from the first shows the first one's error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..accuracy.discretisation import COARSER
from ..errors import ForearmError, MeshError
from ..geometry.cache import cached_mesh
from ..geometry.device.layout import RIGID
from ..geometry.mesh.refinement import rim_edges
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..scenario import Scenario
from ..scenario.limb import MeshLimb

# Others where the first cannot be made; a finer one last, as it costs more than the main solve.
_RATIOS = (COARSER, 1.7, 1.3, 0.8)
# On a user's mesh, which has one size, the order changes instead: nodes are h/order apart.
_OTHER_ORDER = {"P1": ("P2", 1 / 2), "P2": ("P3", 2 / 3), "P3": ("P2", 3 / 2)}


@dataclass(frozen=True)
class Second:
    """A mesh with the scenario (its element pair) to solve on it; its nodes are ``ratio`` times as far apart."""

    scenario: Scenario
    mesh: TissueMesh
    ratio: float

    @property
    def label(self) -> str:
        """Name under which results on it are kept."""
        return f"{self.ratio:.3f}-{self.scenario.element.replace('/', '')}-{self.mesh.digest[:12]}"


def second_mesh(scenario: Scenario, mesh: TissueMesh, *, base: Path) -> Second:
    """The second mesh: sizes 1.4 times as large, or what else can be made.

    A user's ``mesh`` is kept and its element pair changed. Raises :class:`MeshError` saying why there is none.
    """
    if isinstance(scenario.limb, MeshLimb):
        if scenario.element not in _OTHER_ORDER:
            raise MeshError(
                "a mesh of your own has one size, so that its error is estimated with another order, and of element "
                f"pair {scenario.element} neither second nor third order is one; set mesh.element to P2 or P3"
            )
        element, ratio = _OTHER_ORDER[scenario.element]
        return Second(scenario.changed({"mesh.element": element}), mesh, ratio)
    first: ForearmError | None = None
    for ratio in _RATIOS:
        try:
            other = cached_mesh(scenario, base=base, scale=ratio)
        except ForearmError as problem:
            first = first or problem
            continue
        if _differs(scenario, mesh, other, ratio):
            return Second(scenario, other, ratio)
    reason = first or "rims come out as fine on all of them; set mesh.size_contact smaller"
    raise MeshError(f"no second mesh could be made: {reason}")


def _differs(scenario: Scenario, mesh: TissueMesh, other: TissueMesh, ratio: float) -> bool:
    """True if all rims of rigid contacts differ by 0.4 of what ``ratio`` asks for at least: bisection halves edges."""
    if scenario.device.cone.contact not in RIGID:
        return True
    names = [name.removeprefix("contact ") for name in mesh.facets if name.startswith("contact ")]
    found = np.array([_rim_edge(other, name) / _rim_edge(mesh, name) for name in names])
    return bool(np.all((found - 1) * np.sign(ratio - 1) >= 0.4 * abs(ratio - 1)))


def _rim_edge(mesh: TissueMesh, name: str) -> float:
    """Mean length [m] of the edges of a contact's rim."""
    ends = mesh.points[rim_edges(mesh, name)]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())
